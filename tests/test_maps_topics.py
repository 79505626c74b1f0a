"""Dense map, grid and tracked objects on topics, compared with a rendered room."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from hoid_msgs.msg import (
    DetectionArray,
    MappedObject,
    ObjectEvent,
    ObjectState,
    SlamStatus,
    TrackedObjectArray,
)
from hoid_msgs.srv import FindObjects, ForgetObject
from map_msgs.msg import OccupancyGridUpdate
from nav_msgs.msg import OccupancyGrid
from people_msgs.msg import People
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage
from vision_msgs.msg import Detection3D, Detection3DArray, LabelInfo
from visualization_msgs.msg import MarkerArray

from hoid_benchmarks.rooms.object_scores import FoundObject, score_objects
from hoid_benchmarks.rooms.object_truth import true_objects
from hoid_benchmarks.rooms.placed_box import PlacedBox
from hoid_common import se3
from hoid_common.errors import counted
from hoid_common.io.image_size import is_jpeg
from hoid_common.ros import conversions, qos
from hoid_common.se3 import T_BODY_OPTICAL
from hoid_scene.memory.object_memory import MAX_JPEG_BYTES
from hoid_scene.store import scene_file
from hoid_scene.store.scene_file import restored
from hoid_synth.config import SceneConfig
from hoid_synth.room_truth import RoomTruth
from hoid_synth.truth import people_centers
from hoid_system_tests.probe import Probe
from hoid_system_tests.processes import Start
from hoid_system_tests.rendered_room import Messages, recording
from hoid_system_tests.scene_peer import RELIABLE, ScenePeer, start_scene
from hoid_system_tests.slam_peer import SlamPeer
from rgbd_slam.store import map_file

pytestmark = [pytest.mark.thorough, pytest.mark.alone]

SCENE = SceneConfig(num_frames=150)
FIND = 'hoid_scene/find_objects'


@pytest.fixture(scope='module')
def messages() -> list[Messages]:
    return list(recording(SCENE, 'hoid+'))


class Peer(ScenePeer):
    """Plays a recording and collects all outputs of the scene."""

    def __init__(self, probe: Probe) -> None:
        self.grids = probe.collect(OccupancyGrid, 'grid_map', qos.LATCHED, wait=False)
        self.level = probe.collect(TFMessage, '/tf_static', qos.TF_STATIC, wait=False)
        self.patches = probe.collect(OccupancyGridUpdate, 'grid_map_updates', wait=False)
        self.tracked = probe.collect(TrackedObjectArray, 'tracked_objects', wait=False)
        self.people = probe.collect(People, 'people', wait=False)
        self.object_maps = probe.collect(Detection3DArray, 'object_map', qos.LATCHED, wait=False)
        self.markers = probe.collect(MarkerArray, 'tracked_objects/markers', wait=False)
        self.expected = probe.collect(DetectionArray, 'expected_objects', wait=False)
        self.names = probe.collect(LabelInfo, 'cloud_map/labels', qos.LATCHED, wait=False)
        super().__init__(probe)

    def track(self, images: list[Messages]) -> None:
        """Play images, all of which must be tracked."""
        assert {status.state for status in self.play(images)} == {SlamStatus.TRACKING}

    def await_map(self, stamp_ns: int) -> None:
        """Wait for a cloud and a grid that include the image with this stamp."""

        def is_new(received: list[Any]) -> bool:
            return bool(received) and stamp_of(received[-1]) >= stamp_ns

        self.probe.spin_until(lambda: is_new(self.clouds), 'no new cloud_map', 30.0)
        self.probe.spin_until(lambda: is_new(self.grids), 'no new grid_map', 30.0)


def stamp_of(msg: Any) -> int:
    return conversions.stamp_from_msg(msg.header.stamp)


@pytest.fixture
def peer(start: Start, probe: Probe, tmp_path: Path, messages: list[Messages]) -> Peer:
    parameters = {
        'dense.publish_period_s': 0.3,
        'object_map.enabled': True,
        'object_map.label_cloud': True,
        'object_map.prior_score': 0.25,
    }
    start_scene(start, parameters, map_directory=str(tmp_path / 'maps'))
    peer = Peer(probe)
    peer.begin(messages[0].camera)
    return peer


def test_the_room_is_mapped_without_its_people(
    peer: Peer, messages: list[Messages], tmp_path: Path
) -> None:
    peer.track(messages)
    peer.await_map(messages[-11].stamp_ns)
    truth = RoomTruth(SCENE, T_BODY_OPTICAL)
    check_cloud(peer, truth)
    check_grid(peer, truth)
    check_patches(peer)
    check_objects(peer, truth)
    check_object_map(peer, truth)
    check_labels(peer)
    check_expected(peer, messages)
    check_files(peer, tmp_path / 'maps')
    check_run_time(peer)
    check_object_services(peer, tmp_path / 'maps')


def check_cloud(peer: Peer, truth: RoomTruth) -> None:
    assert peer.clouds[-1].header.frame_id == 'map'
    points = peer.cloud_m()
    assert len(points) > 8000
    assert np.mean(truth.distance_m(points) < 0.03) >= 0.99
    assert np.mean(truth.on_paths(points)) < 0.001
    colors = conversions.cloud_from_msg(peer.clouds[-1]).colors_bgr
    assert colors is not None
    assert np.ptp(colors) > 100


def check_grid(peer: Peer, truth: RoomTruth) -> None:
    msg = peer.grids[-1]
    assert msg.header.frame_id == 'map_level'  # without a base frame, the map frame is not level
    (edge,) = peer.level[-1].transforms
    assert (edge.header.frame_id, edge.child_frame_id) == ('map', 'map_level')
    T_map_level = conversions.transform_from_msg(edge)
    q = msg.info.origin.orientation
    assert (q.x, q.y, q.z, q.w) == (0, 0, 0, 1)
    assert msg.info.resolution == pytest.approx(0.05)
    cells = np.array(msg.data, np.int8).reshape(msg.info.height, msg.info.width)
    T_map_origin = T_map_level @ conversions.pose_from_msg(msg.info.origin)
    floor_m = se3.transform(truth.T_world_map @ T_map_origin, np.zeros((1, 3)))[0, 2]
    assert floor_m == pytest.approx(0, abs=0.03)
    occupied = truth.occupied(T_map_origin, cells.shape, msg.info.resolution)
    known = cells >= 0
    assert known.sum() > 1000
    assert np.mean((cells == 100)[known] == occupied[known]) >= 0.97


def check_object_map(peer: Peer, truth: RoomTruth) -> None:
    msg = peer.object_maps[-1]
    assert msg.header.frame_id == 'map'
    found = [found_object(detection) for detection in msg.detections]
    scores = score_objects(found, true_objects(truth))
    assert scores.num_expected >= 5
    assert scores.num_recalled >= 0.8 * scores.num_expected
    assert scores.num_right >= 0.75 * scores.num_found
    assert scores.num_class_right == scores.num_right
    assert np.median(scores.seen_center_m) < 0.15
    assert len({detection.id for detection in msg.detections}) == len(found)
    assert all(stamp_of(detection) <= stamp_of(msg) for detection in msg.detections)


def check_labels(peer: Peer) -> None:
    """Points with the label of a class are on an object of the class."""
    cloud = conversions.cloud_from_msg(peer.clouds[-1])
    assert cloud.labels is not None
    names = {c.class_id: c.class_name for c in peer.names[-1].class_map}
    assert set(cloud.labels.tolist()) <= {0, *names}
    assert 0.01 < np.mean(cloud.labels > 0) < 0.5
    on_object = np.zeros(len(cloud.labels), np.bool_)
    for item in map(found_object, peer.object_maps[-1].detections):
        in_box_m = se3.transform(se3.inverse(item.box.T_map_box), cloud.points_m.astype(float))
        near = np.abs(in_box_m) < item.box.size_m / 2 + 0.1
        number = {name: n for n, name in names.items()}.get(item.class_name, 0)
        on_object |= near.all(axis=1) & (cloud.labels == number)
    assert np.mean(on_object[cloud.labels > 0]) > 0.8


def check_expected(peer: Peer, messages: list[Messages]) -> None:
    """Where objects are expected, the image of the message shows objects of their classes."""
    num_expected = num_shown = 0
    by_stamp = {message.stamp_ns: message for message in messages}
    for msg in peer.expected:
        image = by_stamp[stamp_of(msg)]
        assert msg.header == image.color.header
        assert (msg.image_width, msg.image_height) == SCENE.camera.size_px
        for box in msg.detections:
            num_expected += 1
            num_shown += any(
                item.class_name == box.class_name
                and abs(item.x_min + item.x_max - box.x_min - box.x_max) < box.x_max - box.x_min
                and abs(item.y_min + item.y_max - box.y_min - box.y_max) < box.y_max - box.y_min
                for item in image.objects.objects
            )
    assert num_expected > 10
    assert num_shown >= 0.9 * num_expected


def check_object_services(peer: Peer, folder: Path) -> None:
    """Objects are found, exported, saved with the map, loaded with it, and forgotten."""
    everything = find_objects(peer, state='any')
    shown = {int(detection.id) for detection in peer.object_maps[-1].detections}
    assert shown <= {item.id for item in everything}
    first = everything[0]
    center = first.pose.position
    near = find_objects(peer, state='any', near=center, radius=0.5)
    assert near[0] == first
    assert len(near) < len(everything)
    of_class = find_objects(peer, state='any', class_name=first.class_name)
    assert {item.class_name for item in of_class} == {first.class_name}
    detailed = find_objects(peer, state='any', details=True)
    assert [item.id for item in detailed] == [item.id for item in everything]
    for item in detailed:
        assert item.colors
        assert item.history[0].kind == ObjectEvent.NEW
        assert is_jpeg(bytes(item.picture))
        assert len(item.picture) <= MAX_JPEG_BYTES
    named = find_objects(peer, state='any', class_name=f'{first.colors[0]} {first.class_name}')
    assert first.id in {item.id for item in named}
    assert not any(item.history or item.picture for item in everything)
    refused = peer.probe.call(FindObjects, FIND, FindObjects.Request(state='lost'))
    assert not refused.success
    assert refused.message.startswith('no state "lost"; use one of present, ')

    assert peer.save('things', 'objects').success
    document = yaml.safe_load((folder / 'things.yaml').read_text())
    assert [entry['id'] for entry in document['objects']] == [item.id for item in everything]
    assert peer.save('room').message.endswith(' MB')
    path = folder / 'room.hoidmap'
    saved, scene = map_file.load(path), scene_file.read_file(path)
    objects = restored(scene, saved.keyframes(), saved.camera).mapped_objects()
    assert {item.object_id for item in objects} == {item.id for item in everything}
    assert peer.load('room').success
    loaded = find_objects(peer, state='any')
    assert [(o.id, o.class_name) for o in loaded] == [(o.id, o.class_name) for o in everything]
    assert not any(item.is_new for item in loaded)

    for is_known in (True, False):
        answer = peer.probe.call(
            ForgetObject, 'hoid_scene/forget_object', ForgetObject.Request(id=first.id)
        )
        assert answer.success is is_known
    assert first.id not in {item.id for item in find_objects(peer, state='any')}


def find_objects(peer: Peer, **request: Any) -> list[MappedObject]:
    answer = peer.probe.call(FindObjects, FIND, FindObjects.Request(**request))
    assert answer.success
    assert answer.message == counted(len(answer.objects), 'object')
    assert answer.header.frame_id == 'map'
    return list(answer.objects)


def found_object(detection: Detection3D) -> FoundObject:
    T_map_box, size = conversions.pose_from_msg(detection.bbox.center), detection.bbox.size
    name = max(detection.results, key=lambda result: result.hypothesis.score).hypothesis.class_id
    return FoundObject(name, PlacedBox(T_map_box, np.array([size.x, size.y, size.z])))


def check_patches(peer: Peer) -> None:
    """The grid grows in steps; each update turns the previous grid into the next one."""
    sizes = {(m.info.width, m.info.height, m.info.origin.position.x) for m in peer.grids}
    assert len(sizes) <= 6
    assert all(m.info.width % 40 == 0 and m.info.height % 40 == 0 for m in peer.grids)
    assert peer.patches
    patch = peer.patches[-1]
    stamps = [stamp_of(msg) for msg in peer.grids]
    now = stamps.index(stamp_of(patch))
    before, after = (
        np.array(m.data, np.int8).reshape(m.info.height, m.info.width)
        for m in peer.grids[now - 1 : now + 1]
    )
    patched = before.copy()
    cells = np.array(patch.data, np.int8).reshape(patch.height, patch.width)
    patched[patch.y : patch.y + patch.height, patch.x : patch.x + patch.width] = cells
    assert (patched == after).all()


def check_objects(peer: Peer, truth: RoomTruth) -> None:
    assert 48 <= len(peer.tracked) <= 51  # 10 Hz over 5 s
    assert peer.markers
    check_people(peer)
    errors_m = []
    for msg in peer.tracked:
        i = round((stamp_of(msg) - SCENE.stamp_ns(0)) * 30e-9)
        people_m = people_centers(truth.stage, i)
        for tracked in (t for t in msg.objects if t.state == ObjectState.PERSON):
            at = tracked.position
            world = se3.transform(truth.T_world_map, np.array([[at.x, at.y, at.z]]))
            errors_m.append(np.linalg.norm(people_m - world, axis=1).min())
    assert len(errors_m) > 30
    assert np.median(errors_m) < 0.2


def check_people(peer: Peer) -> None:
    """The people are those of the tracked objects."""
    people = {stamp_of(msg): msg for msg in peer.people}
    assert len(people) == len(peer.tracked)
    for msg in peer.tracked:
        same = people[stamp_of(msg)]
        assert same.header == msg.header
        tracked = [t for t in msg.objects if t.state == ObjectState.PERSON]
        assert [(p.name, p.position) for p in same.people] == [
            (str(t.id), t.position) for t in tracked
        ]
        assert [(p.velocity.x, p.velocity.y, p.velocity.z) for p in same.people] == [
            (t.velocity.x, t.velocity.y, t.velocity.z) for t in tracked
        ]
        assert [p.reliability for p in same.people] == pytest.approx([t.score for t in tracked])


def check_files(peer: Peer, folder: Path) -> None:
    points = len(peer.cloud_m())
    answer = peer.save('', 'cloud')
    assert answer.success, answer.message
    assert str(points) in answer.message
    assert f'element vertex {points}\n'.encode() in (folder / 'cloud.ply').read_bytes()
    answer = peer.save('scene', 'grid')
    assert answer.success, answer.message
    document = yaml.safe_load((folder / 'scene.yaml').read_text())
    image = cv2.imread(str(folder / document['image']), cv2.IMREAD_UNCHANGED)
    assert image is not None
    assert image.shape == (peer.grids[-1].info.height, peer.grids[-1].info.width)
    assert set(np.unique(image)) == {0, 205, 254}
    for what, name in (('cloud', '../cloud.ply'), ('cloud', 'cloud.pcd'), ('grid', 'a/b')):
        answer = peer.save(name, what)
        assert not answer.success
        assert '"' in answer.message
    files = sorted(path.name for path in folder.glob('[!.]*'))
    assert files == ['cloud.ply', 'scene.pgm', 'scene.yaml']


def check_run_time(peer: Peer) -> None:
    """Changed parameters of the grid take effect at once, without a new image."""
    occupied = np.count_nonzero(np.array(peer.grids[-1].data) == 100)
    peer.probe.set_parameters('hoid_scene', {'dense.publish_period_s': 3600.0})
    peer.probe.set_parameters(
        'hoid_scene', {'dense.grid.max_height_m': 0.3, 'dense.publish_period_s': 0.1}
    )

    def is_lower() -> bool:
        cells = np.array(peer.grids[-1].data)
        return bool(np.count_nonzero(cells == 100) < 0.9 * occupied)

    peer.probe.spin_until(is_lower, 'the grid has not become lower')
    peer.probe.set_parameters('hoid_scene', {'dense.grid.resolution_m': 0.1})
    peer.probe.spin_until(
        lambda: peer.grids[-1].info.resolution == pytest.approx(0.1),
        'the grid has not become coarser',
    )


def test_reset_empties_the_maps_and_mapping_continues(
    peer: Peer, messages: list[Messages]
) -> None:
    assert not peer.save('', 'cloud').success
    peer.track(messages[:40])
    peer.await_map(messages[20].stamp_ns)
    assert len(peer.cloud_m()) > 0
    assert peer.probe.call(Trigger, 'rgbd_slam/reset', Trigger.Request()).success
    peer.probe.spin_until(lambda: peer.clouds[-1].width == 0, 'the cloud is not empty', 30.0)
    peer.probe.spin_until(lambda: peer.grids[-1].info.width == 0, 'the grid is not empty', 30.0)
    peer.track(messages[40:80])
    peer.await_map(messages[60].stamp_ns)
    assert len(peer.cloud_m()) > 0


def test_three_nodes_without_the_scene_are_enough_for_poses(
    start: Start, probe: Probe, messages: list[Messages]
) -> None:
    start('rgbd_slam', 'rgbd_slam_node', RELIABLE)
    peer = SlamPeer(probe)
    peer.begin(messages[0].camera)
    assert peer.answer_to(messages[0].features).state == SlamStatus.TRACKING
    assert probe.node.count_publishers('/cloud_map') == 0
