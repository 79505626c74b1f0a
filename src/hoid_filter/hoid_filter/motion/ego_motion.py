"""The camera's motion among points of which some move: poses judged by the area they hold."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import BoolArray, FloatArray, IntArray
from hoid_filter.motion.small_camera import SmallCamera
from hoid_native import Gates, StereoParams, align_triples, optimize_pose, score_poses

MIN_POINTS = 10
_DISPARITY_PX = 0.2  # noise of it at the grey image's scale
_LIMIT = 3.0  # standard deviations that a resting point may be off
_GATES = Gates(_LIMIT**2, _LIMIT**2)
_LEAST_PX, _MOST_PX = 0.25, 0.8  # noise of followed points; what it is shows in the images
_PX_OF_MEDIAN = 1.3  # noise by the median of the residuals, which have a long tail
_LEARNING = 0.1  # share of what one image says
_WIDE = 1.5  # times the limit: what a hypothesis may bring into its fit
_CLEAR = 0.92  # share of the area that leaves nothing to ask
_REGIONS = 4  # largest, each of which may be what rests
_REGION_POINTS = 8
_SAMPLES = 32
_SWITCH = 0.15  # of the area, by which a pose without belief must hold more than one with it


class Points(NamedTuple):
    """N points with a place in the world, as an image shows them."""

    world_m: FloatArray  # (N, 3)
    measured_px: FloatArray  # (N, 3) u, v, u_right; NaN u_right: no depth
    camera_m: FloatArray  # (N, 3) where the depth has them
    has_depth: BoolArray  # (N,)
    region: IntArray  # (N,) of smooth depth; -1 = none
    rests: FloatArray  # (N,) probability
    weights: FloatArray  # (N, 2) the area that each stands for: as far as it rests, and all

    def select(self, keep: BoolArray) -> Points:
        """Return the points at a (N,) mask."""
        return Points(
            world_m=self.world_m[keep],
            measured_px=self.measured_px[keep],
            camera_m=self.camera_m[keep],
            has_depth=self.has_depth[keep],
            region=self.region[keep],
            rests=self.rests[keep],
            weights=self.weights[keep],
        )


class Motion(NamedTuple):
    """A pose, and how much speaks for it."""

    T_camera_world: FloatArray  # (4, 4)
    share: float  # of the area that it explains
    doubted: bool  # the belief in what rests was wrong


class EgoMotion:
    """Finds the pose that explains most of the image, not most of the points."""

    def __init__(self, camera: SmallCamera) -> None:
        self._camera = camera
        self._random = np.random.default_rng(0)
        self._noise_px = _MOST_PX

    @property
    def noise_px(self) -> float:
        """Return the standard deviation of where points at rest are found, in the grey image."""
        return self._noise_px

    def learn_noise(self, residuals_px: FloatArray) -> None:
        """Take note of how far (N,) points that rest, for the most part, were off."""
        if len(residuals_px) < MIN_POINTS:
            return
        middle = len(residuals_px) // 2
        median_px = float(np.partition(residuals_px, middle)[middle])
        now_px = min(max(_PX_OF_MEDIAN * median_px, _LEAST_PX), _MOST_PX)
        self._noise_px += _LEARNING * (now_px - self._noise_px)

    def estimate(self, points: Points, guesses: list[FloatArray]) -> Motion:
        """Return the camera's motion.

        What is believed to rest counts in full. As a belief may be wrong, and keep itself alive,
        the best pose without it is looked for, too, and taken when it clearly holds more area.

        Args:
            points: `MIN_POINTS` or more.
            guesses: (4, 4) T_camera_world, the likeliest first.
        """
        resting = points.rests > 0.5
        if np.count_nonzero(resting) < _REGION_POINTS:
            resting = np.ones_like(resting)
        poses = [*guesses, self._fit(points, resting, guesses[0])]
        shares = self._shares(points, poses)
        if shares[:, 1].max() >= _CLEAR:
            return self._best(points, poses, shares, 0)
        poses += self._hypotheses(points, guesses[0])
        shares = self._shares(points, poses)
        believed = self._best(points, poses, shares, 0)
        if shares[:, 1].max() <= believed.share:
            return believed
        free = self._best(points, poses, shares, 1)
        if free.share > believed.share + _SWITCH:
            return free._replace(doubted=True)
        return believed

    def residuals_px(self, points: Points, T_camera_world: FloatArray) -> FloatArray:
        """Return how far, (N,), each point is from where a pose expects it."""
        seen = self._camera.gray_pinhole
        x, y, z = se3.transform(T_camera_world, points.world_m).T
        scale = 1 / np.maximum(z, 1e-3)
        du = x * scale * seen.fx_px + seen.cx_px - points.measured_px[:, 0]
        dv = y * scale * seen.fy_px + seen.cy_px - points.measured_px[:, 1]
        off_px: FloatArray = np.hypot(du, dv)
        return off_px

    def _hypotheses(self, points: Points, guess: FloatArray) -> list[FloatArray]:
        """Return poses of which each takes another part of the image for what rests."""
        counts = np.bincount(points.region + 1)[1:]
        largest = np.argsort(-counts, kind='stable')[:_REGIONS]
        enough = largest[counts[largest] >= _REGION_POINTS]
        poses = [self._fit(points, points.region == region, guess) for region in enough]
        known = np.flatnonzero(points.has_depth)
        if len(known) >= MIN_POINTS:
            triples = known[self._random.integers(0, len(known), (_SAMPLES, 3))]
            poses += list(align_triples(points.world_m, points.camera_m, triples))
        return poses

    def _best(
        self, points: Points, poses: list[FloatArray], shares: FloatArray, weights: int
    ) -> Motion:
        """Return the best pose by one of two sets of weights, fitted to all that it explains."""
        T = poses[int(shares[:, weights].argmax())]
        off_px = self.residuals_px(points, T)
        near = off_px < _WIDE * _LIMIT * self._noise_px
        refined = self._fit(points, near, T) if np.count_nonzero(near) >= MIN_POINTS else T
        both = self._shares(points, [refined, T])
        k = int(both[:, weights].argmax())
        return Motion((refined, T)[k], float(both[k, 1]), doubted=False)

    def _shares(self, points: Points, poses: list[FloatArray]) -> FloatArray:
        """Return the (M, 2) shares of the area: of what is believed to rest, and of all."""
        weights = points.weights
        scores = score_poses(
            self._stereo(),
            self._noise_px,
            _LIMIT,
            np.array(poses),
            points.world_m,
            points.measured_px,
            weights,
        )
        shares: FloatArray = scores / np.maximum(weights.sum(axis=0), 1e-9)
        return shares

    def _fit(self, points: Points, among: BoolArray, guess: FloatArray) -> FloatArray:
        k = np.flatnonzero(among)
        return optimize_pose(
            self._stereo(),
            _GATES,
            points.world_m.take(k, 0),
            points.measured_px.take(k, 0),
            np.full(len(k), self._noise_px**-2),
            guess,
        ).T_camera_map

    def _stereo(self) -> StereoParams:
        seen = self._camera.gray_pinhole
        return StereoParams(
            seen.fx_px,
            seen.fy_px,
            seen.cx_px,
            seen.cy_px,
            self._camera.disparity_px_m,
            _DISPARITY_PX / self._noise_px,
            0.0,
        )
