"""Geometric verification of places."""

from __future__ import annotations

import numpy as np
import pytest

from hoid_common import se3
from rgbd_slam.config.place_config import VerificationConfig
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.places.geometric_verification import (
    PlaceVerifier,
    detection_probability,
    visibility,
)

from .ring_world import CAMERA, RingWorld, mapped, ring_poses

TRUTH = ring_poses(24)
NEAR = se3.exp(np.array([0.02, 0.08, 0.05, 0.1, 0.05, -0.1]))


@pytest.fixture(scope='module')
def world() -> RingWorld:
    return RingWorld()


@pytest.fixture(scope='module')
def atlas(world: RingWorld) -> Atlas:
    atlas = Atlas(1.2, 8)
    return _well_known(atlas, world)


def _well_known(atlas: Atlas, world: RingWorld) -> Atlas:
    mapped(atlas, world, TRUTH, TRUTH)
    j = atlas.points.indices()
    atlas.points.num_visible[j] = atlas.points.num_found[j] = 20
    return atlas


def _verifier(atlas: Atlas, **config: float) -> PlaceVerifier:
    return PlaceVerifier(atlas, CAMERA, VerificationConfig().updated(config), 0)


def test_a_near_view_is_located_to_millimeters(atlas: Atlas, world: RingWorld) -> None:
    pose = TRUTH[5] @ NEAR
    match = _verifier(atlas).verify(world.frame(pose, 1)[0], 5)
    assert match is not None
    np.testing.assert_allclose(match.T_map_camera, pose, atol=3e-3)
    seen = se3.transform(match.T_camera_map, atlas.points.position_m[match.j])
    frame = world.frame(pose, 1)[0]
    np.testing.assert_allclose(
        CAMERA.project(seen)[:, :2], frame.measurement_px[match.k, :2], atol=3.0
    )


def test_another_place_does_not_align(atlas: Atlas, world: RingWorld) -> None:
    verifier = _verifier(atlas)
    assert verifier.verify(world.frame(TRUTH[12], 1)[0], 0) is None
    assert verifier.doubt.startswith('too few matches: no pose fits')


def test_an_image_without_features_does_not_align(atlas: Atlas, world: RingWorld) -> None:
    frame = world.frame(se3.exp(np.array([0, 0, 0, 0, 50.0, 0])), 1)[0]
    assert len(frame) == 0
    assert _verifier(atlas).verify(frame, 0) is None


def test_a_place_that_shares_a_third_of_its_points_is_not_the_same(
    atlas: Atlas, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With identical furniture in front of other walls, more points are missing than found."""
    other = RingWorld()
    strange = np.random.default_rng(1).random(len(other.points_m)) > 0.3
    other.descriptors[strange] = RingWorld(seed=9).descriptors[strange]
    frame, _ = other.frame(TRUTH[5], 1)
    for limit, is_found in ((0.2, True), (0.45, False), (0.5, False)):
        monkeypatch.setattr(VerificationConfig, 'min_found_share', limit)
        match = _verifier(atlas).verify(frame, 5)
        assert (match is not None and len(match.k) > 40) == is_found


def test_points_that_look_different_from_another_side_are_found_once_the_pose_is_known(
    atlas: Atlas,
) -> None:
    """80 of 256 bits of most descriptors differ; the others alone are a third of all points."""
    aside, strange = RingWorld(), RingWorld()
    rng = np.random.default_rng(1)
    changed = np.flatnonzero(rng.random(len(aside.points_m)) > 0.35)
    bits = np.array([rng.permutation(256) < 80 for _ in changed])
    aside.descriptors[changed] ^= np.packbits(bits, axis=1)
    match = _verifier(atlas).verify(aside.frame(TRUTH[5] @ NEAR, 1)[0], 5)
    assert match is not None
    np.testing.assert_allclose(match.T_map_camera, TRUTH[5] @ NEAR, atol=3e-3)
    strange.descriptors[changed] = RingWorld(seed=9).descriptors[changed]
    assert _verifier(atlas).verify(strange.frame(TRUTH[5] @ NEAR, 1)[0], 5) is None


def test_an_image_that_sees_through_the_map_is_contradicted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Half of a mapped wall is gone, and depth readings lie behind it."""
    atlas = _well_known(Atlas(1.2, 8), RingWorld(count=8000))
    opened = RingWorld(count=8000)
    opened.points_m[opened.points_m[:, 1] > 0] *= [1.6, 1.0, 1.6]
    frame, _ = opened.frame(TRUTH[5], 1)
    monkeypatch.setattr(VerificationConfig, 'min_found_share', 0.0)
    assert _verifier(atlas).verify(frame, 5) is None
    monkeypatch.setattr(VerificationConfig, 'max_contradicted_share', 0.15)
    assert _verifier(atlas).verify(frame, 5) is None
    monkeypatch.setattr(VerificationConfig, 'max_contradicted_share', 1.0)
    assert _verifier(atlas).verify(frame, 5) is not None


def test_occluded_and_masked_points_do_not_count(world: RingWorld) -> None:
    frame, landmark = world.frame(TRUTH[3], 1)
    camera_m = se3.transform(se3.inverse(TRUTH[3]), world.points_m[landmark])
    pixels = CAMERA.project(camera_m).T
    behind = camera_m * 1.5
    before = camera_m * 0.6
    here = visibility(pixels, camera_m[:, 2], frame)
    assert here.observable.all()
    assert not here.contradicted.any()
    hidden = visibility(CAMERA.project(behind).T, behind[:, 2], frame)
    assert hidden.observable.mean() < 0.1
    through = visibility(CAMERA.project(before).T, before[:, 2], frame)
    assert through.contradicted.mean() > 0.3
    outside = visibility(pixels + 5000.0, camera_m[:, 2], frame)
    assert not outside.observable.any()


def test_points_that_are_often_missed_are_expected_less() -> None:
    atlas = Atlas(1.2, 8)
    rows = mapped(atlas, RingWorld(count=400), TRUTH[:2], TRUTH[:2])
    j = atlas.keyframes.point_of_feature[rows[0], :3].astype(np.int64)
    atlas.points.num_visible[j], atlas.points.num_found[j] = [0, 96, 96], [0, 96, 0]
    np.testing.assert_allclose(detection_probability(atlas.points, j), [0.25, 0.97, 0.01])
