"""Every export finds the boxes of the network itself, or is refused with a line that says why."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from hoid_common.coco import COCO
from hoid_common.errors import ModelError
from hoid_common.values import ByteArray, Detections
from hoid_detector.config import DetectorConfig
from hoid_detector.onnx_detector import OnnxDetector

from .export_graphs import Form, build, onnx, tiny_network, yolox_as_yolov8
from .exports import FORMS, NAMES, REFUSED, page

ROOT = Path(__file__).resolve().parents[3]
SHARED = ROOT.parent / 'shared'
MODELS = SHARED / 'models'
NETWORKS = {
    'yolov8n_int8': lambda path: onnx.load(str(path)),
    'yolox_nano': yolox_as_yolov8,
}
IMAGES = [SHARED / 'images' / f'{name}.jpg' for name in ('000000005193', 'bus', '000000009483')]
SIZE_WH = (96, 64)
RED = np.full((128, 192, 3), (0, 0, 255), np.uint8)  # fills the network input at scale 1/2
DARK = np.zeros_like(RED)
FOUND = {
    'person': (20, 40, 60, 120),
    'toothbrush': (4, 8, 36, 32),
    'chair': (100, 16, 180, 48),
}
BOXES = {
    COCO.index('person'): ((20, 40, 20, 40, 0.9), (21, 40, 20, 40, 0.8)),  # one over the other
    COCO.index('toothbrush'): ((10, 10, 16, 12, 0.7),),
    COCO.index('chair'): ((70, 16, 40, 16, 0.6),),
}


def detector_of(form: Form, path: Path, **parameters: Any) -> OnnxDetector:
    """Return a detector with the tiny network, which finds the boxes of FOUND in RED only."""
    build(tiny_network(SIZE_WH, BOXES), form, path)
    config = DetectorConfig(input_size_px=SIZE_WH[0], **form.parameters, **parameters)
    return OnnxDetector(path, config)


@pytest.mark.parametrize('name', FORMS)
def test_an_export_finds_the_boxes_of_the_network(name: str, tmp_path: Path) -> None:
    detector = detector_of(FORMS[name], tmp_path / 'model.onnx')
    assert str(detector.layout.preprocessing) == FORMS[name].preprocessing
    assert len(detector.detect(DARK, 0)) == 0
    for _ in range(2):
        found = detector.detect(RED, 0)
        assert found.class_names == tuple(FOUND)
        np.testing.assert_allclose(found.boxes_xyxy_px, list(FOUND.values()), atol=0.5)
        np.testing.assert_allclose(found.scores, [0.9, 0.7, 0.6], atol=0.01)
    assert len(detector.detect(DARK, 0)) == 0


@pytest.mark.parametrize('name', REFUSED)
def test_an_export_is_refused_with_a_line_that_says_why(name: str, tmp_path: Path) -> None:
    path = tmp_path / 'model.onnx'
    with pytest.raises(ModelError) as error:
        detector_of(REFUSED[name], path).detect(RED, 0)
    message = str(error.value)
    assert message.startswith(str(path))
    assert REFUSED[name].refused in message
    assert '\n' not in message


@pytest.mark.slow
@pytest.mark.skipif(not MODELS.is_dir(), reason='needs the models of ../shared')
@pytest.mark.parametrize('network', NETWORKS)
@pytest.mark.parametrize('name', [name for name in FORMS if FORMS[name].input != 'any size'])
def test_an_export_of_a_real_network_finds_the_people_of_the_original(
    name: str, network: str, tmp_path: Path
) -> None:
    model, path, form = MODELS / f'{network}.onnx', tmp_path / 'model.onnx', FORMS[name]
    build(NETWORKS[network](model), form, path)
    detector = OnnxDetector(path, DetectorConfig(**form.parameters))
    placement = detector.layout.preprocessing.placement
    original = OnnxDetector(model, DetectorConfig(letterbox=placement))
    # An 8-bit quantized network rounds its standardized input, which moves boxes by up to 2 px.
    tolerance_px = 3.0 if form.input == 'ImageNet' and 'int8' in network else 1.0
    for image in map(picture, IMAGES):
        people = people_xyxy_px(detector.detect(image, 0))
        expected = people_xyxy_px(original.detect(image, 0))
        assert len(people) == len(expected) > 0
        # Some exports round boxes to whole pixels of the network input.
        rounding_px = 0.51 * max(image.shape) / min(original.network.size_wh or ())
        np.testing.assert_allclose(people, expected, atol=max(tolerance_px, rounding_px))


@pytest.mark.parametrize('form', NAMES)
def test_class_names_are_read_in_every_form(form: str, tmp_path: Path) -> None:
    key, text = NAMES[form]
    model = FORMS['YOLOv8, cells first']._replace(metadata={key: text} if key else {})
    assert detector_of(model, tmp_path / 'model.onnx').class_names == COCO


@pytest.mark.parametrize('name', ['Person', 'human', 'PEDESTRIAN', 'people'])
def test_people_are_found_by_any_name(name: str, tmp_path: Path) -> None:
    names = {'names': str([name, *COCO[1:]])}
    model = FORMS['YOLOv8, cells first']._replace(metadata=names)
    detector = detector_of(model, tmp_path / 'model.onnx')
    assert detector.detect(RED, 0).class_names == tuple(FOUND)


def test_the_requested_layout_is_the_entry_of_this_name_that_matches(tmp_path: Path) -> None:
    form = FORMS['torchvision (ids of COCO)']
    detector = detector_of(form, tmp_path / 'model.onnx', layout='end_to_end')
    assert str(detector.layout.preprocessing) == form.preprocessing
    assert detector.detect(RED, 0).class_names == tuple(FOUND)


def test_many_images_without_a_box_are_reported_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    detector = detector_of(FORMS['YOLOX'], tmp_path / 'model.onnx')
    for _ in range(700):
        detector.detect(DARK, 0)
    assert len(detector.detect(RED, 0)) == len(FOUND)
    (message,) = (r.getMessage() for r in caplog.records if r.levelname == 'WARNING')
    assert 'nothing is detected in the first 300 images' in message
    assert message.endswith('"letterbox", now BGR 0-255, top_left')


def test_the_page_lists_all_exports() -> None:
    text = (ROOT / 'docs/reference/detector_exports.md').read_text()
    assert text[text.index('## Recognized') :] == page() + '\n'


def picture(path: Path) -> ByteArray:
    image = cv2.imread(str(path))
    assert image is not None
    return np.asarray(image, np.uint8)


def people_xyxy_px(found: Detections) -> list[list[float]]:
    names = found.class_names
    return sorted(
        b for b, n in zip(found.boxes_xyxy_px.tolist(), names, strict=True) if n == 'person'
    )
