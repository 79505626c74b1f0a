"""Fallback to the strategy `motion` if no detector model is found."""

from __future__ import annotations

from collections.abc import Iterable

from hoid_bringup.run.parameter_names import full_names
from hoid_bringup.run.run_config import RunConfig
from hoid_common.errors import NoModelError
from hoid_detector.model.model_path import find_model

MOTION, STRATEGY = 'motion', 'filter.strategy'
NO_DETECTOR = (
    'detections: no detector model found, so dynamic objects are identified by motion alone; '
    'give --detector MODEL.onnx to remove people and handled objects that stand still, too'
)


def has_model() -> bool:
    """Return whether there is a default detector model; if none is found, try to download it.

    ModelError if HOID_MODEL names a missing model, or the download has a wrong digest.
    """
    try:
        find_model()
    except NoModelError:
        return False
    return True


def lacks_model(config: RunConfig, given: Iterable[str]) -> bool:
    """Return whether a run must use the strategy `motion` because no detector model is found.

    It is False if the strategy is among the `given` parameters; without a model, such a run fails.
    """
    changed = {full for name in given for full in full_names(name, config.values())}
    uses_default_model = config.needs_detections and not config.detector.model
    return uses_default_model and STRATEGY not in changed and not has_model()
