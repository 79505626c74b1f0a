"""Absolute and relative errors (ATE, RPE) of a trajectory against ground truth, by evo.

The conventions are those of the TUM RGB-D benchmark (Sturm et al., IROS 2012): poses are
associated within 0.02 s, the estimate is aligned by a rigid transform without scale, and RPE
compares the motion over one second.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from evo.core.geometry import GeometryException
from evo.core.metrics import APE, PoseRelation
from evo.core.sync import SyncException, associate_trajectories
from evo.core.trajectory import PoseTrajectory3D

from hoid_common import se3
from hoid_common.errors import InputError, replaced_by
from hoid_common.values import NS_PER_S, BoolArray, FloatArray, IntArray, Trajectory

ASSOCIATION_S = 0.02
RPE_INTERVAL_S = 1.0
MIN_POSES = 3  # fewer pairs of poses do not determine the alignment


@dataclass(frozen=True, eq=False)
class AlignedTrajectory:
    """N estimated poses, aligned to the true poses at nearly the same stamps."""

    stamps_ns: IntArray  # (N,) stamps of the estimated poses
    T_world_camera: FloatArray  # (N, 4, 4) estimated poses after the alignment
    T_world_camera_true: FloatArray  # (N, 4, 4) true poses
    # (4, 4) alignment: maps points of the estimate's map to the ground-truth frame.
    T_world_map: FloatArray
    error_m: FloatArray  # (N,) distance between estimated and true camera center


@dataclass(frozen=True)
class Evaluation:
    """Errors of one trajectory; RPE values are None if no two poses are a second apart."""

    num_pairs: int  # number of estimated poses with a true pose at nearly the same stamp
    coverage: float | None  # share of frames with a pose; None: the number of frames is unknown
    ate_rmse_m: float
    ate_mean_m: float
    ate_median_m: float
    ate_max_m: float
    rpe_trans_1s_rmse_m: float | None
    rpe_rot_1s_rmse_deg: float | None


def align(estimate: Trajectory, truth: Trajectory) -> AlignedTrajectory:
    """Associate estimated and true poses, and align the estimate to the ground truth.

    The alignment is a rigid transform without scale (Umeyama). InputError if fewer than three
    poses are associated, or they do not determine a rotation.
    """
    fewest = min(len(estimate), len(truth))
    if fewest < MIN_POSES:
        raise InputError(f'a trajectory has {fewest} poses, but an evaluation needs {MIN_POSES}')
    with replaced_by(InputError(_no_overlap(estimate, truth, 0)), SyncException):
        true, moved = associate_trajectories(
            _to_evo(truth), _to_evo(estimate), max_diff=ASSOCIATION_S
        )
    if moved.num_poses < MIN_POSES:
        raise InputError(_no_overlap(estimate, truth, moved.num_poses))
    problem = InputError(
        'trajectories on one line or point cannot be aligned: use a recording in which '
        'the camera moves in two directions at least'
    )
    with replaced_by(problem, GeometryException):
        R, t, _ = moved.align(true)
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
    """Return the absolute and relative errors of an estimated trajectory, and its coverage.

    InputError as in `align`, or if there are more poses than frames.
    """
    if frames_total is not None and frames_total < len(estimate):
        raise InputError(
            f'the estimate has {len(estimate)} poses, but --frames is {frames_total}: give the '
            'number of all frames of the recording'
        )
    aligned = align(estimate, truth)
    rpe_m, rpe_deg = relative_errors(aligned)
    return Evaluation(
        num_pairs=len(aligned.error_m),
        coverage=None if frames_total is None else len(estimate) / frames_total,
        ate_rmse_m=float(_rms(aligned.error_m)),
        ate_mean_m=float(aligned.error_m.mean()),
        ate_median_m=float(np.median(aligned.error_m)),
        ate_max_m=float(aligned.error_m.max()),
        rpe_trans_1s_rmse_m=float(_rms(rpe_m)) if len(rpe_m) else None,
        rpe_rot_1s_rmse_deg=float(_rms(rpe_deg)) if len(rpe_deg) else None,
    )


def relative_errors(aligned: AlignedTrajectory) -> tuple[FloatArray, FloatArray]:
    """Return the errors of the motion over one second: (M,) in m and (M,) in degrees.

    Each pose is paired with the pose nearest to one second later, within 0.02 s. evo only offers
    intervals of frames, which differ in time if the trajectory has gaps.
    """
    stamps_s = (aligned.stamps_ns - aligned.stamps_ns[0]) / NS_PER_S
    first, second = _pairs_at_interval(stamps_s)
    if not len(first):
        return np.empty(0), np.empty(0)
    motion, motion_true = (
        se3.inverse(T[first]) @ T[second]
        for T in (aligned.T_world_camera, aligned.T_world_camera_true)
    )
    T_error = se3.inverse(motion_true) @ motion
    translation_m = np.linalg.norm(T_error[:, :3, 3], axis=1)
    return translation_m, np.degrees(np.linalg.norm(se3.log(T_error)[:, :3], axis=1))


def _pairs_at_interval(stamps_s: FloatArray) -> tuple[IntArray, IntArray]:
    """Return the indices (M,), (M,) of the first and the second pose of each pair."""
    target = stamps_s + RPE_INTERVAL_S
    right = np.clip(np.searchsorted(stamps_s, target), 1, len(stamps_s) - 1)
    nearer_left = target - stamps_s[right - 1] < stamps_s[right] - target
    nearest = right - nearer_left
    found: BoolArray = np.abs(stamps_s[nearest] - target) <= ASSOCIATION_S
    return np.flatnonzero(found), nearest[found]


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
        f'estimate and ground truth share {num_pairs} poses within {ASSOCIATION_S} s, but an '
        f'evaluation needs {MIN_POSES}; they span {spans}: are they of the same recording?'
    )


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
