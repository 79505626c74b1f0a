"""The live tracker's copy of the map equals the map of an offline run."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from hoid_common.values import FeatureVerdicts, FloatArray
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.local_mapping.retraction import retract_observations
from rgbd_slam.mapping.map_loading import MapLoading
from rgbd_slam.mapping.mapper import KeyframeRequest
from rgbd_slam.mapping.mapper_process import MapperProcess
from rgbd_slam.mapping.mapper_worker import Start
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.model.map_state import MapState, snapshot
from rgbd_slam.records.soa_table import SoaTable
from rgbd_slam.slam import RgbdSlam

from .world import CAMERA, PERIOD_NS, World, load, sway

CONFIG = SlamConfig()


def offline_run(
    monkeypatch: pytest.MonkeyPatch, count: int, seed: int = 0
) -> tuple[Atlas, list[Start | KeyframeRequest]]:
    """Return the map of an offline run in the world of a seed, and the requests to its mapper."""
    slam, world = RgbdSlam(CAMERA, CONFIG), World(seed=seed)
    mapper, requests = slam.map.mapper, list[Start | KeyframeRequest]()
    start_map, insert = mapper.start_map, mapper.insert

    def record_start(uid: int, frame: Frame, T_map_camera: FloatArray, map_id: int) -> object:
        requests.append(Start(uid, frame, T_map_camera, map_id))
        return start_map(uid, frame, T_map_camera, map_id)

    def record_insert(request: KeyframeRequest) -> object:
        requests.append(request)
        return insert(request)

    monkeypatch.setattr(mapper, 'start_map', record_start)
    monkeypatch.setattr(mapper, 'insert', record_insert)
    for n, pose in enumerate(sway(count)):
        slam.process(world.features(n * PERIOD_NS, pose))
    slam.map.finish()
    return slam.map.atlas, requests


@pytest.fixture(name='mapper')
def fixture_mapper() -> Iterator[tuple[MapperProcess, Atlas]]:
    atlas = Atlas(CONFIG.camera.scale_factor, CONFIG.camera.num_octaves)
    mapper = MapperProcess(StereoCamera.from_model(CAMERA, CONFIG.camera), atlas, CONFIG)
    yield mapper, atlas
    mapper.close()


def assert_same(live: SoaTable, offline: SoaTable) -> None:
    np.testing.assert_array_equal(live.uid, offline.uid)
    rows = offline.indices()
    for name in offline.columns:
        if name not in {*offline.local} - {'point_of_feature'}:  # what is not sent to copies
            got, wanted = getattr(live, name)[rows], getattr(offline, name)[rows]
            np.testing.assert_array_equal(got, wanted, err_msg=name)


def test_every_column_of_the_live_copy_is_that_of_the_offline_map(
    mapper: tuple[MapperProcess, Atlas], monkeypatch: pytest.MonkeyPatch
) -> None:
    offline, requests = offline_run(monkeypatch, 60)
    client, live = mapper
    for request in requests:
        if isinstance(request, Start):
            client.start_map(*request)
        else:
            client.insert(request)
    client.finish()
    assert len(requests) > 3
    assert offline.points.num_visible[offline.points.alive].max() > 10
    assert_same(live.keyframes, offline.keyframes)
    assert_same(live.points, offline.points)
    assert snapshot(live).digest() == snapshot(offline).digest()


def test_retracted_observations_are_removed_from_both_copies(
    mapper: tuple[MapperProcess, Atlas], monkeypatch: pytest.MonkeyPatch
) -> None:
    offline, requests = offline_run(monkeypatch, 40)
    client, live = mapper
    for request in requests:
        if isinstance(request, Start):
            client.start_map(*request)
        else:
            client.insert(request)
    keyframes, points = offline.keyframes, offline.points
    i = int(keyframes.indices()[-2])
    is_dynamic = np.arange(keyframes.num_features[i]) < 300
    seen = keyframes.points_of(i)[is_dynamic]
    seen = seen[seen != NO_POINT]
    made = seen[points.first_keyframe_uid[seen] == keyframes.uid[i]]
    known = np.setdiff1d(seen, made)
    uids, counts = points.uid[made], points.num_observations[known].copy()
    assert min(len(made), len(known)) > 10
    verdicts = FeatureVerdicts(int(keyframes.stamp_ns[i]), is_dynamic)
    retract_observations(offline, verdicts)
    client.retract(verdicts)
    client.finish()
    assert not np.isin(points.uid, uids).any()
    assert (keyframes.points_of(i)[is_dynamic] == NO_POINT).all()
    assert not keyframes.may_seed[i, : len(is_dynamic)][is_dynamic].any()
    np.testing.assert_array_equal(points.num_observations[known], counts - 1)
    rows = points.indices()
    observed = offline.observations_of(rows)
    np.testing.assert_array_equal(
        np.bincount(observed.j, minlength=points.capacity)[rows], points.num_observations[rows]
    )
    assert_same(live.keyframes, offline.keyframes)
    assert_same(live.points, offline.points)


def loading_of(saved: MapState, first_uid: int, running: Atlas | None = None) -> MapLoading:
    camera = StereoCamera.from_model(CAMERA, CONFIG.camera)
    loading = MapLoading(saved, camera, CONFIG, running=running)
    loading.first_uid = first_uid
    return loading


def test_a_loaded_map_is_the_same_live_and_offline(
    mapper: tuple[MapperProcess, Atlas], monkeypatch: pytest.MonkeyPatch
) -> None:
    saved = snapshot(offline_run(monkeypatch, 30)[0])
    offline, client, live = RgbdSlam(CAMERA, CONFIG), *mapper
    load(offline, saved)
    loading = loading_of(saved, 0)
    client.begin_load(loading)
    client.finish_load(loading)
    assert_same(live.keyframes, offline.map.atlas.keyframes)
    assert_same(live.points, offline.map.atlas.points)


def test_a_map_that_is_loaded_in_the_background_replaces_the_running_one(
    mapper: tuple[MapperProcess, Atlas], monkeypatch: pytest.MonkeyPatch
) -> None:
    offline, requests = offline_run(monkeypatch, 60)
    saved = snapshot(offline)
    client, live = mapper
    for request in requests[:3]:
        if isinstance(request, Start):
            client.start_map(*request)
        else:
            client.insert(request)
    client.wait()
    before, uids = snapshot(live).digest(), live.points.uid.copy()
    loading = loading_of(saved, 100)
    client.begin_load(loading)
    client.update()
    assert client.is_loading
    assert snapshot(live).digest() == before  # tracking continues in it
    loading.restore()
    client.wait()
    assert not client.is_loading
    assert snapshot(live).digest() == saved.digest()
    assert not np.isin(live.points.uid[live.points.alive], uids).any()
    # Both copies have the same rows: further changes apply.
    wanted = RgbdSlam(CAMERA, CONFIG)
    load(wanted, saved)
    first = requests[0]
    assert isinstance(first, Start)
    for mapper_client in (client, wanted.map.mapper):
        mapper_client.start_map(500, first.frame, first.T_map_camera, 9)
    client.wait()
    assert len(live.keyframes) == len(saved) + 1
    assert snapshot(live).digest() == snapshot(wanted.map.atlas).digest()


def test_a_map_that_is_loaded_beside_the_running_one_delays_no_keyframe(
    mapper: tuple[MapperProcess, Atlas], monkeypatch: pytest.MonkeyPatch
) -> None:
    saved = snapshot(offline_run(monkeypatch, 60, seed=7)[0])  # a place that is not seen again
    _, requests = offline_run(monkeypatch, 60)
    client, live = mapper
    wanted = RgbdSlam(CAMERA, CONFIG)
    start = requests[0]
    assert isinstance(start, Start)
    first, *later = [request for request in requests[1:6] if isinstance(request, KeyframeRequest)]
    for mapper_client in (client, wanted.map.mapper):
        mapper_client.start_map(*start)
        mapper_client.insert(first)
    client.wait()
    loading = loading_of(saved, 100, live)
    client.begin_load(loading)
    wanted.map.mapper.begin_load(loading_of(saved, 100, wanted.map.atlas))
    before = snapshot(live).digest()
    for request in later:  # while the map is being loaded
        client.insert(request)
        wanted.map.mapper.insert(request)
    assert set(live.pending) == {request.uid for request in later}
    assert snapshot(live).digest() == before  # tracking continues in it
    loading.restore()
    client.wait()
    assert not client.is_loading
    assert not live.pending
    assert len(live.keyframes) > len(saved) + 2  # the mapper may cull some
    assert_same(live.keyframes, wanted.map.atlas.keyframes)
    assert_same(live.points, wanted.map.atlas.points)
    row = live.keyframes.index_of(start.uid)
    assert row is not None
    assert live.keyframes.map_id[row] == 1 + saved.map_id.max()  # younger than the saved maps
