"""A real network, its answer written as exporters write it, finds the people of the original."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import pytest

from hoid_common.coco import COCO, COCO_IDS
from hoid_common.errors import ModelError
from hoid_common.values import ByteArray, Detections
from hoid_detector.config import DetectorConfig
from hoid_detector.onnx_detector import OnnxDetector

SHARED = Path(__file__).resolve().parents[3].parent / 'shared'
MODEL = SHARED / 'models' / 'yolov8n_int8.onnx'
IMAGES = [SHARED / 'images' / f'{name}.jpg' for name in ('000000005193', 'bus', '000000009483')]

pytestmark = pytest.mark.skipif(not MODEL.is_file(), reason='needs the model of ../shared')


class Export(NamedTuple):
    """A form in which boxes are exported."""

    outputs: Mapping[str, tuple[str, ...]]  # parts by output; one part is squeezed to (N,)
    is_batched: bool = False
    first_id: int = 0
    coco_ids: bool = False
    normalized: bool = False
    names: str | None = None  # in the metadata; None: none


TORCHVISION = {'boxes': ('xyxy',), 'labels': ('class',), 'scores': ('score',)}
TENSORFLOW = {
    'detection_anchor_indices': ('batch',), 'detection_boxes': ('yxyx',),
    'detection_classes': ('class',), 'detection_scores': ('score',),
}  # fmt: skip
NAMES = repr(dict(enumerate(COCO)))
EXPORTS = {
    'YOLO-NAS': Export({'graph2_flat_predictions': ('batch', 'xyxy', 'score', 'class')}),
    'YOLOv7': Export({'output': ('batch', 'xyxy', 'class', 'score')}),
    'PINTO': Export({'batchno_classid_score_x1y1x2y2': ('batch', 'class', 'score', 'xyxy')}),
    'PINTO, y first': Export({'batchno_classid_score_yxyx': ('batch', 'class', 'score', 'yxyx')}),
    'label first': Export({'label_xyxy_score': ('class', 'xyxy', 'score')}, normalized=True),
    'unnamed class, score': Export({'o': ('batch', 'class', 'score', 'xyxy')}, names=NAMES),
    'unnamed 6 columns': Export({'o': ('xyxy', 'class', 'score')}, is_batched=True),
    'unnamed score, class': Export({'o': ('batch', 'xyxy', 'score', 'class')}, normalized=True),
    'torchvision': Export(TORCHVISION, coco_ids=True),
    'labels from 1': Export(TORCHVISION, first_id=1),
    'labels from 0': Export(TORCHVISION),
    'named labels from 0': Export(TORCHVISION, names=NAMES),
    'TensorFlow': Export(TENSORFLOW, is_batched=True, coco_ids=True, normalized=True),
    'batched labels from 1': Export(TORCHVISION, is_batched=True, first_id=1),
    'names as YAML': Export(TORCHVISION, names='\n'.join(f'{i}: {n}' for i, n in enumerate(COCO))),
    'Person': Export(TORCHVISION, names=NAMES.replace('person', 'Person')),
    'people': Export({'o': ('xyxy', 'score', 'class')}, names=NAMES.replace('person', 'People')),
}  # fmt: skip


@pytest.fixture(scope='module')
def originals() -> list[Detections]:
    detector = OnnxDetector(MODEL, DetectorConfig())
    return [detector.detect(picture(path), 0) for path in IMAGES]


@pytest.mark.parametrize('form', EXPORTS)
def test_every_export_finds_the_people_of_the_original(
    form: str, originals: list[Detections], tmp_path: Path
) -> None:
    path = tmp_path / 'model.onnx'
    save(path, EXPORTS[form])
    detector = OnnxDetector(path, DetectorConfig(letterbox='centered'))
    for image, original in zip(IMAGES, originals, strict=True):
        found = detector.detect(picture(image), 0)
        people, expected = people_xyxy_px(found), people_xyxy_px(original)
        assert len(people) == len(expected) > 0
        np.testing.assert_allclose(people, expected, atol=1.0)


@pytest.mark.parametrize('form', ['torchvision', 'TensorFlow', 'PINTO', 'labels from 0'])
def test_all_classes_have_the_names_of_the_original(
    form: str, originals: list[Detections], tmp_path: Path
) -> None:
    path = tmp_path / 'model.onnx'
    save(path, EXPORTS[form])
    detector = OnnxDetector(path, DetectorConfig(letterbox='centered'))
    for image, original in zip(IMAGES, originals, strict=True):
        found = detector.detect(picture(image), 0)
        assert set(found.class_names) >= set(original.class_names)


def test_columns_that_fit_no_known_order_are_refused_with_what_was_seen(tmp_path: Path) -> None:
    path = tmp_path / 'model.onnx'
    save(path, Export({'o': ('score', 'xyxy', 'class', 'batch')}))
    detector = OnnxDetector(path, DetectorConfig())
    with pytest.raises(ModelError, match=r'first row is 0\.\d+ .*"layout" to one of') as error:
        detector.detect(picture(IMAGES[0]), 0)
    assert str(path) in str(error.value)


def test_the_parameter_layout_sets_the_order_of_columns(tmp_path: Path) -> None:
    path = tmp_path / 'model.onnx'
    save(path, Export({'o': ('batch', 'class', 'score', 'xyxy')}))
    image = picture(IMAGES[0])
    detector = OnnxDetector(path, DetectorConfig(layout='batch_class_score_xyxy'))
    assert 'person' in detector.detect(image, 0).class_names
    detector = OnnxDetector(path, DetectorConfig(layout='batch_xyxy_score_class'))
    with pytest.raises(ModelError, match='fits no known order of columns'):
        detector.detect(image, 0)


def picture(path: Path) -> ByteArray:
    image = cv2.imread(str(path))
    assert image is not None
    return np.asarray(image, np.uint8)


def people_xyxy_px(found: Detections) -> list[list[float]]:
    names = found.class_names
    return sorted(
        b for b, n in zip(found.boxes_xyxy_px.tolist(), names, strict=True) if n == 'person'
    )


def save(path: Path, form: Export) -> None:
    """Write the network with non-maximum suppression and the outputs of a form."""
    onnx = pytest.importorskip('onnx')
    model = onnx.load(str(MODEL))
    graph, helper, kind = model.graph, onnx.helper, onnx.TensorProto
    output = graph.output[0].name

    def constant(value: Any) -> str:
        name = f'x_const_{len(graph.initializer)}'
        graph.initializer.append(onnx.numpy_helper.from_array(np.asarray(value), name))
        return name

    def node(op: str, *inputs: str, name: str | None = None, **attributes: Any) -> str:
        name = name or f'x_{len(graph.node)}'
        graph.node.append(helper.make_node(op, list(inputs), [name], **attributes))
        return name

    def channels(begin: int, end: int) -> str:
        return node('Slice', output, *(constant(np.array([v])) for v in (begin, end, 1)))

    center, half = channels(0, 2), node('Mul', channels(2, 4), constant(np.float32(0.5)))
    scores = channels(4, 84)
    corners = node('Sub', center, half), node('Add', center, half)
    boxes = node('Transpose', node('Concat', *corners, axis=1), perm=[0, 2, 1])
    limits = (
        constant(np.array([50])),
        constant(np.array([0.45], np.float32)),
        constant(np.array([0.25], np.float32)),
    )
    chosen = node('NonMaxSuppression', boxes, scores, *limits)
    ids = node('Gather', chosen, constant(np.array([1])), axis=1)
    rows = node('Gather', chosen, constant(np.array(2)), axis=1)
    xyxy = node('Gather', node('Squeeze', boxes, constant(np.array([0]))), rows, axis=0)
    if form.normalized:
        xyxy = node('Div', xyxy, constant(np.float32(640)))
    score = node('Unsqueeze', node('GatherND', scores, chosen), constant(np.array([1])))
    first = node('Add', ids, constant(np.array(form.first_id)))
    numbers = node('Gather', constant(np.array(COCO_IDS)), ids) if form.coco_ids else first
    parts = {
        'xyxy': xyxy,
        'yxyx': node('Gather', xyxy, constant(np.array([1, 0, 3, 2])), axis=1),
        'score': score,
        'class': node('Cast', numbers, to=kind.FLOAT),
        'batch': node('Mul', score, constant(np.float32(0))),
    }
    del graph.output[:]
    for name, columns in form.outputs.items():
        value = node('Concat', *(parts[part] for part in columns), axis=1)
        if len(columns) == 1 and columns[0] not in ('xyxy', 'yxyx'):
            value = node('Squeeze', value, constant(np.array([1])))
        if form.is_batched:
            value = node('Unsqueeze', value, constant(np.array([0])))
        node('Identity', value, name=name)
        graph.output.append(helper.make_tensor_value_info(name, kind.FLOAT, None))
    del model.metadata_props[:]
    helper.set_model_props(model, {'names': form.names} if form.names else {})
    onnx.save(model, str(path))
