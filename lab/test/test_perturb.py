"""Perturbed recordings and detections."""

from collections.abc import Iterator

import numpy as np
import pytest

from hoid_benchmarks.plan.perturb import PerturbedSequence, cover_columns, perturb_detections
from hoid_benchmarks.plan.plan import Perturbation
from hoid_common.values import CameraModel, Detections, RgbdFrame, Trajectory


class Recording:
    name, true_detections, fault = 'r', None, None
    ground_truth: Trajectory | None = None
    camera = CameraModel(64, 48, 50.0, 50.0, 31.5, 23.5)

    def __len__(self) -> int:
        return 90

    def __iter__(self) -> Iterator[RgbdFrame]:
        for i in range(90):
            yield RgbdFrame(
                i * 33_333_333,
                np.full((48, 64, 3), 9, np.uint8),
                np.full((48, 64), 2.0, np.float32),
            )


def test_perturbed_frames_are_the_same_each_time_and_as_hard_as_asked() -> None:
    hard = PerturbedSequence(Recording(), Perturbation(depth_missing_share=0.3), 1)
    first, again = (np.stack([f.depth_m for f in hard]) for _ in range(2))
    np.testing.assert_array_equal(first, again)
    assert (first == 0).mean() == pytest.approx(0.3, abs=0.01)
    noisy = PerturbedSequence(Recording(), Perturbation(depth_noise=0.01), 1)
    assert np.std([f.depth_m for f in noisy]) == pytest.approx(0.04, rel=0.05)


def test_a_looped_recording_goes_forth_and_back_in_time_order() -> None:
    recording = Recording()
    walked = np.tile(np.eye(4), (80, 1, 1))  # the last frames have no ground truth
    walked[:, 0, 3] = np.arange(80)
    recording.ground_truth = Trajectory(33_333_333 * np.arange(80) + 3_000_000, walked)
    looped = PerturbedSequence(recording, Perturbation(loops=3), 0)
    stamps = [f.stamp_ns for f in looped]
    assert len(stamps) == len(looped) == 270
    assert (np.diff(stamps) > 0).all()
    truth = looped.ground_truth
    assert truth is not None
    there = truth.T_world_camera[:, 0, 3].astype(int).tolist()
    assert there == [*range(80), *reversed(range(80)), *range(80)]
    assert set(truth.stamps_ns.tolist()) <= set(stamps)
    # The backward pass begins with frames without ground truth.
    assert truth.stamps_ns[80] == stamps[100]


