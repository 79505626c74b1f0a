"""The whole filter on one textured image with known boxes."""

import dataclasses

import cv2
import numpy as np
import pytest

from hoid_common.errors import MessageError
from hoid_common.values import CameraModel, ObjectState, RgbdFrame
from hoid_filter.config import FilterConfig
from hoid_filter.extraction.extractor import OrbExtractor
from hoid_filter.feature_filter import FeatureFilter

from .helpers import detections

HEIGHT, WIDTH = 480, 640
CAMERA = CameraModel(WIDTH, HEIGHT, 500.0, 500.0, 320.0, 240.0)
PERSON_BOX = (100.0, 50.0, 300.0, 450.0)


@pytest.fixture(scope='module')
def frame() -> RgbdFrame:
    rng = np.random.default_rng(3)
    coarse = rng.integers(0, 256, (HEIGHT // 8, WIDTH // 8, 3), dtype=np.uint8)
    image = cv2.resize(coarse, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
    color = np.asarray(image, np.uint8)
    return RgbdFrame(1_000, color, np.full((HEIGHT, WIDTH), 2.0, np.float32))


def test_no_feature_in_a_dynamic_box_and_the_budget_refilled(frame: RgbdFrame) -> None:
    found = detections(('person', PERSON_BOX), stamp_ns=frame.stamp_ns)
    result = FeatureFilter(FilterConfig(strategy='hoid2d'), CAMERA).process(
        frame, found, for_picture=True
    )
    u, v = np.rint(result.features.uv_px).T
    inside = (u >= 100) & (u < 300) & (v >= 50) & (v < 450)
    assert not inside.any()
    assert len(result.features) == 1000
    assert 0 < result.num_removed < result.num_features_in
    x, y = np.rint(result.removed_uv_px).T
    assert len(x) > 100
    assert ((x >= 100) & (x < 300) & (y >= 50) & (y < 450)).all()


@pytest.mark.parametrize('strategy', ['person', 'hoid+'])
def test_a_person_over_the_whole_image_leaves_no_feature(frame: RgbdFrame, strategy: str) -> None:
    found = detections(('person', (-5.0, -5.0, WIDTH + 5.0, HEIGHT + 5.0)), stamp_ns=1_000)
    result = FeatureFilter(FilterConfig(strategy=strategy), CAMERA).process(frame, found)
    assert len(result.features) == 0
    assert result.num_removed == result.num_features_in > 1000


def test_without_refill_the_masked_features_are_not_replaced(frame: RgbdFrame) -> None:
    found = detections(('person', PERSON_BOX), stamp_ns=frame.stamp_ns)
    everything = FeatureFilter(FilterConfig(strategy='none'))
    corners = everything.detect_corners(frame).corners
    extractor = OrbExtractor(FilterConfig().extraction)
    chosen = extractor.choose(corners, None, frame.depth_m.size)
    v, u = np.divmod(corners.pixel[chosen], WIDTH)
    outside = ~((u >= 100) & (u < 300) & (v >= 50) & (v < 450))
    whole = everything.process(frame, found).features
    config = FilterConfig(strategy='hoid2d').updated({'extraction.refill': False})
    rest = FeatureFilter(config).process(frame, found).features
    assert 100 < len(rest) == np.count_nonzero(outside) < 1000
    np.testing.assert_array_equal(rest.descriptors, whole.descriptors[outside])
    moved = (rest.uv_px != whole.uv_px[outside]).any(1)  # at the box, not into it
    assert 0 < moved.sum() < 20


def test_an_object_has_a_center_in_the_camera_frame(frame: RgbdFrame) -> None:
    found = detections(('person', PERSON_BOX), stamp_ns=frame.stamp_ns)
    (person,) = (
        FeatureFilter(FilterConfig(strategy='hoid2d'), CAMERA).process(frame, found).objects
    )
    assert person.state is ObjectState.PERSON
    assert person.is_dynamic
    assert person.center_camera_m == pytest.approx((-0.48, 0.04, 2.0))
    assert person.size_m == pytest.approx((0.8, 1.6))


def test_the_center_is_right_with_lens_distortion(frame: RgbdFrame) -> None:
    lens = dataclasses.replace(CAMERA, distortion=(-0.3, 0.1, 0.001, -0.002, 0.0))
    center_m = (-0.9, 0.6, 2.0)
    u, v = lens.project_px(np.array([center_m]))[0]
    assert u > 320 - 0.9 / 2.0 * 500 + 10  # the lens moves it by more than 10 px
    found = detections(('person', (u - 50, v - 60, u + 50, v + 60)), stamp_ns=frame.stamp_ns)
    (person,) = FeatureFilter(FilterConfig(strategy='person'), lens).process(frame, found).objects
    assert person.center_camera_m == pytest.approx(center_m, abs=1e-4)


def test_without_a_camera_centers_are_unknown(frame: RgbdFrame) -> None:
    found = detections(('person', PERSON_BOX), stamp_ns=frame.stamp_ns)
    (person,) = FeatureFilter(FilterConfig(strategy='person')).process(frame, found).objects
    assert np.isnan(person.center_camera_m).all()


def test_with_a_camera_of_another_image_size_centers_are_unknown(frame: RgbdFrame) -> None:
    found = detections(('person', PERSON_BOX), stamp_ns=frame.stamp_ns)
    half = CameraModel(WIDTH // 2, HEIGHT // 2, 250.0, 250.0, 160.0, 120.0)
    (person,) = FeatureFilter(FilterConfig(strategy='person'), half).process(frame, found).objects
    assert np.isnan((*person.center_camera_m, *person.size_m)).all()


def test_silent_detector_is_bridged_by_prediction(frame: RgbdFrame) -> None:
    feature_filter = FeatureFilter(FilterConfig(strategy='hoid2d'), CAMERA)
    found = detections(('person', PERSON_BOX), stamp_ns=frame.stamp_ns)
    feature_filter.process(frame, found)
    later = RgbdFrame(frame.stamp_ns + 33_000_000, frame.image_bgr, frame.depth_m)
    (person,) = feature_filter.process(later, None).objects
    assert person.state is ObjectState.PREDICTED
    assert person.is_dynamic
    much_later = RgbdFrame(frame.stamp_ns + 10**10, frame.image_bgr, frame.depth_m)
    assert feature_filter.process(much_later, None).objects == ()


def test_reset_forgets_earlier_images_and_keeps_the_camera(frame: RgbdFrame) -> None:
    feature_filter = FeatureFilter(FilterConfig(strategy='hoid2d'), CAMERA)
    late = dataclasses.replace(frame, stamp_ns=10**12)
    found = detections(('person', PERSON_BOX), stamp_ns=late.stamp_ns)
    feature_filter.process(late, found)
    feature_filter.reset()
    early = dataclasses.replace(found, stamp_ns=frame.stamp_ns)
    (person,) = feature_filter.process(frame, early).objects
    assert person.state is ObjectState.PERSON
    assert person.center_camera_m == pytest.approx((-0.48, 0.04, 2.0))
    next_one = dataclasses.replace(frame, stamp_ns=frame.stamp_ns + 33_000_000)
    (person,) = feature_filter.process(next_one, None).objects
    assert person.state is ObjectState.PREDICTED


def test_bad_boxes_are_counted(frame: RgbdFrame) -> None:
    feature_filter = FeatureFilter(FilterConfig(strategy='hoid2d'), CAMERA)
    found = detections(
        ('person', (50.0, 50.0, 20.0, 90.0)), ('cup', (600.0, 10.0, 700.0, 50.0)), stamp_ns=1_000
    )
    feature_filter.process(frame, found)
    assert feature_filter.counters['boxes refused'] == 1
    assert feature_filter.counters['boxes clipped'] == 1


def test_depth_of_another_size_is_refused(frame: RgbdFrame) -> None:
    small = RgbdFrame(0, frame.image_bgr, np.ones((240, 320), np.float32))
    with pytest.raises(MessageError, match='320x240 but color is 640x480'):
        FeatureFilter(FilterConfig()).process(small, None)


@pytest.mark.parametrize('strategy', ['person', 'hoid2d', 'hoid3d', 'hoid+'])
def test_late_detections_classify_the_published_features(frame: RgbdFrame, strategy: str) -> None:
    features = FeatureFilter(FilterConfig(strategy=strategy), CAMERA)
    first = features.process(frame, None)
    assert first.objects == ()
    found = detections(('person', PERSON_BOX), stamp_ns=frame.stamp_ns)
    final = features.reevaluate(first.features, frame.depth_m, found)
    assert [seen.state for seen in final.objects] == [ObjectState.PERSON]
    assert final.feature_verdicts.stamp_ns == frame.stamp_ns
    u, v = np.rint(first.features.uv_px).T
    inside = (u >= 100) & (u < 300) & (v >= 50) & (v < 450)
    near = (u >= 88) & (u < 312) & (v >= 38) & (v < 462)
    assert inside.sum() > 50
    assert final.feature_verdicts.is_dynamic[inside].all()
    assert not final.feature_verdicts.is_dynamic[~near].any()


def test_late_detections_are_used_in_the_next_image(frame: RgbdFrame) -> None:
    late, prompt = (FeatureFilter(FilterConfig(), CAMERA) for _ in range(2))
    found = detections(('person', PERSON_BOX), stamp_ns=frame.stamp_ns)
    first = late.process(frame, None)
    late.reevaluate(first.features, frame.depth_m, found)
    prompt.process(frame, found)
    following = dataclasses.replace(frame, stamp_ns=frame.stamp_ns + 33_000_000)
    got, wanted = late.process(following, None), prompt.process(following, None)
    assert [seen.state for seen in got.objects] == [ObjectState.PREDICTED]
    assert [seen.box_xyxy_px for seen in got.objects] == [PERSON_BOX]
    np.testing.assert_array_equal(got.features.uv_px, wanted.features.uv_px)


def test_a_skipped_image_is_classified_by_the_boxes_of_the_next(frame: RgbdFrame) -> None:
    depth_m = np.full_like(frame.depth_m, 3.0)
    depth_m[50:450, 100:300] = 1.5  # the person before a wall
    frame = dataclasses.replace(frame, depth_m=depth_m)
    features = FeatureFilter(FilterConfig(), CAMERA)
    first = features.process(frame, None)
    following = dataclasses.replace(frame, stamp_ns=frame.stamp_ns + 33_000_000)
    features.process(following, None)
    found = detections(('person', PERSON_BOX), stamp_ns=following.stamp_ns)
    final = features.reevaluate(first.features, frame.depth_m, found)
    assert [seen.state for seen in final.objects] == [ObjectState.PREDICTED]
    assert final.feature_verdicts.is_dynamic.sum() > 50
    again = features.reevaluate(first.features, frame.depth_m, found)
    np.testing.assert_array_equal(
        again.feature_verdicts.is_dynamic, final.feature_verdicts.is_dynamic
    )


def test_late_detections_of_nobody_leave_all_features(frame: RgbdFrame) -> None:
    features = FeatureFilter(FilterConfig(), CAMERA)
    first = features.process(frame, None)
    final = features.reevaluate(first.features, frame.depth_m, detections(stamp_ns=1_000))
    assert final.objects == ()
    assert len(final.feature_verdicts.is_dynamic) == len(first.features)
    assert not final.feature_verdicts.is_dynamic.any()
