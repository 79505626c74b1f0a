"""The additions of hoid+ to the rules of the paper, in scenes with known answers."""

from __future__ import annotations

import numpy as np
import pytest

from hoid_common.values import Detections, Float32Array, ObjectState
from hoid_filter.config import FilterConfig
from hoid_filter.motion.moving_regions import NO_MOVING_REGIONS
from hoid_filter.strategies.hoid_plus import HoidPlus
from hoid_filter.strategy import Verdict

from .helpers import HEIGHT, WIDTH, BoxTuple, detections, picture_of, view

FRAME_NS = 33_333_333
QUARTER_S_NS = 250_000_000
PERSON: BoxTuple = (20.0, 10.0, 60.0, 110.0)
HUGE: BoxTuple = (5.0, 5.0, 155.0, 115.0)


def plus(**switches: object) -> HoidPlus:
    return HoidPlus(FilterConfig().updated({f'plus.{k}': v for k, v in switches.items()}))


def cup_covered_by(share: float, stamp_ns: int) -> Detections:
    left = 60.0 - 20.0 * share
    cup = (left, 50.0, left + 20.0, 70.0)
    return detections(('person', PERSON), ('cup', cup), stamp_ns=stamp_ns)


def reasons(verdict: Verdict) -> dict[str, ObjectState]:
    return dict(zip(verdict.objects.class_names, verdict.objects.reasons, strict=True))


def walker(left: float) -> tuple[BoxTuple, Float32Array]:
    """Return the box and the depth image of a person at 1.5 m before a wall at 3 m."""
    depth_m = np.full((HEIGHT, WIDTH), 3.0, np.float32)
    depth_m[10:110, round(left) : round(left) + 40] = 1.5
    return (left, 10.0, left + 40.0, 110.0), depth_m


def walk(strategy: HoidPlus, num_frames: int) -> tuple[float, int]:
    """Show a person who walks by 3 px a frame; return the left edge and the stamp last seen."""
    for n in range(num_frames):
        left, stamp_ns = 10.0 + 3.0 * n, n * FRAME_NS
        box, depth_m = walker(left)
        strategy.classify(view(detections(('person', box), stamp_ns=stamp_ns), depth_m))
    return left, stamp_ns


def test_missed_person_is_predicted_along_the_motion() -> None:
    strategy = plus()
    left, stamp_ns = walk(strategy, 20)
    expected, depth_m = walker(left + 9)
    verdict = strategy.classify(view(Detections.none(stamp_ns + 3 * FRAME_NS), depth_m))
    assert verdict.objects.reasons == (ObjectState.PREDICTED,)
    assert verdict.objects.boxes_xyxy_px[0] == pytest.approx(expected, abs=0.1)
    kept = picture_of(verdict.kept)
    middle = round(left) + 29
    assert not kept[14:106, middle - 15 : middle + 15].any()
    assert kept[:, : middle - 40].all()


def test_an_image_that_the_detector_left_out_has_the_mask_of_the_one_before() -> None:
    # The person touches the wall, so that no region lies mostly in the box, and the mask is what
    # is near the person's depth. A box that was missed has no such certainty.
    depth_m = np.full((HEIGHT, WIDTH), 1.7, np.float32)
    strategy = plus()
    seen, left_out, missed = (
        strategy.classify(view(heard, depth_m, stamp_ns=n * FRAME_NS)).detected_mask
        for n, heard in enumerate(
            (detections(('person', PERSON)), None, Detections.none(2 * FRAME_NS))
        )
    )
    assert seen is not None
    assert seen.any()
    np.testing.assert_array_equal(left_out, seen)
    assert missed is not None
    assert np.count_nonzero(missed) < np.count_nonzero(seen)


def test_prediction_ends_after_its_time_and_can_be_switched_off() -> None:
    for strategy, late_ns in ((plus(), 400_000_001), (plus(coast_s=0.0), 1)):
        _, stamp_ns = walk(strategy, 20)
        verdict = strategy.classify(view(Detections.none(stamp_ns + late_ns)))
        assert verdict.objects.reasons == ()
        assert verdict.kept is None


def test_a_missed_person_stays_dynamic_at_first() -> None:
    strategy = plus()
    strategy.classify(view(detections(('person', PERSON), stamp_ns=0)))
    assert strategy.classify(view(Detections.none(FRAME_NS))).objects.reasons == (
        ObjectState.PREDICTED,
    )
    # An object seen only once is predicted for a shorter time than one seen repeatedly.
    assert strategy.classify(view(Detections.none(5 * FRAME_NS))).objects.reasons == ()


