"""How far an estimated trajectory is from the truth: ATE and RPE, with evo underneath.

Conventions of the TUM RGB-D benchmark (Sturm et al., IROS 2012): poses are associated within
0.02 s, the estimate is aligned by a rigid transform (no scale), and the relative error is taken
over one second.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from evo.core.geometry import GeometryException
from evo.core.metrics import APE, PoseRelation
from evo.core.sync import SyncException, associate_trajectories
from evo.core.trajectory import PoseTrajectory3D

from hoid_common import se3
from hoid_common.errors import InputError
from hoid_common.values import NS_PER_S, BoolArray, FloatArray, IntArray, Trajectory

ASSOCIATION_S = 0.02
RPE_INTERVAL_S = 1.0
MIN_POSES = 3  # a rigid alignment of fewer is not unique


@dataclass(frozen=True, eq=False)
class AlignedTrajectory:
    """An estimate moved onto the truth, pose by pose."""

    stamps_ns: IntArray  # (N,)
    T_world_camera: FloatArray  # (N, 4, 4), estimate after alignment
    T_world_camera_true: FloatArray  # (N, 4, 4)
    T_world_map: FloatArray  # (4, 4), the alignment
    error_m: FloatArray  # (N,), distance between the two camera centers


@dataclass(frozen=True)
class Evaluation:
    """Errors of one trajectory; RPE is None when it spans less than a second."""

    num_pairs: int
    coverage: float  # share of the reference that the estimate covers, in [0, 1]
    ate_rmse_m: float
    ate_mean_m: float
    ate_median_m: float
    ate_max_m: float
    rpe_trans_1s_rmse_m: float | None
    rpe_rot_1s_rmse_deg: float | None


def align(estimate: Trajectory, truth: Trajectory) -> AlignedTrajectory:
    """Associate the poses and move the estimate rigidly onto the truth (Umeyama without scale).

    Raises:
        InputError: Fewer than three poses can be associated, or they do not fix a rotation.
    """
    fewest = min(len(estimate), len(truth))
    if fewest < MIN_POSES:
        raise InputError(f'{fewest} poses cannot be evaluated, {MIN_POSES} are needed')
    try:
        true, moved = associate_trajectories(
            _to_evo(truth), _to_evo(estimate), max_diff=ASSOCIATION_S
        )
    except SyncException as error:
        raise InputError(_no_overlap(estimate, truth, 0)) from error
    if moved.num_poses < MIN_POSES:
        raise InputError(_no_overlap(estimate, truth, moved.num_poses))
    try:
        R, t, _ = moved.align(true)
    except GeometryException as error:
        raise InputError('camera centers on one line or point cannot be aligned') from error
    ape = APE(PoseRelation.translation_part)
    ape.process_data((true, moved))
    T_world_map = np.eye(4)
    T_world_map[:3, :3], T_world_map[:3, 3] = R, t
    return AlignedTrajectory(
        np.rint(moved.timestamps * NS_PER_S).astype(np.int64),
        np.array(moved.poses_se3),
        np.array(true.poses_se3),
        T_world_map,
        np.asarray(ape.error),
    )


def evaluate(
    estimate: Trajectory, truth: Trajectory, frames_total: int | None = None
) -> Evaluation:
    """Return all errors of an estimate.

    Args:
        frames_total: Images in the recording; coverage is then the share that has a pose.
            Without it, the share of the truth's time that the estimate covers.

    Raises:
        InputError: The two do not overlap in time, or there are more poses than images.
    """
    if frames_total is not None and frames_total < len(estimate):
        raise InputError(
            f'the estimate has {len(estimate)} poses, the recording {frames_total} images: '
            'give the number of all its images'
        )
    aligned = align(estimate, truth)
    rpe_m, rpe_deg = relative_errors(aligned)
    covered = (
        len(estimate) / frames_total
        if frames_total is not None
        else _covered_share(estimate, truth)
    )
    return Evaluation(
        num_pairs=len(aligned.error_m),
        coverage=covered,
        ate_rmse_m=float(_rms(aligned.error_m)),
        ate_mean_m=float(aligned.error_m.mean()),
        ate_median_m=float(np.median(aligned.error_m)),
        ate_max_m=float(aligned.error_m.max()),
        rpe_trans_1s_rmse_m=float(_rms(rpe_m)) if len(rpe_m) else None,
        rpe_rot_1s_rmse_deg=float(_rms(rpe_deg)) if len(rpe_deg) else None,
    )


def relative_errors(
    aligned: AlignedTrajectory, interval_s: float = RPE_INTERVAL_S
) -> tuple[FloatArray, FloatArray]:
    """Return the errors of the motion over an interval, (M,) m and (M,) degrees.

    evo counts intervals in frames only, and a trajectory with gaps needs them in time: pose i is
    paired with the one nearest to t_i + interval, if there is one within the association limit.
    """
    stamps_s = (aligned.stamps_ns - aligned.stamps_ns[0]) / NS_PER_S
    first, second = _pairs_at_interval(stamps_s, interval_s)
    if not len(first):
        return np.empty(0), np.empty(0)
    motion = _relative(aligned.T_world_camera, first, second)
    motion_true = _relative(aligned.T_world_camera_true, first, second)
    error = se3.log(se3.inverse(motion_true) @ motion)
    translation_m = np.linalg.norm((se3.inverse(motion_true) @ motion)[:, :3, 3], axis=1)
    return translation_m, np.degrees(np.linalg.norm(error[:, :3], axis=1))


def _pairs_at_interval(stamps_s: FloatArray, interval_s: float) -> tuple[IntArray, IntArray]:
    target = stamps_s + interval_s
    right = np.clip(np.searchsorted(stamps_s, target), 1, len(stamps_s) - 1)
    nearer_left = target - stamps_s[right - 1] < stamps_s[right] - target
    nearest = right - nearer_left
    found: BoolArray = np.abs(stamps_s[nearest] - target) <= ASSOCIATION_S
    return np.flatnonzero(found), nearest[found]


def _relative(T_world_camera: FloatArray, first: IntArray, second: IntArray) -> FloatArray:
    return se3.inverse(T_world_camera[first]) @ T_world_camera[second]


def _covered_share(estimate: Trajectory, truth: Trajectory) -> float:
    """Return the share of true poses that have an estimated one within a frame's time."""
    period_s = float(np.median(np.diff(estimate.stamps_ns))) / NS_PER_S
    limit_ns = max(ASSOCIATION_S, 0.75 * period_s) * NS_PER_S
    right = np.clip(np.searchsorted(estimate.stamps_ns, truth.stamps_ns), 1, len(estimate) - 1)
    gap_ns = np.minimum(
        np.abs(estimate.stamps_ns[right] - truth.stamps_ns),
        np.abs(estimate.stamps_ns[right - 1] - truth.stamps_ns),
    )
    return float((gap_ns <= limit_ns).mean())


def _to_evo(trajectory: Trajectory) -> PoseTrajectory3D:
    return PoseTrajectory3D(
        poses_se3=list(trajectory.T_world_camera), timestamps=trajectory.stamps_ns / NS_PER_S
    )


def _no_overlap(estimate: Trajectory, truth: Trajectory, num_pairs: int) -> str:
    spans = ' and '.join(
        f'{t.stamps_ns[0] / NS_PER_S:.2f}-{t.stamps_ns[-1] / NS_PER_S:.2f} s'
        for t in (estimate, truth)
    )
    return (
        f'estimate and ground truth share {num_pairs} poses within {ASSOCIATION_S} s, '
        f'{MIN_POSES} are needed; they span {spans}: are they of the same recording?'
    )


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
