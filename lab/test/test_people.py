from dataclasses import replace

import numpy as np
import pytest

from hoid_synth.acting.script import walk_along
from hoid_synth.people.body import Build
from hoid_synth.people.gait import STRIDE_PER_HEIGHT, Stance, joints

BUILD = Build(1.8, 1.0)


def stance(
    walked_m: float, reach: float = 0.0, hand: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Stance:
    hands = np.array([hand, hand])
    return Stance(
        np.array([walked_m, 0.0]),
        0.0,
        walked_m,
        1.0 - reach,
        0.0,
        0.0,
        0.0,
        0.0,
        hands,
        np.full(2, reach),
    )


def test_links_keep_their_length() -> None:
    for walked in np.linspace(0, 1.4, 15):
        j = joints(stance(walked), BUILD)
        for a, b, c, link in (
            (j.shoulders, j.elbows, j.wrists, BUILD.arm_m / 2),
            (j.hips, j.knees, j.ankles, BUILD.leg_m / 2),
        ):
            np.testing.assert_allclose(np.linalg.norm(b - a, axis=1), link, rtol=0.03)
            np.testing.assert_allclose(np.linalg.norm(c - b, axis=1), link, rtol=0.03)


def test_a_standing_foot_stays_where_it_is() -> None:
    cycle = STRIDE_PER_HEIGHT * BUILD.height_m
    walked = np.linspace(0.02, 0.35, 8) * cycle  # the right foot is down
    ankles = np.array([joints(stance(w), BUILD).ankles[0] for w in walked])
    np.testing.assert_allclose(ankles, np.broadcast_to(ankles[0], ankles.shape), atol=1e-6)


def test_a_reaching_hand_arrives() -> None:
    target = (0.45, -0.1, 1.2)
    j = joints(stance(0.0, 1.0, target), BUILD)
    fingers = (
        j.wrists + 0.07 * (target - j.wrists) / np.linalg.norm(target - j.wrists, axis=1)[:, None]
    )
    np.testing.assert_allclose(fingers, [target, target], atol=0.02)


def test_a_person_is_as_tall_as_said() -> None:
    standing = replace(stance(0.0), stride=0.0)
    j = joints(standing, BUILD)
    assert j.head[2] + 0.118 * BUILD.height_m / 1.75 == pytest.approx(BUILD.height_m, abs=0.06)


def test_a_walk_starts_and_stops_at_rest() -> None:
    path = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 2.0]])
    xy, heading = walk_along(path, 1.0)
    speed = np.linalg.norm(np.diff(xy, axis=0), axis=1) * 30
    np.testing.assert_allclose(xy[[0, -1]], path[[0, -1]], atol=0.02)
    assert speed[0] < 0.05
    assert speed[-1] < 0.2
    assert speed.max() == pytest.approx(1.0, abs=0.05)
    assert heading[0] == pytest.approx(0.0)
    assert heading[-1] == pytest.approx(np.pi / 2)
