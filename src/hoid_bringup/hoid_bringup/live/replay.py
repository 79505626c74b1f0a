"""Live replay: the nodes as processes, a bag played in real time, the results recorded."""

from __future__ import annotations

import dataclasses
import shutil
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hoid_bags.bag.bag_reader import BagReader
from hoid_bags.bag.bag_sequence import BagSequence
from hoid_bags.live.ros_session import ros_session
from hoid_bags.progress import progress
from hoid_bringup.live.live_recorder import LiveRecorder
from hoid_bringup.live.node_specs import node_specs
from hoid_bringup.live.replay_plan import BagNames, ReplayConfig, node_options, player_spec
from hoid_bringup.live.ros_domain import own_domain
from hoid_bringup.live.supervisor import ProcessExit, Supervisor
from hoid_bringup.run.outputs import write_outputs
from hoid_bringup.run.summary import MapCounts, RunResult, Summary
from hoid_common.errors import InputError
from hoid_common.io.files import scratch_folder
from hoid_common.process.shared_memory import check_shared_memory, clean_shared_memory

_NUM_OTHERS = 3  # the scene mapper, the player and this process
_READY_LIMIT_S = 90.0
_TICK_S = 0.25
_LOOK_S = 2.0  # a look at processor times goes through all processes of the machine
_QUIET_S = 2.0  # so long without a result, the nodes have nothing left to do


def replay(
    bag: BagSequence,
    config: ReplayConfig,
    out_dir: Path,
    *,
    options: Mapping[str, Any] | None = None,
    recording: Path | None = None,
    show_progress: bool = True,
) -> Summary:
    """Play a bag through the live nodes and write the results.

    Args:
        bag: What is played.
        config: Parameters of all stages, and the rate.
        out_dir: Where the files go; the processes' own output lies in its folder `logs`.
        options: What to note in the summary as asked for; the changed parameters by default.
        recording: What to note as the recording, when the bag is but made from it.
        show_progress: Whether to draw a progress bar on stderr.

    Raises:
        HoidError: The nodes cannot hear this bag, do not start or end early, the output folder is
            unusable, or shared memory is scarce.
    """
    noted = {**(options or config.run.noted()), 'rate': config.rate, 'lockstep': config.lockstep}
    with scratch_folder(out_dir, 'replay') as folder, own_domain():
        live = _LiveRun(bag, config, folder.resolve(), out_dir / 'logs')
        try:
            result = live.run(noted, show_progress=show_progress)
        finally:
            clean_shared_memory()
    return write_outputs(out_dir, dataclasses.replace(result, recording=recording or bag.path))


