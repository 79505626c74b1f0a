"""A camera driver from an ordinary ROS shell, without the transport profile of the suite.

    python -m hoid_system_tests.plain_camera RELIABILITY DEPTH COUNT TOPIC

It waits for a subscriber, publishes COUNT images of 640x480 pixels at 30 Hz, and ends. The driver
of `plain_camera.cpp` does the same in C++.
"""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import time
from collections.abc import Sequence
from pathlib import Path

import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image

RATE_HZ = 30.0
PYTHON = (sys.executable, '-m', __name__)
"""Command of the driver in Python."""
_WIDTH, _HEIGHT = 640, 480
_VARIABLES = ('FASTRTPS_DEFAULT_PROFILES_FILE', 'ROS_AUTOMATIC_DISCOVERY_RANGE')
_SOURCE = Path(__file__).with_suffix('.cpp')
_LIBRARIES = ('rcl', 'rcutils', 'rmw', 'rosidl_runtime_c', 'sensor_msgs__rosidl_typesupport_cpp')


def cpp_driver(folder: Path) -> tuple[str]:
    """Build the driver in C++ and return its command."""
    prefixes = map(Path, [*os.environ['AMENT_PREFIX_PATH'].split(os.pathsep), sys.prefix])
    prefix = next(prefix for prefix in prefixes if (prefix / 'include/rcl').is_dir())
    headers = [f'-I{path}' for path in (prefix / 'include').iterdir() if path.is_dir()]
    linked = ['-Wl,--allow-shlib-undefined', f'-Wl,-rpath,{prefix}/lib', f'-L{prefix}/lib']
    linked += [f'-l{name}' for name in _LIBRARIES]
    # The middleware of the wheels loads modules for Python.
    version, folder_of_python = (sysconfig.get_config_var(n) for n in ('LDVERSION', 'LIBDIR'))
    linked += [f'-L{folder_of_python}', '-Wl,--no-as-needed', f'-lpython{version}']
    program = folder / 'plain_camera'
    subprocess.run(
        ['g++', '-std=c++17', *headers, str(_SOURCE), '-o', str(program), *linked], check=True
    )
    return (str(program),)


def start_plain_camera(
    command: Sequence[str], reliability: str, depth: int, count: int, topic: str
) -> subprocess.Popen[bytes]:
    """Start a driver without the suite's transport profile, and return its process."""
    environment = {k: v for k, v in os.environ.items() if k not in _VARIABLES}
    arguments = [reliability, str(depth), str(count), topic]
    return subprocess.Popen([*command, *arguments], env=environment)


def main() -> None:
    """Publish the images that the command line asks for."""
    reliability, depth, count, topic = sys.argv[1:]
    rclpy.init()
    node = rclpy.create_node('plain_camera')
    profile = QoSProfile(depth=int(depth), reliability=ReliabilityPolicy[reliability.upper()])
    publisher = node.create_publisher(Image, topic, profile)
    while not publisher.get_subscription_count():
        time.sleep(0.05)
    time.sleep(1.0)  # the subscriber discovers the publisher later
    msg = Image(width=_WIDTH, height=_HEIGHT, encoding='bgr8', step=3 * _WIDTH)
    msg.data = bytes(3 * _WIDTH * _HEIGHT)
    msg.header.frame_id = 'camera'
    start_s = time.monotonic()
    for i in range(int(count)):
        time.sleep(max(start_s + i / RATE_HZ - time.monotonic(), 0.0))
        msg.header.stamp = node.get_clock().now().to_msg()
        publisher.publish(msg)
    time.sleep(2.0)  # for reliable messages that are sent again
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == '__main__':
    main()
