"""Even choice of features: many corners in, a budget of well-spread ones out."""

from __future__ import annotations

import numpy as np

from hoid_common.values import IntArray


def octave_budgets(num_features: int, num_levels: int, scale_factor: float) -> IntArray:
    """Return the features of each octave, (num_levels,), in proportion to 1 / scale."""
    weights = scale_factor ** -np.arange(num_levels, dtype=np.float64)
    ends = np.round(np.cumsum(weights) / weights.sum() * num_features).astype(np.int64)
    return np.concatenate([ends[:1], ends[1:] - ends[:-1]])
