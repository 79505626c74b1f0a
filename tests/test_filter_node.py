"""hoid_filter on real topics: features and verdicts, late and missing detections."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from hoid_msgs.msg import ObjectState
from sensor_msgs.msg import Image

from hoid_common.ros import conversions
from hoid_system_tests.filter_peer import (
    CUP,
    DEPTH_M,
    HEIGHT,
    IMAGE,
    PERSON,
    TV,
    WIDTH,
    FilterRunner,
    num_inside,
)
from hoid_system_tests.probe import Probe


def test_one_image_yields_the_expected_features_and_objects(run_filter: FilterRunner) -> None:
    peer = run_filter()
    peer.show(0, PERSON, CUP, TV)
    features, objects = peer.answer()
    header = peer.header(0)
    assert features.header == header
    assert objects.header == header
    assert (features.image_width, features.image_height) == (WIDTH, HEIGHT)
    assert len(features.octave) == 1000
    assert set(features.depth_m) == {2.0}
    assert num_inside(features, PERSON) == num_inside(features, CUP) == 0
    assert num_inside(features, TV) > 50
    assert 0 < features.num_removed < features.num_detected
    assert [(o.class_name, o.dynamic, o.state) for o in objects.objects] == [
        ('person', True, ObjectState.PERSON),
        ('cup', True, ObjectState.HANDLED),
        ('tv', False, ObjectState.AT_REST),
    ]
    person, cup, _ = objects.objects
    assert cup.overlap_ratio == pytest.approx(0.5)
    assert cup.depth_gap_m == 0.0
    assert list(person.center_camera_m) == pytest.approx([-0.48, 0.04, 2.0])
    assert list(person.size_m) == pytest.approx([0.8, 1.6])


def test_the_first_image_waits_for_the_first_detections(run_filter: FilterRunner) -> None:
    peer = run_filter(**{'detections.wait_s': 10.0})
    peer.send_images(0)
    peer.probe.spin_for(0.3)
    assert peer.features == []
    peer.send_boxes(0, PERSON)
    features, objects = peer.answer(1)
    assert not objects.provisional
    assert [o.state for o in objects.objects] == [ObjectState.PERSON]
    assert num_inside(features, PERSON) == 0


def test_held_images_are_published_one_by_one(run_filter: FilterRunner) -> None:
    """The queue of the SLAM node is short: a burst would overflow it."""
    peer = run_filter(**{'detections.wait_s': 10.0})
    for i in range(8):
        peer.send_images(i)
        peer.probe.spin_for(0.1)
    assert peer.features == []
    peer.send_boxes(0, PERSON)
    peer.answer(1)
    first_s = time.monotonic()
    features, _ = peer.answer(8)
    assert features.header == peer.header(7)
    assert time.monotonic() - first_s > 0.2  # they are published by the filter's timer


def test_an_image_is_published_at_once_and_late_detections_give_the_final_verdict(
    run_filter: FilterRunner,
) -> None:
    peer = run_filter(**{'detections.wait_s': 10.0})
    peer.show(0)
    peer.answer(1)
    peer.send_images(1)
    features, objects = peer.answer(2)
    assert objects.provisional
    assert list(objects.objects) == []
    assert num_inside(features, PERSON) > 50  # it has not been detected so far
    peer.probe.spin_for(0.3)
    assert peer.verdicts == []
    peer.send_boxes(1, PERSON)
    _, objects = peer.answer(3, num_features=2)
    assert not objects.provisional
    assert objects.header == peer.header(1)
    assert [o.state for o in objects.objects] == [ObjectState.PERSON]
    peer.probe.spin_until(lambda: bool(peer.verdicts), 'no final verdict on the features')
    assert peer.verdicts[0].header == peer.header(1)
    is_dynamic = np.array(peer.verdicts[0].dynamic, np.bool_)
    assert is_dynamic.sum() == pytest.approx(num_inside(features, PERSON), rel=0.2)
    u, v = np.rint(np.array(features.uv_px).reshape(-1, 2)).T
    left, top, right, bottom = PERSON[1]
    inside = (u >= left) & (u < right) & (v >= top) & (v < bottom)
    assert is_dynamic[inside].all()
    peer.wait_for_count('images filtered', 2)
    assert peer.newest_diagnosis()[1]['images without detections'] == '0'


def test_detections_before_the_image_make_its_verdict_final(run_filter: FilterRunner) -> None:
    peer = run_filter()
    peer.send_boxes(0, PERSON)
    peer.probe.spin_for(0.2)
    peer.send_images(0)
    features, objects = peer.answer(1)
    assert not objects.provisional
    assert [o.state for o in objects.objects] == [ObjectState.PERSON]
    assert num_inside(features, PERSON) == 0


def test_the_provisional_verdict_becomes_final_without_detections_in_time(
    run_filter: FilterRunner,
) -> None:
    peer = run_filter(**{'detections.wait_s': 0.2})
    peer.send_boxes(0, PERSON)
    peer.probe.spin_for(0.2)
    peer.send_images(1)
    features, objects = peer.answer(1)
    assert objects.provisional
    assert [o.state for o in objects.objects] == [ObjectState.PREDICTED]
    assert num_inside(features, PERSON) == 0
    _, final = peer.answer(2, num_features=1)
    assert not final.provisional
    assert [o.state for o in final.objects] == [ObjectState.PREDICTED]
    peer.probe.spin_until(lambda: bool(peer.verdicts), 'no final verdict on the features')
    assert not any(peer.verdicts[0].dynamic)
    peer.wait_for_count('images without detections', 1)


def test_a_skipped_image_is_classified_by_the_boxes_of_the_next(run_filter: FilterRunner) -> None:
    peer = run_filter(**{'detections.wait_s': 10.0})
    peer.show(0)
    for i in range(1, 4):
        peer.answer(i)
        peer.send_images(i)
    peer.answer(4)
    assert all(objects.provisional for objects in peer.objects[1:])
    peer.send_boxes(2, PERSON)
    peer.answer(6, num_features=4)
    assert [o.header for o in peer.objects[4:]] == [peer.header(1), peer.header(2)]
    reasons = [o.objects[0].state for o in peer.objects[4:]]
    assert reasons == [ObjectState.PREDICTED, ObjectState.PERSON]
    peer.send_images(4)
    features, objects = peer.answer(7, num_features=5)
    assert objects.provisional
    assert [o.state for o in objects.objects] == [ObjectState.PREDICTED]
    assert num_inside(features, PERSON) == 0


@pytest.mark.parametrize('strategy', ['motion', 'hoid+'])
def test_features_are_published_before_motion_is_segmented(
    run_filter: FilterRunner, probe: Probe, strategy: str
) -> None:
    masks = probe.collect(Image, 'hoid_filter/mask', wait=False)
    peer = run_filter(strategy=strategy)
    num = 12
    for i in range(num):
        image_bgr, depth_m = IMAGE.copy(), np.full_like(DEPTH_M, 3.0)
        left = 100 + 14 * i
        box = (float(left), 120.0, left + 200.0, 320.0)
        image_bgr[120:320, left : left + 200] = IMAGE[0:200, 0:200]
        depth_m[120:320, left : left + 200] = 1.5  # the square passes in front of a wall
        if strategy == 'hoid+':  # nobody is detected
            peer.send_boxes(i)
            peer.probe.spin_for(0.1)
        peer.send_images(i, depth_m, image_bgr)
        _, final = peer.answer(2 * i + 2, num_features=i + 1)
    assert [objects.provisional for objects in peer.objects] == [True, False] * num
    headers = [peer.header(i) for i in range(num)]
    assert [objects.header for objects in peer.objects[::2]] == headers
    (seen,) = final.objects
    assert (seen.class_name, seen.state) == ('unknown', ObjectState.MOVING)
    assert (seen.x_min, seen.y_min, seen.x_max, seen.y_max) == pytest.approx(box, abs=16)
    before = peer.objects[-2].objects[0]  # the provisional verdict has the previous region
    assert before.x_max == pytest.approx(box[2] - 14, abs=16)
    peer.probe.spin_until(
        lambda: len(peer.verdicts) == len(masks) == num, 'final verdicts or masks are missing'
    )
    assert [v.header for v in peer.verdicts] == headers
    # Features on pixels that did not move before become dynamic.
    assert any(any(v.dynamic) for v in peer.verdicts[1:])
    # The final verdict masks the pixels that the square covers only in the last image.
    new = ('', (box[2] - 10, 140.0, box[2], 300.0))
    assert num_inside(peer.features[-1], ('', box)) < 0.2 * num_inside(peer.features[0], ('', box))
    mask = np.frombuffer(masks[-1].data, np.uint8).reshape(HEIGHT, WIDTH)
    assert not mask[140:300, int(new[1][0]) : int(new[1][2])].any()


def test_motion_segmentation_is_skipped_while_the_next_image_waits(
    run_filter: FilterRunner,
) -> None:
    peer = run_filter(strategy='motion', **{'input.reliability': 'reliable'})
    peer.send_images(0)
    peer.answer(2, num_features=1)
    num = 6
    for i in range(1, num):  # faster than the node can process them
        peer.send_images(i)
    peer.answer(2 * num, num_features=num)
    final = [objects.header for objects in peer.objects if not objects.provisional]
    assert final == [peer.header(i) for i in range(num)]
    peer.wait_for_count('images without motion segmentation', 1)
    assert int(peer.newest_diagnosis()[1]['images without motion segmentation']) < num - 1


@pytest.mark.parametrize('on_loss', ['unfiltered', 'stop'])
def test_the_loss_of_the_detector_is_reported_and_survived(
    run_filter: FilterRunner, on_loss: str
) -> None:
    peer = run_filter(**{'detections.timeout_s': 1.0, 'detections.on_loss': on_loss})
    peer.show(0, PERSON)
    peer.answer(1)
    for i in range(1, 46):
        peer.send_images(i)
        peer.probe.spin_for(0.033)
    features, objects = peer.answer(2)  # predicted boxes are used at first
    assert [o.state for o in objects.objects] == [ObjectState.PREDICTED]
    assert num_inside(features, PERSON) == 0
    peer.probe.spin_until(
        lambda: 'is the detector alive?' in peer.newest_diagnosis()[0], 'the loss is not reported'
    )
    if on_loss == 'stop':
        assert peer.features[-1].header.stamp != peer.header(45).stamp
    else:
        peer.probe.spin_until(
            lambda: peer.features[-1].header.stamp == peer.header(45).stamp,
            'the filter has stopped',
        )
        assert num_inside(peer.features[-1], PERSON) > 50
    peer.send_boxes(45, PERSON)
    peer.probe.spin_until(
        lambda: 'is the detector alive?' not in peer.newest_diagnosis()[0],
        'the detector is still reported as lost',
    )
    peer.show(46, PERSON)
    peer.probe.spin_until(
        lambda: peer.features[-1].header.stamp == peer.header(46).stamp, 'features do not resume'
    )
    assert num_inside(peer.features[-1], PERSON) == 0


def test_the_debug_image_is_drawn_for_a_subscriber(run_filter: FilterRunner) -> None:
    peer = run_filter()
    pictures = peer.probe.collect(Image, 'hoid_filter/debug_image')
    peer.probe.spin_for(0.3)
    peer.show(0, PERSON)
    peer.probe.spin_until(lambda: bool(pictures), 'no picture')
    picture = conversions.color_from_msg(pictures[0])
    assert pictures[0].header == peer.header(0)
    assert picture.shape == IMAGE.shape
    assert picture[300, 100].tolist() == [60, 60, 230]  # the left edge of the person's box


def test_a_parameter_set_at_run_time_changes_the_verdicts(run_filter: FilterRunner) -> None:
    peer = run_filter()
    chair = ('chair', (200.0, 100.0, 400.0, 300.0))  # half of it in the person's box
    seat = ('chair', (300.0, 100.0, 400.0, 300.0))  # the other half
    for i, (limit, reason) in enumerate(
        [(0.4, ObjectState.HANDLED), (0.6, ObjectState.AT_REST), (0.4, ObjectState.HANDLED)]
    ):
        peer.probe.set_parameters('hoid_filter', {'min_interaction_area': limit})
        peer.show(i, PERSON, chair)
        features, objects = peer.answer(i + 1)
        assert [o.state for o in objects.objects] == [ObjectState.PERSON, reason]
        assert (num_inside(features, seat) > 20) == (reason == ObjectState.AT_REST)


@pytest.mark.parametrize('strategy', ['person', 'hoid+'])
def test_masked_images_for_another_slam_exclude_the_person(
    run_filter: FilterRunner, probe: Probe, strategy: str
) -> None:
    peer = run_filter(strategy=strategy)
    masks = probe.collect(Image, 'hoid_filter/mask')
    depths = probe.collect(Image, 'hoid_filter/static_depth')
    probe.spin_for(0.5)
    depth_m = np.full_like(DEPTH_M, 4.0)
    depth_m[50:450, 100:300] = 2.0  # the person in front of a wall
    peer.show(0, PERSON, depth_m=depth_m)
    probe.spin_until(lambda: bool(masks and depths), 'no masked images')
    assert masks[0].header == depths[0].header == peer.header(0)
    assert masks[0].encoding == 'mono8'
    mask = np.frombuffer(masks[0].data, np.uint8).reshape(HEIGHT, WIDTH)
    assert set(np.unique(mask)) == {0, 255}
    assert not mask[80:420, 130:270].any()
    assert (mask[:, 340:] == 255).all()
    static_m = conversions.depth_from_msg(depths[0])
    np.testing.assert_allclose(static_m, np.where(mask == 255, depth_m, 0.0))


def test_all_classes_may_be_handled_with_an_empty_list(run_filter: FilterRunner) -> None:
    peer = run_filter(dynamic_classes=[])
    sink = ('sink', CUP[1])
    peer.show(0, PERSON, sink)
    _, objects = peer.answer()
    assert [(o.class_name, o.state) for o in objects.objects] == [
        ('person', ObjectState.PERSON),
        ('sink', ObjectState.HANDLED),
    ]


def test_a_misspelled_class_is_named(run_filter: FilterRunner, tmp_path: Path) -> None:
    run_filter(dynamic_classes=['cupp', 'zebra'])
    log = '\n'.join(path.read_text() for path in tmp_path.glob('log_*/*'))
    assert 'dynamic_classes: COCO has no class "cupp"; did you mean cup' in log
    assert 'zebra' not in log
