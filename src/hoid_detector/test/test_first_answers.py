"""Finished boxes whose columns and ids nothing states: no answer is misread in silence."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from hypothesis import event, example, given
from hypothesis import strategies as st
from numpy.typing import NDArray

from hoid_common.coco import COCO, COCO_IDS
from hoid_common.errors import ModelError
from hoid_common.values import Float32Array
from hoid_detector.model.decoders import Candidates
from hoid_detector.model.finished_boxes import TABLE_LAYOUTS
from hoid_detector.model.layouts import Layout, recognize
from hoid_detector.model.probe import Probe

SIZE_WH = (96, 64)
THRESHOLD = 0.25
LAYOUTS = [name for name in TABLE_LAYOUTS if 'xyxy' in name]  # that boxes can show
Row = tuple[float, float, float, float, float, int]  # x1, y1, x2, y2, score, class index
PERSON: Row = (10.5, 20.25, 30.5, 60.75, 0.9, COCO.index('person'))
CHAIR: Row = (50.5, 8.25, 90.5, 24.75, 0.6, COCO.index('chair'))
CUP: Row = (40.5, 30.25, 47.5, 38.75, 0.5, COCO.index('cup'))
IDS = {  # by convention: the ids of the class names
    'from_0': list(range(len(COCO))),
    'from_1': list(range(1, len(COCO) + 1)),
    'coco_91': list(COCO_IDS),
}


def table(rows: Sequence[Row], layout: str) -> Float32Array:
    """Return the (N, C) table of rows, with the columns in the order that a layout names."""
    values = np.array(rows, np.float32).reshape(-1, 6)
    parts = {
        'batch': np.zeros((len(values), 1), np.float32),
        'xyxy': values[:, :4],
        'score': values[:, 4:5],
        'class': values[:, 5:],
    }
    return np.hstack([parts[word] for word in layout.split('_')])


def recognized(layout: str) -> Layout:
    """Return the layout of a model whose answer to the test image has no box."""
    return recognize(Probe(SIZE_WH, ('output',), (table((), layout),), {}, None))


def read(layout: Layout, output: Float32Array) -> Candidates:
    return layout.decode([output], SIZE_WH, THRESHOLD)


def are(found: Candidates, rows: Sequence[Row]) -> bool:
    """Return whether the boxes are those of the rows, which are in pixels or fractions."""
    values = np.array(rows, np.float32).reshape(-1, 6)
    scale = np.array(SIZE_WH * 2) if np.abs(values[:, :4]).max(initial=0) <= 1 else 1
    return (
        found.class_ids.tolist() == values[:, 5].tolist()
        and np.array_equal(found.scores, values[:, 4])
        and np.allclose(found.boxes_xyxy_px, values[:, :4] * scale)
    )


@contextmanager
def warnings() -> Iterator[list[str]]:
    """Yield the list of the warnings that are logged in the block."""
    messages: list[str] = []

    class _Handler(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            messages.append(record.getMessage())

    logger, handler = logging.getLogger('hoid_detector'), _Handler(logging.WARNING)
    logger.addHandler(handler)
    try:
        yield messages
    finally:
        logger.removeHandler(handler)


def read_or_refused(
    layout: Layout, outputs: list[NDArray[Any]], messages: list[str]
) -> Candidates:
    """Return the boxes; if the outputs are refused, return none and add the message."""
    try:
        return layout.decode(outputs, SIZE_WH, THRESHOLD)
    except ModelError as error:
        messages.append(str(error))
        return read(recognized('xyxy_score_class'), table((), 'xyxy_score_class'))


@pytest.mark.parametrize('name', LAYOUTS)
@pytest.mark.parametrize('rows', [(PERSON,), (CHAIR,), (CHAIR, PERSON), (PERSON, PERSON, CUP)])
def test_the_first_box_shows_the_order_of_columns(name: str, rows: tuple[Row, ...]) -> None:
    layout = recognized(name)
    for _ in range(100):
        assert are(read(layout, table((), name)), ())
    assert are(read(layout, table(rows, name)), rows)
    assert are(read(layout, table((CHAIR, PERSON), name)), (CHAIR, PERSON))


@pytest.mark.parametrize('name', LAYOUTS)
@pytest.mark.parametrize('fill', [0, -1])
def test_padding_is_no_box(name: str, fill: float) -> None:
    layout = recognized(name)
    padding = np.full((50, table((), name).shape[1]), fill, np.float32)
    assert are(read(layout, padding), ())
    assert are(read(layout, np.vstack([table((PERSON,), name), padding])), (PERSON,))


@st.composite
def answers_of_one_network(draw: st.DrawFn) -> list[list[Row]]:
    """Return boxes in pixels, whole pixels or fractions, which often touch the image's edges."""
    unit = draw(st.sampled_from(['pixel', 'whole pixel', 'fraction']))
    width, height = (1, 1) if unit == 'fraction' else SIZE_WH
    ends = st.tuples(st.sampled_from([0.0, 0.9]) | st.floats(0, 0.9), st.floats(0.1, 1))

    def row() -> Row:
        (x1, dx), (y1, dy) = draw(ends), draw(ends)
        corners = [x1 * width, y1 * height, min(x1 + dx, 1) * width, min(y1 + dy, 1) * height]
        if unit == 'whole pixel':
            corners = [float(round(value)) for value in corners]
        score = draw(st.floats(0.25, 1) | st.just(1.0))
        return (*corners, score, draw(st.integers(0, 3) | st.integers(0, 79)))  # type: ignore[return-value]

    return [
        [row() for _ in range(draw(st.integers(1, 3)))] for _ in range(draw(st.integers(1, 3)))
    ]


