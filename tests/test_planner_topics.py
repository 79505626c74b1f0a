"""What planners and other detectors exchange with the suite, in types of other packages."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from geometry_msgs.msg import Point
from hoid_msgs.msg import DynamicObject as ObjectMsg
from people_msgs.msg import People, Person
from sensor_msgs.msg import PointCloud2
from vision_msgs.msg import (
    BoundingBox2D,
    Detection2D,
    Detection2DArray,
    ObjectHypothesis,
    ObjectHypothesisWithPose,
    Point2D,
    Pose2D,
)

from hoid_common import topics
from hoid_common.ros import conversions
from hoid_common.values import Detections
from hoid_system_tests.filter_peer import DEPTH_M, HEIGHT, PERSON, WIDTH, FilterRunner, num_inside
from hoid_system_tests.probe import Probe

EXAMPLES = Path(__file__).parents[1] / 'examples'
# As the packages of Jazzy define them: another order or name is another type.
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
}  # fmt: skip


@pytest.mark.parametrize('type_', FIELDS, ids=lambda type_: type_.__name__)
def test_messages_are_those_of_their_packages(type_: Any) -> None:
    assert list(type_.get_fields_and_field_types().items()) == FIELDS[type_]


def test_another_detectors_boxes_are_filtered_by(run_filter: FilterRunner, probe: Probe) -> None:
    peer = run_filter(**{'detections.as_vision_msgs': True, 'detections.wait_s': 5.0})
    boxes = probe.publisher(Detection2DArray, 'detections_2d')
    box = np.array([PERSON[1]], np.float32)
    person = Detections(0, box, ('person',), np.array([0.9], np.float32))
    boxes.publish(Detection2DArray(header=peer.header(0), detections=[Detection2D()]))
    peer.wait_for_count('detections refused', 1)  # and it lives on
    boxes.publish(conversions.detections_2d_to_msg(person, peer.header(1)))
    peer.send_images(1)
    features, objects = peer.answer()
    assert [o.reason for o in objects.objects] == [ObjectMsg.PERSON]
    only = objects.objects[0]
    assert (only.x_min, only.y_min, only.x_max, only.y_max) == PERSON[1]
    assert num_inside(features, PERSON) == 0


def test_points_of_what_moves_and_of_what_does_not(run_filter: FilterRunner, probe: Probe) -> None:
    peer = run_filter(strategy='person')
    moving, static = (probe.collect(PointCloud2, t) for t in ('moving_points', 'static_points'))
    probe.spin_for(0.5)
    depth_m = np.full_like(DEPTH_M, 4.0)
    depth_m[50:450, 100:300] = 2.0  # the person before a wall
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
    assert len(rest) == WIDTH * HEIGHT // 64 - len(points) - 1  # that without depth
    assert set(rest[:, 2]) == {4.0}


def test_somebody_who_fills_the_view_is_there_for_planners(
    run_filter: FilterRunner, probe: Probe
) -> None:
    peer = run_filter(strategy='hoid+')
    moving = probe.collect(PointCloud2, 'moving_points')
    probe.spin_for(0.5)
    peer.show(0, ('person', (0.0, 0.0, float(WIDTH), float(HEIGHT))))
    features, _ = peer.answer()
    assert len(features.octave) > 0  # given back: there is nothing else
    probe.spin_until(lambda: bool(moving), 'no points')
    assert moving[0].width > 0.9 * WIDTH * HEIGHT / 64


def test_the_example_hears_of_people(probe: Probe) -> None:
    example = EXAMPLES / 'people_consumer.py'
    assert len(example.read_text().splitlines()) <= 30
    command = [sys.executable, str(example)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            people = probe.publisher(People, topics.PEOPLE)
            person = Person(
                name='3', position=Point(x=1.0, y=-0.5, z=0.9), velocity=Point(x=0.5, y=0.25)
            )
            header = conversions.header_to_msg(1, 'map')
            people.publish(People(header=header, people=[person]))
            assert process.stdout is not None
            line = process.stdout.readline()
        finally:
            process.terminate()
    assert line == 'person 3 at (1.00, -0.50) m in map, in 1 s at (1.50, -0.25) m\n'


def test_the_example_for_nav2_marks_and_clears_with_what_is_published() -> None:
    told = yaml.safe_load((EXAMPLES / 'nav2_params.yaml').read_text())
    for name in ('local_costmap', 'global_costmap'):
        layers = told[name][name]['ros__parameters']
        assert set(layers['plugins']) <= layers.keys()
        layer = layers['obstacle_layer']
        sources = [layer[source] for source in layer['observation_sources'].split()]
        assert [(s['topic'], s['marking'], s['clearing']) for s in sources] == [
            (f'/{topics.MOVING_POINTS}', True, True),
            (f'/{topics.STATIC_POINTS}', False, True),
        ]
        assert {s['data_type'] for s in sources} == {'PointCloud2'}
    static = told['global_costmap']['global_costmap']['ros__parameters']['static_layer']
    assert static['map_topic'] == f'/{topics.GRID_MAP}'
