"""Groups of keyframes cover a map, and a correction changes steadily between their heads."""

from __future__ import annotations

import numpy as np
import pytest

from hoid_common import se3
from rgbd_slam.loops.keyframe_groups import keyframe_groups, spread_corrections

NUM_KEYFRAMES = 60


@pytest.fixture(name='nodes', autouse=True)
def fixture_nodes(monkeypatch: pytest.MonkeyPatch) -> int:
    """Let a pose graph have a tenth of the keyframes as nodes."""
    monkeypatch.setattr('rgbd_slam.loops.keyframe_groups._MAX_NODES', 6)
    return 6


def test_groups_are_connected_and_of_limited_size() -> None:
    rng = np.random.default_rng(0)
    parents = np.r_[-1, [rng.integers(max(0, i - 3), i) for i in range(1, NUM_KEYFRAMES)]]
    groups = keyframe_groups(parents)
    assert np.bincount(groups.group).max() <= 10
    np.testing.assert_array_equal(groups.group[groups.heads], np.arange(len(groups.heads)))
    for i, parent in enumerate(parents.tolist()):
        is_head = groups.heads[groups.group[i]] == i
        assert is_head or groups.group[i] == groups.group[parent]


def test_a_small_map_has_a_group_for_each_keyframe() -> None:
    groups = keyframe_groups(np.array([-1, 0, 1]))
    assert groups.heads.tolist() == groups.group.tolist() == [0, 1, 2]


def test_a_drift_along_a_way_is_removed_for_all_keyframes() -> None:
    """The heads are moved by a drift that grows steadily; so are the keyframes between them."""
    groups = keyframe_groups(np.arange(-1, NUM_KEYFRAMES - 1))
    truth = np.tile(np.eye(4), (NUM_KEYFRAMES, 1, 1))
    truth[:, 0, 3] = 0.2 * np.arange(NUM_KEYFRAMES)
    drift = np.zeros((NUM_KEYFRAMES, 6))
    drift[:, 4] = 0.01 * np.arange(NUM_KEYFRAMES)
    drifted = se3.exp(drift) @ truth
    pairs = np.arange(len(groups.heads) - 1)
    corrected = spread_corrections(groups, drifted, truth[groups.heads], pairs, pairs + 1)
    np.testing.assert_allclose(corrected[groups.heads], truth[groups.heads], atol=1e-6)
    inner = slice(0, int(groups.heads[-1]) + 1)
    errors_m = np.linalg.norm(corrected[inner, :3, 3] - truth[inner, :3, 3], axis=1)
    before_m = np.linalg.norm(drifted[inner, :3, 3] - truth[inner, :3, 3], axis=1)
    assert before_m.max() > 0.4
    assert errors_m.max() < 0.04