@given(st.sampled_from(LAYOUTS), answers_of_one_network())
@example('xyxy_class_score', [[PERSON]])
@example('batch_class_score_xyxy', [[(0.0, 0.5, 0.25, 1.0, 0.5, 0)]])
def test_a_box_is_read_right_or_with_a_warning_or_refused(
    name: str, answers: list[list[Row]]
) -> None:
    layout = recognized(name)
    with warnings() as messages:
        for rows in answers:
            if not are(read_or_refused(layout, [table(rows, name)], messages), rows):
                assert any('"layout"' in message for message in messages)
                event('refused or warned')
                return
    event('right')


def separate(
    rows: Sequence[Row], ids: Sequence[int], kind: type[np.generic]
) -> list[NDArray[Any]]:
    """Return the outputs boxes, labels and scores, with the ids of all class names."""
    values = np.array(rows, np.float32).reshape(-1, 6)
    labels = np.array([ids[int(index)] for index in values[:, 5]], kind)
    return [values[:, :4], labels, values[:, 4]]


def recognized_separate(names: tuple[str, ...] | None = None) -> Layout:
    """Return what is recognized of three outputs that were empty for the test image."""
    empty = tuple(separate((), (), np.int64))
    return recognize(Probe(SIZE_WH, ('boxes', 'labels', 'scores'), empty, {}, names))


@given(
    st.sampled_from(sorted(IDS)),
    st.lists(st.lists(st.integers(0, 79), max_size=3), min_size=1, max_size=4),
    st.sampled_from([np.int64, np.float32]),
)
@example('from_0', [[], [56], [0]], np.int64)
@example('from_1', [[0], [0, 78]], np.int64)
def test_a_class_is_read_right_or_with_a_warning_or_refused(
    convention: str, answers: list[list[int]], kind: type[np.generic]
) -> None:
    layout = recognized_separate()
    with warnings() as messages:
        for classes in answers:
            rows = [(*PERSON[:5], index) for index in classes]
            outputs = separate(rows, IDS[convention], kind)
            if read_or_refused(layout, outputs, messages).class_ids.tolist() != classes:
                assert any('class_ids' in message for message in messages)
                return


@pytest.mark.parametrize('background', ['background', '__background__', 'N/A', '???'])
def test_ids_count_from_a_background_class(background: str) -> None:
    names = (background, 'car', 'person')
    layout = recognized_separate(names)
    rows = [(*PERSON[:5], 2), (*CHAIR[:5], 1)]
    found = layout.decode(separate(rows, range(3), np.int64), SIZE_WH, THRESHOLD)
    assert [names[index] for index in found.class_ids] == ['person', 'car']


def test_a_warning_is_logged_once() -> None:
    layout = recognized_separate()
    with warnings() as messages:
        for _ in range(5):
            layout.decode(separate((PERSON,), COCO_IDS, np.int64), SIZE_WH, THRESHOLD)
    (message,) = messages
    assert 'class ids coco_91, but may be columns xyxy_score_class, class ids from_0' in message
    assert 'the first row is 10.5 20.25 30.5 60.75 0.9 1;' in message


def test_centers_after_the_number_of_the_image_are_refused() -> None:
    """With three classes, the table has as many columns as one of queries."""
    centers = np.array([(x, y) for y in (0.2, 0.5, 0.8) for x in (0.1, 0.3, 0.5, 0.7)])
    scores = np.linspace(0.45, 0.95, len(centers))
    classes = np.arange(len(centers)) % 3
    sides = np.tile([0.11, 0.23], (len(centers), 1))
    rows = np.column_stack([0 * scores, scores, classes, centers, sides]).astype(np.float32)
    probe = Probe(SIZE_WH, ('output',), (rows[None],), {}, ('person', 'cup', 'chair'))
    with pytest.raises(ModelError, match='the answer fits no known order of columns'):
        recognize(probe)


@pytest.mark.parametrize('num_classes', [None, 1, 2, 3, 80])
@pytest.mark.parametrize('shape', [(0, 7), (0, 6), (1, 0, 6)])
def test_a_table_without_a_box_is_recognized(
    shape: tuple[int, ...], num_classes: int | None
) -> None:
    """As YOLOv7 exported with `--end2end --max-wh` answers a test image that shows nothing."""
    names = None if num_classes is None else COCO[:num_classes]
    for size_wh in ((640, 640), SIZE_WH):
        layout = recognize(Probe(size_wh, ('output',), (np.zeros(shape, np.float32),), {}, names))
        columns = 'batch_xyxy_class_score' if shape[-1] == 7 else 'xyxy_score_class'
        row = (10.5, 20.25, 30.5, 60.75, 0.9, 0)
        found = layout.decode([table((row,), columns)], size_wh, THRESHOLD)
        assert found.class_ids.tolist() == [0]
        np.testing.assert_allclose(found.boxes_xyxy_px, [row[:4]])