def test_returning_person_keeps_the_track() -> None:
    strategy = plus()
    left, stamp_ns = walk(strategy, 10)
    strategy.classify(view(Detections.none(stamp_ns + FRAME_NS)))
    box = (left + 6, 10.0, left + 46, 110.0)
    back = strategy.classify(view(detections(('person', box), stamp_ns=stamp_ns + 2 * FRAME_NS)))
    assert back.objects.reasons == (ObjectState.PERSON,)
    assert back.objects.track_ids.tolist() == [0]


@pytest.mark.parametrize('late', [1, 4])
@pytest.mark.parametrize('period', [1, 2, 5])
def test_late_and_rare_detections_are_predicted_without_a_gap(late: int, period: int) -> None:
    strategy = plus()
    for n in range(30):
        heard = cup_covered_by(0.6, (n - late) * FRAME_NS) if n % period == 0 else None
        found = reasons(strategy.classify(view(heard, stamp_ns=n * FRAME_NS)))
        assert found == {'person': ObjectState.PREDICTED, 'cup': ObjectState.PREDICTED}


def test_what_stands_still_is_reported_between_detections() -> None:
    strategy = plus()
    strategy.classify(view(cup_covered_by(0.1, 0)))
    found = reasons(strategy.classify(view(None, stamp_ns=FRAME_NS)))
    assert found == {'person': ObjectState.PREDICTED, 'cup': ObjectState.AT_REST}


def test_nothing_is_predicted_for_longer_than_the_limit() -> None:
    strategy = HoidPlus(FilterConfig(prediction_limit_s=0.2))
    strategy.classify(view(cup_covered_by(0.6, 0)))
    assert len(strategy.classify(view(None, stamp_ns=200_000_000)).objects.reasons) == 2
    assert strategy.classify(view(None, stamp_ns=200_000_001)).objects.reasons == ()


def test_an_object_that_is_sometimes_missed_keeps_its_track() -> None:
    strategy = plus()
    verdicts = []
    for n in range(12):
        stamp_ns = n * FRAME_NS
        found = Detections.none(stamp_ns) if n % 3 == 2 else cup_covered_by(0.6, stamp_ns)
        verdicts.append(strategy.classify(view(found)))
    assert all('cup' in reasons(verdict) for verdict in verdicts[3:])
    assert {i for verdict in verdicts for i in verdict.objects.track_ids.tolist()} == {0, 1}


def test_an_object_that_only_flickers_is_never_established() -> None:
    strategy = plus()
    for n in range(30):
        stamp_ns = n * FRAME_NS
        seen = n % 6 == 0  # 0.2 s apart
        person = detections(('person', PERSON), stamp_ns=stamp_ns)
        found = cup_covered_by(0.6, stamp_ns) if seen else person
        assert ('cup' in reasons(strategy.classify(view(found)))) is seen


def classify_huge(strategy: HoidPlus, score: float, n: int = 0) -> ObjectState:
    found = detections(('person', HUGE), stamp_ns=n * FRAME_NS, score=score)
    (reason,) = strategy.classify(view(found)).objects.reasons
    return reason


def test_a_weak_person_over_the_whole_image_is_confirmed_by_detections_in_a_row() -> None:
    strategy = plus()
    found = [classify_huge(strategy, 0.3, n) for n in range(4)]
    assert found == [ObjectState.AT_REST] * 3 + [ObjectState.PERSON]


def test_a_weak_person_over_the_whole_image_who_flickers_is_never_confirmed() -> None:
    strategy = plus()
    for n in range(0, 40, 4):
        assert [classify_huge(strategy, 0.3, n + k) for k in range(3)] == [ObjectState.AT_REST] * 3
        assert strategy.classify(view(Detections.none((n + 3) * FRAME_NS))).kept is None


def test_late_detector_does_not_break_the_row() -> None:
    strategy = plus()
    for n in range(0, 6, 2):
        assert classify_huge(strategy, 0.3, n) is ObjectState.AT_REST
        strategy.classify(view(None, stamp_ns=(n + 1) * FRAME_NS))
    assert classify_huge(strategy, 0.3, 6) is ObjectState.PERSON


def test_a_large_person_is_confirmed_when_strong_or_tracked_or_the_switch_is_off() -> None:
    assert classify_huge(plus(), 0.9) is ObjectState.PERSON
    assert classify_huge(plus(doubt_large_people=False), 0.3) is ObjectState.PERSON
    strategy = plus()
    classify_huge(strategy, 0.9)
    assert classify_huge(strategy, 0.3, 1) is ObjectState.PERSON


