"""Images are selected for each map at its rate, whatever the frame rate."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hoid_common.poses.keyframe_poses import NO_KEYFRAMES, TrackedImage
from hoid_common.values import UNKNOWN, DynamicObject, ObjectState
from hoid_scene.scene_scheduler import SceneRequest, SceneScheduler, has_detections

PERIOD_NS = 33_333_333
BOX = (0.0, 0.0, 9.0, 9.0)
PREDICTED = DynamicObject('cup', BOX, 0.9, -1, ObjectState.PREDICTED)
SEEN = replace(PREDICTED, state=ObjectState.AT_REST)


def image(number: int = 0, **changes: bool) -> TrackedImage:
    flags = {'is_in_main_map': True, 'is_growing': True} | changes
    return TrackedImage(number * PERIOD_NS, np.eye(4), 5, **flags)


def requests_of(
    scheduler: SceneScheduler, objects_of: Callable[[int], tuple[DynamicObject, ...]]
) -> dict[int, SceneRequest]:
    """Return the requests for 90 images by number, after the objects of each are known."""
    offered = {i: scheduler.pick(image(i), lambda: NO_KEYFRAMES) for i in range(90)}
    narrowed = {i: scheduler.narrow(picked, objects_of(i)) for i, picked in offered.items()}
    return {i: request for i, request in narrowed.items() if request is not None}


def test_the_dense_map_and_the_object_tracks_have_their_own_rates() -> None:
    requests = requests_of(SceneScheduler(3.0, 10.0), lambda _: ()).values()
    assert {request.reference_uid for request in requests} == {5}
    assert sum(request.keyframes is not None for request in requests) == 9
    assert sum(request.track_objects for request in requests) == 30


@pytest.mark.parametrize('phase', [0, 1, 2])
def test_tracks_take_the_images_in_which_the_detector_found_objects(phase: int) -> None:
    requests = requests_of(
        SceneScheduler(3.0, 10.0), lambda i: (SEEN if i % 3 == phase else PREDICTED,)
    )
    tracked = [i for i, request in requests.items() if request.track_objects]
    assert tracked == list(range(phase, 90, 3))
    assert sum(request.fuse for request in requests.values()) == 9


def test_tracks_keep_their_rate_with_a_slower_detector() -> None:
    requests = requests_of(SceneScheduler(None, 10.0), lambda i: (PREDICTED if i % 6 else SEEN,))
    assert list(requests)[:6] == [0, 4, 6, 10, 12, 16]


def test_the_object_map_has_a_rate_of_its_own_and_needs_keyframes() -> None:
    requests = requests_of(SceneScheduler(None, None, 2.0), lambda _: ()).values()
    assert len(requests) == 6
    assert all(request.map_objects for request in requests)
    assert not any(request.fuse or request.track_objects for request in requests)


def test_nothing_is_selected_while_all_maps_are_off() -> None:
    assert SceneScheduler(None, None).pick(image(), lambda: NO_KEYFRAMES) is None


def test_an_image_without_a_pose_is_for_no_map_and_takes_no_turn() -> None:
    scheduler = SceneScheduler(3.0, 10.0)
    assert scheduler.pick(None, lambda: NO_KEYFRAMES) is None
    assert scheduler.pick(image(), lambda: NO_KEYFRAMES) is not None


def test_in_localization_objects_are_tracked_and_nothing_is_fused() -> None:
    request = SceneScheduler(30.0, 30.0, 30.0).pick(image(is_growing=False), lambda: NO_KEYFRAMES)
    assert request is not None
    assert not request.fuse
    assert request.track_objects
    assert request.map_objects


def test_a_map_beside_the_main_one_is_fused_and_its_objects_are_not_tracked() -> None:
    request = SceneScheduler(30.0, 30.0, 30.0).pick(
        image(is_in_main_map=False), lambda: NO_KEYFRAMES
    )
    assert request is not None
    assert request.fuse
    assert not request.track_objects
    aside = image(is_in_main_map=False, is_growing=False)
    assert SceneScheduler(30.0, 30.0, 30.0).pick(aside, lambda: NO_KEYFRAMES) is None


def test_an_image_whose_boxes_are_all_predicted_has_no_detections() -> None:
    moving = DynamicObject(UNKNOWN, BOX, 1.0, -1, ObjectState.MOVING)
    assert not has_detections((PREDICTED, moving))
    assert has_detections((PREDICTED, SEEN))
    assert has_detections(())
