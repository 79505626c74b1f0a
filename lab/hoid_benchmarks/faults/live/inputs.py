"""Wrong messages among good ones, on every input of every node."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from hoid_msgs.msg import DynamicObject, DynamicObjectArray, FeatureVerdicts
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from hoid_benchmarks.faults.cases import Outcome
from hoid_benchmarks.faults.damage import Rng
from hoid_benchmarks.faults.live.mutations import mutated
from hoid_benchmarks.faults.live.sender import Sender
from hoid_benchmarks.faults.live.stage import Seen, Stage
from hoid_common import topics

_COLOR, _DEPTH = topics.RGB_IMAGE, topics.DEPTH_IMAGE
_IMAGES = (_COLOR, _DEPTH)
_PACKED = (topics.compressed(_COLOR), topics.compressed_depth(_DEPTH))
_OTHERS = (
    topics.CAMERA_INFO, topics.DETECTIONS, topics.FEATURES, topics.FEATURE_VERDICTS,
    topics.DYNAMIC_OBJECTS, topics.INITIAL_POSE, topics.TF_STATIC,
)  # fmt: skip
_CLOCK_BYTES = 12
_BETWEEN = 8  # wrong messages between two good ones
_SETTLE_S = 0.1  # for each wrong message, at most
_FOREIGN = (topics.CLOCK, topics.TF, topics.DETECTIONS_2D)


def message_cases(stage: Stage, seeds: range) -> Iterator[Outcome]:
    """Yield one outcome for each input: all its seeds are sent to the same nodes.

    A few wrong messages lie between two good ones, fewer than an input's queue holds. Before
    many of them, the nodes settle.
    """
    if not seeds:
        return
    stage.settle(_SETTLE_S * len(seeds))
    setup = stage.setup
    sent = _FOREIGN if setup.is_foreign else (*_IMAGES, *_OTHERS)
    for topic in _PACKED if setup.is_compressed else sent:

        def send(topic: str = topic) -> Seen:
            _send_wrong(stage.sender, topic, np.random.default_rng(seeds.start), len(seeds))
            return Seen()

        outcome = stage.outcome(f'messages on `{topic.lstrip("/")}`', seeds.start, send)
        yield outcome._replace(number=len(seeds))


def _send_wrong(sender: Sender, topic: str, rng: Rng, number: int) -> None:
    pause_s = sender.period_s / (_BETWEEN + 1)
    for i in range(number):
        if i % _BETWEEN == 0:
            good = sender.send()
            msg = good.get(topic)
            if msg is None:
                msg = _sample(sender, topic, good[topics.CAMERA_INFO].header)
        wrong = mutated(msg, rng)
        if topic == topics.CLOCK:  # of a fixed size; the middleware sends no more than that
            wrong = wrong[:_CLOCK_BYTES]
        sender.publish(topic, wrong, type(msg))
        sender.spin_until(time.monotonic() + pause_s)


def _sample(sender: Sender, topic: str, header: Header) -> Any:
    """Return a good message of what the sender does not send."""
    if topic == topics.FEATURES and sender.features is not None:
        sender.features.header = header
        return sender.features
    if topic == topics.FEATURE_VERDICTS:
        return FeatureVerdicts(header=header, dynamic=[0, 1] * 500)
    if topic == topics.DYNAMIC_OBJECTS:
        cup = DynamicObject(class_name='cup', score=0.9, x_max=40.0, y_max=40.0, dynamic=True)
        return DynamicObjectArray(header=header, objects=[cup])
    if topic == topics.INITIAL_POSE:
        return PoseWithCovarianceStamped(header=Header(frame_id='map', stamp=header.stamp))
    return TFMessage(transforms=[TransformStamped(header=header, child_frame_id='mast')])
