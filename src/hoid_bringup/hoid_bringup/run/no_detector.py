"""A machine without a detector model: motion alone tells what moves."""

from __future__ import annotations

from collections.abc import Iterable

from hoid_bringup.run.parameter_names import full_name
from hoid_bringup.run.run_config import RunConfig
from hoid_common.errors import NoModelError
from hoid_detector.model.model_path import find_model

MOTION, STRATEGY = 'motion', 'filter.strategy'
NO_DETECTOR = (
    'detections: no detector model is found; what moves is told by motion alone. A detector would '
    'add people and handled objects that keep still (--detector MODEL.onnx)'
)


def has_model() -> bool:
    """Return whether a detector model is found where nobody asks for one.

    Raises:
        ModelError: The environment asks for one that does not exist.
    """
    try:
        find_model()
    except NoModelError:
        return False
    return True


def lacks_model(config: RunConfig, asked_for: Iterable[str]) -> bool:
    """Return whether a configuration is to go by motion, as no model is found.

    Args:
        config: What would run.
        asked_for: Names of the parameters that somebody set: a strategy that was asked for
            stays, and fails without its model.
    """
    known = [p.name for p in config.params()]
    asked = {full_name(name, known) for name in asked_for}
    by_default = config.needs_detections and not config.detector.model
    return by_default and STRATEGY not in asked and not has_model()
