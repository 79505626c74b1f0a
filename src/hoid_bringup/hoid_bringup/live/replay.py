"""Live replay: plays a bag to the nodes in real time and records their results."""

from __future__ import annotations

import dataclasses
import shutil
import time
from pathlib import Path

from hoid_bags.bag.bag_reader import BagReader
from hoid_bags.bag.bag_sequence import BagSequence
from hoid_bags.live.ros_session import ros_session
from hoid_bags.progress import progress
from hoid_bringup.live import replay_plan
from hoid_bringup.live.live_recorder import LiveRecorder
from hoid_bringup.live.node_specs import node_specs
from hoid_bringup.live.replay_plan import ReplayConfig
from hoid_bringup.live.ros_domain import own_domain
from hoid_bringup.live.supervisor import ProcessExit, Supervisor, last_line
from hoid_bringup.run.outputs import write_outputs
from hoid_bringup.run.summary import RunResult, Summary
from hoid_common.errors import InputError
from hoid_common.io.files import scratch_folder
from hoid_common.process.shared_memory import check_shared_memory, clean_shared_memory

_NUM_OTHER_PROCESSES = 2  # the player and this process, besides the nodes
# Not tuned: nodes start in seconds, or in tens of seconds on a busy computer.
_READY_TIMEOUT_S = 90.0
_TICK_S = 0.25  # chosen: period of checks and of updates of the progress bar
_CPU_PERIOD_S = 2.0  # chosen: period of the measurement, which reads all processes of the machine
_QUIET_S = 2.0  # chosen: all images are processed if no result comes for this time


def replay(
    bag: BagSequence, config: ReplayConfig, out_dir: Path, *, recording: Path | None = None
) -> Summary:
    """Start the nodes, play a bag to them, and write the results.

    HoidError if the bag lacks topics that the nodes need, a node does not start or ends early, the
    output folder cannot be written, or shared memory is scarce.

    Args:
        out_dir: Folder for the results. Its subfolder `logs`, for logs of processes, is emptied.
        recording: Path in the summary; None: the path of the bag.
    """
    with scratch_folder(out_dir, 'replay') as folder, own_domain():
        live = _LiveRun(bag, config, folder.resolve(), out_dir / 'logs')
        try:
            result = live.run()
        finally:
            clean_shared_memory()
    return write_outputs(out_dir, dataclasses.replace(result, recording=recording or bag.path))


