"""Each topic of the scene is one row of a table, and is published with the type of its row."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from hoid_msgs.msg import DetectionArray
from nav_msgs.msg import OccupancyGrid
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Header, UInt32

from hoid_common.poses.keyframe_poses import KeyframePoses
from hoid_common.ros import qos
from hoid_common.ros.conversions import cloud_from_msg, header_to_msg
from hoid_common.se3 import T_BODY_OPTICAL
from hoid_common.values import CameraModel, DynamicObject, ObjectState
from hoid_scene.config.dense_config import DenseConfig
from hoid_scene.config.object_config import ObjectMapConfig, ObjectTrackerConfig
from hoid_scene.config.scene_config import SceneConfig
from hoid_scene.objects.mapped_object import MapObject
from hoid_scene.ros import outputs
from hoid_scene.ros.object_messages import (
    object_map_markers_to_msg,
    object_map_to_msg,
)
from hoid_scene.ros.outputs import (
    MAP_OUTPUTS,
    OBJECT_MAP_OUTPUTS,
    OBJECT_OUTPUTS,
    OutputTopic,
    Publisher,
    SceneOutputs,
)
from hoid_scene.scene_mapper import SceneMapper
from hoid_scene.scene_scheduler import SceneRequest
from hoid_scene.tracks.object_track import TrackedObject

CAMERA = CameraModel(160, 120, 130.0, 130.0, 79.5, 59.5)
EVERY = frozenset(output.name for output in (*MAP_OUTPUTS, *OBJECT_OUTPUTS))
BLACK = np.zeros((120, 160, 3), np.uint8)
STAMP_NS = 5_000_000_000
PERSON = TrackedObject(
    1, 'person', ObjectState.PERSON, STAMP_NS, 0.9, np.zeros(3), np.zeros(3), np.ones(3)
)


class Sent(NamedTuple):
    """A message that was published."""

    topic: str
    data: bytes


class Bench:
    """The outputs of a scene, with publishers that collect what they publish."""

    def __init__(self, *, is_map_level: bool, object_map: ObjectMapConfig | None = None) -> None:
        self.sent: list[Sent] = []
        self.subscribed = EVERY
        config = SceneConfig(object_map=object_map or ObjectMapConfig())
        self.outputs = SceneOutputs(self.publisher, config)
        self.outputs.frame = 'map'
        self.outputs.set_level(is_map_level=is_map_level)

    def publisher(self, output: OutputTopic) -> Publisher:
        bench = self

        class Collector:
            @property
            def is_wanted(self) -> bool:
                return output.name in bench.subscribed

            def publish(self, message: Any) -> None:
                data = message.tobytes() if isinstance(message, np.ndarray) else None
                bench.sent.append(Sent(output.name, data or serialize_message(message)))

        return Collector()


def new_outputs(
    *, is_map_level: bool, object_map: ObjectMapConfig | None = None
) -> tuple[Bench, SceneOutputs, list[Sent]]:
    bench = Bench(is_map_level=is_map_level, object_map=object_map)
    return bench, bench.outputs, bench.sent


def floor_scene(object_map: ObjectMapConfig | None = None) -> SceneMapper:
    """Return the scene of a camera 1 m above a floor, tilted down by 45 degrees.

    With an object map, there is a bag on the floor.
    """
    scene = SceneMapper(
        CAMERA, DenseConfig(), ObjectTrackerConfig(), object_map or ObjectMapConfig()
    )
    pitch = np.eye(4)
    pitch[[0, 0, 2, 2], [0, 2, 0, 2]] = np.sqrt(0.5) * np.array([1, 1, -1, 1])
    T_map_camera = pitch @ T_BODY_OPTICAL
    v = np.arange(120)[:, None].repeat(160, axis=1)
    depth_m = (1 / (np.sqrt(0.5) * (1 + (v - 59.5) / 130))).astype(np.float32)
    one = np.zeros(1, np.int64)
    keyframes = KeyframePoses(1, one, one, 0, T_map_camera[None])
    if object_map is not None:
        depth_m[44:76, 54:106] -= 0.2
    bag = DynamicObject('bag', (50.0, 40.0, 110.0, 80.0), 0.9, -1, ObjectState.AT_REST)
    for i in range(3):
        request = SceneRequest(STAMP_NS + i * 500_000_000, T_map_camera, 0, keyframes, True, True)
        scene.fuse(request, depth_m, BLACK, ())
        scene.map_objects(request, depth_m, (bag,), lambda: BLACK)
    return scene


@pytest.mark.parametrize('is_map_level', [False, True])
def test_every_message_has_the_type_of_its_topic(is_map_level: bool) -> None:
    _, scene_outputs, sent = new_outputs(is_map_level=is_map_level)
    scene_outputs.note_change()
    scene_outputs.publish_map(floor_scene(), STAMP_NS)
    scene_outputs.publish_objects((PERSON,), STAMP_NS)
    scene_outputs.clear(STAMP_NS)
    tables = (*MAP_OUTPUTS, *OBJECT_OUTPUTS, *OBJECT_MAP_OUTPUTS)
    types = {output.name: output.type for output in tables}
    messages = [(o.topic, deserialize_message(o.data, types[o.topic])) for o in sent]
    names = [name for name, _ in messages]
    objects = [output.name for output in OBJECT_OUTPUTS]
    level = [] if is_map_level else ['/tf_static']
    maps = [output.name for output in OBJECT_MAP_OUTPUTS]
    before = ['cloud_map', *level, 'grid_map', *objects]
    assert names == [*before, 'cloud_map', 'grid_map', *objects, *maps]
    clouds = [message.width for name, message in messages if name == 'cloud_map']
    grids = [message.info.width for name, message in messages if name == 'grid_map']
    assert clouds[0] > 1000
    assert grids[0] > 0
    assert clouds[1] == grids[1] == 0


def test_the_grid_is_in_the_map_frame_once_that_is_level() -> None:
    _, scene_outputs, sent = new_outputs(is_map_level=False)
    scene, frames = floor_scene(), []
    for is_level in (False, True):
        scene.is_map_level = is_level
        scene_outputs.set_level(is_map_level=is_level)
        scene_outputs.note_change()
        scene_outputs.publish_map(scene, STAMP_NS)
        grids = [deserialize_message(o.data, OccupancyGrid) for o in sent if o.topic == 'grid_map']
        frames.append(grids[-1].header.frame_id)
        assert grids[-1].info.width > 0
    assert frames == ['map_level', 'map']


def test_a_row_of_the_table_adds_a_topic(monkeypatch: pytest.MonkeyPatch) -> None:
    def num_people_to_msg(objects: tuple[TrackedObject, ...], header: Header) -> UInt32:
        assert header.frame_id == 'map'
        return UInt32(data=sum(item.state is ObjectState.PERSON for item in objects))

    row = OutputTopic('num_people', UInt32, qos.OUTPUT, num_people_to_msg)
    monkeypatch.setattr(outputs, 'OBJECT_OUTPUTS', (*OBJECT_OUTPUTS, row))
    bench, scene_outputs, sent = new_outputs(is_map_level=True)
    bench.subscribed = frozenset({'num_people'})
    scene_outputs.publish_objects((PERSON, PERSON), STAMP_NS)
    assert sent[-1].topic == 'num_people'
    assert deserialize_message(sent[-1].data, UInt32).data == 2


@pytest.mark.parametrize(
    ('subscribed', 'published'),
    [
        (set(), []),
        ({'people'}, ['people']),
        ({'cloud_map'}, ['cloud_map']),
        ({'grid_map'}, ['/tf_static', 'grid_map']),
        ({'cloud_map', 'grid_map_updates'}, ['cloud_map', '/tf_static', 'grid_map']),
    ],
)
def test_messages_are_made_for_subscribers_only(
    subscribed: set[str], published: list[str]
) -> None:
    bench, scene_outputs, sent = new_outputs(is_map_level=False)
    scene_outputs.note_change()
    bench.subscribed = frozenset(subscribed)
    scene_outputs.publish_map(floor_scene(), STAMP_NS)
    scene_outputs.publish_objects((PERSON,), STAMP_NS)
    assert [output.topic for output in sent] == published
    assert not scene_outputs.due
    bench.subscribed = EVERY  # late subscribers get what was not made so far
    late = {'cloud_map', '/tf_static', 'grid_map', 'grid_map_updates'} - set(published)
    assert scene_outputs.due == (late if 'grid_map' not in published else late & {'cloud_map'})


def test_the_object_map_is_published_to_late_subscribers_once() -> None:
    bench, scene_outputs, sent = new_outputs(is_map_level=True)
    scene = SceneMapper(CAMERA, DenseConfig(), ObjectTrackerConfig(), ObjectMapConfig())
    scene_outputs.note_object_change()
    scene_outputs.publish_object_map(scene, STAMP_NS)
    assert not sent
    bench.subscribed = frozenset({'object_map'})
    scene_outputs.publish_object_map(scene, STAMP_NS)
    scene_outputs.publish_object_map(scene, STAMP_NS)
    assert [output.topic for output in sent] == ['object_map']


def test_objects_at_rest_are_detections_with_their_classes() -> None:
    T = np.eye(4)
    T[:3, 3] = 1.0, 2.0, 3.0
    scores = (('cup', 3.0), ('bottle', 1.0))
    at_rest = MapObject(
        4, 'cup', scores, ObjectState.AT_REST, T, np.array([0.1, 0.2, 0.3]), 5, 1, STAMP_NS, 0.5
    )
    gone = replace(at_rest, object_id=5, state=ObjectState.GONE)
    header = Header(frame_id='map')
    (found,) = object_map_to_msg((at_rest, gone), header).detections
    assert found.id == '4'
    assert found.header.frame_id == 'map'
    assert found.header.stamp.sec == 5
    means = {result.hypothesis.class_id: result.hypothesis.score for result in found.results}
    assert means == pytest.approx({'cup': 0.6, 'bottle': 0.2})
    center, size = found.bbox.center.position, found.bbox.size
    assert (center.x, center.y, center.z) == (1.0, 2.0, 3.0)
    assert (size.x, size.y, size.z) == (0.1, 0.2, 0.3)
    labels = [m.text for m in object_map_markers_to_msg((at_rest, gone), header).markers if m.text]
    assert labels == ['cup 4', 'cup 5: gone']


@pytest.mark.parametrize('prior_score', [0.0, 0.25])
def test_expected_objects_are_published_if_the_map_is_a_prior(prior_score: float) -> None:
    config = ObjectMapConfig(enabled=True, prior_score=prior_score)
    bench, scene_outputs, sent = new_outputs(is_map_level=True, object_map=config)
    bench.subscribed = frozenset({'expected_objects'})
    scene = floor_scene(config)
    expected = scene.expected_objects()
    if prior_score == 0:
        assert expected is None
        return
    assert expected is not None
    header = header_to_msg(STAMP_NS, 'camera')
    scene_outputs.publish_expected(expected, header, CAMERA.size_px)
    (output,) = sent
    assert output.topic == 'expected_objects'
    message = deserialize_message(output.data, DetectionArray)
    assert (message.header, message.image_width, message.image_height) == (header, 160, 120)
    (bag,) = message.detections
    assert bag.class_name == 'bag'
    # The part of the bag whose depth is not at an edge.
    assert (bag.x_min, bag.y_min, bag.x_max, bag.y_max) == pytest.approx((54, 44, 106, 76), abs=8)


def test_a_labeled_cloud_is_published_with_the_names_of_its_labels() -> None:
    config = ObjectMapConfig(enabled=True, label_cloud=True)
    bench, scene_outputs, sent = new_outputs(is_map_level=True, object_map=config)
    bench.subscribed = frozenset({'cloud_map', 'cloud_map/labels'})
    scene_outputs.note_change()
    scene_outputs.publish_map(floor_scene(config), STAMP_NS)
    scene_outputs.clear(STAMP_NS)
    types = {output.name: output.type for output in MAP_OUTPUTS}
    of_cloud = [output for output in sent if output.topic in bench.subscribed]
    cloud, names, no_points, no_names = [
        deserialize_message(output.data, types[output.topic]) for output in of_cloud
    ]
    assert [(c.class_id, c.class_name) for c in names.class_map] == [(1, 'bag')]
    labels = cloud_from_msg(cloud).labels
    assert labels is not None
    assert set(labels.tolist()) == {0, 1}
    assert 0.05 < labels.mean() < 0.6
    assert [field.name for field in no_points.fields] == [field.name for field in cloud.fields]
    assert no_points.width == len(no_names.class_map) == 0


def test_a_map_that_was_published_before_the_first_image_is_cleared() -> None:
    """A loaded map has no image yet, so that its stamp is 0."""
    _, scene_outputs, sent = new_outputs(is_map_level=True)
    scene_outputs.clear(0)
    assert sent == []  # nothing of a scene was published
    scene_outputs.note_change()
    scene_outputs.publish_map(floor_scene(), 0)
    scene_outputs.clear(0)
    types = {output.name: output.type for output in MAP_OUTPUTS}
    clouds = [deserialize_message(o.data, types[o.topic]) for o in sent if o.topic == 'cloud_map']
    assert clouds[0].width > 1000
    assert [cloud.width for cloud in clouds[1:]] == [0]
    num_sent = len(sent)
    scene_outputs.clear(0)
    assert len(sent) == num_sent
