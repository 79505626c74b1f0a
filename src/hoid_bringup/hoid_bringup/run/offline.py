"""The whole suite in one process: every frame, in order, and the same result every time."""

from __future__ import annotations

import logging
import resource
import time
from collections import defaultdict
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from hoid_bags.progress import progress
from hoid_bags.sequence import Sequence
from hoid_bringup.run import offline_maps
from hoid_bringup.run.detection_source import DetectionSource, detection_source
from hoid_bringup.run.offline_maps import MapFiles
from hoid_bringup.run.outputs import write_outputs
from hoid_bringup.run.run_config import RunConfig
from hoid_bringup.run.summary import FilterCounts, MapCounts, RunResult, Summary
from hoid_common.io.files import check_writable
from hoid_common.slam_status import SlamMode
from hoid_common.values import Detections, DynamicObject, FilterResult, RgbdFrame
from hoid_filter.feature_filter import FeatureFilter
from rgbd_slam.robot_frames import RobotFrames
from rgbd_slam.scene.fusion_scheduler import FusionScheduler
from rgbd_slam.scene.scene_mapper import SceneMapper
from rgbd_slam.session import Processed, SlamSession
from rgbd_slam.statistics import SlamStats

_LOG = logging.getLogger(__name__)
_MS = 1e3
_KIB_PER_MB = 1024


class OfflinePipeline:
    """Detector, filter and SLAM, one call a frame.

    Args:
        find_features: In place of the filter that the configuration asks for.
        dense: Whether to make the dense map and the grid too.
    """

    def __init__(
        self,
        sequence: Sequence,
        config: RunConfig,
        detect: DetectionSource | None = None,
        *,
        find_features: Callable[[RgbdFrame, Detections | None], FilterResult] | None = None,
        dense: bool = False,
    ) -> None:
        self._detect = detect or detection_source(sequence, config)
        self._find_features = (
            find_features or FeatureFilter(config.filter, sequence.camera).process
        )
        self._session = SlamSession(
            sequence.camera,
            config.slam,
            RobotFrames(),
            fusion_scheduler=FusionScheduler(config.slam.dense.rate_hz if dense else None, None),
        )
        self._scene = SceneMapper(sequence.camera, config.slam.dense, config.slam.objects)
        self._features_in = self._features_removed = self._objects_dynamic = 0
        self.stage_ms: defaultdict[str, list[float]] = defaultdict(list)
        self.num_processed = 0
        self.num_kept: list[int] = []  # features that the filter left, by frame
        self.objects: tuple[DynamicObject, ...] = ()  # of the last frame, with the verdicts

    def load_map(self, path: Path, *, localize: bool) -> None:
        """Start with a saved map, and leave it as it is if so wanted.

        Raises:
            MapFileError: It is unusable.
        """
        offline_maps.load(path, self._session, self._scene)
        self._session.set_mode(SlamMode.LOCALIZATION if localize else SlamMode.MAPPING)

    def save_map(self, path: Path) -> None:
        """Save the map as it is now; raises HoidError if that is impossible."""
        offline_maps.save(path, self._session, self._scene)

    def process(self, frame: RgbdFrame) -> Processed:
        """Run one frame through all stages."""
        start_s = time.perf_counter()  # the network has threads of its own: wall clock
        detections = self._detect(frame)
        detect_ms = _MS * (time.perf_counter() - start_s)
        filtered = self._find_features(frame, detections)
        start_s = time.thread_time()
        done = self._session.process(filtered.features)
        track_ms = _MS * (time.thread_time() - start_s)
        if done.fusion is not None:
            self._scene.fuse(done.fusion, frame.depth_m, frame.image_bgr, filtered.objects)
        self._count(filtered)
        self._time(filtered, done.status.stage_ms, track_ms)
        if detections is not None:
            self.stage_ms['detect'].append(detect_ms)
        return done

    def _count(self, filtered: FilterResult) -> None:
        self.num_processed += 1
        self.num_kept.append(len(filtered.features))
        self.objects = filtered.objects
        self._features_in += filtered.num_features_in
        self._features_removed += filtered.num_removed
        self._objects_dynamic += sum(item.is_dynamic for item in filtered.objects)

    def _time(
        self, filtered: FilterResult, slam_stage_ms: Mapping[str, float], slam_ms: float
    ) -> None:
        stages = {**filtered.stage_ms, **slam_stage_ms}
        stages.setdefault('track', slam_ms)
        stages['frame'] = stages['extract'] + stages['filter'] + stages['track']
        for name, spent_ms in stages.items():
            self.stage_ms[name].append(spent_ms)

    def finish(
        self, sequence: Sequence, options: Mapping[str, Any], recording: Path | None = None
    ) -> RunResult:
        """Let the map settle and return all results, in the z-up map frame."""
        session, scene = self._session, self._scene
        session.slam.map.finish()
        session.close()
        scene.settle(session.robot_map.keyframes())
        cloud = scene.cloud() if scene.num_voxels else None
        grid = scene.grid(cloud) if cloud is not None else None
        if cloud is not None and grid is None:
            _LOG.warning('no grid is written, as no floor was seen')
        return RunResult(
            input_name=sequence.name,
            recording=recording,
            options=options,
            frames_total=len(sequence),
            frames_processed=self.num_processed,
            final=session.robot_map.trajectory('final'),
            online=session.robot_map.trajectory('online'),
            keyframes=session.robot_map.trajectory('keyframes'),
            map_points_m=session.robot_map.points_m(),
            cloud=cloud,
            grid=grid,
            ground_truth=sequence.ground_truth,
            map_counts=_map_counts(session.slam.stats),
            filter_counts=FilterCounts(
                self._features_in, self._features_removed, self._objects_dynamic
            ),
            stage_ms=self.stage_ms,
            peak_rss_mb=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / _KIB_PER_MB,
        )


