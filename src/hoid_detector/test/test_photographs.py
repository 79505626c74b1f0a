"""Both real models on photographs, compared with boxes that a person read off."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from hoid_common.values import ByteArray, Detections
from hoid_detector.config import DetectorConfig
from hoid_detector.onnx_detector import OnnxDetector

SHARED = Path(__file__).resolve().parents[3].parent / 'shared'
MODELS = ('yolov8n_int8', 'yolox_nano')
YOLOV8, YOLOX = MODELS

pytestmark = pytest.mark.skipif(
    not (SHARED / 'models').is_dir(), reason='needs the models and pictures of ../shared'
)

Box = tuple[int, int, int, int]
# x1 y1 x2 y2 of the visible part, read off to about 5 px, and the models that detect it.
BOXES_BY_EYE: dict[str, tuple[tuple[str, Box, tuple[str, ...]], ...]] = {
    '000000009483': (
        ('person', (39, 62, 177, 480), MODELS),
        ('keyboard', (306, 317, 422, 361), MODELS),
        ('tv', (456, 212, 578, 350), MODELS),
        ('mouse', (375, 361, 408, 379), (YOLOV8,)),
    ),
    '000000005193': (
        ('person', (0, 86, 219, 425), MODELS),
        ('person', (290, 168, 402, 402), MODELS),
        ('person', (133, 115, 254, 425), (YOLOV8,)),
        ('surfboard', (241, 64, 340, 412), (YOLOV8,)),
    ),
    'bus': (
        ('person', (50, 400, 245, 900), MODELS),
        ('person', (224, 406, 343, 858), MODELS),
        ('person', (668, 398, 810, 880), (YOLOV8,)),
        ('bus', (8, 232, 800, 738), MODELS),
    ),
    '000000003934': (
        ('person', (60, 147, 216, 458), MODELS),
        ('couch', (135, 210, 375, 360), MODELS),
        ('person', (153, 85, 205, 232), (YOLOX,)),
    ),
    '000000009400': (
        ('person', (312, 88, 457, 287), MODELS),
        ('person', (143, 92, 280, 268), (YOLOV8,)),
        ('laptop', (70, 305, 262, 480), MODELS),
    ),
    '000000000139': (
        ('tv', (7, 167, 154, 261), MODELS),
        ('chair', (292, 218, 351, 315), (YOLOV8,)),
        ('person', (415, 157, 467, 296), (YOLOV8,)),
    ),
    '000000002431': (
        ('wine glass', (306, 0, 430, 212), MODELS),
        ('knife', (180, 117, 246, 193), MODELS),
    ),
    '000000005060': (('person', (160, 308, 322, 497), (YOLOX,)),),
    '000000004134': (
        ('person', (46, 44, 312, 425), MODELS),
        ('person', (237, 47, 583, 425), MODELS),
        ('tie', (395, 190, 432, 360), (YOLOV8,)),
    ),
}


@pytest.fixture(scope='module', params=MODELS)
def detector(request: pytest.FixtureRequest) -> OnnxDetector:
    return OnnxDetector(SHARED / 'models' / f'{request.param}.onnx', DetectorConfig())


def photograph(name: str) -> ByteArray:
    image = cv2.imread(str(SHARED / 'images' / f'{name}.jpg'))
    assert image is not None
    return image.astype(np.uint8, copy=False)


def best_iou(found: Detections, name: str, box: Box) -> float:
    own = found.boxes_xyxy_px[[n == name for n in found.class_names]].astype(np.float64)
    true = np.array(box, np.float64)
    sides = np.minimum(own[:, 2:], true[2:]) - np.maximum(own[:, :2], true[:2])
    shared = np.maximum(sides, 0).prod(axis=1)
    areas = (own[:, 2:] - own[:, :2]).prod(axis=1) + (true[2:] - true[:2]).prod()
    return float((shared / (areas - shared)).max(initial=0.0))


@pytest.mark.parametrize('picture', BOXES_BY_EYE)
def test_objects_are_detected_where_they_are(picture: str, detector: OnnxDetector) -> None:
    found = detector.detect(photograph(picture), 0)
    model = detector.network.path.stem
    ious = {
        f'{name} {box}': round(best_iou(found, name, box), 2)
        for name, box, models in BOXES_BY_EYE[picture]
        if model in models
    }
    assert {what: value for what, value in ious.items() if value < 0.8} == {}


def test_same_image_gives_the_same_bytes(detector: OnnxDetector) -> None:
    image = photograph('bus')
    first, second = detector.detect(image, 0), detector.detect(image, 0)
    assert first.boxes_xyxy_px.tobytes() == second.boxes_xyxy_px.tobytes()
    assert first.scores.tobytes() == second.scores.tobytes()
