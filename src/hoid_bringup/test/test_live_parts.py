"""The parts of a live replay that do not use ROS."""

from __future__ import annotations

import json
import socket
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from hoid_bags.bag.bag_sequence import BagSequence
from hoid_bags.bag.bag_topics import RecordedTopics
from hoid_bags.bag.contents import BagTopic
from hoid_bringup.live.live_metrics import LiveMetrics
from hoid_bringup.live.node_specs import NodeOptions, node_specs, parameter_arguments
from hoid_bringup.live.replay_plan import ReplayConfig, node_options, player_spec
from hoid_bringup.live.ros_domain import own_domain
from hoid_bringup.run.run_config import TRUTH, RunConfig
from hoid_bringup.run.summary import FilterCounts
from hoid_common.camera_topics import CAMERA_TOPICS
from hoid_common.errors import ConfigError, InputError
from hoid_common.topics import is_compressed

IMAGE, COMPRESSED = 'sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage'


class FakeBag:
    """A bag with only the attributes that a replay plan uses."""

    path = Path('a bag')
    name = 'a bag'

    def __init__(
        self,
        color: str = '/rgb/image',
        depth: str = '/depth/image',
        info: str | None = '/rgb/camera_info',
        truth: str | None = None,
        types: dict[str, str] | None = None,
    ) -> None:
        self.depth_offset_ns, self.depth_units_per_m = 0, 0.0

        def topic(name: str | None) -> BagTopic | None:
            return (
                None
                if name is None
                else cast('BagTopic', BagTopicStub(name, (types or {}).get(name, '')))
            )

        self.topics = RecordedTopics(
            cast('BagTopic', topic(color)), cast('BagTopic', topic(depth)), topic(info), None,
            topic(truth),
        )  # fmt: skip


class BagTopicStub:
    def __init__(self, name: str, type_name: str = '') -> None:
        self.name, self.qos = name, None
        self.type_name = type_name or (COMPRESSED if is_compressed(name) else IMAGE)


def plan(bag: FakeBag, **changes: object) -> NodeOptions:
    config = ReplayConfig(run=RunConfig().updated(changes))
    return node_options(cast('BagSequence', bag), config, Path('folder'))


def test_the_suites_own_bag_needs_no_remaps() -> None:
    options = plan(FakeBag())
    assert options.nodes == ('hoid_detector', 'hoid_filter', 'rgbd_slam', 'hoid_scene')
    assert options.remappings == ()
    assert not options.use_sim_time  # no node needs /clock, which would wake each of them
    assert options.parameters['rgbd_slam']['map_directory'] == 'folder'


def test_foreign_and_compressed_topics_are_remapped() -> None:
    bag = FakeBag('/cam/color/compressed', '/cam/depth/compressedDepth', '/cam/info')
    options = plan(bag)
    assert dict(options.remappings) == {
        'rgb/image': 'cam/color/compressed',
        'depth/image': 'cam/depth/compressedDepth',
        'rgb/camera_info': 'cam/info',
    }


def test_one_compressed_topic_beside_a_raw_one_is_played() -> None:
    options = plan(FakeBag('/cam/color/compressed', '/depth/image'))
    assert dict(options.remappings) == {'rgb/image': 'cam/color/compressed'}


def test_offset_and_units_of_depth_reach_the_nodes() -> None:
    bag = FakeBag()
    bag.depth_offset_ns, bag.depth_units_per_m = 25_000_000, 10_000.0
    for node in ('hoid_filter', 'hoid_scene'):
        parameters = plan(bag).parameters[node]
        assert parameters['input.depth_offset_s'] == 0.025
        assert parameters['input.depth_units_per_m'] == 10_000.0


def test_ground_truth_boxes_replace_the_detector() -> None:
    options = plan(FakeBag(truth='/detections_gt'), model=TRUTH)
    assert options.nodes == ('hoid_filter', 'rgbd_slam', 'hoid_scene')
    assert options.remappings == (('detections', 'detections_gt'),)
    with pytest.raises(InputError, match='no ground-truth boxes'):
        plan(FakeBag(), model=TRUTH)


