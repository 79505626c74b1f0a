"""Processes killed while they run: the gap in odometry, and the time until recovery."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from hoid_msgs.msg import SlamStatus
from hoid_msgs.srv import SaveMap
from sensor_msgs.msg import PointCloud2

from hoid_benchmarks.faults.cases import Outcome
from hoid_benchmarks.faults.live.node_harness import (
    MAPPER,
    NodeHarness,
    Setup,
    member_pids,
    running_nodes,
)
from hoid_benchmarks.faults.live.sender import OWN_DETECTIONS
from hoid_bringup.live.node_specs import DETECTOR, FILTER, SCENE, SLAM
from hoid_common import topics
from hoid_common.errors import MapFileError
from hoid_common.ros import conversions, qos
from rgbd_slam.store import map_file

VICTIMS = (DETECTOR, MAPPER, SCENE, FILTER, SLAM)
_GAP_S = 0.2  # longest gap of odometry if the killed process is not needed for a pose
_SAME_MAP_S, _SCENE_S, _LIMIT_S = 5.0, 10.0, 30.0
_QUIET_S = 2.0
_LATER_S, _POLL_S = 0.01, 0.0005  # chosen: the map of this camera is written in some 10 ms
_SAVED, _PARTS = 'saved', '.*partial-*'


def death_cases(folder: Path, seeds: range) -> Iterator[Outcome]:
    """Yield the outcome of a SIGKILL to each process, for each seed."""
    with running_nodes(folder, Setup(restart=True)) as harness:
        deaths = _Deaths(harness)
        for seed in seeds:
            rng = np.random.default_rng(seed)
            for victim in VICTIMS:
                deaths.send_for(_QUIET_S + rng.random())
                yield deaths.outcome(victim, seed)
            deaths.send_for(_QUIET_S)
            yield deaths.outcome_of_save(seed, _LATER_S * rng.random())


class _Deaths:
    def __init__(self, harness: NodeHarness) -> None:
        self._harness, self._sender = harness, harness.sender
        harness.sender.node.create_subscription(
            PointCloud2, topics.CLOUD_MAP, self._on_cloud, qos.LATCHED
        )
        self._cloud_s = 0.0

    def send_for(self, duration_s: float) -> None:
        """Send images for some time without a fault."""
        self._until(lambda: False, duration_s)

    def outcome(self, victim: str, seed: int) -> Outcome:
        """Kill one process, and wait until its outputs are complete again."""
        sending_before_s = self._sender.sending_s
        killed_s = self._kill(victim)
        is_back, limit_s = self._recovery_check(victim, killed_s)
        self._until(is_back, _LIMIT_S)
        back_s = time.monotonic() - killed_s
        gap_s = self._gap_s(killed_s)
        complaint = ''
        if not is_back():
            complaint = f'not back in {_LIMIT_S:g} s; {self._sender.latest_diagnostics()}'
        elif back_s > limit_s:
            complaint = f'back after {back_s:.1f} s'
        elif victim not in (FILTER, SLAM) and gap_s > _GAP_S:
            complaint = f'no odometry for {gap_s:.2f} s'
        elif self._num_maps() > 1:
            complaint = f'{self._num_maps()} maps'
        if complaint:
            complaint += f', {self._sender.sending_s - sending_before_s:.1f} s spent in sends'
        note = f'longest gap of odometry {gap_s:.2f} s'
        return Outcome(
            f'{victim} killed', seed, complaint, wall_s=back_s, note=note, note_rank=gap_s
        )

    def outcome_of_save(self, seed: int, after_s: float) -> Outcome:
        """Kill SLAM while it saves its map, some time (s) after it began, and check the folder.

        The saved map must be complete or missing, and no part of one may be left for ever.
        """
        client = self._harness.services.client(SaveMap, SLAM, topics.SAVE_MAP)
        client.call_async(SaveMap.Request(name=_SAVED))
        folder, end_s = self._harness.maps, time.monotonic() + _LIMIT_S
        while not any(folder.glob(_PARTS)) and time.monotonic() < end_s:
            time.sleep(_POLL_S)
        time.sleep(after_s)
        killed_s = self._kill(SLAM)
        is_back, _ = self._recovery_check(SLAM, killed_s)
        self._until(is_back, _LIMIT_S)
        back_s = time.monotonic() - killed_s
        self._until(lambda: not any(folder.glob(_PARTS)), _SAME_MAP_S)
        complaint = '' if is_back() else f'not back in {_LIMIT_S:g} s'
        if parts := sorted(path.name for path in folder.glob(_PARTS)):
            complaint = f'left behind: {", ".join(parts)}'
        try:
            for path in folder.glob(f'{_SAVED}*'):
                map_file.load(path)
        except MapFileError as error:
            complaint = str(error)
        return Outcome(f'{SLAM} killed while it saves', seed, complaint, wall_s=back_s)

    def _kill(self, victim: str) -> float:
        self._harness.nodes.poll()
        pid = member_pids(self._harness.nodes.pids)[victim]
        os.kill(pid, signal.SIGKILL)
        return time.monotonic()

    def _recovery_check(self, victim: str, killed_s: float) -> tuple[Callable[[], bool], float]:
        """Return a function that detects the recovery, and the time limit (s) of the recovery."""
        since_ns, newest_ns = self._sender.now_ns(), self._sender.newest_ns
        if victim == DETECTOR:
            return (lambda: newest_ns.get(OWN_DETECTIONS, 0) > since_ns), _SAME_MAP_S
        if victim == SCENE:
            return (lambda: self._cloud_s > killed_s), _SCENE_S

        def is_tracked() -> bool:
            status = self._sender.status
            return (
                status is not None
                and conversions.stamp_from_msg(status.header.stamp) > since_ns
                and status.state == SlamStatus.TRACKING
                and newest_ns.get(topics.ODOM, 0) > since_ns
            )

        return is_tracked, _SAME_MAP_S

    def _until(self, is_done: Callable[[], bool], limit_s: float) -> None:
        end_s = time.monotonic() + limit_s
        while time.monotonic() < end_s and not is_done():
            self._sender.send()
            self._harness.nodes.poll()

    def _gap_s(self, since_s: float) -> float:
        self.send_for(1.0)
        times_s = [heard.received_s for heard in self._sender.heard]
        before = [t for t in times_s if t <= since_s][-1:]
        after = [t for t in times_s if t > since_s]
        return float(np.max(np.diff([*before, *after, time.monotonic()]), initial=0.0))

    def _num_maps(self) -> int:
        return self._sender.status.maps if self._sender.status else 0

    def _on_cloud(self, msg: PointCloud2) -> None:
        if msg.width * msg.height:
            self._cloud_s = time.monotonic()
