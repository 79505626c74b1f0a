"""Any outputs of a network are either decoded or refused by a ModelError."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import event, example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray

from hoid_common.errors import ModelError
from hoid_detector.model.layouts import LAYOUTS, recognize
from hoid_detector.model.probe import AUTO, Probe

pytestmark = pytest.mark.slow

SIZE_WH = (96, 64)
NAMES = st.sampled_from(['output0', 'boxes', 'pred_boxes', 'logits', 'labels', 'scores', 'num'])
SHAPES = st.lists(st.sampled_from([0, 1, 2, 4, 5, 6, 7, 20]), max_size=3).map(tuple)
TYPES = st.sampled_from([np.float32, np.float16, np.int64])
VALUES = st.sampled_from([0.0, 1.0, 0.5, -3.0, 700.0, np.nan, np.inf])
REQUESTED = st.sampled_from([AUTO, *(layout.name for layout in LAYOUTS)])

Shapes = dict[str, tuple[int, ...]]
Outputs = tuple[tuple[str, ...], tuple[NDArray[Any], ...]]


@st.composite
def known_shapes(draw: st.DrawFn) -> Shapes:
    """Return output names and shapes of a known layout, sometimes with one wrong side length."""
    num = draw(st.sampled_from([0, 1, 20, 126, 378]))  # a grid of this size has 126 cells
    classes = draw(st.sampled_from([0, 1, 3, 80]))
    forms: list[Shapes] = [
        {'output0': (1, 4 + classes, num)},
        {'output0': (1, num, 5 + classes)},
        {'output0': (1, num, 6)},
        {'output0': (num, 7)},
        {'boxes': (1, num, 4), 'labels': (1, num), 'scores': (1, num)},
        {'num': (1, 1), 'boxes': (1, num, 4), 'labels': (1, num), 'scores': (1, num)},
        {'logits': (1, num, classes), 'pred_boxes': (1, num, 4)},
    ]
    shapes = draw(st.sampled_from(forms))
    if draw(st.integers(0, 3)) == 0:
        name = draw(st.sampled_from(sorted(shapes)))
        wrong = list(shapes[name])
        wrong[draw(st.integers(0, len(wrong) - 1))] += 1
        shapes[name] = tuple(wrong)
    return shapes


@st.composite
def outputs(draw: st.DrawFn) -> Outputs:
    shapes = draw(known_shapes() | st.dictionaries(NAMES, SHAPES, min_size=1, max_size=4))
    return tuple(shapes), tuple(draw(output(shape)) for shape in shapes.values())


@st.composite
def output(draw: st.DrawFn, shape: tuple[int, ...]) -> NDArray[Any]:
    kind = draw(TYPES)
    if kind is np.int64:
        return draw(arrays.arrays(kind, shape, elements=st.integers(-1, 90), fill=st.just(0)))
    return draw(arrays.arrays(np.float32, shape, elements=VALUES, fill=VALUES)).astype(kind)


def zeros(shapes: Shapes) -> Outputs:
    return tuple(shapes), tuple(np.zeros(shape, np.float32) for shape in shapes.values())


@settings(max_examples=300)
@example(zeros({'logits': (1, 5, 0), 'boxes': (1, 5, 4)}), AUTO, None)
@example(zeros({'logits': (1, 5, 3), 'boxes': (1, 4, 4)}), AUTO, None)
@example(zeros({'labels': (1, 5), 'scores': (1, 4), 'boxes': (1, 5, 4)}), AUTO, None)
@given(outputs(), REQUESTED, st.sampled_from([None, 1, 3, 80]))
def test_outputs_are_decoded_or_refused(
    network: Outputs, requested: str, num_classes: int | None
) -> None:
    names = None if num_classes is None else ('person',) * num_classes
    probe = Probe(SIZE_WH, *network, metadata={}, class_names=names)
    try:
        layout = recognize(probe, requested)
        event(layout.name)
        with np.errstate(over='ignore', invalid='ignore'):  # as the detector does
            found = layout.decode(list(probe.outputs), SIZE_WH, 0.25)
    except ModelError:
        return
    num = len(found.scores)
    assert found.boxes_xyxy_px.shape == (num, 4)
    assert found.class_ids.shape == (num,)
    assert not (found.scores < 0.25).any()
