"""Class names of a model, from a file or from the model's metadata, and the names of COCO."""

from __future__ import annotations

import ast
from collections.abc import Mapping
from pathlib import Path

from hoid_common.errors import InputError, ModelError
from hoid_common.io.untrusted import read_text

COCO = (
    'person', 'bicycle', 'car', 'motorcycle', 'airplane', 'bus', 'train', 'truck', 'boat',
    'traffic light', 'fire hydrant', 'stop sign', 'parking meter', 'bench', 'bird', 'cat', 'dog',
    'horse', 'sheep', 'cow', 'elephant', 'bear', 'zebra', 'giraffe', 'backpack', 'umbrella',
    'handbag', 'tie', 'suitcase', 'frisbee', 'skis', 'snowboard', 'sports ball', 'kite',
    'baseball bat', 'baseball glove', 'skateboard', 'surfboard', 'tennis racket', 'bottle',
    'wine glass', 'cup', 'fork', 'knife', 'spoon', 'bowl', 'banana', 'apple', 'sandwich', 'orange',
    'broccoli', 'carrot', 'hot dog', 'pizza', 'donut', 'cake', 'chair', 'couch', 'potted plant',
    'bed', 'dining table', 'toilet', 'tv', 'laptop', 'mouse', 'remote', 'keyboard', 'cell phone',
    'microwave', 'oven', 'toaster', 'sink', 'refrigerator', 'book', 'clock', 'vase', 'scissors',
    'teddy bear', 'hair drier', 'toothbrush',
)  # fmt: skip

_MAX_FILE_BYTES = 1_000_000  # chosen: far above any list of class names
# Keys that exporters use; Ultralytics writes `names`.
_METADATA_KEYS = ('names', 'class_names', 'classes', 'labels')


def known_names(file: str, metadata: Mapping[str, str]) -> tuple[str, ...] | None:
    """Return the names in the file if there is one, else those in the metadata, else None."""
    return names_in_file(Path(file)) if file else names_in_metadata(metadata)


def names_in_file(path: Path) -> tuple[str, ...]:
    """Return the names in a text file, one a line; raise ModelError if there are none."""
    try:
        lines = read_text(path, _MAX_FILE_BYTES).splitlines()
    except InputError as error:
        raise ModelError(f'class_names_file {error}') from error
    names = tuple(line.strip() for line in lines if line.strip())
    if not names:
        raise ModelError(f'class_names_file {path} is empty: write one class name a line')
    return names


def names_in_metadata(metadata: Mapping[str, str]) -> tuple[str, ...] | None:
    """Return the names in a model's metadata: a dict or list literal, or names with commas.

    Raises:
        ModelError: The metadata have such a key, but no list of names.
    """
    for key in _METADATA_KEYS:
        if text := metadata.get(key):
            return _parse(key, text)
    return None


def _parse(key: str, text: str) -> tuple[str, ...]:
    try:
        value = ast.literal_eval(text)
    except (ValueError, TypeError, SyntaxError, MemoryError, RecursionError):
        value = [name.strip() for name in text.split(',')]
    if isinstance(value, dict):
        by_index = {str(index): name for index, name in value.items()}
        if by_index.keys() != {str(index) for index in range(len(value))}:
            raise ModelError(f'model metadata "{key}": class indices {[*value]} have gaps')
        value = [by_index[str(index)] for index in range(len(value))]
    if not isinstance(value, list | tuple) or not value:
        raise ModelError(f'model metadata "{key}" is no list of class names: {text[:60]!r}')
    return tuple(str(name) for name in value)
