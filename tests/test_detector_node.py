"""The detector node on real topics: outputs, services, parameters, lifecycle, invalid input."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticStatus
from hoid_msgs.msg import DetectionArray
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from numpy.typing import NDArray
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from sensor_msgs.msg import CompressedImage, Image
from std_srvs.srv import SetBool
from tf2_msgs.msg import TFMessage
from vision_msgs.msg import Detection2DArray

from hoid_bags.bag.bag_sequence import BagSequence
from hoid_common.errors import ModelError
from hoid_common.ros import conversions, qos
from hoid_common.values import ByteArray, Detections
from hoid_detector.config import DetectorConfig
from hoid_detector.model.model_path import SYNTHETIC
from hoid_detector.node import DetectorNode
from hoid_detector.onnx_detector import OnnxDetector
from hoid_synth.bag import write_bag
from hoid_synth.config import SceneConfig
from hoid_system_tests.detector_bench import FRAME, IMAGE, STAMP_NS, Bench, write_model
from hoid_system_tests.probe import SETTLE_S
from hoid_training.evaluate import Tally, Truth, count
from rgbd_slam.robot_frames import camera_mount

SMALL_PX = 32  # objects with a shorter side may be missed
MakeBench = Callable[..., Bench]


@pytest.fixture
def make_bench(tmp_path: Path, domain_id: int) -> Iterator[MakeBench]:
    """Return a function that starts ROS with parameters for the node."""
    benches: list[Bench] = []

    def make(*, work: int = 0, **parameters: object) -> Bench:
        model = parameters.pop('model', None) or write_model(tmp_path / 'm.onnx', work=work)
        args = ['--ros-args', '-p', f'model:={model}', '-p', 'expert:=true']
        for name, value in parameters.items():
            args += ['-p', f'{name.replace("__", ".")}:={value}']
        rclpy.init(args=args, domain_id=domain_id)
        benches.append(Bench())
        return benches[-1]

    yield make
    for bench in benches:
        bench.close()
    rclpy.try_shutdown()


@pytest.fixture
def bench(make_bench: MakeBench) -> Bench:
    bench = make_bench()
    bench.start()
    return bench


def test_image_gives_detections_with_its_stamp_and_frame(bench: Bench) -> None:
    bench.send(IMAGE)
    msg = bench.answer()
    assert conversions.stamp_from_msg(msg.header.stamp) == STAMP_NS
    assert msg.header.frame_id == FRAME
    assert (msg.image_width, msg.image_height) == (192, 128)
    assert msg.inference_ms > 0
    found = [
        (d.class_name, d.class_id, d.x_min, d.y_min, d.x_max, d.y_max) for d in msg.detections
    ]
    assert found == [('person', 0, 20, 40, 60, 120), ('cup', 41, 100, 16, 180, 48)]
    assert [d.score for d in msg.detections] == pytest.approx([0.9, 0.6])


def test_detections_2d_hold_the_same_boxes_for_a_subscriber(bench: Bench) -> None:
    received: list[Detection2DArray] = []
    topic = 'hoid_detector/detections_2d'
    bench.peer.create_subscription(Detection2DArray, topic, received.append, qos.OUTPUT)
    bench.until(lambda: bench.peer.count_publishers(topic) or None)
    bench.spin(SETTLE_S)
    bench.send(IMAGE)
    own = conversions.detections_from_msg(bench.answer())
    bench.until(lambda: received or None)
    assert conversions.stamp_from_msg(received[0].header.stamp) == STAMP_NS
    assert received[0].header.frame_id == FRAME
    foreign = conversions.detections_2d_from_msg(received[0])
    assert foreign.class_names == own.class_names == ('person', 'cup')
    np.testing.assert_allclose(foreign.boxes_xyxy_px, own.boxes_xyxy_px)
    np.testing.assert_allclose(foreign.scores, own.scores)


def test_compressed_images_are_received_when_the_parameter_is_set(make_bench: MakeBench) -> None:
    bench = make_bench(input__compressed='true')
    bench.images = bench.peer.create_publisher(CompressedImage, 'rgb/image/compressed', qos.OUTPUT)
    bench.start()
    header = conversions.header_to_msg(STAMP_NS, FRAME)
    bench.images.publish(CompressedImage(header=header, format='jpeg', data=b'no picture'))
    bench.until(lambda: bench.values().get('images refused') == '1')
    bench.images.publish(conversions.compressed_color_to_msg(IMAGE, header, 90))
    msg = bench.answer()
    assert conversions.stamp_from_msg(msg.header.stamp) == STAMP_NS
    assert [d.class_name for d in msg.detections] == ['person', 'cup']


def test_the_newest_image_is_processed_and_dropped_ones_are_counted(make_bench: MakeBench) -> None:
    bench = make_bench(work=30)  # some 300 ms: all images arrive while the first is processed
    bench.start()
    bench.send(IMAGE, 1)
    bench.spin(0.02)
    for stamp_ns in range(2, 7):
        bench.send(IMAGE, stamp_ns)
        bench.spin(0.001)
    stamps = []
    while 6 not in stamps:
        stamps.append(conversions.stamp_from_msg(bench.answer().header.stamp))
    assert stamps[0] == 1
    assert stamps == sorted(stamps)
    assert len(stamps) <= 3  # two on any machine that sends the images within 300 ms
    # Detections are published before the image is counted, so earlier diagnostics can lack it.
    processed = str(len(stamps))
    values = bench.until(lambda: (v := bench.values()).get('images processed') == processed and v)
    assert values['images dropped for newer ones'] == str(6 - len(stamps))
    assert bench.detections == []


def test_detections_come_at_a_rate_by_stamps_and_once_the_images_pause(
    make_bench: MakeBench,
) -> None:
    bench = make_bench(rate_hz=10.0)
    bench.start()
    stamps = [STAMP_NS + k * 33_333_333 for k in range(9)]
    for stamp_ns in stamps[:8]:
        bench.send(IMAGE, stamp_ns)
        bench.spin(0.03)
    answered = []
    while stamps[7] not in answered:  # it is not due, but no other image follows
        answered.append(conversions.stamp_from_msg(bench.answer().header.stamp))
    assert answered == sorted(answered)
    assert answered[0] == stamps[0]
    assert len(answered) <= 6  # 4 in time: 0, 3, 6 and 7
    bench.send(IMAGE, stamps[8])
    assert conversions.stamp_from_msg(bench.answer().header.stamp) == stamps[8]


def test_objects_are_detected_in_every_image_of_a_10_hz_camera_by_default(bench: Bench) -> None:
    for k in range(4):
        bench.send(IMAGE, STAMP_NS + k * 100_000_000)
        answer = bench.answer()
        assert conversions.stamp_from_msg(answer.header.stamp) == STAMP_NS + k * 100_000_000


def test_the_synthetic_detector_finds_people_and_objects_of_a_rendered_bag(
    make_bench: MakeBench, tmp_path: Path
) -> None:
    write_bag(SceneConfig(seed=901, num_frames=4), tmp_path / 'scene.bag')
    bag = BagSequence(tmp_path / 'scene.bag')
    assert bag.true_detections is not None
    bench = make_bench(model=SYNTHETIC)
    bench.start()
    tally = Tally()
    for frame in bag:
        bench.send(frame.image_bgr, frame.stamp_ns)
        found = conversions.detections_from_msg(bench.answer())
        assert found.stamp_ns == frame.stamp_ns
        true = bag.true_detections[found.stamp_ns]
        sides_px = true.boxes_xyxy_px[:, 2:] - true.boxes_xyxy_px[:, :2]
        visible_px = np.where(sides_px.min(1) >= SMALL_PX, sides_px.prod(1), 0)
        count(tally, Truth(true.class_names, true.boxes_xyxy_px, visible_px), found)
    people, objects = tally.people(), tally.objects()
    assert people.found == people.asked >= 4
    assert objects.asked >= 20
    assert objects.recall >= 0.85
    assert objects.precision >= 0.85


def test_a_weak_box_is_reported_where_the_object_map_expects_it(make_bench: MakeBench) -> None:
    bench = make_bench(score_threshold=0.7, expected_score_threshold=0.05)
    publisher = bench.peer.create_publisher(DetectionArray, 'expected_objects', qos.OUTPUT)
    bench.start()
    assert classes_seen(bench) == ['person']
    bench.until(lambda: publisher.get_subscription_count() or None)
    box = np.array([[104, 16, 180, 50]], np.float32)
    cup = Detections(STAMP_NS, box, ('cup',), np.array([0.8], np.float32))
    header = conversions.header_to_msg(STAMP_NS, FRAME)
    publisher.publish(conversions.detections_to_msg(cup, header, (192, 128)))
    bench.until(lambda: classes_seen(bench) == ['person', 'cup'] or None)


def test_the_debug_image_is_published_only_with_a_subscriber(bench: Bench) -> None:
    bench.send(IMAGE)
    bench.answer()
    pictures: list[Image] = []
    bench.peer.create_subscription(Image, 'hoid_detector/debug_image', pictures.append, qos.OUTPUT)
    bench.until(lambda: bench.peer.count_publishers('/hoid_detector/debug_image') or None)
    bench.spin(0.5)
    assert pictures == []
    bench.send(IMAGE, 5)
    picture = bench.until(lambda: pictures.pop() if pictures else None)
    assert conversions.stamp_from_msg(picture.header.stamp) == 5
    drawn = conversions.color_from_msg(picture)
    assert drawn.shape == IMAGE.shape
    assert drawn[80, 20].argmax() == 2  # the person's edge is red
    assert (drawn[90:110, 30:50] == 60).all()


def test_the_enable_service_stops_and_resumes_detection(bench: Bench) -> None:
    off = bench.call(SetBool, 'hoid_detector/enable', SetBool.Request(data=False))
    assert (off.success, off.message) == (True, 'stopped')
    bench.send(IMAGE, 1)
    bench.spin(0.5)
    assert bench.detections == []
    bench.call(SetBool, 'hoid_detector/enable', SetBool.Request(data=True))
    bench.send(IMAGE, 2)
    assert conversions.stamp_from_msg(bench.answer().header.stamp) == 2


def set_parameter(bench: Bench, name: str, value: object) -> Any:
    request = SetParameters.Request(parameters=[Parameter(name, value=value).to_parameter_msg()])
    return bench.call(SetParameters, 'hoid_detector/set_parameters', request).results[0]


def classes_seen(bench: Bench) -> list[str]:
    bench.send(IMAGE)
    return [d.class_name for d in bench.answer().detections]


def test_parameters_change_at_run_time(bench: Bench) -> None:
    assert set_parameter(bench, 'score_threshold', 0.7).successful
    assert classes_seen(bench) == ['person']
    assert set_parameter(bench, 'score_threshold', 0.1).successful
    assert set_parameter(bench, 'classes', ['cup', 'book']).successful
    assert classes_seen(bench) == ['cup']
    assert set_parameter(bench, 'nms_iou', 0.9).successful
    refused = set_parameter(bench, 'classes', ['unicorn'])
    assert not refused.successful
    assert refused.reason.startswith('classes: the model knows no "unicorn"; it knows person, ')
    assert not set_parameter(bench, 'score_threshold', 1.5).successful
    assert not set_parameter(bench, 'threads', 2).successful  # read only
    assert classes_seen(bench) == ['cup']


@pytest.mark.parametrize('value', [5, 'person', True, None])  # None deletes it
def test_classes_that_are_no_list_are_refused_in_one_line(bench: Bench, value: object) -> None:
    refused = set_parameter(bench, 'classes', value)
    assert not refused.successful
    assert refused.reason == f'classes must be list, got {value!r}'
    assert classes_seen(bench) == ['person', 'cup']


@pytest.mark.parametrize(
    ('changes', 'words'),
    [
        ({'encoding': 'h264'}, 'encoding'),
        ({'step': 10}, 'step'),
        ({'height': 4000}, 'bytes'),
        ({'width': 0, 'height': 0}, 'empty'),
    ],
)
def test_an_invalid_image_is_refused_and_counted(
    bench: Bench, changes: dict[str, Any], words: str, capfd: pytest.CaptureFixture[str]
) -> None:
    bench.send(IMAGE, 1, **changes)
    bench.until(lambda: bench.values().get('images refused') == '1')
    assert words in capfd.readouterr().err
    bench.send(IMAGE, 2)
    assert conversions.stamp_from_msg(bench.answer().header.stamp) == 2


def test_a_missing_input_is_reported_in_diagnostics(bench: Bench) -> None:
    bench.peer.destroy_publisher(bench.images)
    status = bench.until(lambda: (v := bench.values())['message'] != 'running' and v)
    assert status['message'].startswith('no color images yet for ')
    assert status['message'].endswith(' s on /rgb/image: no publisher')
    assert status['model'].startswith('m.onnx: end_to_end, 80 classes, input 96x64 float32')


def test_another_provider_than_requested_is_reported_once(
    make_bench: MakeBench, capfd: pytest.CaptureFixture[str]
) -> None:
    bench = make_bench(providers='["tensorrt", "cpu"]')
    bench.start()
    if 'on tensorrt' in bench.values()['model']:
        pytest.skip('this machine has TensorRT')
    assert 'the network runs on cpu, not on tensorrt: ' in bench.values()['message']
    assert bench.values()['level'] == DiagnosticStatus.WARN
    assert capfd.readouterr().err.count('not on tensorrt') == 1


def state(bench: Bench) -> str:
    reply = bench.call(GetState, 'hoid_detector/get_state', GetState.Request())
    return str(reply.current_state.label)


def change_state(bench: Bench, transition: int) -> bool:
    request = ChangeState.Request(transition=Transition(id=transition))
    return bool(bench.call(ChangeState, 'hoid_detector/change_state', request).success)


def test_the_node_activates_itself(bench: Bench) -> None:
    assert state(bench) == 'active'


def test_a_lifecycle_manager_controls_the_node(make_bench: MakeBench) -> None:
    bench = make_bench(autostart='false')
    bench.start()
    assert state(bench) == 'unconfigured'
    assert change_state(bench, Transition.TRANSITION_CONFIGURE)
    bench.send(IMAGE, 1)
    bench.spin(0.5)
    assert bench.detections == []
    assert change_state(bench, Transition.TRANSITION_ACTIVATE)
    bench.send(IMAGE, 2)
    assert conversions.stamp_from_msg(bench.answer().header.stamp) == 2
    assert change_state(bench, Transition.TRANSITION_DEACTIVATE)
    bench.send(IMAGE, 3)
    bench.spin(0.5)
    assert bench.detections == []
    assert change_state(bench, Transition.TRANSITION_CLEANUP)
    assert change_state(bench, Transition.TRANSITION_CONFIGURE)
    assert change_state(bench, Transition.TRANSITION_ACTIVATE)
    bench.send(IMAGE, 4)
    assert conversions.stamp_from_msg(bench.answer().header.stamp) == 4
    assert change_state(bench, Transition.TRANSITION_ACTIVE_SHUTDOWN)
    assert state(bench) == 'finalized'


def test_a_missing_model_fails_the_transition_or_ends_the_node(
    make_bench: MakeBench, domain_id: int, tmp_path: Path
) -> None:
    bench = make_bench(model=tmp_path / 'gone.onnx', autostart='false')
    bench.start()
    assert not change_state(bench, Transition.TRANSITION_CONFIGURE)
    assert state(bench) == 'unconfigured'
    values = bench.values()
    assert values['level'] == DiagnosticStatus.ERROR
    assert 'gone.onnx does not exist: give the path of an ONNX file' in values['message']
    rclpy.shutdown()
    args = ['--ros-args', '-p', f'model:={tmp_path / "gone.onnx"}']
    rclpy.init(args=args, domain_id=domain_id)
    with pytest.raises(ModelError, match='does not exist'):
        DetectorNode()


def boxes(bench: Bench, image: ByteArray) -> NDArray[np.float32]:
    """Return the boxes (N, 4) that the node finds in an image."""
    bench.send(image)
    found = bench.answer().detections
    return np.array([(d.x_min, d.y_min, d.x_max, d.y_max) for d in found], np.float32)


def test_a_camera_that_is_mounted_turned_is_known_from_tf_static(make_bench: MakeBench) -> None:
    bench = make_bench(base_frame='base_link')
    node = bench.start()
    unturned = boxes(bench, IMAGE)
    assert 'does not join frames "base_link"' in bench.values()['message']
    tree = bench.peer.create_publisher(TFMessage, '/tf_static', qos.TF_STATIC)
    mount = camera_mount(178.0, 10.0, 30.0)  # nearly upside down
    edge = conversions.transform_to_msg(mount, 0, 'base_link', f'/{FRAME}')
    tree.publish(TFMessage(transforms=[edge]))
    bench.until(lambda: (boxes(bench, IMAGE) != unturned).any() or None)
    expected = OnnxDetector(
        Path(str(node.get_parameter('model').value)), DetectorConfig(camera_roll_deg=180.0)
    ).detect(IMAGE, STAMP_NS)
    np.testing.assert_allclose(boxes(bench, IMAGE), expected.boxes_xyxy_px, atol=1e-3)
    assert bench.values()['camera roll'] == '178 degrees'
