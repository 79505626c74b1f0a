"""Random mutations of messages, by field or by byte, repeatable by seed."""

from __future__ import annotations

import copy
from array import array
from contextlib import suppress
from typing import Any

import numpy as np
from rclpy.serialization import serialize_message

from hoid_benchmarks.faults.damage import Rng, damaged

_NUMBERS = (0, 1, 2**31 - 1, 2**32 - 1, 2**63 - 1, -1, -(2**31))
_FLOATS = (float('nan'), float('inf'), -float('inf'), 0.0, -1.0, 1e-300, 1e300)
_TEXTS = ('', 'x' * 10_000, 'é\u202e\x00', '../../etc/passwd', '%s%n')


def mutated(msg: Any, rng: Rng) -> bytes:
    """Return the CDR bytes of a message in which one field or some bytes are changed."""
    if rng.random() < 0.5:
        return damaged(serialize_message(msg), rng)
    data: bytes = serialize_message(msg)
    changed = copy.deepcopy(msg)
    # If a value does not fit the field, the setter or the serializer raises one of these.
    with suppress(AssertionError, ValueError, TypeError, OverflowError, SystemError):
        _change(changed, rng)
        data = serialize_message(changed)
    return data


def _change(msg: Any, rng: Rng) -> None:
    """Change one field at any depth; raises an exception if the value does not fit."""
    names = list(msg.get_fields_and_field_types())
    name = names[int(rng.integers(len(names)))]
    value = getattr(msg, name)
    if hasattr(value, 'get_fields_and_field_types'):
        _change(value, rng)
    elif isinstance(value, list) and value and hasattr(value[0], 'get_fields_and_field_types'):
        _change(value[int(rng.integers(len(value)))], rng)
    else:
        setattr(msg, name, _other(value, rng))


def _other(value: Any, rng: Rng) -> Any:
    """Return an abnormal value of the same type."""
    if isinstance(value, bool):
        return not value
    for kind, others in ((int, _NUMBERS), (float, _FLOATS), (str, _TEXTS)):
        if isinstance(value, kind):
            return others[int(rng.integers(len(others)))]
    if isinstance(value, np.ndarray):  # an array of fixed length
        with np.errstate(over='ignore'):  # the largest values overflow to infinity as float32
            return np.full_like(value, _FLOATS[int(rng.integers(len(_FLOATS)))])
    return _array(value, rng) if isinstance(value, array) else value


def _array(values: array[Any], rng: Rng) -> array[Any]:
    if values.typecode != 'f' or not values or rng.random() < 0.5:
        return values[: int(rng.integers(len(values) + 1))]
    out = array('f', values)
    out[int(rng.integers(len(out)))] = float('nan')
    return out
