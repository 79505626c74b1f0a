"""`summary.json`: what a run came to, in numbers."""

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
from hoid_common.errors import InputError
from hoid_common.values import FloatArray, Trajectory
from rgbd_slam.scene.grid import Grid
from rgbd_slam.scene.voxel_map import ColoredCloud

_LOG = logging.getLogger(__name__)
_LIBRARIES = ('numpy', 'opencv-python-headless', 'onnxruntime', 'gtsam', 'rosbags', 'evo')
_STAGES = ('detect', 'extract', 'filter', 'track', 'map', 'frame')


@dataclass(frozen=True)
class Spread:
    """Median and 95th percentile of times in ms."""

    median: float
    p95: float

    @classmethod
    def of(cls, values_ms: Sequence[float]) -> Spread | None:
        """Return the spread, or None of nothing."""
        if not len(values_ms):
            return None
        median, p95 = np.percentile(np.asarray(values_ms), (50, 95))
        return cls(round(float(median), 3), round(float(p95), 3))


@dataclass(frozen=True)
class FilterCounts:
    """What the filter did, summed over all frames."""

    features_in: int = 0
    features_removed: int = 0
    objects_dynamic: int = 0


@dataclass(frozen=True)
class MapCounts:
    """What the SLAM core holds at the end of a run."""

    keyframes: int = 0
    map_points: int = 0
    maps: int = 0
    loops: int = 0
    merges: int = 0
    relocalizations: int = 0


@dataclass(frozen=True, eq=False)
class RunResult:
    """Everything that a run leaves, offline or live; poses and points are in a z-up map frame."""

    input_name: str
    options: Mapping[str, Any]  # what was asked for, by option
    frames_total: int
    frames_processed: int
    final: Trajectory
    online: Trajectory
    keyframes: Trajectory
    map_points_m: FloatArray  # (N, 3)
    ground_truth: Trajectory | None
    map_counts: MapCounts
    filter_counts: FilterCounts
    stage_ms: Mapping[str, Sequence[float]]  # per stage, one entry a frame
    peak_rss_mb: float
    latency_ms: Sequence[float] = ()  # image stamp to odometry, live only
    rss_by_node_mb: Mapping[str, float] = field(default_factory=dict)  # with helpers; live only
    cpu_share_by_node: Mapping[str, float] = field(default_factory=dict)  # of a core; live only
    cloud: ColoredCloud | None = None  # dense map, in the map frame
    grid: Grid | None = None
    recording: Path | None = None  # where it lay


@dataclass(frozen=True)
class Summary:
    """The content of `summary.json`, in its order; scripts rely on the names."""

    input: str
    recording: str | None  # absolute path, for `hoid view`
    frames_total: int
    frames_processed: int
    frames_tracked: int  # in the main map, as in trajectory.txt
    frames_in_other_maps: int  # tracked after a loss in maps that no known place ever joined
    coverage: float
    ate_rmse_m: float | None
    ate_online_rmse_m: float | None
    rpe_trans_1s_rmse_m: float | None
    rpe_rot_1s_rmse_deg: float | None
    keyframes: int
    map_points: int
    maps: int
    loops: int
    merges: int
    relocalizations: int
    stage_ms: Mapping[str, Spread | None]  # every stage; None where nothing was timed
    latency_ms: Spread | None
    peak_rss_mb: float
    peak_rss_by_node_mb: Mapping[str, float]
    cpu_share_by_node: Mapping[str, float]
    filter: FilterCounts
    options: Mapping[str, Any]
    versions: Mapping[str, str]

    def to_json(self) -> str:
        """Return the file's text."""
        return json.dumps(_without_nan(asdict(self)), indent=2) + '\n'


def summarize(result: RunResult) -> Summary:
    """Evaluate a run and condense its times."""
    errors = _errors(result.final, result.ground_truth, say_why_not=True)
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
        **asdict(result.map_counts),
        stage_ms={
            name: Spread.of(result.stage_ms.get(name, ()))
            for name in dict.fromkeys((*_STAGES, *result.stage_ms))
        },
        latency_ms=Spread.of(result.latency_ms),
        peak_rss_mb=round(result.peak_rss_mb, 1),
        peak_rss_by_node_mb={n: round(mb, 1) for n, mb in result.rss_by_node_mb.items()},
        cpu_share_by_node={n: round(c, 3) for n, c in result.cpu_share_by_node.items()},
        filter=result.filter_counts,
        options=dict(result.options),
        versions=versions(),
    )


def versions() -> dict[str, str]:
    """Return the versions of this suite, Python and the libraries that results depend on."""
    found = {'python': platform.python_version(), 'machine': platform.machine()}
    for name in ('hoid_bringup', *_LIBRARIES):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def _errors(
    estimate: Trajectory, truth: Trajectory | None, *, say_why_not: bool = False
) -> dict[str, float | None]:
    """Return the errors by name; all None where there is no truth or too little of an estimate."""
    names = ('ate_rmse_m', 'rpe_trans_1s_rmse_m', 'rpe_rot_1s_rmse_deg')
    if truth is None:
        return dict.fromkeys(names)
    try:
        evaluation = asdict(evaluate(estimate, truth))
    except InputError as error:
        if say_why_not:
            _LOG.warning('no errors: %s', error)
        return dict.fromkeys(names)
    return {name: None if (v := evaluation[name]) is None else round(v, 6) for name in names}


def _without_nan(value: Any) -> Any:
    """Return nested values with NaN as None: JSON has no NaN."""
    if isinstance(value, dict):
        return {key: _without_nan(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(inner) for inner in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
