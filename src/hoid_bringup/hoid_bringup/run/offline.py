"""Offline pipeline: all stages in one process on every frame, with repeatable results."""

from __future__ import annotations

import logging
import resource
import time
from collections import defaultdict
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from hoid_bags.imu_recording import ImuRecording
from hoid_bags.progress import progress
from hoid_bags.sequence import Sequence
from hoid_bringup.run.detection_source import DetectionSource, detection_source
from hoid_bringup.run.imu_feed import ImuFeed
from hoid_bringup.run.outputs import write_outputs
from hoid_bringup.run.run_config import RunConfig
from hoid_bringup.run.summary import FilterCounts, RunResult, Summary
from hoid_common.errors import ConfigError
from hoid_common.io.files import check_writable
from hoid_common.slam_status import SlamMode
from hoid_common.values import Detections, DynamicObject, FilterResult, FloatArray, RgbdFrame
from hoid_filter.feature_filter import FeatureFilter
from hoid_scene.grid.floor import NO_FLOOR
from hoid_scene.scene_mapper import SceneMapper
from hoid_scene.scene_scheduler import SceneScheduler
from hoid_scene.store import scene_file
from rgbd_slam.inertial.report import ImuReport, report_of
from rgbd_slam.robot_frames import RobotFrames
from rgbd_slam.session import Processed, SlamSession
from rgbd_slam.store import map_file

_LOG = logging.getLogger(__name__)
_MS_PER_S = 1e3
_KIB_PER_MB = 1024


class MapFiles(NamedTuple):
    """The map files that a run loads and saves."""

    load: Path | None = None  # map to start with; None: an empty map
    localize: bool = False  # whether the loaded map stays unchanged
    save: Path | None = None  # file in which to save the map at the end; None: it is not saved

    def check(self) -> None:
        """Raise HoidError if the options contradict each other, or a map cannot be saved."""
        if self.localize and self.load is None:
            raise ConfigError('--localize needs --map FILE')
        if self.save is not None:
            if self.save.is_dir():  # `--save-map ''` is the current folder
                raise ConfigError(f'--save-map {self.save}: is a folder; name a file')
            check_writable(self.save.parent)


