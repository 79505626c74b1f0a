"""A camera driver from an ordinary ROS shell, without the transport profile of the suite.

    python -m hoid_system_tests.plain_camera RELIABILITY DEPTH COUNT [TOPIC ...]

It waits for a subscriber, publishes COUNT images of 640x480 pixels at 30 Hz on each topic, and
ends. `start_plain_camera` starts it in a process of its own.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Sequence

import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image

RATE_HZ = 30.0
_WIDTH, _HEIGHT = 640, 480
_VARIABLES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'ROS_AUTOMATIC_DISCOVERY_RANGE')


def start_plain_camera(
    reliability: str, depth: int, count: int, topics: Sequence[str] = ('rgb/image',)
) -> subprocess.Popen[bytes]:
    """Start the driver without the suite's transport profile, and return its process."""
    environment = {k: v for k, v in os.environ.items() if k not in _VARIABLES}
    arguments = [reliability, str(depth), str(count), *topics]
    return subprocess.Popen([sys.executable, '-m', __name__, *arguments], env=environment)


def main() -> None:
    """Publish the images that the command line asks for."""
    reliability, depth, count, *topics = sys.argv[1:]
    rclpy.init()
    node = rclpy.create_node('plain_camera')
    profile = QoSProfile(depth=int(depth), reliability=ReliabilityPolicy[reliability.upper()])
    publishers = [
        node.create_publisher(Image, topic, profile) for topic in topics or ['rgb/image']
    ]
    while not all(publisher.get_subscription_count() for publisher in publishers):
        time.sleep(0.05)
    time.sleep(1.0)  # the subscriber discovers the publisher later
    msg = Image(width=_WIDTH, height=_HEIGHT, encoding='bgr8', step=3 * _WIDTH)
    msg.data = bytes(3 * _WIDTH * _HEIGHT)
    msg.header.frame_id = 'camera'
    start_s = time.monotonic()
    for i in range(int(count)):
        time.sleep(max(start_s + i / RATE_HZ - time.monotonic(), 0.0))
        msg.header.stamp = node.get_clock().now().to_msg()
        for publisher in publishers:
            publisher.publish(msg)
    time.sleep(2.0)  # for reliable messages that are sent again
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == '__main__':
    main()
