"""What a run has found out about its IMU, compared with the ground truth.

The calibration of rendered IMUs is known, and the direction of gravity: z of the ground truth.
While black images hide the view, the pose rests on the gyro.
"""

from __future__ import annotations

import math

import numpy as np

from hoid_bags.sequence import Sequence
from hoid_benchmarks.plan.imu_changes import late_ms, turned
from hoid_benchmarks.plan.perturb import black_range
from hoid_benchmarks.plan.plan import Job
from hoid_benchmarks.plan.sequences import scene_of
from hoid_bringup.evaluate.evaluation import evaluate
from hoid_common import se3
from hoid_common.errors import InputError
from hoid_common.values import S_PER_NS, FloatArray, Trajectory
from hoid_synth.imu import GYRO_BIAS_RADPS, R_CAMERA_IMU
from rgbd_slam.inertial.report import ImuReport
from rgbd_slam.inertial.rotations import rotation_vector
from rgbd_slam.robot_frames import RobotPose

_TIMES_S = 2.0, 5.0, 20.0  # chosen: when the calibration and the level are compared
_LEVEL_OVER_S = 0.5  # chosen: poses of this time are averaged, because each has an error
_AFTER = 10  # chosen: images after black ones, when the pose is compared again


class InertialErrors:
    """Compares calibration, level and bridges of a run with the ground truth.

    Args:
        job: The run.
        sequence: The recording, as the run processes it.
        num_images: The number of images of the recording.

    Raises:
        InputError: The recording has no ground truth.
    """

    def __init__(self, job: Job, sequence: Sequence, num_images: int) -> None:
        if sequence.ground_truth is None:
            raise InputError(f'{job.sequence}: has no ground truth')
        self._truth, self._job = sequence.ground_truth, job
        self._black = black_range(num_images, job.perturbation)
        self._stamps_ns: list[int] = []
        self._poses: list[FloatArray | None] = []  # (4, 4) T_map_camera as published
        self._sigmas_m: list[float] = []  # standard deviation of its position
        self._reports: dict[float, ImuReport] = {}  # by time [s]
        self._last: ImuReport | None = None

    def add(self, stamp_ns: int, pose: RobotPose | None, report: ImuReport | None) -> None:
        """Add a processed image.

        Args:
            stamp_ns: Its stamp.
            pose: The published pose of the camera, if there is one.
            report: The calibration that is known by now, if there is an IMU.
        """
        self._stamps_ns.append(stamp_ns)
        self._poses.append(None if pose is None else pose.T_map_odom @ pose.T_odom_base)
        covariance = np.zeros((6, 6)) if pose is None else pose.covariance
        self._sigmas_m.append(float(np.sqrt(np.trace(covariance[3:, 3:]))))
        elapsed_s = S_PER_NS * (stamp_ns - self._stamps_ns[0])
        self._last = report
        for time_s in _TIMES_S:
            if report is not None and elapsed_s < time_s:
                self._reports[time_s] = report

    def summary(self, final: Trajectory) -> dict[str, float]:
        """Return the errors by name; those that are not known are left out.

        `seen_m` is the RMSE of the final poses of images that are not black, `reported` whether a
        problem of the IMU was reported, `gyro_used` whether its gyro is in use at the end: 0 or 1.
        """
        black_ns = [self._stamps_ns[k] for k in self._black]
        is_seen = ~np.isin(final.stamps_ns, black_ns)
        seen = Trajectory(final.stamps_ns[is_seen], final.T_world_camera[is_seen])
        errors = {'seen_m': evaluate(seen, self._truth).ate_rmse_m} if len(seen) > 2 else {}
        if self._last is not None:
            errors['reported'] = float(len(self._last.problems) > 0)
            errors['gyro_used'] = float('gyro' in self._last.in_use)
        return errors | self._calibration() | self._tilts() | self._bridge()

    def _calibration(self) -> dict[str, float]:
        """Return the errors of the calibration at each time, or at the end of a shorter run."""
        if scene_of(self._job.sequence) is None:
            return {}
        change = self._job.perturbation.imu
        found: dict[str, float] = {}
        R_turned_imu = turned(change, self._job.seed)
        R_camera_imu = R_CAMERA_IMU @ R_turned_imu.T
        for time_s, report in self._reports.items():
            if report.time_offset_ms is None or report.rotation_deg is None:
                continue
            R = se3.exp(np.append(np.deg2rad(report.rotation_deg), np.zeros(3)))[:3, :3]
            bias_radps = np.array(report.gyro_bias_radps) - R_turned_imu @ GYRO_BIAS_RADPS
            found |= {
                f'offset_{time_s:.0f}s_ms': abs(report.time_offset_ms - late_ms(change)),
                f'rotation_{time_s:.0f}s_deg': _degrees(R_camera_imu.T @ R),
                f'bias_{time_s:.0f}s_radps': float(np.linalg.norm(bias_radps)),
            }
        return found

    def _tilts(self) -> dict[str, float]:
        """Return the angles between z of the map and of the ground truth, and to the last one."""
        times_s = S_PER_NS * (np.array(self._stamps_ns) - self._stamps_ns[0])
        last = self._up(times_s, times_s[-1] - _LEVEL_OVER_S)
        found = {}
        for time_s in _TIMES_S:
            up = self._up(times_s, time_s)
            if up is not None and last is not None:
                found[f'tilt_{time_s:.0f}s_deg'] = _angle_deg(up, np.array([0.0, 0.0, 1.0]))
                found[f'tilt_{time_s:.0f}s_to_last_deg'] = _angle_deg(up, last)
        return found

    def _up(self, times_s: FloatArray, from_s: float) -> FloatArray | None:
        """Return z of the map (3,) in the frame of the ground truth, from a time on."""
        chosen = np.flatnonzero((times_s >= from_s) & (times_s <= from_s + _LEVEL_OVER_S))
        ups = [
            (self._true(k) @ se3.inverse(pose))[:3, 2]
            for k in chosen.tolist()
            if (pose := self._poses[k]) is not None
        ]
        return np.mean(ups, axis=0) if ups else None

    def _bridge(self) -> dict[str, float]:
        """Return the errors of the motion since the last image before the black ones."""
        if not self._black:
            return {}
        before, last = self._black[0] - 1, self._black[-1]
        found = {'bridged': float(all(self._poses[k] is not None for k in self._black))}
        for name, k in (('bridge', last), ('after', last + _AFTER)):
            first_pose, pose = self._poses[before], self._poses[k]
            if first_pose is not None and pose is not None:
                true = se3.inverse(self._true(before)) @ self._true(k)
                error = se3.inverse(true) @ se3.inverse(first_pose) @ pose
                found[f'{name}_deg'] = _degrees(error[:3, :3])
                found[f'{name}_m'] = float(np.linalg.norm(error[:3, 3]))
                found[f'{name}_sigmas'] = found[f'{name}_m'] / max(self._sigmas_m[k], 1e-4)
        return found

    def _true(self, k: int) -> FloatArray:
        nearest = np.argmin(np.abs(self._truth.stamps_ns - self._stamps_ns[k]))
        pose: FloatArray = self._truth.T_world_camera[nearest]
        return pose


def _degrees(R: FloatArray) -> float:
    return float(np.rad2deg(np.linalg.norm(rotation_vector(R))))


def _angle_deg(a: FloatArray, b: FloatArray) -> float:
    cosine = float(a @ b / (np.linalg.norm(a) * np.linalg.norm(b)))
    return math.degrees(math.acos(min(max(cosine, -1.0), 1.0)))
