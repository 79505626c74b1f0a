"""The synthetic detector on rendered scenes that it was not trained on."""

import pytest

from hoid_detector.config import DetectorConfig
from hoid_detector.model.model_path import SYNTHETIC, find_model
from hoid_detector.onnx_detector import OnnxDetector
from hoid_synth.config import SceneConfig
from hoid_training.dataset import CLASSES
from hoid_training.evaluate import Tally, measure

SCENE = SceneConfig(  # training uses seeds from 100000 on
    seed=900, num_frames=120, width_px=416, depth_holes=False
)
FRAMES = 8


@pytest.fixture(scope='module')
def detector() -> OnnxDetector:
    return OnnxDetector(find_model(SYNTHETIC), DetectorConfig())


@pytest.fixture(scope='module')
def tally(detector: OnnxDetector) -> Tally:
    return measure(detector, [SCENE], FRAMES)[0]


def test_the_model_states_its_input_size_and_classes(detector: OnnxDetector) -> None:
    assert detector.layout.name == 'yolov8'
    assert detector.class_names == CLASSES
    assert detector.network.path.stat().st_size <= 1_500_000


@pytest.mark.slow
def test_people_are_found(tally: Tally) -> None:
    people = tally.people()
    assert people.asked >= FRAMES
    assert people.recall >= 0.9
    assert people.precision >= 0.9


@pytest.mark.slow
def test_objects_are_found(tally: Tally) -> None:
    objects = tally.objects()
    assert objects.asked >= 8 * FRAMES
    assert objects.recall >= 0.85
    assert objects.precision >= 0.85