def test_a_run_without_its_maps_needs_no_scene() -> None:
    off = {'dense.enabled': False, 'objects.enabled': False, 'object_map.enabled': False}
    assert plan(FakeBag(), **off).nodes == ('hoid_detector', 'hoid_filter', 'rgbd_slam')


def test_no_filter_needs_no_detector() -> None:
    options = plan(FakeBag(), **{'filter.strategy': 'none', 'filter.depth_limit_m': 0.3})
    assert options.nodes == ('hoid_filter', 'rgbd_slam', 'hoid_scene')
    assert options.parameters['hoid_filter']['strategy'] == 'none'
    assert options.parameters['hoid_filter']['depth_limit_m'] == 0.3


@pytest.mark.parametrize(
    ('bag', 'message'),
    [
        (FakeBag(info=None), 'no camera_info topic'),
        (FakeBag(color='/rgb/image', types={'/rgb/image': COMPRESSED}), 'its name says otherwise'),
    ],
)
def test_bags_without_the_topics_of_the_nodes_are_refused(bag: FakeBag, message: str) -> None:
    with pytest.raises(InputError, match=message):
        plan(bag)


def test_the_player_waits_for_every_subscriber() -> None:
    config = ReplayConfig(rate=2.0)
    argv = player_spec(cast('BagSequence', FakeBag()), config).argv
    # Detector, filter, and SLAM for its dense map.
    assert argv[argv.index('--require') + 1] == 'rgb/image=3'
    assert argv[argv.index('--rate') + 1] == '2.0'


def test_only_topics_of_the_nodes_are_played() -> None:
    bag = cast('BagSequence', FakeBag(truth='/true_detections'))
    heard = ('/rgb/image', '/depth/image', '/rgb/camera_info')
    argv = player_spec(bag, ReplayConfig()).argv
    assert argv[argv.index('--topics') + 1 :] == heard
    argv = player_spec(bag, ReplayConfig(run=RunConfig().updated({'detector.model': TRUTH}))).argv
    assert argv[argv.index('--topics') + 1 :] == (*heard, '/true_detections')


def test_parameters_of_detections_keep_their_names() -> None:
    options = plan(FakeBag(), **{'detections.on_loss': 'stop', 'filter.strategy': 'hoid2d'})
    parameters = options.parameters['hoid_filter']
    assert parameters['detections.on_loss'] == 'stop'
    assert parameters['strategy'] == 'hoid2d'


def test_the_options_in_a_summary_reproduce_the_configuration() -> None:
    changes = {'filter.strategy': 'person', 'slam.seed': 3, 'detector.classes': ('cup', 'person')}
    options = RunConfig().updated(changes).summary_options()
    assert options == {'filter': 'person', 'seed': 3, 'detector.classes': ('cup', 'person')}
    read = {**json.loads(json.dumps(options)), 'rate': 2.0, 'of.later.versions': 1}
    assert RunConfig.from_summary_options(read) == RunConfig().updated(changes)
    assert RunConfig().summary_options().keys() == {'filter', 'seed'}


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'slam.camera.num_octaves': 7}, r'slam\.camera\.num_octaves, 7, must be at least 8'),
        ({'slam.camera.scale_factor': 1.3}, r'slam\.camera\.scale_factor, 1\.3, must be 1\.2'),
    ],
)
def test_contradicting_octaves_are_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        RunConfig().updated(changes)


def test_in_lockstep_no_message_may_be_lost() -> None:
    config = ReplayConfig(lockstep=True)
    bag = cast('BagSequence', FakeBag())
    options = node_options(bag, config, Path('folder'))
    assert all(p['input.reliability'] == 'reliable' for p in options.parameters.values())
    assert '--lockstep' in player_spec(bag, config).argv


