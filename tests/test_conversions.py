"""Round trips and refusals of every conversion, with messages that are serialized as by ROS."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from vision_msgs.msg import (
    Detection2D,
    Detection2DArray,
    ObjectHypothesis,
    ObjectHypothesisWithPose,
)

from hoid_common.errors import MessageError
from hoid_common.ros import conversions
from hoid_common.ros.conversions import Cloud, FeatureCounts
from hoid_common.values import (
    CameraModel,
    Detections,
    DynamicObject,
    Features,
    ObjectState,
)
from hoid_system_tests.wire import sent

HEADER = conversions.header_to_msg(1_305_031_102_160_407_123, 'camera')
SIZE = (640, 480)
NAN = float('nan')


def test_header_keeps_nanoseconds() -> None:
    msg = sent(HEADER)
    assert conversions.stamp_from_msg(msg.stamp) == 1_305_031_102_160_407_123
    assert (msg.stamp.nanosec, msg.frame_id) == (160_407_123, 'camera')


def test_color_round_trip() -> None:
    image = np.random.default_rng(0).integers(0, 256, (48, 64, 3), np.uint8)
    msg = sent(conversions.color_to_msg(image, HEADER))
    assert (msg.encoding, msg.width, msg.height, msg.step) == ('bgr8', 64, 48, 192)
    assert msg.header == HEADER
    np.testing.assert_array_equal(conversions.color_from_msg(msg), image)


@pytest.mark.parametrize(
    'frame_id', ['', 'camera', 'farbe \N{LATIN SMALL LETTER U WITH DIAERESIS}']
)
def test_an_image_read_from_cdr_equals_the_message(frame_id: str) -> None:
    image = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)
    msg = conversions.color_to_msg(image, conversions.header_to_msg(7_000_000_008, frame_id))
    received = conversions.image_from_cdr(serialize_message(msg))
    for name in vars(received).keys() - {'data'}:
        assert getattr(received, name) == getattr(msg, name)
    assert received.data.tobytes() == msg.data.tobytes()
    np.testing.assert_array_equal(conversions.color_from_msg(received), image)


@given(cut=st.integers(0, 200), place=st.integers(0, 99), byte=st.integers(0, 255))
def test_corrupt_image_bytes_are_refused_or_read_within_bounds(
    cut: int, place: int, byte: int
) -> None:
    whole = bytearray(
        serialize_message(conversions.color_to_msg(np.zeros((4, 5, 3), 'u1'), HEADER))
    )
    whole[place] = byte
    data = bytes(whole[:cut])
    try:
        received = conversions.image_from_cdr(data)
    except MessageError as error:
        reason = str(error)
    else:
        reason = ''
        assert received.data.size < len(data)
    assert reason in ('', f'{len(data)} bytes are no sensor_msgs/Image')


def test_compressed_color_round_trip() -> None:
    image = np.full((48, 64, 3), (200, 100, 50), np.uint8)
    msg = sent(conversions.compressed_color_to_msg(image, HEADER, quality=95))
    assert msg.format == 'bgr8; jpeg compressed bgr8'
    assert np.abs(conversions.color_from_msg(msg).astype(int) - image).max() <= 2


def test_whole_millimeters_are_sent_as_16uc1() -> None:
    depth = np.random.default_rng(0).integers(50, 10_000, (48, 64)).astype(
        np.float32
    ) / np.float32(1000)
    msg = sent(conversions.depth_to_msg(depth, HEADER))
    assert (msg.encoding, msg.step) == ('16UC1', 128)
    np.testing.assert_array_equal(conversions.depth_from_msg(msg), depth)
    packed = sent(conversions.compressed_depth_to_msg(depth, HEADER))
    assert packed.format == '16UC1; compressedDepth png'
    np.testing.assert_array_equal(conversions.depth_from_msg(packed), depth)


def test_finer_depth_is_sent_as_32fc1() -> None:
    depth = np.random.default_rng(0).integers(250, 50_000, (48, 64)).astype(
        np.float32
    ) / np.float32(5000)
    msg = sent(conversions.depth_to_msg(depth, HEADER))
    assert (msg.encoding, msg.step) == ('32FC1', 256)
    np.testing.assert_array_equal(conversions.depth_from_msg(msg), depth)
    with pytest.raises(MessageError, match='not in whole millimeters'):
        conversions.compressed_depth_to_msg(depth, HEADER)


def test_a_short_image_is_refused() -> None:
    with pytest.raises(MessageError, match='has 10 bytes'):
        conversions.color_from_msg(
            Image(height=2, width=2, encoding='bgr8', step=6, data=bytes(10))
        )


@pytest.mark.parametrize('distortion', [(), (0.26, -0.95, -0.005, 0.003, 1.16), (0.1,) * 8])
def test_camera_round_trip(distortion: tuple[float, ...]) -> None:
    camera = CameraModel(640, 480, 517.3, 516.5, 318.6, 255.3, distortion)
    assert conversions.camera_from_msg(sent(conversions.camera_to_msg(camera, HEADER))) == camera


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'k': np.zeros(9)}, 'fx=0.0 fy=0.0'),
        ({'width': 0}, '0x480'),
        ({'distortion_model': 'mei'}, 'distortion_model "mei"'),
    ],
)
def test_unusable_camera_infos_are_refused(change: dict[str, Any], message: str) -> None:
    good = conversions.camera_to_msg(CameraModel(640, 480, 500, 500, 0, 0, (0.1,) * 5), HEADER)
    fields = {name: getattr(good, name) for name in good.get_fields_and_field_types()}
    with pytest.raises(MessageError, match=message):
        conversions.camera_from_msg(CameraInfo(**(fields | change)))


def test_detections_round_trip() -> None:
    detections = Detections(
        conversions.stamp_from_msg(HEADER.stamp),
        np.array([[1.5, 2, 30, 40], [5, 6, 7, 8]], np.float32),
        ('person', 'unicorn'),
        np.array([0.75, 0.25], np.float32),
    )
    msg = sent(conversions.detections_to_msg(detections, HEADER, SIZE, ['cup', 'person'], 12.5))
    assert [box.class_id for box in msg.detections] == [1, -1]
    assert (msg.image_width, msg.image_height, msg.inference_ms) == (640, 480, 12.5)
    back = conversions.detections_from_msg(msg)
    assert (back.stamp_ns, back.class_names) == (detections.stamp_ns, detections.class_names)
    np.testing.assert_array_equal(back.boxes_xyxy_px, detections.boxes_xyxy_px)
    np.testing.assert_array_equal(back.scores, detections.scores)


def test_detections_2d_round_trip() -> None:
    detections = Detections(
        conversions.stamp_from_msg(HEADER.stamp),
        np.array([[1.5, 2, 30, 40], [5, 6, 7, 8]], np.float32),
        ('person', 'unicorn'),
        np.array([0.75, 0.25], np.float32),
    )
    msg = sent(conversions.detections_2d_to_msg(detections, HEADER))
    person = msg.detections[0]
    assert msg.header == person.header == HEADER
    assert (person.bbox.center.position.x, person.bbox.center.position.y) == (15.75, 21.0)
    assert (person.bbox.size_x, person.bbox.size_y) == (28.5, 38.0)
    back = conversions.detections_2d_from_msg(msg)
    assert (back.stamp_ns, back.class_names) == (detections.stamp_ns, detections.class_names)
    np.testing.assert_array_equal(back.boxes_xyxy_px, detections.boxes_xyxy_px)
    np.testing.assert_array_equal(back.scores, detections.scores)


def test_a_rotated_box_becomes_its_bounding_box_with_the_most_likely_class() -> None:
    one = Detections(0, np.array([[0, 0, 40, 20]], np.float32), ('cup',), np.array([0.25], 'f4'))
    msg = conversions.detections_2d_to_msg(one, HEADER)
    msg.detections[0].bbox.center.theta = np.pi / 2
    hypothesis = ObjectHypothesis(class_id='vase', score=0.5)
    msg.detections[0].results.append(ObjectHypothesisWithPose(hypothesis=hypothesis))
    back = conversions.detections_2d_from_msg(sent(msg))
    assert (back.class_names, back.scores.tolist()) == (('vase',), [0.5])
    np.testing.assert_allclose(back.boxes_xyxy_px, [[10, -10, 30, 30]], atol=1e-5)


@pytest.mark.parametrize('number', [np.inf, -np.inf, np.nan, 1e300])
@pytest.mark.parametrize('field', ['theta', 'size_x', 'score'])
@pytest.mark.filterwarnings('error')
def test_invalid_numbers_of_a_box_become_non_finite(field: str, number: float) -> None:
    one = Detections(0, np.array([[0, 0, 40, 20]], np.float32), ('cup',), np.array([0.25], 'f4'))
    msg = conversions.detections_2d_to_msg(one, HEADER)
    found = msg.detections[0]
    owner = {'theta': found.bbox.center, 'size_x': found.bbox}.get(
        field, found.results[0].hypothesis
    )
    setattr(owner, field, number)
    back = conversions.detections_2d_from_msg(msg)
    is_turned = field == 'theta' and number == 1e300  # a valid angle
    assert np.isfinite([*back.boxes_xyxy_px[0], *back.scores]).all() == is_turned


@pytest.mark.parametrize(
    ('detections', 'message'),
    [([Detection2D()], 'results is empty'), ([Detection2D()] * 1001, '1001 elements')],
)
def test_empty_or_too_many_vision_msgs_detections_are_refused(
    detections: list[Detection2D], message: str
) -> None:
    with pytest.raises(MessageError, match=message):
        conversions.detections_2d_from_msg(Detection2DArray(detections=detections))


def test_no_detections_round_trip() -> None:
    msg = sent(conversions.detections_to_msg(Detections.none(7), HEADER, SIZE))
    assert len(conversions.detections_from_msg(msg)) == 0


def test_more_than_1000_detections_are_refused() -> None:
    many = Detections(
        0, np.ones((1001, 4), np.float32), ('cup',) * 1001, np.ones(1001, np.float32)
    )
    msg = conversions.detections_to_msg(many, HEADER, SIZE)
    with pytest.raises(MessageError, match='1001 elements, more than 1000'):
        conversions.detections_from_msg(msg)


def features(n: int, may_seed: Any = None) -> Features:
    rng = np.random.default_rng(n)
    return Features(
        conversions.stamp_from_msg(HEADER.stamp),
        rng.uniform(0, 479, (n, 2)).astype(np.float32),
        rng.uniform(0, 5, n).astype(np.float32),
        rng.integers(0, 8, n, np.uint8),
        rng.uniform(0, 360, n).astype(np.float32),
        rng.uniform(0, 1, n).astype(np.float32),
        rng.integers(0, 256, (n, 32), np.uint8),
        np.ones(n, np.bool_) if may_seed is None else np.array(may_seed),
    )


@pytest.mark.parametrize('n', [0, 1, 1000])
def test_features_round_trip(n: int) -> None:
    msg = sent(
        conversions.features_to_msg(features(n), HEADER, SIZE, FeatureCounts(1200, 200, 8.5, 0.25))
    )
    assert len(msg.may_seed) == 0
    assert conversions.feature_counts_from_msg(msg) == (1200, 200, 8.5, 0.25)
    back = conversions.features_from_msg(msg)
    for name in vars(features(n)):
        np.testing.assert_array_equal(getattr(back, name), getattr(features(n), name))


def test_may_seed_round_trip() -> None:
    msg = sent(conversions.features_to_msg(features(3, [True, False, True]), HEADER, SIZE))
    assert conversions.features_from_msg(msg).may_seed.tolist() == [True, False, True]


@pytest.mark.parametrize(
    ('field', 'value', 'message'),
    [
        ('uv_px', [1.0] * 5, 'features.uv_px has 5 elements, expected 6'),
        ('depth_m', [1.0] * 4, 'features.depth_m has 4 elements, expected 3'),
        ('descriptors', [1] * 95, 'features.descriptors has 95 elements, expected 96'),
        ('may_seed', [1], 'features.may_seed has 1 elements, expected 3'),
        ('uv_px', [1.0, 1, 2, NAN, 3, 3], 'features.uv_px: feature 1 at .* is outside 640x480'),
        ('uv_px', [1.0, 1, 2, 2, 640, 3], 'features.uv_px: feature 2'),
        ('depth_m', [1.0, -1.0, 1.0], 'features.depth_m: feature 1 has depth -1'),
        ('depth_m', [1.0, 1.0, NAN], 'features.depth_m: feature 2 has depth nan'),
    ],
)
def test_inconsistent_features_are_refused(field: str, value: Any, message: str) -> None:
    msg = conversions.features_to_msg(features(3), HEADER, SIZE)
    setattr(
        msg,
        field,
        value,
    )
    with pytest.raises(MessageError, match=message):
        conversions.features_from_msg(msg)


@pytest.mark.parametrize('state', list(ObjectState)[: ObjectState.MOVED.value])
def test_dynamic_objects_round_trip(state: ObjectState) -> None:
    obj = DynamicObject(
        'cup', (1.0, 2.0, 3.5, 4.0), 0.5, 7, state, 0.25, 0.125, (1.0, -2.0, 3.0), (0.5, 0.75),
        (0.25, -0.5, 1.5),
    )  # fmt: skip
    msg = sent(conversions.dynamic_objects_to_msg((obj,), HEADER, SIZE))
    assert msg.objects[0].dynamic == obj.is_dynamic
    assert conversions.dynamic_objects_from_msg(msg) == (obj,)


def test_unknown_measurements_stay_nan() -> None:
    obj = DynamicObject('cup', (1.0, 2.0, 3.0, 4.0), 0.5, -1, ObjectState.AT_REST)
    msg = sent(conversions.dynamic_objects_to_msg((obj,), HEADER, SIZE))
    (back,) = conversions.dynamic_objects_from_msg(msg)
    unknown = [back.depth_gap_m, *back.center_camera_m, *back.size_m, *back.velocity_camera_mps]
    assert np.isnan(unknown).all()


@pytest.mark.parametrize('state', [6, 7, 8, 9])
def test_a_state_that_no_object_in_an_image_has_is_refused(state: int) -> None:
    obj = DynamicObject('cup', (1.0, 2.0, 3.0, 4.0), 0.5, -1, ObjectState.AT_REST)
    msg = conversions.dynamic_objects_to_msg((obj,), HEADER, SIZE)
    msg.objects[0].state = state
    with pytest.raises(MessageError, match=f'state is {state}'):
        conversions.dynamic_objects_from_msg(msg)


@pytest.mark.parametrize('field', ['x_min', 'y_min', 'x_max', 'y_max', 'score'])
@pytest.mark.parametrize('value', [np.nan, np.inf, -np.inf, 3e38, -3e38])
def test_objects_with_values_out_of_range_are_refused(field: str, value: float) -> None:
    obj = DynamicObject('cup', (1.0, 2.0, 3.0, 4.0), 0.5, -1, ObjectState.AT_REST)
    msg = conversions.dynamic_objects_to_msg((obj,), HEADER, SIZE)
    setattr(msg.objects[0], field, value)
    with pytest.raises(MessageError, match='is out of range'):
        conversions.dynamic_objects_from_msg(msg)


def test_more_than_1000_objects_are_refused() -> None:
    obj = DynamicObject('cup', (1.0, 2.0, 3.0, 4.0), 0.5, -1, ObjectState.AT_REST)
    msg = conversions.dynamic_objects_to_msg((obj,) * 1001, HEADER, SIZE)
    with pytest.raises(MessageError, match='more than 1000'):
        conversions.dynamic_objects_from_msg(msg)


@pytest.mark.parametrize('n', [0, 1, 100])
@pytest.mark.parametrize('colored', [False, True])
@pytest.mark.parametrize('labeled', [False, True])
def test_cloud_round_trip(n: int, colored: bool, labeled: bool) -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(n, 3)).astype(np.float32)
    colors = rng.integers(0, 256, (n, 3), np.uint8) if colored else None
    cloud = Cloud(points, colors, rng.integers(0, 2**32, n, np.uint32) if labeled else None)
    msg = sent(conversions.cloud_to_msg(cloud, HEADER))
    assert (msg.width, msg.point_step) == (n, 12 + 4 * (colored + labeled))
    back = conversions.cloud_from_msg(msg)
    np.testing.assert_array_equal(back.points_m, points)
    np.testing.assert_array_equal(back.colors_bgr, cloud.colors_bgr)
    np.testing.assert_array_equal(back.labels, cloud.labels)


def test_the_color_of_a_cloud_point_is_packed_as_rgb() -> None:
    cloud = Cloud(np.zeros((1, 3), np.float32), np.array([[0, 0, 255]], np.uint8))
    msg = conversions.cloud_to_msg(cloud, HEADER)
    assert int.from_bytes(bytes(msg.data)[12:16], 'little') == 0x00FF0000


def test_inconsistent_clouds_are_refused() -> None:
    with pytest.raises(MessageError, match='x, y, z'):
        conversions.cloud_from_msg(PointCloud2())
    msg = conversions.cloud_to_msg(Cloud(np.zeros((2, 3), np.float32)), HEADER)
    msg.width = 3
    with pytest.raises(MessageError, match='24 bytes, but 3 points need 36'):
        conversions.cloud_from_msg(msg)
    msg.width, msg.fields[2].offset = 2, 10
    with pytest.raises(MessageError, match='point_step 12, but its fields need 14'):
        conversions.cloud_from_msg(msg)
