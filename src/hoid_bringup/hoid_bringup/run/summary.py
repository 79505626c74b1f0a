"""Results of a run, and their summary in `summary.json`."""

from __future__ import annotations

import json
import logging
import math
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from hoid_bringup.evaluate.evaluation import evaluate
from hoid_bringup.run.provenance import Provenance
from hoid_common.errors import InputError
from hoid_common.slam_status import SlamStatus
from hoid_common.values import FloatArray, Trajectory
from hoid_scene.dense.submap import ColoredCloud
from hoid_scene.grid.grid import Grid
from rgbd_slam.inertial.report import ImuReport

_LOG = logging.getLogger(__name__)
_LIBRARIES = ('numpy', 'opencv-python-headless', 'onnxruntime', 'gtsam', 'rosbags', 'evo')
# Stages that every summary lists, even if they were not timed.
_STAGES = ('detect', 'extract', 'filter', 'track', 'map', 'frame')
_MAP_COUNTS = ('keyframes', 'map_points', 'maps', 'loops', 'merges', 'relocalizations')


@dataclass(frozen=True)
class Spread:
    """Median and 95th percentile of times in ms."""

    median: float
    p95: float

    @classmethod
    def of(cls, values_ms: Sequence[float]) -> Spread | None:
        if not len(values_ms):
            return None
        median, p95 = np.percentile(np.asarray(values_ms), (50, 95))
        return cls(round(float(median), 3), round(float(p95), 3))


@dataclass(frozen=True)
class FilterCounts:
    """Counts of the filter, summed over all frames."""

    features_in: int = 0  # detected features
    features_removed: int = 0  # features that were removed as dynamic
    objects_dynamic: int = 0  # objects that were classified as dynamic


@dataclass(frozen=True, eq=False)
class RunResult:
    """Results of an offline or live run, with poses and points in the z-up map frame."""

    input_name: str
    options: Mapping[str, Any]  # options for the summary, by name
    frames_total: int  # number of frames in the recording
    frames_processed: int
    final: Trajectory  # poses of the frames in the final main map
    online: Trajectory  # poses as they were estimated when the frames were tracked
    keyframes: Trajectory  # poses of the keyframes in the final main map
    map_points_m: FloatArray  # (N, 3)
    ground_truth: Trajectory | None  # in the frame of the ground truth; None: there is none
    status: SlamStatus  # status at the end, with the counts of the main map
    filter_counts: FilterCounts
    # By stage: durations in ms, one per frame.
    stage_ms: Mapping[str, Sequence[float]]
    peak_rss_mb: float  # peak resident memory in MiB; live: sum of the peaks of the nodes
    # Times in ms from the publication of an image to its odometry; live runs only.
    latency_ms: Sequence[float] = ()
    # By node: peak resident memory in MiB, with child processes; live runs only.
    rss_by_node_mb: Mapping[str, float] = field(default_factory=dict)
    # By node: number of cores in use on average; live runs only.
    cpu_share_by_node: Mapping[str, float] = field(default_factory=dict)
    # Points of the dense map, in the map frame; None: no dense map was made.
    cloud: ColoredCloud | None = None
    grid: Grid | None = None  # None: no grid was made, or no floor was found
    recording: Path | None = None  # path of the recording
    imu: ImuReport | None = None  # None: there was no IMU, or the run was live


@dataclass(frozen=True)
class Summary:
    """Content of `summary.json` in the order of the file. The names are a public interface."""

    input: str
    recording: str | None  # absolute path, for `hoid view`
    frames_total: int
    frames_processed: int
    frames_tracked: int  # with a pose in the main map, as in trajectory.txt
    frames_in_other_maps: int  # with a pose in a map that was not merged into the main map
    coverage: float  # share of all frames that have a pose in the main map
    ate_rmse_m: float | None
    ate_online_rmse_m: float | None
    rpe_trans_1s_rmse_m: float | None
    rpe_rot_1s_rmse_deg: float | None
    keyframes: int  # number in the main map
    map_points: int  # number in the main map
    maps: int  # number of maps, the main map included; more than 1: they are not merged
    loops: int
    merges: int  # number of merges of two maps
    relocalizations: int
    stage_ms: Mapping[str, Spread | None]  # None for a stage that was not timed
    latency_ms: Spread | None
    peak_rss_mb: float
    peak_rss_by_node_mb: Mapping[str, float]
    cpu_share_by_node: Mapping[str, float]
    filter: FilterCounts
    imu: ImuReport | None  # None: there was no IMU, or the run was live
    options: Mapping[str, Any]
    made_by: Provenance
    versions: Mapping[str, str]

    def to_json(self) -> str:
        """Return the text of `summary.json`, in which NaN and infinity are null."""
        return json.dumps(_without_nan(asdict(self)), indent=2) + '\n'


def summarize(result: RunResult) -> Summary:
    errors = _errors(result.final, result.ground_truth, warn=True)
    online = _errors(result.online, result.ground_truth)
    total = result.frames_total
    return Summary(
        input=result.input_name,
        recording=str(result.recording.resolve()) if result.recording else None,
        frames_total=total,
        frames_processed=result.frames_processed,
        frames_tracked=len(result.final),
        frames_in_other_maps=len(result.online) - len(result.final),
        coverage=round(len(result.final) / total, 6) if total else 0.0,
        ate_rmse_m=errors['ate_rmse_m'],
        ate_online_rmse_m=online['ate_rmse_m'],
        rpe_trans_1s_rmse_m=errors['rpe_trans_1s_rmse_m'],
        rpe_rot_1s_rmse_deg=errors['rpe_rot_1s_rmse_deg'],
        **{name: getattr(result.status, name) for name in _MAP_COUNTS},
        stage_ms={
            name: Spread.of(result.stage_ms.get(name, ()))
            for name in dict.fromkeys((*_STAGES, *result.stage_ms))
        },
        latency_ms=Spread.of(result.latency_ms),
        peak_rss_mb=round(result.peak_rss_mb, 1),
        peak_rss_by_node_mb={n: round(mb, 1) for n, mb in result.rss_by_node_mb.items()},
        cpu_share_by_node={n: round(c, 3) for n, c in result.cpu_share_by_node.items()},
        filter=result.filter_counts,
        imu=result.imu,
        options=dict(result.options),
        made_by=Provenance.of_this_process(result.options),
        versions=versions(),
    )


def versions() -> dict[str, str]:
    """Return the versions of Python, this suite and the libraries that results depend on.

    `machine` is the processor architecture. Libraries that are not installed are left out.
    """
    found = {'python': platform.python_version(), 'machine': platform.machine()}
    for name in ('hoid_bringup', *_LIBRARIES):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def _errors(
    estimate: Trajectory, truth: Trajectory | None, *, warn: bool = False
) -> dict[str, float | None]:
    """Return errors by name; None without ground truth, or if an error is undefined."""
    names = ('ate_rmse_m', 'rpe_trans_1s_rmse_m', 'rpe_rot_1s_rmse_deg')
    if truth is None:
        return dict.fromkeys(names)
    try:
        evaluation = asdict(evaluate(estimate, truth))
    except InputError as error:
        if warn:
            _LOG.warning('errors cannot be computed: %s', error)
        return dict.fromkeys(names)
    return {name: None if (v := evaluation[name]) is None else round(v, 6) for name in names}


def _without_nan(value: Any) -> Any:
    """Return nested values with None for NaN and infinity, which JSON lacks."""
    if isinstance(value, dict):
        return {key: _without_nan(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(inner) for inner in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