@pytest.mark.parametrize(
    ('turn_radps', 'score', 'is_doubted', 'expected'),
    [
        (1.0, 0.4, True, ObjectState.AT_REST),
        (0.3, 0.4, True, ObjectState.PERSON),
        (1.0, 0.6, True, ObjectState.PERSON),
        (1.0, 0.4, False, ObjectState.PERSON),
    ],
)
def test_a_weak_person_is_doubted_while_the_camera_turns_fast(
    turn_radps: float, score: float, is_doubted: bool, expected: ObjectState
) -> None:
    found = view(detections(('person', PERSON), score=score))
    turning = NO_MOVING_REGIONS._replace(camera_turn_radps=turn_radps)
    strategy = plus(doubt_in_turns=is_doubted)
    verdict = strategy.classify(found._replace(moving_regions=turning))
    assert verdict.objects.reasons == (expected,)


@pytest.mark.parametrize(('turn_radps', 'expected'), [(0.3, (ObjectState.PREDICTED,)), (1.0, ())])
def test_a_missed_person_is_not_predicted_while_the_camera_turns_fast(
    turn_radps: float, expected: tuple[ObjectState, ...]
) -> None:
    strategy = plus()
    _, stamp_ns = walk(strategy, 10)
    missed = view(Detections.none(stamp_ns + FRAME_NS))
    turning = NO_MOVING_REGIONS._replace(camera_turn_radps=turn_radps)
    verdict = strategy.classify(missed._replace(moving_regions=turning))
    assert verdict.objects.reasons == expected


def test_a_handled_object_is_released_at_less_overlap_than_it_is_taken() -> None:
    for area in (0.1, 0.4, 0.8):
        strategy = HoidPlus(FilterConfig().updated({'min_interaction_area': area}))
        found = [
            reasons(strategy.classify(view(cup_covered_by(s * area, n * QUARTER_S_NS))))['cup']
            for n, s in enumerate((0.75, 1.25, 0.75, 0.25))
        ]
        assert found == [
            ObjectState.AT_REST,
            ObjectState.HANDLED,
            ObjectState.HANDLED,
            ObjectState.REMEMBERED,
        ]


def test_an_object_put_down_is_dynamic_until_seen_at_rest() -> None:
    for strategy, num_remembered in ((plus(), 3), (plus(remember=False), 0)):
        found = [
            reasons(strategy.classify(view(cup_covered_by(s, n * QUARTER_S_NS))))['cup']
            for n, s in enumerate((0.5, 0.1, 0.1, 0.1, 0.1))
        ]
        assert found[0] is ObjectState.HANDLED
        assert found[1:].count(ObjectState.REMEMBERED) == num_remembered
        assert found[4] is ObjectState.AT_REST


def test_object_far_from_the_person_in_depth_is_not_handled() -> None:
    for cup_depth_m, reason in (
        (1.5, ObjectState.HANDLED),
        (2.1, ObjectState.HANDLED),
        (2.5, ObjectState.AT_REST),
    ):
        depth_m = np.full((HEIGHT, WIDTH), 2.0, np.float32)
        depth_m[50:70, 50:70] = cup_depth_m
        assert reasons(plus().classify(view(cup_covered_by(0.5, 0), depth_m)))['cup'] is reason


def person_before_a_wall() -> tuple[Detections, Float32Array]:
    depth_m = np.full((HEIGHT, WIDTH), 3.0, np.float32)
    depth_m[10:110, 60:100] = 1.5
    return detections(('person', (30.0, 10.0, 130.0, 110.0))), depth_m


def test_background_in_a_persons_box_is_kept() -> None:
    verdict = plus().classify(view(*person_before_a_wall()))
    kept = picture_of(verdict.kept)
    assert verdict.static_area_px == np.count_nonzero(kept)
    assert not kept[14:106, 64:96].any()
    assert kept[14:106, 34:46].all()
    assert kept[14:106, 114:126].all()
    whole_box = plus(keep_background=False).classify(view(*person_before_a_wall()))
    assert not picture_of(whole_box.kept)[14:106, 34:126].any()


def test_a_silent_detector_is_bridged_like_a_miss() -> None:
    strategy = plus()
    _, stamp_ns = walk(strategy, 5)
    assert strategy.classify(view(None, stamp_ns=stamp_ns + FRAME_NS)).objects.reasons == (
        ObjectState.PREDICTED,
    )