class OfflinePipeline:
    """Detector, filter and SLAM in one process, with one call of `process` for each frame.

    HoidError if the detector model, the configured ground-truth boxes or the IMU's calibration
    file are missing or unusable.

    Args:
        detect: Function that returns the detections of a frame; None: the configured detector.
        find_features: Function that returns the features of a frame; None: the configured filter.
        dense: Whether to make the dense map and the grid as well.
        T_base_camera: (4, 4) pose of the camera on a level base; None: the camera is level.
    """

    def __init__(
        self,
        sequence: Sequence,
        config: RunConfig,
        detect: DetectionSource | None = None,
        *,
        find_features: Callable[[RgbdFrame, Detections | None], FilterResult] | None = None,
        dense: bool = False,
        T_base_camera: FloatArray | None = None,
        imu: ImuRecording | None = None,
    ) -> None:
        self._imu = None if imu is None else ImuFeed(imu, config.slam.imu)
        self._find_features = (
            find_features or FeatureFilter(config.filter, sequence.camera).process
        )
        self._session = SlamSession(
            sequence.camera,
            config.slam,
            RobotFrames(T_base_camera),
            imu=None if self._imu is None else self._imu.imu,
        )
        self._scene = SceneMapper(
            sequence.camera,
            config.scene.dense,
            config.scene.objects,
            config.scene.object_map,
        )
        self._scheduler = _scheduler(config, dense=dense)
        self._detect = detect or detection_source(sequence, config, self._scene.expected_objects)
        self._features_in = self._features_removed = self._objects_dynamic = 0
        # By stage: duration in ms for each frame.
        self.stage_ms: defaultdict[str, list[float]] = defaultdict(list)
        self.num_processed = 0
        self.num_kept: list[int] = []  # number of features that the filter kept in each frame
        self.objects: tuple[DynamicObject, ...] = ()  # objects in the last frame

    def load_map(self, path: Path, *, localize: bool) -> None:
        """Load a saved map, to extend it or only to localize in it.

        MapFileError if the file is not a valid map, if its octaves or voxels differ from the
        configuration, or if its camera differs too much to extend the map.
        """
        content = map_file.load(path)
        uids = self._session.map.load(content, extend=not localize)
        self._scene.correct(self._session.map.keyframes())
        scene = scene_file.read_file(path).renamed(content.keyframes().uids, uids)
        scene_file.load(self._scene, scene)
        self._session.set_mode(SlamMode.LOCALIZATION if localize else SlamMode.MAPPING)

    def save_map(self, path: Path) -> None:
        """Save the map in a file, with the dense map and the object map if they exist."""
        content = self._session.map.export()
        keyframes = self._session.map.keyframes()
        self._scene.correct(keyframes)
        path.parent.mkdir(parents=True, exist_ok=True)
        map_file.save(path, content)
        scene_file.add_to_file(path, scene_file.exported(self._scene, keyframes.uids))

    def process(self, frame: RgbdFrame) -> Processed:
        start_s = time.perf_counter()
        detections = self._detect(frame)
        detect_ms = _MS_PER_S * (time.perf_counter() - start_s)
        filtered = self._find_features(frame, detections)
        start_s = time.perf_counter()
        if self._imu is not None:
            self._imu.advance(frame.stamp_ns)
        done = self._session.process(filtered.features)
        track_ms = _MS_PER_S * (time.perf_counter() - start_s)
        self._scene.is_map_level = self._session.map.frames.is_level
        picked = self._scheduler.pick(done.image, self._session.map.keyframes)
        request = self._scheduler.narrow(picked, filtered.objects)
        if request is not None:
            self._scene.use(request, frame.depth_m, frame.image_bgr, filtered.objects)
        self._count(filtered)
        self._time(filtered, done.status.stage_ms, track_ms)
        if detections is not None:
            self.stage_ms['detect'].append(detect_ms)
        self._log_imu()
        return done

    def _log_imu(self) -> None:
        if self._imu is not None:
            for news in self._imu.imu.trust.take_news():
                _LOG.log(logging.WARNING if news.is_problem else logging.INFO, '%s', news.text)

    def imu_report(self) -> ImuReport | None:
        return None if self._imu is None else report_of(self._imu.imu)

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
        """Finish mapping, end the session, and return all results in the map frame, with z up.

        The ground truth stays in its own frame.
        """
        session, scene = self._session, self._scene
        session.map.finish()
        session.close()
        if session.focal_length.problem:
            _LOG.warning('%s', session.focal_length.problem)
        scene.correct(session.map.keyframes(), force=True)
        cloud = scene.cloud() if len(scene.dense) else None
        grid = scene.grid(cloud) if cloud is not None else None
        if cloud is not None and grid is None:
            _LOG.warning('%s', NO_FLOOR)
        return RunResult(
            input_name=sequence.name,
            recording=recording,
            options=options,
            frames_total=len(sequence),
            frames_processed=self.num_processed,
            final=session.map.trajectory('final'),
            online=session.map.trajectory('online'),
            keyframes=session.map.trajectory('keyframes'),
            map_points_m=session.map.points_m(),
            cloud=cloud,
            grid=grid,
            ground_truth=sequence.ground_truth,
            status=session.status(),
            filter_counts=FilterCounts(
                self._features_in, self._features_removed, self._objects_dynamic
            ),
            stage_ms=self.stage_ms,
            imu=self.imu_report(),
            peak_rss_mb=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / _KIB_PER_MB,
        )


def _scheduler(config: RunConfig, *, dense: bool) -> SceneScheduler:
    """Return the scheduler of the scene; it plans objects only if the object map is enabled."""
    scene = config.scene
    rates = (scene.objects.rate_hz, scene.object_map.rate_hz)
    of_objects = rates if scene.object_map.enabled else (None, None)
    return SceneScheduler(scene.dense.rate_hz if dense else None, *of_objects)


def run_offline(
    sequence: Sequence,
    config: RunConfig,
    out_dir: Path,
    *,
    detect: DetectionSource | None = None,
    dense: bool = False,
    recording: Path | None = None,
    maps: MapFiles = MapFiles(),  # noqa: B008 - immutable
    T_base_camera: FloatArray | None = None,
    imu: ImuRecording | None = None,
    show_progress: bool = True,
) -> Summary:
    """Process every frame of a recording and write the results.

    HoidError if the recording, the detector model or a map file is invalid, or if the results
    cannot be written.

    Args:
        recording: Path of the recording in the summary.
        T_base_camera: (4, 4) pose of the camera on a level base; None: the camera is level.
    """
    check_writable(out_dir)
    maps.check()
    pipeline = OfflinePipeline(
        sequence, config, detect, dense=dense, T_base_camera=T_base_camera, imu=imu
    )
    if maps.load is not None:
        pipeline.load_map(maps.load, localize=maps.localize)
    bar = progress(sequence, len(sequence), 'frames', show=show_progress)
    for frame in bar:
        done = pipeline.process(frame)
        bar.set_postfix_str(done.status.state.name.lower(), refresh=False)
    result = pipeline.finish(sequence, config.summary_options(), recording)
    summary = write_outputs(out_dir, result)
    if maps.save is not None:
        pipeline.save_map(maps.save)
    return summary