class _LiveRun:
    """One replay: starts the nodes and the player, and collects the results."""

    def __init__(
        self, bag: BagSequence, config: ReplayConfig, folder: Path, log_dir: Path
    ) -> None:
        self._bag, self._config, self._folder, self._log_dir = bag, config, folder, log_dir
        shutil.rmtree(log_dir, ignore_errors=True)
        self._nodes = node_specs(replay_plan.node_options(bag, config, folder))
        self._camera_info = _first_camera_info(bag)
        self._player = replay_plan.player_spec(bag, config)
        # By process: number of cores in use while the bag is played.
        self._cpu_share: dict[str, float] = {}

    def run(self) -> RunResult:
        check_shared_memory(len(self._nodes) + _NUM_OTHER_PROCESSES)
        with ros_session('hoid_replay') as node:
            recorder = LiveRecorder(
                node, replay_plan.camera_info_topic(self._bag).name.lstrip('/')
            )
            with Supervisor(self._nodes, log_dir=self._log_dir) as nodes:
                self._wait_until_ready(recorder, nodes)
                with Supervisor([self._player], log_dir=self._log_dir) as player:
                    self._record(recorder, nodes, player)
                return self._result(recorder, nodes)

    def _wait_until_ready(self, recorder: LiveRecorder, nodes: Supervisor) -> None:
        """Wait until the filter and the SLAM node can receive images; InputError after 90 s.

        The player itself waits for the detector's subscription, which exists before the model is
        loaded.
        """
        end_s = time.monotonic() + _READY_TIMEOUT_S
        while missing := recorder.missing(self._camera_info):
            recorder.spin(_TICK_S)
            self._raise_for(nodes.poll())
            if time.monotonic() > end_s:
                raise InputError(
                    f'nodes not ready after {_READY_TIMEOUT_S:g} s: {missing}; see {self._log_dir}'
                )

    def _record(self, recorder: LiveRecorder, nodes: Supervisor, player: Supervisor) -> None:
        """Record until the bag has been played and then no image is processed for 2 s.

        The processor time of the nodes and the player is measured while the bag is played.
        """
        metrics = recorder.metrics
        start_s, cpu_before_s = time.monotonic(), nodes.cpu_s()
        measured_s, cpu_after_s = start_s - _CPU_PERIOD_S, cpu_before_s
        with progress(None, len(self._bag), 'frames') as bar:
            while player.pids:
                recorder.spin(_TICK_S)
                self._raise_for(nodes.poll())
                if time.monotonic() >= measured_s + _CPU_PERIOD_S:
                    measured_s, cpu_after_s = time.monotonic(), nodes.cpu_s() | player.cpu_s()
                # In a damaged bag, the player ends with an error after the last readable message.
                ended = player.poll()
                self._raise_for([e for e in ended if e.status != 0 and self._bag.fault is None])
                bar.set_postfix_str(recorder.state_text(), refresh=False)
                bar.update(metrics.num_processed - bar.n)
            for name, cpu_s in cpu_after_s.items():
                used_s = cpu_s - cpu_before_s.get(name, 0.0)
                self._cpu_share[name] = used_s / (measured_s - start_s)
            num_processed = -1
            while num_processed != metrics.num_processed:
                num_processed = metrics.num_processed
                recorder.spin(_QUIET_S)
            bar.update(num_processed - bar.n)

    def _raise_for(self, exits: list[ProcessExit]) -> None:
        """Raise InputError with the last log line of the first of `exits`, if there are any."""
        for ended in exits:
            raise InputError(f'{ended}: {last_line(self._log_dir / f"{ended.name}.log")}')

    def _result(self, recorder: LiveRecorder, nodes: Supervisor) -> RunResult:
        status, metrics = recorder.last_status, recorder.metrics
        if status is None or not metrics.num_processed:
            raise InputError(f'rgbd_slam processed no image; see {self._log_dir}')
        final, online, keyframes = (
            recorder.trajectory(kind, self._folder) for kind in ('final', 'online', 'keyframes')
        )
        points_m = recorder.latest_map_points_m()
        self._raise_for(nodes.poll())
        return RunResult(
            input_name=self._bag.name,
            options={
                **self._config.run.summary_options(),
                'rate': self._config.rate,
                'lockstep': self._config.lockstep,
            },
            # The nodes match color and depth images one by one, which may give a few more pairs
            # than the best matching of all images.
            frames_total=max(len(self._bag), metrics.num_processed),
            frames_processed=metrics.num_processed,
            final=final,
            online=online,
            keyframes=keyframes,
            map_points_m=points_m,
            ground_truth=self._bag.ground_truth,
            status=dataclasses.replace(status, keyframes=len(keyframes), map_points=len(points_m)),
            filter_counts=metrics.filter_counts(),
            stage_ms=metrics.stage_ms(),
            peak_rss_mb=sum(nodes.peak_rss_mb().values()),
            rss_by_node_mb=nodes.peak_rss_mb(),
            cpu_share_by_node=self._cpu_share,
            latency_ms=metrics.latency_ms(),
        )


def _first_camera_info(bag: BagSequence) -> bytes:
    """Return the first camera_info message, serialized; InputError if there is none."""
    topic = replay_plan.camera_info_topic(bag).name
    with BagReader(bag.path) as reader:
        for message in reader.messages([topic]):
            return message.data
    raise InputError(
        f'{bag.path}: has no message on {topic}, which the nodes need; record it, or use '
        '"hoid run --calibration"'
    )