def walked(count: int) -> Trajectory:
    """Return one true pose per image of the recording, each one meter further."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 0, 3] = np.arange(count)
    return Trajectory(33_333_333 * np.arange(count), poses)


def arranged(perturbation: Perturbation) -> tuple[list[RgbdFrame], dict[int, int], int]:
    """Return the images, the true position of each by stamp, and the number of visible images."""
    recording = Recording()
    recording.ground_truth = walked(90)
    made = PerturbedSequence(recording, perturbation, 3)
    truth = made.ground_truth
    assert truth is not None
    places = truth.T_world_camera[:, 0, 3].astype(int).tolist()
    there = dict(zip(truth.stamps_ns.tolist(), places, strict=True))
    return list(made), there, len(made)


def test_a_covered_lens_shows_nothing_and_the_stream_goes_on() -> None:
    frames, _, visible = arranged(Perturbation(black_images=20))
    black = [not f.image_bgr.any() and not f.depth_m.any() for f in frames]
    assert black == [False] * 45 + [True] * 20 + [False] * 25
    assert visible == 70


def test_after_a_blackout_the_camera_is_elsewhere_at_once() -> None:
    frames, there, visible = arranged(Perturbation(black_images=10, cut_images=15))
    assert [there[f.stamp_ns] for f in frames] == [*range(55), *range(70, 90)]
    assert [n for n, f in enumerate(frames) if not f.image_bgr.any()] == list(range(45, 55))
    assert set(np.diff([f.stamp_ns for f in frames])) == {33_333_333}
    assert visible == 65


def test_a_jump_goes_back_to_a_place_seen_before() -> None:
    frames, there, visible = arranged(Perturbation(jump_back=20))
    assert [there[f.stamp_ns] for f in frames] == [*range(45), *range(25, 90)]
    assert set(np.diff([f.stamp_ns for f in frames])) == {33_333_333}
    assert visible == 110


def test_images_are_lost_at_their_own_times_and_stamps_are_off() -> None:
    frames, there, visible = arranged(Perturbation(keep_every=2))
    assert [there[f.stamp_ns] for f in frames] == list(range(0, 90, 2))
    assert [f.stamp_ns for f in frames] == [33_333_333 * n for n in range(0, 90, 2)]
    assert visible == 45
    frames, there, _ = arranged(Perturbation(stamp_jitter_ms=5.0))
    assert [there[f.stamp_ns] for f in frames] == list(range(90))
    off_ms = np.array([f.stamp_ns - 33_333_333 * n for n, f in enumerate(frames)]) / 1e6
    assert np.abs(off_ms).max() <= 5
    assert off_ms.std() == pytest.approx(5 / 3**0.5, rel=0.2)


def test_the_cover_hides_its_share_of_the_width() -> None:
    for stamp_ns in range(0, 10**10, 10**9):
        left, right = cover_columns(640, 0.4, stamp_ns)
        assert 0 <= left < right <= 640
        assert right - left == 256


def detect(frame: RgbdFrame) -> Detections:
    box = np.array([[1, 2, 3, 4]], np.float32)
    return Detections(frame.stamp_ns, box, ('person',), np.ones(1, np.float32))


def outcomes(perturbation: Perturbation) -> list[Detections | None]:
    source = perturb_detections(detect, perturbation, 0)
    return [source(frame) for frame in Recording()]


def is_empty(found: Detections | None) -> bool:
    return found is not None and len(found) == 0


def test_missed_detections_are_empty_and_late_ones_none() -> None:
    missed = [is_empty(d) for d in outcomes(Perturbation(missed_share=0.4))]
    assert np.mean(missed) == pytest.approx(0.4, abs=0.12)
    third = [is_empty(d) for d in outcomes(Perturbation(missed_every=3))]
    assert third[:6] == [False, False, True] * 2
    slow = outcomes(Perturbation(detector_hz=10.0))
    assert sum(d is not None for d in slow) == 30
    run = [is_empty(d) for d in outcomes(Perturbation(missed_run=10))]
    assert sum(run) == 0  # the first run of missed frames comes after 3 s


def test_people_are_missed_and_things_are_not() -> None:
    boxes = np.tile(np.array([[1, 1, 9, 9]], np.float32), (3, 1))
    seen = Detections(0, boxes, ('person', 'cup', 'person'), np.ones(3, np.float32))
    frame = next(iter(Recording()))
    for share in (0.6, 1.0):
        source = perturb_detections(lambda _: seen, Perturbation(missed_people=share), 0)
        found = [names for _ in range(200) if (names := source(frame)) is not None]
        assert all(one.class_names.count('cup') == 1 for one in found)
        people = sum(one.class_names.count('person') for one in found)
        assert people / 400 == pytest.approx(1 - share, abs=0.08)


def test_a_detector_that_dies_says_nothing_more() -> None:
    has_detections = [d is not None for d in outcomes(Perturbation(detector_dead_s=1.0))]
    assert has_detections == [True] * 31 + [False] * 59  # frame 30 is 1 ns before the limit


def test_what_the_cover_hides_is_not_detected() -> None:
    frame = RgbdFrame(0, np.zeros((48, 64, 3), np.uint8), np.ones((48, 64), np.float32))
    left, right = cover_columns(64, 0.5, 0)
    boxes = np.array(
        [[left + 1, 2, right - 1, 4], [left - 8, 2, left + 4, 9], [right - 4, 1, right + 3, 5]]
    )
    seen = Detections(0, boxes.astype(np.float32), ('a', 'b', 'c'), np.ones(3, np.float32))
    found = perturb_detections(lambda _: seen, Perturbation(covered_share=0.5), 0)(frame)
    assert found is not None
    assert found.class_names == ('b', 'person')
    expected = [[left - 8, 2, left, 9], [left, 0, right, 48]]
    np.testing.assert_array_equal(found.boxes_xyxy_px, expected)


def test_extra_boxes_lie_in_the_image_and_stay_the_same() -> None:
    one, two = (outcomes(Perturbation(extra_boxes=50))[7] for _ in range(2))
    assert one is not None
    assert two is not None
    assert len(one) == 51
    np.testing.assert_array_equal(one.boxes_xyxy_px, two.boxes_xyxy_px)
    assert set(one.class_names[1:]) == {'cup'}


def test_half_size_images_show_points_at_half_the_position() -> None:
    half = PerturbedSequence(Recording(), Perturbation(half_size=True), 0)
    frame = next(iter(half))
    assert frame.image_bgr.shape == (24, 32, 3)
    assert frame.depth_m.shape == (24, 32)
    point_m = np.array([[0.2, -0.1, 2.0]])
    full_px, half_px = (c.project_px(point_m) for c in (Recording.camera, half.camera))
    # The center of the first 2x2 pixels, at 0.5, is that of the first pixel of half the size.
    np.testing.assert_allclose(2 * half_px + 0.5, full_px)


def test_a_stated_focal_length_changes_no_image() -> None:
    wrong = PerturbedSequence(Recording(), Perturbation(focal_factor=1.08), 0)
    assert wrong.camera.fx_px == pytest.approx(1.08 * Recording.camera.fx_px)
    assert wrong.camera.cx_px == Recording.camera.cx_px
    for one, other in zip(wrong, Recording(), strict=True):
        np.testing.assert_array_equal(one.image_bgr, other.image_bgr)
