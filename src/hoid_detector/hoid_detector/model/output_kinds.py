"""Kinds of network outputs, recognized by lower-case name, shape, type and values."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_CLASS_WORDS = ('label', 'class', 'cls', 'logit', 'score')


def is_boxes(name: str, output: NDArray[Any]) -> bool:
    """Return whether an output contains boxes, and not the scores of four classes."""
    has_shape = output.ndim >= 2 and output.shape[-1] == 4
    return has_shape and ('box' in name or not any(word in name for word in _CLASS_WORDS))


def is_logits(name: str, output: NDArray[Any]) -> bool:
    return _is_class_table(name, output) and ('logit' in name or bool((output < 0).any()))


def is_class_scores(name: str, output: NDArray[Any]) -> bool:
    return _is_class_table(name, output) and bool(((output >= 0) & (output <= 1)).all())


def is_count(name: str, output: NDArray[Any]) -> bool:
    return 'num' in name and output.size == 1


def is_labels(name: str, output: NDArray[Any]) -> bool:
    if is_count(name, output) or is_boxes(name, output) or output.ndim > 2:
        return False
    return output.dtype.kind == 'i' or any(word in name for word in ('label', 'class', 'cls'))


def is_scores(name: str, output: NDArray[Any]) -> bool:
    taken = is_count(name, output) or is_boxes(name, output) or is_labels(name, output)
    return not taken and output.ndim <= 2 and output.dtype.kind == 'f'


def _is_class_table(name: str, output: NDArray[Any]) -> bool:
    return output.ndim == 3 and not is_boxes(name, output)


def is_no_object_last(logits: NDArray[Any]) -> bool:
    """Return whether logits (1, N, C) of noise are of a softmax that ends with "no object".

    Such a network finds "no object" in noise; one with a sigmoid per class has no strong class
    there.
    """
    is_last = logits.argmax(axis=-1) == logits.shape[-1] - 1
    return 2 * int(np.count_nonzero(is_last)) > int(is_last.size)
