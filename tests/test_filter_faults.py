"""hoid_filter on real topics: invalid input is refused or clipped, and counted."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hoid_msgs.msg import Detection, DetectionArray, ObjectState
from rclpy.serialization import serialize_message

from hoid_common.ros import conversions
from hoid_common.values import CameraModel
from hoid_system_tests.filter_peer import (
    CAMERA,
    DEPTH_M,
    HEIGHT,
    IMAGE,
    PERSON,
    TV,
    WIDTH,
    FilterRunner,
    num_inside,
)

pytestmark = pytest.mark.thorough

NAN, INF = float('nan'), float('inf')


def test_invalid_boxes_are_refused_or_clipped_one_by_one(run_filter: FilterRunner) -> None:
    peer = run_filter()
    refused = [
        (NAN, 10.0, 50.0, 60.0),
        (0.0, 0.0, INF, 60.0),
        (90.0, 10.0, 50.0, 60.0),  # inverted
        (700.0, 10.0, 800.0, 60.0),  # outside
    ]
    for i, box in enumerate(refused):
        peer.show(i, PERSON, ('cup', box))
        features, objects = peer.answer(i + 1)
        assert [o.class_name for o in objects.objects] == ['person']
        assert num_inside(features, PERSON) == 0
    peer.show(9, ('cup', (600.0, -10.0, 800.0, 60.0)))
    cup = peer.answer(5)[1].objects[0]
    assert (cup.x_min, cup.y_min, cup.x_max, cup.y_max) == (600.0, 0.0, WIDTH, 60.0)
    peer.wait_for_count('boxes clipped', 1)
    peer.wait_for_count('boxes refused', len(refused))


def test_invalid_detection_messages_are_refused(run_filter: FilterRunner) -> None:
    peer = run_filter(**{'detections.wait_s': 1.0, 'detections.timeout_s': 600.0})
    peer.send_images(0)
    peer.answer(1)
    peer.send_boxes(1, PERSON, image_width=1920, image_height=1080)
    peer.wait_for_count('detections refused', 1)
    peer.boxes.publish(serialized_crowd(peer.header(1), 1_000_000))
    peer.wait_for_count('detections refused', 2, timeout_s=90.0)  # unpacking takes seconds
    peer.show(2, PERSON)
    features, _ = peer.answer(2)
    assert num_inside(features, PERSON) == 0
    peer.wait_for_count('images filtered', 2)
    assert peer.newest_diagnosis()[1]['detections refused'] == '2'


def serialized_crowd(header: Any, number: int) -> bytes:
    """Return a serialized DetectionArray of `number` boxes, which take 32 bytes each."""
    msg = DetectionArray(
        header=header, image_width=WIDTH, image_height=HEIGHT, detections=[Detection()]
    )
    one: bytes = serialize_message(msg)
    return one[:-36] + number.to_bytes(4, 'little') + one[-32:] * number


def test_invalid_images_are_refused(run_filter: FilterRunner) -> None:
    peer = run_filter(**{'detections.wait_s': 0.1})
    peer.send_images(0, DEPTH_M[:, ::2])
    peer.wait_for_count('matched images refused', 1)
    strange = conversions.color_to_msg(IMAGE, peer.header(1))
    strange.encoding = 'h264'
    peer.color.publish(strange)
    peer.depth.publish(conversions.depth_to_msg(DEPTH_M, peer.header(1)))
    peer.wait_for_count('color images refused', 1)
    for i, fields in ((3, {'encoding': '64FC1'}), (4, {'height': 2 * HEIGHT})):
        wrong = conversions.depth_to_msg(DEPTH_M, peer.header(i))
        for name, value in fields.items():
            setattr(wrong, name, value)
        peer.color.publish(conversions.color_to_msg(IMAGE, peer.header(i)))
        peer.depth.publish(wrong)
        peer.wait_for_count('depth images refused', i - 2)
    depth_m = np.tile(np.where(np.arange(WIDTH) % 2, np.float32('nan'), 2.5001), (HEIGHT, 1))
    holed = conversions.depth_to_msg(np.full((HEIGHT, WIDTH), np.float32(2.5001)), peer.header(5))
    holed.data = depth_m.astype(np.float32).tobytes()
    peer.color.publish(conversions.color_to_msg(IMAGE, peer.header(5)))
    peer.depth.publish(holed)
    peer.send_boxes(5, PERSON)
    features, _ = peer.answer()
    assert features.header == peer.header(5)
    assert set(features.depth_m) == {0.0, float(np.float32(2.5001))}


def test_scores_out_of_range_are_clipped_and_nan_is_refused(
    run_filter: FilterRunner,
) -> None:
    peer = run_filter()
    x1, y1, x2, y2 = PERSON[1]
    peer.send_boxes(
        0,
        detections=[
            Detection(class_name='person', score=score, x_min=x1, y_min=y1, x_max=x2, y_max=y2)
            for score in (7.5, -1.0, NAN)
        ],
    )
    peer.probe.spin_for(0.2)
    peer.send_images(0)
    _, objects = peer.answer()
    assert [o.score for o in objects.objects] == [1.0, 0.0]
    peer.wait_for_count('boxes clipped', 2)
    peer.wait_for_count('boxes refused', 1)


def test_a_camera_info_of_another_size_is_refused(run_filter: FilterRunner) -> None:
    other = CameraModel(WIDTH // 2, HEIGHT, 250.0, 250.0, 160.0, 120.0)
    peer = run_filter()  # receives the right camera first
    # The cameras alternate, so that each change shows in the objects of the next image.
    for i, camera in enumerate((other, CAMERA, other, CAMERA)):
        peer.camera.publish(conversions.camera_to_msg(camera, peer.header(i)))
        peer.wait_for_count('camera infos received', i + 2)
        peer.show(i, PERSON)
        (person,) = peer.answer(i + 1)[1].objects
        assert np.isnan([*person.center_camera_m, *person.size_m]).all() == (camera is other)
    peer.wait_for_count('camera infos refused', 2)
    assert peer.newest_diagnosis()[1]['camera infos refused'] == '2'


def test_a_recording_may_restart(run_filter: FilterRunner) -> None:
    peer = run_filter()
    first = 10_000  # an image at the end of the recording
    peer.show(first, PERSON)
    peer.answer(1)
    peer.show(0, PERSON)
    assert peer.answer(2)[1].header == peer.header(0)
    peer.wait_for_count('times that stamps went back', 1)
    peer.send_boxes(first + 1, TV)  # late detections from before the restart
    peer.wait_for_count('detections refused', 1)
    peer.send_images(1)  # an image that the detector skips
    features, objects = peer.answer(3)
    assert [(o.class_name, o.state) for o in objects.objects] == [
        ('person', ObjectState.PREDICTED)
    ]
    assert num_inside(features, PERSON) == 0
    assert peer.newest_diagnosis()[1]['times that stamps went back'] == '1'
