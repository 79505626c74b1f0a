"""Motion segmentation in small rendered scenes with known answers."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from hoid_common import se3
from hoid_common.values import (
    PERSON,
    UNKNOWN,
    BoolArray,
    ByteArray,
    CameraModel,
    Detections,
    DynamicObject,
    Float32Array,
    FloatArray,
    ObjectState,
    RgbdFrame,
)
from hoid_filter.config import FilterConfig, MotionConfig
from hoid_filter.feature_filter import FeatureFilter
from hoid_filter.motion.downscaled_camera import DownscaledCamera, DownscaledView
from hoid_filter.motion.motion_segmentation import strongest_per_cell
from hoid_filter.motion.moving_regions import MotionLogOdds
from hoid_native import depth_segments

CAMERA = CameraModel(320, 240, 260.0, 260.0, 159.5, 119.5)
GRAY = np.zeros((240, 320), np.uint8)
LENS = CameraModel(320, 240, 260.0, 260.0, 159.5, 119.5, (0.1, -0.05, 0.0, 0.0, 0.0))
WALL_M, SQUARE_M, SIDE_M = 3.0, 1.5, 0.5
PERIOD_NS = 33_333_333


def texture(seed: int) -> ByteArray:
    """Return a (1024, 1024) random texture with 5 mm per pixel."""
    noise = np.random.default_rng(seed).integers(0, 256, (256, 256)).astype(np.uint8)
    return np.asarray(cv2.resize(noise, (1024, 1024), interpolation=cv2.INTER_CUBIC), np.uint8)


WALL, SQUARE = texture(1), texture(2)


class Scene:
    """A textured wall, and a textured square before it, seen by a camera without noise."""

    def __init__(self, camera: CameraModel = CAMERA) -> None:
        self.camera = camera
        v, u = np.mgrid[0 : camera.height_px, 0 : camera.width_px]
        pixels = np.stack([u.ravel(), v.ravel()], axis=1).astype(np.float32)
        ideal = camera.undistort_px(pixels).astype(np.float64)
        x = (ideal[:, 0] - camera.cx_px) / camera.fx_px
        y = (ideal[:, 1] - camera.cy_px) / camera.fy_px
        self._rays = np.stack([x, y, np.ones(len(x))], axis=1)

    def frame(
        self,
        i: int,
        T_world_camera: FloatArray,
        square_x_m: float | None,
        side_m: float = SIDE_M,
    ) -> tuple[RgbdFrame, BoolArray]:
        """Return an image, and the mask of its pixels on the square."""
        gray, depth_m = self._surface(T_world_camera, WALL_M, WALL)
        shape = self.camera.height_px, self.camera.width_px
        on_square = np.zeros(len(gray), np.bool_)
        if square_x_m is not None:
            on_square = self._is_square(T_world_camera, square_x_m, side_m)
            moved = T_world_camera.copy()
            moved[0, 3] -= square_x_m  # its texture goes with it
            near_gray, near_m = self._surface(moved, SQUARE_M, SQUARE)
            gray, depth_m = (
                np.where(on_square, *pair) for pair in ((near_gray, gray), (near_m, depth_m))
            )
        bgr = np.repeat(gray.reshape(*shape, 1), 3, axis=2).astype(np.uint8)
        depth = depth_m.reshape(shape).astype(np.float32)
        return RgbdFrame(i * PERIOD_NS, bgr, depth), on_square.reshape(shape)

    def _at(self, T_world_camera: FloatArray, plane_m: float) -> tuple[FloatArray, FloatArray]:
        rays = self._rays @ T_world_camera[:3, :3].T
        distance = (plane_m - T_world_camera[2, 3]) / rays[:, 2]
        return rays * distance[:, None] + T_world_camera[:3, 3], distance

    def _surface(
        self, T_world_camera: FloatArray, plane_m: float, painted: ByteArray
    ) -> tuple[FloatArray, FloatArray]:
        points_m, depth_m = self._at(T_world_camera, plane_m)
        shape = self.camera.height_px, self.camera.width_px
        column, row = (
            (part / 0.005 + 512).astype(np.float32).reshape(shape) for part in points_m.T[:2]
        )
        shown = cv2.remap(painted, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        return np.asarray(shown.ravel(), np.float64), depth_m

    def _is_square(
        self, T_world_camera: FloatArray, square_x_m: float, side_m: float
    ) -> BoolArray:
        points_m, _ = self._at(T_world_camera, SQUARE_M)
        off_m = np.abs(points_m[:, :2] - (square_x_m, 0.0)).max(axis=1)
        return np.asarray(off_m < side_m / 2, np.bool_)


def moved(x_m: float = 0.0, turned_rad: float = 0.0) -> FloatArray:
    return se3.exp(np.array([0.0, turned_rad, 0.0, x_m, 0.0, 0.0]))


@cache
def scene_of(camera: CameraModel) -> Scene:
    return Scene(camera)


@cache
def passing(i: int, camera: CameraModel = CAMERA) -> tuple[RgbdFrame, BoolArray]:
    """Return image i of a square that passes a moving camera."""
    return scene_of(camera).frame(i, moved(0.004 * i), -0.4 + 0.02 * i)


def seen_person(stamp_ns: int, square: BoolArray) -> Detections:
    """Return detections of the square as a person."""
    rows, columns = np.nonzero(square)
    box = [[columns.min(), rows.min(), columns.max() + 1, rows.max() + 1]]
    score = np.array([0.9], np.float32)
    return Detections(stamp_ns, np.array(box, np.float32), ('person',), score)


def make_filter(camera: CameraModel | None = CAMERA, strategy: str = 'motion') -> FeatureFilter:
    return FeatureFilter(FilterConfig(strategy=strategy), camera)


def corner_shares(motion: FeatureFilter, frame: RgbdFrame, square: BoolArray) -> tuple[float, ...]:
    """Return the share of features on the square, and the number of features."""
    features = motion.process(frame, None).features
    at = np.rint(features.uv_px).astype(int)
    return float(square[at[:, 1], at[:, 0]].mean()), len(features)


@pytest.mark.slow
@pytest.mark.parametrize('camera', [CAMERA, LENS], ids=['pinhole', 'lens'])
def test_a_moving_square_is_masked_and_reported(camera: CameraModel) -> None:
    motion = make_filter(camera)
    for i in range(25):
        frame, square = passing(i, camera)
        result = motion.process(frame, None)
    at = np.rint(result.features.uv_px).astype(int)
    assert square[at[:, 1], at[:, 0]].mean() < 0.01
    assert len(result.features) > 500
    (region,) = result.objects
    assert (region.class_name, region.state, region.is_dynamic) == (
        UNKNOWN,
        ObjectState.MOVING,
        True,
    )
    rows, columns = np.nonzero(square)
    box = columns.min(), rows.min(), columns.max() + 1, rows.max() + 1
    np.testing.assert_allclose(region.box_xyxy_px, box, atol=6)
    x_m, y_m, z_m = region.center_camera_m
    assert z_m == pytest.approx(SQUARE_M, abs=0.01)
    assert (x_m, y_m) == pytest.approx((-0.4 + 0.02 * 24 - 0.004 * 24, 0.0), abs=0.05)
    assert region.velocity_camera_mps == pytest.approx((0.02 * 30, 0.0, 0.0), abs=0.03)


@pytest.mark.slow
def test_a_square_that_moves_by_less_than_half_a_pixel_an_image_is_masked() -> None:
    motion = make_filter()
    for i in range(36):
        frame, square = scene_of(CAMERA).frame(i, moved(0.004 * i), 0.0018 * i)
        share, count = corner_shares(motion, frame, square)
    assert share < 0.01
    assert count > 500


@pytest.mark.slow
@pytest.mark.parametrize(
    ('step_m', 'turn_rad'), [(0.0, 0.0), (0.01, 0.0), (0.0, 0.02)], ids=['rests', 'goes', 'turns']
)
def test_nothing_is_masked_in_a_static_scene(step_m: float, turn_rad: float) -> None:
    motion, none = make_filter(), make_filter(strategy='none')
    for i in range(15):
        pose = moved(step_m * i, turn_rad * np.sin(i / 3))
        frame, _ = scene_of(CAMERA).frame(i, pose, 0.0)
        result = motion.process(frame, None)
        assert result.num_removed == 0
        assert result.objects == ()
        unfiltered = none.process(frame, None).features
        np.testing.assert_array_equal(result.features.uv_px, unfiltered.uv_px)


def test_features_may_be_described_before_motion_is_segmented() -> None:
    quick, patient = make_filter(), make_filter()
    objects: tuple[DynamicObject, ...] = ()  # of the last final verdict
    num_retracted = 0
    for i in range(20):
        frame, square = passing(i)
        detected = quick.detect_corners(frame)
        first = quick.select_and_describe(detected, None)
        assert not quick.is_motion_known(frame.stamp_ns)
        quick.detect_motion(detected)
        assert quick.is_motion_known(frame.stamp_ns)
        final = quick.reevaluate(first.features, frame.depth_m, None)
        boxes = [seen.box_xyxy_px for seen in first.objects]
        assert boxes == [seen.box_xyxy_px for seen in objects]  # as in the image before
        objects = final.objects
        at = np.rint(first.features.uv_px).astype(int)
        on_square = square[at[:, 1], at[:, 0]]
        num_retracted += int(final.feature_verdicts.is_dynamic[on_square].sum())
        wanted = patient.process(frame, None)
        assert list(map(repr, final.objects)) == list(map(repr, wanted.objects))
    assert len(objects) == 1
    assert num_retracted > 50  # where it had not been known to move
    assert on_square.mean() < 0.01


def test_motion_is_segmented_at_a_rate_and_regions_stay_between() -> None:
    config = FilterConfig(strategy='motion').updated({'motion.rate_hz': 15.0})
    motion = FeatureFilter(config, CAMERA)
    known, boxes = [], []
    for i in range(20):
        frame, square = passing(i)
        known.append(motion.is_motion_known(frame.stamp_ns))
        share, _ = corner_shares(motion, frame, square)
        boxes.append([seen.box_xyxy_px for seen in motion.process(frame, None).objects])
    assert known == [False, True] * 10
    assert len(boxes[18]) == 1
    assert boxes[18] == boxes[19]
    assert share < 0.03


@pytest.mark.slow
def test_an_object_that_stops_becomes_static_again() -> None:
    motion = make_filter()
    for i in range(20):
        last, square = passing(i)
        share, _ = corner_shares(motion, last, square)
    assert share == 0
    for i in range(20, 140):
        frame = RgbdFrame(i * PERIOD_NS, last.image_bgr, last.depth_m)
        share, _ = corner_shares(motion, frame, square)
    assert share > 0.1


def test_the_same_images_give_the_same_features() -> None:
    results = []
    for motion in (make_filter(), make_filter()):
        for i in range(15):
            result = motion.process(passing(i)[0], None)
        results.append(result.features.uv_px)
    np.testing.assert_array_equal(results[0], results[1])


def test_lost_depth_time_jumps_and_other_image_sizes_do_no_harm() -> None:
    motion = make_filter()
    blank = np.zeros((CAMERA.height_px, CAMERA.width_px), np.float32)
    for i in (0, 1, 2, 3, 24, 23, 4, 5, 5, 6):
        frame, _ = passing(i)
        for depth_m in (frame.depth_m, blank, blank * np.nan):
            seen = RgbdFrame(frame.stamp_ns * 3, frame.image_bgr, depth_m)
            assert len(motion.process(seen, None).features) > 100
    black = RgbdFrame(0, np.zeros((240, 320, 3), np.uint8), blank)
    assert len(motion.process(black, None).features) == 0
    other = CameraModel(160, 120, 130.0, 130.0, 79.5, 59.5)
    small = scene_of(other)
    for i in range(4):
        if i == 2:
            assert motion.counters['images without their camera'] == 2
            motion.camera = other
        motion.process(small.frame(i, moved(), 0.0)[0], None)
    assert motion.counters['images without their camera'] == 2


def test_without_a_camera_no_motion_is_segmented() -> None:
    motion = make_filter(None)
    for i in range(10):
        assert motion.process(passing(i)[0], None).num_removed == 0


def test_hoid_plus_masks_what_the_detector_misses() -> None:
    both = make_filter(strategy='hoid+')
    switched_off = FeatureFilter(
        FilterConfig(strategy='hoid+', motion=MotionConfig(enabled=False)), CAMERA
    )
    for i in range(20):
        frame, _ = passing(i)
        nobody = Detections.none(frame.stamp_ns)
        found, without = both.process(frame, nobody), switched_off.process(frame, nobody)
    assert [item.state for item in found.objects] == [ObjectState.MOVING]
    assert without.objects == ()
    assert without.num_removed == 0


def test_a_detected_object_is_not_reported_twice() -> None:
    both = make_filter(strategy='hoid+')
    for i in range(20):
        frame, square = passing(i)
        result = both.process(frame, seen_person(frame.stamp_ns, square))
    assert [item.state for item in result.objects] == [ObjectState.PERSON]


def test_a_person_over_most_of_the_view_does_not_pass_for_the_static_scene() -> None:
    both = make_filter(strategy='hoid+')
    for i in range(15):
        x_m = -0.3 + 0.02 * i
        frame, square = scene_of(CAMERA).frame(i, moved(0.004 * i), x_m, side_m=1.6)
        result = both.process(frame, seen_person(frame.stamp_ns, square))
    assert square.mean() > 0.6
    assert [item.state for item in result.objects] == [ObjectState.PERSON]
    at = np.rint(result.features.uv_px).astype(int)
    assert not square[at[:, 1], at[:, 0]].any()
    assert len(at) > 100


def test_each_pixel_maps_to_the_downscaled_pixel_of_its_undistorted_position() -> None:
    lens = (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)
    camera = CameraModel(640, 480, 517.3, 516.5, 318.6, 255.3, lens)
    pixels = np.arange(640 * 480)
    uv_px = np.stack([pixels % 640, pixels // 640], axis=1).astype(np.float32)
    small_px = (camera.undistort_px(uv_px) + 0.5) / 4 - 0.5
    nearest_px = np.clip(np.rint(small_px), 0, (159, 119))
    row, column = np.divmod(DownscaledCamera(camera).downscaled_of_pixel[pixels], 160)
    off_px = np.abs(np.stack([column, row], axis=1) - nearest_px).max(axis=1)
    assert off_px.max() <= 1  # where it lies between two
    assert np.mean(off_px > 0) < 0.01


def test_downscaled_depth_is_zero_beyond_the_full_image_and_where_depth_is_not_finite() -> None:
    distorted = replace(CAMERA, distortion=(0.6, 0.0, 0.0, 0.0, 0.0))
    small = DownscaledCamera(distorted).depth(np.ones((240, 320), np.float32))
    assert set(np.unique(small)) == {0.0, 1.0}  # the corners are not in the full image
    for missing in (np.nan, np.inf, -np.inf):
        depth_m = np.full((240, 320), 2.0, np.float32)
        depth_m[100:140, 100:140] = missing
        small = DownscaledCamera(CAMERA).depth(depth_m)
        assert set(np.unique(small)) == {0.0, 2.0}
        assert np.count_nonzero(small == 0) == 20 * 20


def test_pixels_without_depth_never_get_log_odds() -> None:
    camera = DownscaledCamera(CAMERA)
    log_odds = MotionLogOdds(camera, 1.0)
    random = np.random.default_rng(0)
    for i in range(20):
        depth_m: Float32Array = random.uniform(1.0, 1.02, camera.shape_hw).astype(np.float32)
        depth_m[random.random(camera.shape_hw) < 0.02] = 0.0
        segments = depth_segments(depth_m, 20)
        view = DownscaledView(i / 30, GRAY, depth_m, segments)
        evidence = random.normal(0.5, 1.0, len(segments.region))
        log_odds.update(view, np.eye(4), evidence)
        assert (log_odds.log_odds[depth_m == 0] == 0).all()
        assert np.abs(log_odds.log_odds).max() <= 3.0


def test_log_odds_decay_by_time_and_not_by_images() -> None:
    camera = DownscaledCamera(CAMERA)
    depth_m = np.full(camera.shape_hw, 2.0, np.float32)
    segments = depth_segments(depth_m, 20)
    left = []
    for rate_hz in (8.0, 60.0):
        log_odds = MotionLogOdds(camera, 1.0)
        evidence = np.full(len(segments.region), 2.0)
        log_odds.update(DownscaledView(0.0, GRAY, depth_m, segments), np.eye(4), evidence)
        for i in range(1, int(rate_hz) + 1):
            view = DownscaledView(i / rate_hz, GRAY, depth_m, segments)
            log_odds.update(view, np.eye(4), 0 * evidence)
        left.append(float(log_odds.log_odds[60, 80]))
    assert left[0] == pytest.approx(left[1], rel=1e-3)
    assert left[0] == pytest.approx(2.0 * np.exp(-1.0), rel=1e-3)


def test_no_motion_is_looked_for_in_a_color_image_that_is_sent_twice() -> None:
    """A camera passes a square at rest; the depth image of each copy is new, and shows it."""
    filtering = FeatureFilter(FilterConfig(strategy='motion'), CAMERA)
    frames = [scene_of(CAMERA).frame(i, moved(0.01 * i), 0.0)[0] for i in range(24)]
    for i, frame in enumerate(frames):
        shown = frames[i - i % 2].image_bgr
        result = filtering.process(replace(frame, image_bgr=shown), None)
        assert not [item for item in result.objects if item.is_dynamic]
    assert filtering.counters['repeated color images'] == 12


@pytest.mark.parametrize(
    ('turn_radps', 'expected'), [(0.5, ObjectState.PERSON), (2.5, ObjectState.AT_REST)]
)
def test_a_weak_person_is_doubted_by_the_turn_that_the_images_show(
    turn_radps: float, expected: ObjectState
) -> None:
    both = make_filter(strategy='hoid+')
    for i in range(6):
        pose = moved(turned_rad=turn_radps * (i - 3) * PERIOD_NS * 1e-9)
        frame, square = scene_of(CAMERA).frame(i, pose, 0.0)
        found = replace(seen_person(frame.stamp_ns, square), scores=np.array([0.4], np.float32))
        is_last = i == 5
        result = both.process(frame, found if is_last else Detections.none(frame.stamp_ns))
    (person,) = [item for item in result.objects if item.class_name == PERSON]
    assert person.state is expected


def test_the_strongest_corner_of_each_cell_is_chosen() -> None:
    cells = np.array([7, 0, 0, 0, 7, 3])
    scores = np.array([10, 90, 90, 80, 200, 255], np.uint8)
    assert strongest_per_cell(cells, scores).tolist() == [1, 5, 4]
