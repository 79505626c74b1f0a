"""Topics for planners and other detectors, in message types of other packages."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from ament_index_python.packages import get_package_share_directory
from geometry_msgs.msg import Point, Pose
from hoid_msgs.msg import ObjectState
from nav2_msgs.msg import CostmapFilterInfo
from nav_msgs.msg import MapMetaData, OccupancyGrid
from people_msgs.msg import People, Person
from sensor_msgs.msg import PointCloud2
from tf2_msgs.msg import TFMessage
from vision_msgs.msg import (
    BoundingBox2D,
    Detection2D,
    Detection2DArray,
    LabelInfo,
    ObjectHypothesis,
    ObjectHypothesisWithPose,
    Point2D,
    Pose2D,
    VisionClass,
)

from hoid_common import se3, topics
from hoid_common.ros import conversions, qos
from hoid_common.se3 import T_BODY_OPTICAL
from hoid_common.values import NS_PER_S, Detections, FloatArray
from hoid_system_tests.filter_peer import DEPTH_M, HEIGHT, PERSON, WIDTH, FilterRunner, num_inside
from hoid_system_tests.probe import Probe

EXAMPLES = Path(__file__).parents[1] / 'examples'
LIMIT_S = 30
# Fields as defined in the packages of Jazzy. Another order or name would be another type.
FIELDS: dict[Any, list[tuple[str, str]]] = {
    Person: [
        ('name', 'string'), ('position', 'geometry_msgs/Point'),
        ('velocity', 'geometry_msgs/Point'), ('reliability', 'double'),
        ('tagnames', 'sequence<string>'), ('tags', 'sequence<string>'),
    ],
    People: [('header', 'std_msgs/Header'), ('people', 'sequence<people_msgs/Person>')],
    Point2D: [('x', 'double'), ('y', 'double')],
    Pose2D: [('position', 'vision_msgs/Point2D'), ('theta', 'double')],
    BoundingBox2D: [
        ('center', 'vision_msgs/Pose2D'), ('size_x', 'double'), ('size_y', 'double'),
    ],
    ObjectHypothesis: [('class_id', 'string'), ('score', 'double')],
    ObjectHypothesisWithPose: [
        ('hypothesis', 'vision_msgs/ObjectHypothesis'),
        ('pose', 'geometry_msgs/PoseWithCovariance'),
    ],
    Detection2D: [
        ('header', 'std_msgs/Header'),
        ('results', 'sequence<vision_msgs/ObjectHypothesisWithPose>'),
        ('bbox', 'vision_msgs/BoundingBox2D'), ('id', 'string'),
    ],
    Detection2DArray: [
        ('header', 'std_msgs/Header'), ('detections', 'sequence<vision_msgs/Detection2D>'),
    ],
    VisionClass: [('class_id', 'uint16'), ('class_name', 'string')],
    LabelInfo: [
        ('header', 'std_msgs/Header'), ('class_map', 'sequence<vision_msgs/VisionClass>'),
        ('threshold', 'float'),
    ],
    CostmapFilterInfo: [
        ('header', 'std_msgs/Header'), ('type', 'uint8'), ('filter_mask_topic', 'string'),
        ('base', 'float'), ('multiplier', 'float'),
    ],
}  # fmt: skip


@pytest.mark.parametrize('type_', FIELDS, ids=lambda type_: type_.__name__)
def test_message_fields_equal_those_of_the_original_packages(type_: Any) -> None:
    assert list(type_.get_fields_and_field_types().items()) == FIELDS[type_]


# The hashes of TFMessage and OccupancyGridUpdate come from bags of Jazzy and from `ros2 topic info
# -v`, the others from the definitions in vision_msgs 4.1.1 and wg-perception's people_msgs.
HASHES = {
    'tf2_msgs/TFMessage': 'e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087',
    'map_msgs/OccupancyGridUpdate': (
        'c4095b0be2e4363f8978a1570e0293ee093436f1e1c61d99b48502ac317025e8'
    ),
    'vision_msgs/Detection2DArray': (
        '214274120007f4a683866481336b70310268cfa107aebe9d594a6acf75bda968'
    ),
    'people_msgs/People': '9ea98a5e58f833a9532957bca23a6b8006a12885d5a16c8ca41dd901d10c33b6',
}


@pytest.mark.parametrize('name', HASHES)
def test_type_hashes_equal_those_of_the_original_packages(name: str) -> None:
    package, _, type_ = name.partition('/')
    share = Path(get_package_share_directory(package))
    hashes = json.loads((share / 'msg' / f'{type_}.json').read_text())['type_hashes']
    (found,) = [t['hash_string'] for t in hashes if t['type_name'] == f'{package}/msg/{type_}']
    assert found == f'RIHS01_{HASHES[name]}'


def test_the_filter_uses_the_boxes_of_another_detector(
    run_filter: FilterRunner, probe: Probe
) -> None:
    peer = run_filter(**{'detections.as_vision_msgs': True, 'detections.wait_s': 5.0})
    boxes = probe.publisher(Detection2DArray, 'detections_2d')
    box = np.array([PERSON[1]], np.float32)
    person = Detections(0, box, ('person',), np.array([0.9], np.float32))
    boxes.publish(Detection2DArray(header=peer.header(0), detections=[Detection2D()]))
    peer.wait_for_count('detections refused', 1)  # and the node keeps running
    boxes.publish(conversions.detections_2d_to_msg(person, peer.header(1)))
    peer.send_images(1)
    features, objects = peer.answer()
    assert [o.state for o in objects.objects] == [ObjectState.PERSON]
    only = objects.objects[0]
    assert (only.x_min, only.y_min, only.x_max, only.y_max) == PERSON[1]
    assert num_inside(features, PERSON) == 0


def test_moving_and_static_points_are_published(run_filter: FilterRunner, probe: Probe) -> None:
    peer = run_filter(strategy='person')
    moving, static = (probe.collect(PointCloud2, t) for t in ('moving_points', 'static_points'))
    probe.spin_for(0.5)
    depth_m = np.full_like(DEPTH_M, 4.0)
    depth_m[50:450, 100:300] = 2.0  # the person in front of a wall
    depth_m[0, 0] = 0.0
    peer.show(0, PERSON, depth_m=depth_m)
    probe.spin_until(lambda: bool(moving and static), 'no points')
    assert moving[0].header == static[0].header == peer.header(0)
    points = conversions.cloud_from_msg(moving[0]).points_m
    assert points.shape == (25 * 50, 3)  # every eighth pixel in the box
    assert set(points[:, 2]) == {2.0}
    # By hand: u in 104..296, v in 56..448, 500 px of focal length around (320, 240).
    np.testing.assert_allclose(points.min(0), [-0.864, -0.736, 2.0], atol=1e-6)
    np.testing.assert_allclose(points.max(0), [-0.096, 0.832, 2.0], atol=1e-6)
    rest = conversions.cloud_from_msg(static[0]).points_m
    assert len(rest) == WIDTH * HEIGHT // 64 - len(points) - 1  # minus the pixel without depth
    assert set(rest[:, 2]) == {4.0}


def test_a_person_who_fills_the_view_is_published_for_planners(
    run_filter: FilterRunner, probe: Probe
) -> None:
    peer = run_filter(strategy='hoid+')
    moving = probe.collect(PointCloud2, 'moving_points')
    probe.spin_for(0.5)
    peer.show(0, ('person', (0.0, 0.0, float(WIDTH), float(HEIGHT))))
    features, _ = peer.answer()
    assert len(features.octave) == 0
    probe.spin_until(lambda: bool(moving), 'no points')
    assert moving[0].width > 0.9 * WIDTH * HEIGHT / 64


def test_the_example_prints_the_distance_of_people_and_their_floor(probe: Probe) -> None:
    example = EXAMPLES / 'people_consumer.py'
    assert len(example.read_text().splitlines()) <= 32
    grids = probe.publisher(OccupancyGrid, topics.GRID_MAP, qos.LATCHED, wait=False)
    info = MapMetaData(resolution=0.5, width=4, height=2, origin=Pose(position=Point(x=-1.0)))
    grids.publish(OccupancyGrid(
        header=conversions.header_to_msg(1, 'map_level'), info=info,
        data=[0, 0, 0, 100, -1, 0, 0, 0],
    ))  # fmt: skip
    static = probe.publisher(TFMessage, topics.TF_STATIC, qos.TF_STATIC, wait=False)
    lower = shifted(0.0, 0.0, -1.0)
    static.publish(
        TFMessage(transforms=[conversions.transform_to_msg(lower, 0, 'map', 'map_level')])
    )
    command = [sys.executable, str(example), 'camera']
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as process:
        try:
            people, tf = (
                probe.publisher(People, topics.PEOPLE),
                probe.publisher(TFMessage, topics.TF),
            )
            for second in (1, 2):  # the camera moves at 1 m/s along its z axis
                edges = [('map', 'odom', shifted(0.5)), ('odom', 'camera', camera_at(second))]
                tf.publish(TFMessage(transforms=[
                    conversions.transform_to_msg(T, second * NS_PER_S, parent, child)
                    for parent, child, T in edges
                ]))  # fmt: skip
            probe.spin_for(0.5)
            at_m = ((4.0, 0.0), (0.6, 0.2), (-0.8, 0.7), (0.2, 0.7))
            between_ns = 3 * NS_PER_S // 2  # between the stamps of the two transforms
            header = conversions.header_to_msg(between_ns, 'map')
            people.publish(People(header=header, people=[
                Person(name=str(i), position=Point(x=x, y=y, z=0.9))
                for i, (x, y) in enumerate(at_m)
            ]))  # fmt: skip
            assert process.stdout is not None
            lines = [process.stdout.readline() for _ in at_m]
            process.send_signal(signal.SIGINT)
            assert 'Traceback' not in process.communicate(timeout=LIMIT_S)[1]
        finally:
            process.kill()
    assert lines == [
        '0: 2.00 m ahead, unknown floor\n',  # beyond the grid
        '1: -1.40 m ahead, occupied floor\n',
        '2: -2.80 m ahead, unknown floor\n',
        '3: -1.80 m ahead, free floor\n',
    ]


def shifted(x: float, y: float = 0.0, z: float = 0.0) -> FloatArray:
    return se3.exp(np.array([0.0, 0, 0, x, y, z]))


def camera_at(second: float) -> FloatArray:
    """Return the (4, 4) T_odom_camera of a camera that faces along x."""
    return np.asarray(shifted(second) @ T_BODY_OPTICAL)


def test_the_page_includes_the_example() -> None:
    page = EXAMPLES.parent / 'docs' / 'howto' / 'nav2.md'
    assert '```python\n--8<-- "examples/people_consumer.py"\n```\n' in page.read_text()


def test_the_example_for_nav2_marks_and_clears_with_published_topics() -> None:
    parameters = yaml.safe_load((EXAMPLES / 'nav2_params.yaml').read_text())
    for name in ('local_costmap', 'global_costmap'):
        layers = parameters[name][name]['ros__parameters']
        assert set(layers['plugins']) <= layers.keys()
        layer = layers['obstacle_layer']
        sources = [layer[source] for source in layer['observation_sources'].split()]
        assert [(s['topic'], s['marking'], s['clearing']) for s in sources] == [
            (f'/{topics.MOVING_POINTS}', True, True),
            (f'/{topics.STATIC_POINTS}', False, True),
        ]
        assert {s['data_type'] for s in sources} == {'PointCloud2'}
        # No source marks what is at rest: it enters a costmap only by the grid, before people do.
        assert layers['plugins'].index('static_layer') < layers['plugins'].index('obstacle_layer')
        assert layers['static_layer'] == {
            'plugin': 'nav2_costmap_2d::StaticLayer',
            'map_topic': f'/{topics.GRID_MAP}',
            'map_subscribe_transient_local': True,
            'subscribe_to_updates': True,
        }
