"""Images that arrive from a driver without the suite's profile, by what the receiver does alone.

    ./hoid dev python lab/scripts/plain_driver.py [--seconds 8]

The driver publishes 640 x 480 px at 30 Hz (tests/hoid_system_tests/plain_camera.cpp).
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image

from hoid_bringup.live.ros_domain import own_domain
from hoid_system_tests.plain_camera import RATE_HZ, cpp_driver, start_plain_camera

_TOPIC = '/plain/image'
_PROFILE = Path(__file__).parents[2] / 'src/hoid_common/config/fastdds_profile.xml'
_SHARED = re.compile(r'\s*<transport_id>shared_memory</transport_id>(?=\s*<transport_id>network)')
_BUFFERS = re.compile(r'\s*<(send|receive)BufferSize>\d+</\1BufferSize>')


def receivers(folder: Path) -> dict[str, Path | None]:
    """Return the transport profile of each receiver; None is that of Fast DDS."""
    suite = _PROFILE.read_text(encoding='utf-8')
    network = _SHARED.sub('', suite)
    assert network != suite
    texts = {'UDP alone, 4 MiB': network, 'UDP alone': _BUFFERS.sub('', network)}
    found: dict[str, Path | None] = {'plain': None, 'profile of the suite': _PROFILE}
    for name, text in texts.items():
        found[name] = folder / f'{name}.xml'
        (folder / f'{name}.xml').write_text(text, encoding='utf-8')
    return found


def receive(reliability: str, depth: int) -> None:
    """Print the number of images that arrive until none has come for 3 s."""
    rclpy.init()
    node, count, last_s = rclpy.create_node('receiver'), 0, time.monotonic() + 20.0

    def on_image(_: bytes) -> None:
        nonlocal count, last_s
        count, last_s = count + 1, time.monotonic()

    qos = QoSProfile(depth=depth, reliability=ReliabilityPolicy[reliability.upper()])
    node.create_subscription(Image, _TOPIC, on_image, qos, raw=True)
    while time.monotonic() < last_s + 3.0:
        rclpy.spin_once(node, timeout_sec=0.1)
    sys.stdout.write(str(count))


def main() -> None:
    """Print a row for each receiver."""
    parser = argparse.ArgumentParser()
    parser.add_argument('--seconds', type=float, default=8.0)
    parser.add_argument('--receive', nargs=2)
    args = parser.parse_args()
    if args.receive:
        receive(args.receive[0], int(args.receive[1]))
        return
    number = round(args.seconds * RATE_HZ)
    with own_domain() as domain, tempfile.TemporaryDirectory() as name:
        os.environ.update(ROS_DOMAIN_ID=str(domain), ROS_AUTOMATIC_DISCOVERY_RANGE='LOCALHOST')
        os.environ.pop('FASTRTPS_DEFAULT_PROFILES_FILE', None)
        command = cpp_driver(Path(name))
        limit = Path('/proc/sys/net/core/rmem_max').read_text().strip()
        sys.stdout.write(f'of {number} images, rmem_max {limit} B\n')
        for what, profile in receivers(Path(name)).items():
            extra = {'FASTRTPS_DEFAULT_PROFILES_FILE': str(profile)} if profile else {}
            counts = []
            for reliability, depth in (('best_effort', 5), ('reliable', 1), ('reliable', 10)):
                receiver = subprocess.Popen(
                    [sys.executable, __file__, '--receive', reliability, '10'],
                    env={**os.environ, **extra}, stdout=subprocess.PIPE, text=True,
                )  # fmt: skip
                driver = start_plain_camera(command, reliability, depth, number, _TOPIC)
                found, _ = receiver.communicate()
                driver.wait()
                counts.append(f'{reliability} {depth}: {found.strip()}')
            sys.stdout.write(f'{what:22} {", ".join(counts)}\n')
            sys.stdout.flush()


if __name__ == '__main__':
    main()
