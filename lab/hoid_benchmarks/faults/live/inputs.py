"""Wrong messages between good ones, on every input of every node."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped, Vector3
from hoid_msgs.msg import DynamicObject, DynamicObjectArray, FeatureVerdicts
from sensor_msgs.msg import Imu
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from hoid_benchmarks.faults.cases import Outcome
from hoid_benchmarks.faults.damage import Rng
from hoid_benchmarks.faults.live.mutations import mutated
from hoid_benchmarks.faults.live.node_harness import CaseResult, NodeHarness
from hoid_benchmarks.faults.live.sender import Sender
from hoid_common import topics

_COLOR, _DEPTH = topics.RGB_IMAGE, topics.DEPTH_IMAGE
_IMAGES = (_COLOR, _DEPTH)
_PACKED = (topics.compressed(_COLOR), topics.compressed_depth(_DEPTH))
_OTHERS = (
    topics.CAMERA_INFO, topics.DETECTIONS, topics.FEATURES, topics.FEATURE_VERDICTS,
    topics.DYNAMIC_OBJECTS, topics.INITIAL_POSE, topics.TF_STATIC, topics.IMU,
)  # fmt: skip
_CLOCK_BYTES = 12  # of a serialized Clock
_NUM_WRONG = 8  # wrong messages between two good ones; fewer than the queue of an input holds
_SETTLE_S = 0.1  # longest settling time for each wrong message
_FOREIGN = (topics.CLOCK, topics.TF, topics.DETECTIONS_2D)


def message_cases(harness: NodeHarness, seeds: range) -> Iterator[Outcome]:
    """Yield one outcome for each input; the messages of all seeds go to the same nodes.

    A few wrong messages lie between two good ones. The nodes settle before the first case, so that
    their memory can be compared.
    """
    if not seeds:
        return
    harness.settle(_SETTLE_S * len(seeds))
    setup = harness.setup
    sent = _FOREIGN if setup.is_foreign else (*_IMAGES, *_OTHERS)
    for topic in _PACKED if setup.is_compressed else sent:

        def send(topic: str = topic) -> CaseResult:
            _send_wrong(harness.sender, topic, np.random.default_rng(seeds.start), len(seeds))
            return CaseResult()

        outcome = harness.outcome(f'messages on `{topic.lstrip("/")}`', seeds.start, send)
        yield outcome._replace(number=len(seeds))


def _send_wrong(sender: Sender, topic: str, rng: Rng, number: int) -> None:
    pause_s = sender.period_s / (_NUM_WRONG + 1)
    for i in range(number):
        if i % _NUM_WRONG == 0:
            good = sender.send()
            msg = good.get(topic)
            if msg is None:
                msg = _sample(sender, topic, good[topics.CAMERA_INFO].header)
        wrong = mutated(msg, rng)
        # A Clock has a fixed size, and the middleware sends no more bytes.
        if topic == topics.CLOCK:
            wrong = wrong[:_CLOCK_BYTES]
        sender.publish(topic, wrong, type(msg))
        sender.spin_until(time.monotonic() + pause_s)


def _sample(sender: Sender, topic: str, header: Header) -> Any:
    """Return a good message for a topic that the sender does not publish."""
    if topic == topics.FEATURES and sender.features is not None:
        sender.features.header = header
        return sender.features
    if topic == topics.FEATURE_VERDICTS:
        return FeatureVerdicts(header=header, dynamic=[0, 1] * 500)
    if topic == topics.DYNAMIC_OBJECTS:
        cup = DynamicObject(class_name='cup', score=0.9, x_max=40.0, y_max=40.0, dynamic=True)
        return DynamicObjectArray(header=header, objects=[cup])
    if topic == topics.IMU:
        return Imu(header=header, angular_velocity=Vector3(x=0.1, y=0.2, z=0.3))
    if topic == topics.INITIAL_POSE:
        return PoseWithCovarianceStamped(header=Header(frame_id='map', stamp=header.stamp))
    return TFMessage(transforms=[TransformStamped(header=header, child_frame_id='mast')])
