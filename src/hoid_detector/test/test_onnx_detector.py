"""The detector: boxes, class names, parameters that change at run time, and invalid input."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hoid_common.errors import ConfigError, MessageError, ModelError
from hoid_detector.config import DetectorConfig
from hoid_detector.onnx_detector import OnnxDetector

IMAGE = np.full((128, 192, 3), 60, np.uint8)


def table(*rows: tuple[float, ...]) -> dict[str, Any]:
    """Return an end-to-end output: x1, y1, x2, y2 of the 96 x 64 input, score, class."""
    return {'output0': np.array(rows, np.float32)[None]}


ROWS = (
    (10.0, 20.0, 30.0, 60.0, 0.9, 0.0),
    (50.0, 8.0, 90.0, 24.0, 0.6, 2.0),
    (40.0, 8.0, 60.0, 24.0, 0.3, 56.0),
)


def test_thresholds_and_classes_change_at_run_time(make_model: Any) -> None:
    detector = OnnxDetector(make_model(table(*ROWS)), DetectorConfig())
    assert detector.detect(IMAGE, 0).class_names == ('person', 'car', 'chair')
    detector.reconfigure(DetectorConfig(score_threshold=0.5))
    assert detector.detect(IMAGE, 0).class_names == ('person', 'car')
    detector.reconfigure(DetectorConfig(classes=('chair', 'person')))
    assert detector.detect(IMAGE, 0).class_names == ('person', 'chair')
    with pytest.raises(ConfigError, match='the model knows no "unicorn"'):
        detector.reconfigure(DetectorConfig(classes=('unicorn',)))
    assert detector.config.classes == ('chair', 'person')


def test_of_many_boxes_the_hundred_of_highest_score_are_reported(make_model: Any) -> None:
    scores = np.linspace(0.3, 0.9, 130)
    rows = [(10.0 + n % 60, 8.0, 30.0 + n % 60, 24.0, s, 0.0) for n, s in enumerate(scores)]
    found = OnnxDetector(make_model(table(*rows)), DetectorConfig()).detect(IMAGE, 0)
    np.testing.assert_allclose(found.scores, scores[:-101:-1], rtol=1e-6)


def test_nms_threshold_changes_at_run_time(make_model: Any) -> None:
    output = np.zeros((1, 84, 126), np.float32)
    output[0, :4, 5] = (48, 32, 20, 20)
    output[0, :4, 6] = (53, 32, 20, 20)  # IoU 0.6
    output[0, 4, 5:7] = 0.9, 0.8
    detector = OnnxDetector(make_model({'output0': output}), DetectorConfig())
    assert len(detector.detect(IMAGE, 0)) == 1
    detector.reconfigure(DetectorConfig(nms_iou=0.7))
    assert len(detector.detect(IMAGE, 0)) == 2


def test_unusable_boxes_are_dropped_and_the_others_clipped(make_model: Any) -> None:
    rows = (
        (-20.0, -20.0, 48.0, 100.0, 1.05, 0.0),
        (10.0, np.nan, 20.0, 20.0, 0.9, 0.0),
        (10.0, 10.0, np.inf, 20.0, 0.9, 0.0),
        (30.0, 10.0, 20.0, 20.0, 0.9, 0.0),  # inverted
        (200.0, 10.0, 220.0, 20.0, 0.9, 0.0),  # outside
        (10.0, 10.0, 20.0, 20.0, np.nan, 0.0),
        (10.0, 10.0, 20.0, 20.0, 0.9, -1.0),
        (10.0, 10.0, 20.0, 20.0, 0.8, 79.0),
    )
    found = OnnxDetector(make_model(table(*rows)), DetectorConfig()).detect(IMAGE, 0)
    assert found.class_names == ('person', 'toothbrush')
    np.testing.assert_array_equal(found.boxes_xyxy_px[0], [0, 0, 96, 128])
    np.testing.assert_array_equal(found.scores, np.array([1.0, 0.8], np.float32))


def test_boxes_are_corrected_for_the_padding(make_model: Any) -> None:
    detector = OnnxDetector(make_model(table((36.0, 0.0, 48.0, 32.0, 0.9, 0.0))), DetectorConfig())
    found = detector.detect(np.zeros((128, 64, 3), np.uint8), 0)  # 32 x 64, between 32 wide pads
    np.testing.assert_allclose(found.boxes_xyxy_px, [[8, 0, 32, 64]])


def test_class_names_come_from_metadata_file_or_coco(make_model: Any, tmp_path: Path) -> None:
    rows = table((10.0, 20.0, 30.0, 60.0, 0.9, 1.0))
    assert OnnxDetector(make_model(rows), DetectorConfig()).class_names[77] == 'teddy bear'
    for text in ("{0: 'person', 1: 'b'}", '["Person", "b"]', 'people, b'):
        path = make_model(rows, metadata={'names': text})
        assert OnnxDetector(path, DetectorConfig()).class_names == ('person', 'b')
    file = tmp_path / 'names.txt'
    file.write_text('x\ny z\n\n', encoding='utf-8')
    config = DetectorConfig(class_names_file=str(file), person_names=())
    assert OnnxDetector(path, config).detect(IMAGE, 0).class_names == ('y z',)


@pytest.mark.parametrize(
    ('metadata', 'names', 'message'),
    [
        ({}, None, 'has 3 classes and does not name them: set class_names_file'),
        ({'names': "{0: 'a', 2: 'b'}"}, None, r'class indices \[0, 2\] have gaps'),
        ({'names': '7'}, None, 'is no list of class names'),
        ({'names': "['a']"}, None, 'and 1 class names'),
        ({}, '', 'is empty: write one class name a line'),
        ({}, ' \n\n', 'is empty: write one class name a line'),
        ({}, 'person\n \ncup\n', 'names.txt: line 2 is empty, which would shift the classes'),
    ],
)
def test_wrong_class_names_are_refused(
    metadata: dict[str, str], names: str | None, message: str, make_model: Any, tmp_path: Path
) -> None:
    file = tmp_path / 'names.txt'
    if names is not None:
        file.write_text(names, encoding='utf-8')
    path = make_model({'output0': np.zeros((1, 7, 126), np.float32)}, metadata=metadata)
    config = DetectorConfig(class_names_file=str(file) if names is not None else '')
    with pytest.raises(ModelError, match=message):
        OnnxDetector(path, config)


def test_a_model_without_people_or_for_another_task_is_refused(make_model: Any) -> None:
    path = make_model(table(*ROWS[:2]), metadata={'names': "{0: 'cat', 1: 'cup', 2: 'car'}"})
    with pytest.raises(ModelError, match=r'the classes are cat, cup, car: .* person_names'):
        OnnxDetector(path, DetectorConfig())
    detector = OnnxDetector(path, DetectorConfig(person_names=('Cat',), class_ids='from_0'))
    assert 'person' in detector.class_names
    path = make_model(table(*ROWS), metadata={'task': 'obb'})
    with pytest.raises(ModelError, match='is a model for the task "obb"'):
        OnnxDetector(path, DetectorConfig())


def test_class_ids_beyond_the_names_are_refused_with_the_ids(make_model: Any) -> None:
    path = make_model(table((10.0, 10.0, 20.0, 20.0, 0.8, 592.0)))
    with pytest.raises(ModelError, match='contains the class ids 592, which do not fit'):
        OnnxDetector(path, DetectorConfig())


@pytest.mark.parametrize(
    ('content', 'message'), [(None, 'does not exist'), (b'no model', 'is no usable ONNX model')]
)
def test_unreadable_model_is_refused(content: bytes | None, message: str, tmp_path: Path) -> None:
    path = tmp_path / 'broken.onnx'
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ModelError, match=message) as error:
        OnnxDetector(path, DetectorConfig())
    assert '\n' not in str(error.value)


def test_a_model_for_huge_images_is_refused(make_model: Any) -> None:
    with pytest.raises(ModelError, match='has an input of 100000x64 px, more than 4096 a side'):
        OnnxDetector(make_model(table(*ROWS), size_wh=(100_000, 64)), DetectorConfig())


def test_wrong_image_is_refused(make_model: Any) -> None:
    detector = OnnxDetector(make_model(table(*ROWS)), DetectorConfig())
    with pytest.raises(MessageError, match=r'got \(4, 4\)'):
        detector.detect(np.zeros((4, 4), np.uint8), 0)
    with pytest.raises(MessageError, match=r'got \(0, 4, 3\)'):
        detector.detect(np.zeros((0, 4, 3), np.uint8), 0)


def test_a_missing_provider_is_reported(make_model: Any) -> None:
    path = make_model(table(*ROWS))
    network = OnnxDetector(path, DetectorConfig(providers=('tensorrt', 'cpu'))).network
    if network.provider == 'cpu':
        reason = network.provider_warning.removeprefix(
            'the network runs on cpu, not on tensorrt: '
        )
        assert reason.startswith(('this onnxruntime has only ', 'it failed to start'))
    for providers in ((), ('cpu',)):
        network = OnnxDetector(path, DetectorConfig(providers=providers)).network
        assert network.provider_warning == '' or network.provider != 'cpu'
    with pytest.raises(ConfigError, match='"coral" is not one of tensorrt, cuda, openvino, cpu'):
        OnnxDetector(path, DetectorConfig(providers=('coral',)))


@pytest.mark.filterwarnings('ignore:Specified provider')
def test_a_provider_that_fails_to_start_is_reported(
    make_model: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    installed = ['TensorrtExecutionProvider', 'CPUExecutionProvider']
    monkeypatch.setattr('onnxruntime.get_available_providers', lambda: installed)
    network = OnnxDetector(make_model(table(*ROWS)), DetectorConfig()).network
    if network.provider == 'cpu':
        expected = 'the network runs on cpu, not on tensorrt: it failed to start'
        assert network.provider_warning == expected


def test_a_table_without_rows_has_no_detections(make_model: Any) -> None:
    path = make_model({'output': np.zeros((0, 7), np.float32)})
    assert len(OnnxDetector(path, DetectorConfig()).detect(IMAGE, 0)) == 0


def test_a_model_of_any_input_size_gets_the_smallest_that_holds_the_image(make_model: Any) -> None:
    """The network returns the lower right quarter of its input as a box."""
    onnx = pytest.importorskip('onnx')
    h = onnx.helper
    to_float = onnx.TensorProto.FLOAT
    array = onnx.numpy_helper.from_array
    constants = [
        array(np.array([3, 2], np.int64), 'wh'),
        array(np.array(0.5, np.float32), 'half'),
        array(np.array([0.9, 0], np.float32), 'rest'),
        array(np.array([1, 1, 6], np.int64), 'as_table'),
    ]
    nodes = [
        h.make_node('Shape', ['images'], ['shape']),
        h.make_node('Gather', ['shape', 'wh'], ['size_int']),
        h.make_node('Cast', ['size_int'], ['size'], to=to_float),
        h.make_node('Mul', ['size', 'half'], ['middle']),
        h.make_node('Concat', ['middle', 'size', 'rest'], ['row'], axis=0),
        h.make_node('Reshape', ['row', 'as_table'], ['output0']),
    ]
    image = h.make_tensor_value_info('images', to_float, ['batch', 3, 'height', 'width'])
    result = h.make_tensor_value_info('output0', to_float, [1, 1, 6])
    path = make_model.save(onnx, h.make_graph(nodes, 'open', [image], [result], constants), {})
    detector = OnnxDetector(path, DetectorConfig(input_size_px=320))
    found = detector.detect(np.zeros((480, 640, 3), np.uint8), 0)  # 320 x 256, 8 rows of padding
    np.testing.assert_allclose(found.boxes_xyxy_px, [[320, 240, 640, 480]])
    found = detector.detect(np.zeros((640, 640, 3), np.uint8), 0)
    np.testing.assert_allclose(found.boxes_xyxy_px, [[320, 320, 640, 640]])


def test_time_of_the_network_is_within_that_of_detection(make_model: Any) -> None:
    detector = OnnxDetector(make_model(table(*ROWS)), DetectorConfig())
    detector.detect(IMAGE, 0)
    assert 0 < detector.network_ms < detector.detect_ms


def test_network_failure_is_one_line(make_model: Any) -> None:
    detector = OnnxDetector(make_model(table(*ROWS)), DetectorConfig())
    with pytest.raises(ModelError, match='inference fails on input 1x3x7x7') as error:
        detector.network.run(np.zeros((1, 3, 7, 7), np.float32))
    assert '\n' not in str(error.value)


@pytest.mark.parametrize('number', [np.nan, np.inf])
def test_a_network_with_non_finite_outputs_is_refused(make_model: Any, number: float) -> None:
    path = make_model({'output0': np.full((1, 84, 126), number, np.float32)})
    with pytest.raises(ModelError, match=r'\.onnx: all outputs are NaN or Inf'):
        OnnxDetector(path, DetectorConfig())


def test_images_with_non_finite_outputs_are_counted_and_reported_once(
    make_model: Any, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    detector = OnnxDetector(make_model(table(*ROWS)), DetectorConfig())
    finite = detector.network.run
    monkeypatch.setattr(
        detector.network, 'run', lambda blob: [np.full_like(o, np.nan) for o in finite(blob)]
    )
    for _ in range(3):
        assert len(detector.detect(IMAGE, 0)) == 0
    assert detector.warning.endswith('all outputs are NaN or Inf: nothing is detected')
    assert detector.num_non_finite == 3
    warnings = [record.message for record in caplog.records if 'NaN' in record.message]
    assert len(warnings) == 1
    monkeypatch.setattr(detector.network, 'run', finite)
    assert len(detector.detect(IMAGE, 0)) == 3
    assert detector.warning == ''
    assert detector.num_non_finite == 3
