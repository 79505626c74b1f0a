import logging
from collections import Counter

import numpy as np
import pytest

from hoid_common import se3
from hoid_common.values import FloatArray, Trajectory
from loop_check import checked, fate, fates_table, listening
from rgbd_slam.loops.loop_closer import Join, LoopEvent
from rgbd_slam.model.loop_edge import LoopEdge
from rgbd_slam.places.place_finder import Candidate

NS = 1_000_000_000
TRUTH = Trajectory(
    np.arange(4) * NS, se3.exp(np.outer(np.arange(4), [0.0, 0.1, 0.0, 0.5, 0.0, 0.2]))
)
T_0_3 = se3.inverse(TRUTH.T_world_camera[0]) @ TRUTH.T_world_camera[3]


def _join(event: LoopEvent, T_place_camera: FloatArray, place_ns: int, stamp_ns: int) -> Join:
    edge = LoopEdge(0, 1, T_place_camera, np.eye(6), 50, 1.0, event.value, 0.0, is_used=True)
    return Join(edge, place_ns, stamp_ns, None)


@pytest.mark.parametrize(
    ('twist', 'is_false'),
    [([0.0] * 6, False), ([0, 0, 0, 0.05, 0, 0], False), ([0, 0, 0, 0, 0.2, 0], True),
     ([0.1, 0, 0, 0, 0, 0], True)],
)  # fmt: skip
def test_a_join_is_held_against_the_truth(twist: list[float], is_false: bool) -> None:
    T = T_0_3 @ se3.exp(np.array(twist))
    join = _join(LoopEvent.CLOSED, T, 0, 3 * NS + 1000)
    found = checked(join, TRUTH)
    assert found.is_false is is_false
    assert found.error_m == pytest.approx(np.linalg.norm(twist[3:]), abs=1e-9)
    assert found.error_deg == pytest.approx(np.degrees(np.linalg.norm(twist[:3])), abs=1e-6)


def test_joins_are_heard_of_while_listening() -> None:
    join = _join(LoopEvent.MERGED, T_0_3, 1, 3)
    logger = logging.getLogger('rgbd_slam.loops.loop_closer')
    with listening() as heard:
        logger.info('%s', join)
        logger.info('something else')
    logger.info('%s', join)
    assert heard.joins == [join]


def test_candidates_are_counted_by_reason_and_held_against_the_truth() -> None:
    candidates = [
        Candidate(3 * NS, 2 * NS, False, 'geometry: 12 points of the map were found'),
        Candidate(3 * NS, 2 * NS, True, 'geometry: 30 points of the map were found'),
        Candidate(3 * NS, 0, True, 'geometry: 5 points of the map were found'),
        Candidate(3 * NS, 2 * NS, True, ''),
    ]
    turning = Trajectory(TRUTH.stamps_ns, se3.exp(np.outer(np.arange(4), [0, 0.3, 0, 0, 0, 0])))
    fates = Counter(fate(candidate, turning) for candidate in candidates)
    table = fates_table(fates)
    assert '| geometry | 1 (1) | 2 (1) |\n' in table
    assert '| the same place | 0 (0) | 1 (1) |\n' in table
    assert fate(candidates[0], None).is_same_place is None