class _LiveRun:
    """One replay, from starting the nodes to their last answer."""

    def __init__(
        self, bag: BagSequence, config: ReplayConfig, folder: Path, log_dir: Path
    ) -> None:
        self._bag, self._folder, self._log_dir = bag, folder, log_dir
        shutil.rmtree(log_dir, ignore_errors=True)
        self._nodes = node_specs(node_options(bag, config, folder), folder)
        self._player = player_spec(bag, config)
        self._cpu_share: dict[str, float] = {}  # of a core, by process, while the bag is played

    def run(self, noted: Mapping[str, Any], *, show_progress: bool) -> RunResult:
        """Start everything, listen until the bag is over, and ask for the results."""
        check_shared_memory(len(self._nodes) + _NUM_OTHERS)
        with ros_session('hoid_replay') as node:
            recorder = LiveRecorder(node, BagNames.of(self._bag).camera_info)
            with Supervisor(self._nodes, log_dir=self._log_dir) as nodes:
                self._wait_until_ready(recorder, nodes)
                with Supervisor([self._player], log_dir=self._log_dir) as player:
                    self._listen(recorder, nodes, player, show_progress=show_progress)
                return self._result(recorder, nodes, noted)

    def _wait_until_ready(self, recorder: LiveRecorder, nodes: Supervisor) -> None:
        end_s = time.monotonic() + _READY_LIMIT_S
        topic = f'/{BagNames.of(self._bag).camera_info}'
        with BagReader(self._bag.path) as reader:
            camera_info = next(reader.messages([topic])).data
        while awaited := recorder.awaited(camera_info):
            recorder.spin(_TICK_S)
            self._stop_on(nodes.poll())
            if time.monotonic() > end_s:
                raise InputError(
                    f'not ready after {_READY_LIMIT_S:g} s: {awaited}; see {self._log_dir}'
                )

    def _listen(
        self,
        recorder: LiveRecorder,
        nodes: Supervisor,
        player: Supervisor,
        *,
        show_progress: bool,
    ) -> None:
        """Record until the bag is over and the nodes have nothing left to do."""
        metrics = recorder.metrics
        start_s, idle_s = time.monotonic(), nodes.cpu_s()
        looked_s, spent_s = start_s - _LOOK_S, idle_s
        with progress(None, len(self._bag), 'frames', show=show_progress) as bar:
            while player.pids:
                recorder.spin(_TICK_S)
                self._stop_on(nodes.poll())
                if time.monotonic() >= looked_s + _LOOK_S:
                    looked_s, spent_s = time.monotonic(), {**nodes.cpu_s(), **player.cpu_s()}
                # The player of a damaged bag ends with an error after all that can be read.
                ended = player.poll()
                self._stop_on([e for e in ended if e.status != 0 and self._bag.fault is None])
                bar.set_postfix_str(recorder.state_text(), refresh=False)
                bar.update(metrics.num_processed - bar.n)
            for name, cpu_s in spent_s.items():
                spent_here_s = cpu_s - idle_s.get(name, 0.0)
                self._cpu_share[name] = spent_here_s / (looked_s - start_s)
            seen = -1
            while seen != metrics.num_processed:
                seen = metrics.num_processed
                recorder.spin(_QUIET_S)
            bar.update(seen - bar.n)

    def _stop_on(self, exits: list[ProcessExit]) -> None:
        for ended in exits:
            raise InputError(f'{ended}: {_last_words(self._log_dir / f"{ended.name}.log")}')

    def _result(
        self, recorder: LiveRecorder, nodes: Supervisor, noted: Mapping[str, Any]
    ) -> RunResult:
        status, metrics = recorder.last_status, recorder.metrics
        if status is None or not metrics.num_processed:
            raise InputError(f'rgbd_slam processed no image; see {self._log_dir}')
        final, online, keyframes = (
            recorder.trajectory(kind, self._folder) for kind in ('final', 'online', 'keyframes')
        )
        points_m = recorder.latest_map_points_m()
        self._stop_on(nodes.poll())
        return RunResult(
            input_name=self._bag.name,
            options=noted,
            # Live matching decides image by image and may pair a few more than the best matching.
            frames_total=max(len(self._bag), metrics.num_processed),
            frames_processed=metrics.num_processed,
            final=final,
            online=online,
            keyframes=keyframes,
            map_points_m=points_m,
            ground_truth=self._bag.ground_truth,
            map_counts=MapCounts(
                len(keyframes),
                len(points_m),
                status.maps,
                status.loops,
                status.merges,
                status.relocalizations,
            ),
            filter_counts=metrics.filter_counts(),
            stage_ms=metrics.stage_ms(),
            peak_rss_mb=sum(nodes.peak_rss_mb().values()),
            rss_by_node_mb=nodes.peak_rss_mb(),
            cpu_share_by_node=self._cpu_share,
            latency_ms=metrics.latency_ms(),
        )


def _last_words(log: Path) -> str:
    """Return the last line of a process's output: its error, as all of them say it in one."""
    try:
        lines = log.read_text(encoding='utf-8', errors='replace').split('\n')
    except OSError:
        lines = []
    said = [line.strip() for line in lines if line.strip()]
    return said[-1].removeprefix('error: ') if said else 'it said nothing'