def set_parameters(argv: Sequence[str]) -> dict[str, Any]:
    """Return the parameters that a command line sets."""
    pairs = [text.partition(':=') for flag, text in pairwise(argv) if flag == '-p']
    return {name: json.loads(text) for name, _, text in pairs}


def test_parameters_are_passed_on_the_command_line() -> None:
    options = NodeOptions(
        nodes=('rgbd_slam',),
        namespace='robot1',
        parameters={'rgbd_slam': {'keyframes.min_gap_s': 2.0, 'frames.base': 'base: link'}},
        remappings=(('rgb/image', '/a b'),),
    )
    (spec,) = node_specs(options)
    assert '__ns:=/robot1' in spec.argv
    assert 'rgb/image:=/a b' in spec.argv
    assert set_parameters(spec.argv) == {
        'keyframes.min_gap_s': 2.0,
        'frames.base': 'base: link',
        'expert': True,  # as keyframes.min_gap_s is a parameter for experts
        'use_sim_time': False,
    }


def test_an_internal_parameter_is_refused_by_nodes() -> None:
    options = NodeOptions(nodes=('rgbd_slam',), parameters={'rgbd_slam': {'mapping.rounds': 1}})
    with pytest.raises(ConfigError, match=r'mapping\.rounds is no parameter of a node'):
        node_specs(options)


def test_arguments_have_lists_empty_lists_and_texts_that_look_like_numbers() -> None:
    values = {'classes': ('cup', 'book'), 'providers': (), 'a.b': True, 'c': '1e3', 'd': 1e-9}
    arguments = parameter_arguments({**values, 'long': 'two words ' * 50})
    assert arguments[1::2][:3] == ['classes:=["cup", "book"]', 'providers:=[""]', 'a.b:=true']
    assert arguments[7:10:2] == ['c:="1e3"', 'd:=1e-09']
    assert '\n' not in arguments[-1]
    assert set_parameters(arguments)['long'] == 'two words ' * 50


def test_a_free_domain_is_reserved_unless_one_is_set(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv('ROS_DOMAIN_ID', raising=False)
    with own_domain() as domain:
        with socket.socket() as other, pytest.raises(OSError, match='in use'):
            other.bind(('', 32768 + domain))
        monkeypatch.setenv('ROS_DOMAIN_ID', '7')
        with own_domain() as chosen:
            assert chosen == 7
    monkeypatch.setenv('ROS_DOMAIN_ID', 'seven')
    with pytest.raises(ConfigError, match='not a number'), own_domain():
        pass


def test_metrics_by_stamp_in_any_order() -> None:
    metrics = LiveMetrics()
    metrics.odometry_ns[1] = 5_000_000
    metrics.published_ns[1] = 2_000_000
    metrics.published_ns[2] = 3_000_000  # never processed
    metrics.odometry_ns[3] = 9_000_000  # its publication was not received
    assert metrics.latency_ms() == [3.0]
    metrics.record_stages(1, {'track': 4.0, 'map': 7.0})
    metrics.record_stages(1, {'extract': 8.0, 'filter': 0.5})
    metrics.record_stages(2, {'extract': 9.0, 'filter': 0.5})
    assert metrics.stage_ms() == {
        'frame': [12.5],
        'track': [4.0],
        'map': [7.0],
        'extract': [8.0, 9.0],
        'filter': [0.5, 0.5],
    }
    metrics.processed |= {1}
    assert metrics.num_processed == 1
    metrics.num_features[1] = 1000, 200
    metrics.num_features[2] = 900, 100
    metrics.num_dynamic[2] = 3
    assert metrics.filter_counts() == FilterCounts(1900, 300, 3)


def test_camera_drivers_name_raw_and_compressed_topics() -> None:
    for name, camera in CAMERA_TOPICS.items():
        targets = [target for _, target in camera.remappings()]
        assert len(set(targets)) == 5, name
        assert np.all([not t.startswith('/') for t in targets]) == (name == 'bag')