def _map_counts(stats: SlamStats) -> MapCounts:
    return MapCounts(
        keyframes=stats.num_keyframes,
        map_points=stats.num_map_points,
        maps=stats.num_maps,
        loops=stats.num_loops,
        merges=stats.num_merges,
        relocalizations=stats.num_relocalizations,
    )


def run_offline(
    sequence: Sequence,
    config: RunConfig,
    out_dir: Path,
    *,
    detect: DetectionSource | None = None,
    dense: bool = False,
    options: Mapping[str, Any] | None = None,
    recording: Path | None = None,
    maps: MapFiles = MapFiles(),  # noqa: B008 - immutable
    show_progress: bool = True,
) -> Summary:
    """Run every frame of a recording and write the results.

    Args:
        sequence: The recording.
        config: Parameters of all stages.
        out_dir: Where the files go; made when missing.
        detect: Detections in place of those that the configuration asks for.
        dense: Whether to make the dense map and the grid too.
        options: What to note in the summary as asked for; the changed parameters by default.
        recording: Where the recording lies, to note as well.
        maps: Map files to start with and to leave.
        show_progress: Whether to draw a progress bar on stderr.

    Raises:
        HoidError: The recording, the model or the output folder is unusable.
    """
    check_writable(out_dir)
    maps.check()
    pipeline = OfflinePipeline(sequence, config, detect, dense=dense)
    if maps.load is not None:
        pipeline.load_map(maps.load, localize=maps.localize)
    bar = progress(sequence, len(sequence), 'frames', show=show_progress)
    for frame in bar:
        done = pipeline.process(frame)
        bar.set_postfix_str(done.status.state.name.lower(), refresh=False)
    noted = options if options is not None else config.noted()
    summary = write_outputs(out_dir, pipeline.finish(sequence, noted, recording))
    if maps.save is not None:
        pipeline.save_map(maps.save)
    return summary
