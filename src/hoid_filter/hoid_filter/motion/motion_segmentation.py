"""Which parts of an RGB-D image move in the world, image by image, without a detector."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import (
    BoolArray,
    CameraModel,
    Float32Array,
    FloatArray,
    IntArray,
)
from hoid_filter.config import MotionConfig
from hoid_filter.extraction.pyramid import Int32Array
from hoid_filter.motion.belief import Belief, MovingArea
from hoid_filter.motion.course import Course
from hoid_filter.motion.ego_motion import MIN_POINTS, EgoMotion, Points
from hoid_filter.motion.past_views import PastViews
from hoid_filter.motion.point_tracks import PointTracks, expected_px, follow
from hoid_filter.motion.small_camera import SmallCamera, nearest_pixels
from hoid_filter.motion.small_view import MotionView, SmallView, small_view
from hoid_native import depths_at, strongest_in_cells

_LONGEST_GAP_S = 0.7  # between images, beyond which all starts anew
# A point so far from where it should be moves: standard deviations, and px of the grey image.
_OUTLIER, _SURE_PX = 6.0, 3.0
_POINT_EVIDENCE = 0.6  # log-odds of 1/30 s that a point gives its segment ...
_MOST_POINT_EVIDENCE = 1.0  # ... and that all its points do
_RIPE_S = 0.2  # points anchored for less long say little about rest
_SAME_SHARE = 0.05  # of its depth, by which a point that is followed may be off by noise ...
_FASTEST_M_S = 3.0  # ... and how fast it may come or go
_NEAREST_M = 0.3  # what is nearer does not hold even less area
_UNSTABLE_AREA_PX = 2.0  # that a point on an edge of depth stands for


class Found(NamedTuple):
    """Where N points are in an image."""

    pixel: IntArray  # (N,) flat
    depth_m: FloatArray  # (N,); 0 = no reading

    def select(self, keep: BoolArray) -> Found:
        """Return the points at a (N,) mask."""
        return Found(self.pixel[keep], self.depth_m[keep])


class Seen(NamedTuple):
    """The points of an image, N of them."""

    points: Points
    segment: Int32Array  # (N,); -1 = none
    small_pixel: IntArray  # (N,) flat, in the small depth image


class MotionSegmentation:
    """Follows points and depth over time, and believes what it sees more than once.

    Frames: the world is the camera's frame at the first image, or after the last restart.
    """

    def __init__(self, config: MotionConfig, camera: CameraModel) -> None:
        self._config = config
        self.camera = SmallCamera(camera)
        self._restart()

    def _restart(self) -> None:
        """Start anew, as at the first image."""
        self._belief = Belief(self.camera, self._config.fade_s)
        self._past = PastViews(self.camera)
        self._ego = EgoMotion(self.camera)
        self._random = np.random.default_rng(0)
        self._tracks = PointTracks.none()
        self._rests = np.empty(0)
        self._view: SmallView | None = None
        self._T_world_camera = self._T_camera_world = np.eye(4)
        self._T_before_now = np.eye(4)
        self.course = Course.none()  # of the points of the last view

    def observe(self, view: MotionView) -> MovingArea:
        """Return what moves in a view; views come in order of time."""
        small = small_view(view, self.camera)
        if self._view is not None and not 0 < small.stamp_s - self._view.stamp_s < _LONGEST_GAP_S:
            self._restart()
        # Where the camera is if it goes on as before, and if it stands.
        guesses = [
            se3.inverse(self._T_world_camera @ self._T_before_now),
            self._T_camera_world,
        ]
        found = self._follow(view, small, guesses[0])
        seen = self._seen(found, small)
        self._move(seen, ~view.is_detected(found.pixel), guesses)
        self._believe(seen, small)
        moving = self._belief.moving()
        self.course = self._course(seen, small.stamp_s) if moving.num_regions else Course.none()
        self._past.remember(small, self._T_world_camera)
        followed = self._renew(seen, small.stamp_s)
        self._add_points(view, small, followed)
        self._view = small
        return moving

    @property
    def depth_m(self) -> Float32Array:
        """Return the small depth image (h, w) of the last view."""
        assert self._view is not None
        return self._view.depth_m

    def _follow(self, view: MotionView, small: SmallView, T_next_world: FloatArray) -> Found:
        """Find the points again; one that has slipped onto another surface is lost."""
        if self._view is None:
            return Found(np.empty(0, np.int64), np.empty(0))
        guess_px = expected_px(self._tracks, self._T_camera_world, T_next_world, self.camera)
        tracks, kept = follow(self._view.gray, small.gray, self._tracks, guess_px)
        pixel = nearest_pixels(self.camera.full_px(tracks.uv_px), view.depth_m.shape)
        depth_m = _readings(view.depth_m, pixel)
        limit_m = _SAME_SHARE * tracks.depth_m
        limit_m += _FASTEST_M_S * (small.stamp_s - self._view.stamp_s)
        stayed = (depth_m == 0) | (np.abs(depth_m - tracks.depth_m) < limit_m)
        known_m = np.where(depth_m > 0, depth_m, tracks.depth_m)
        self._tracks = replace(tracks, depth_m=known_m).select(stayed)
        self._rests = self._rests[kept][stayed]
        return Found(pixel, depth_m).select(stayed)

    def _seen(self, found: Found, small: SmallView) -> Seen:
        depth_m = found.depth_m
        measured_px = self.camera.measure(self.camera.full_px(self._tracks.uv_px), depth_m)
        label = small.segments.label.ravel()
        small_pixel = self.camera.small_pixels(found.pixel)
        segment = label[small_pixel]
        area = _areas(small.segments.area_px, segment) * np.maximum(depth_m, _NEAREST_M)
        points = Points(
            world_m=self._tracks.anchor_m,
            measured_px=measured_px,
            camera_m=self.camera.points_m(measured_px, depth_m),
            has_depth=depth_m > 0,
            region=np.append(small.segments.region, -1)[segment],
            rests=self._rests,
            weights=np.stack([area * self._rests, area], axis=1),
        )
        return Seen(points, segment, small_pixel)

    def _move(self, seen: Seen, may_rest: BoolArray, guesses: list[FloatArray]) -> None:
        """Find the camera's motion; without enough points, all starts anew.

        People who are detected may cover more than the world does; they are asked only when little
        else is left.
        """
        if self._view is None:
            return
        if len(self._tracks) < MIN_POINTS:
            self._restart()
            return
        points = seen.points
        if MIN_POINTS <= np.count_nonzero(may_rest) < len(may_rest):
            points = points.select(may_rest)
        motion = self._ego.estimate(points, guesses)
        if motion.doubted:
            self._belief.forget()
        T_now = se3.inverse(motion.T_camera_world)
        self._T_before_now = self._T_camera_world @ T_now
        self._T_world_camera, self._T_camera_world = T_now, motion.T_camera_world

    def _believe(self, seen: Seen, small: SmallView) -> None:
        evidence = np.zeros(len(small.segments.region))
        if self._config.in_front:
            evidence += self._past.evidence(small, self._T_world_camera)
        if self._config.off_course and len(self._tracks):
            evidence += self._off_course(seen, small)
        self._belief.update(small, self._T_before_now, evidence)

    def _course(self, seen: Seen, now_s: float) -> Course:
        if not len(self._tracks):
            return Course.none()
        told = seen.points.has_depth
        way_m = se3.transform(self._T_world_camera, seen.points.camera_m[told])
        way_m -= seen.points.world_m[told]
        along_camera_m = way_m @ self._T_world_camera[:3, :3]
        since_s = now_s - self._tracks.anchored_s[told]
        return Course(seen.small_pixel[told], along_camera_m, since_s)

    def _off_course(self, seen: Seen, small: SmallView) -> FloatArray:
        """Return the (S,) log-odds of 1/30 s that points of segments do not go as if at rest."""
        off_px = self._ego.residuals_px(seen.points, self._T_camera_world)
        self._ego.learn_noise(off_px[seen.points.rests > 0.5])
        ripe = np.minimum((small.stamp_s - self._tracks.anchored_s) / _RIPE_S, 1.0)
        is_outlier = off_px > min(_OUTLIER * self._ego.noise_px, _SURE_PX)
        odds = _POINT_EVIDENCE * np.where(is_outlier, 1.0, -ripe)
        inside = seen.segment >= 0
        num = len(small.segments.region)
        total = np.bincount(seen.segment[inside], weights=odds[inside], minlength=num)
        return np.clip(total, -_MOST_POINT_EVIDENCE, _MOST_POINT_EVIDENCE)

    def _renew(self, seen: Seen, now_s: float) -> IntArray:
        """Anchor points anew that were long ago; drop those that have no depth then.

        Returns:
            Where the (N,) points left are, in the flat small image.
        """
        if not len(self._tracks):
            return np.empty(0, np.int64)
        due = self._tracks.renew_s <= now_s
        world_m = se3.transform(self._T_world_camera, seen.points.camera_m)
        anchored = self._tracks.anchored_anew(
            due & seen.points.has_depth, world_m, now_s, self._config.anchor_s
        )
        kept = ~due | seen.points.has_depth
        self._tracks = anchored.select(kept)
        return seen.small_pixel[kept]

    def _add_points(self, view: MotionView, small: SmallView, followed: IntArray) -> None:
        """Take up corners with depth where no point is; (N,) small pixels of those followed."""
        pixels = self._free_corners(view, small)
        depth_m = _readings(view.depth_m, pixels)
        width = view.depth_m.shape[1]
        full_px = np.stack([pixels % width, pixels // width], axis=1).astype(np.float32)
        camera_m = self.camera.points_m(self.camera.measure(full_px, depth_m), depth_m)
        # Not all at once: what was anchored long ago shows slow things, what was lately is true.
        ages_s = self._random.uniform(0.0, self._config.anchor_s, len(pixels))
        self._tracks = self._tracks.joined(
            PointTracks(
                self.camera.gray_px(full_px),
                se3.transform(self._T_world_camera, camera_m),
                np.full(len(pixels), small.stamp_s),
                small.stamp_s + self._config.anchor_s - ages_s,
                depth_m,
            )
        )
        at = np.concatenate([followed, self.camera.small_pixels(pixels)])
        self._rests = self._belief.probability_at(at)

    def _free_corners(self, view: MotionView, small: SmallView) -> IntArray:
        """Return flat pixels of the best corner of each cell that has no point.

        Depth there is smooth: on an edge it may be of either side.
        """
        missing = self._config.num_points - len(self._tracks)
        height, width = view.depth_m.shape
        cell_px = (height * width / self._config.num_points) ** 0.5
        taken = np.zeros((int(height / cell_px) + 1, int(width / cell_px) + 1), np.uint8)
        pixel = nearest_pixels(self.camera.full_px(self._tracks.uv_px), (height, width))
        row, column = np.divmod(pixel, width)
        taken[(row / cell_px).astype(np.int64), (column / cell_px).astype(np.int64)] = 1
        best = strongest_in_cells(
            view.corner_pixels,
            view.corner_scores,
            view.depth_m,
            self.camera.small_of_pixel,
            small.segments.label,
            cell_px,
            taken,
        )[: max(missing, 0)]
        return view.corner_pixels[best]


def _readings(depth_m: Float32Array, pixels: IntArray) -> FloatArray:
    """Return the (N,) depths of flat pixels; 0 = no reading."""
    return depths_at(depth_m, pixels).astype(np.float64)


def _areas(area_px: Int32Array, segment: Int32Array) -> FloatArray:
    """Return the (N,) areas in pixels that points in segments, (S,) in area, stand for."""
    points = np.bincount(segment + 1, minlength=len(area_px) + 1)[1:]
    share = np.append(area_px / np.maximum(points, 1), _UNSTABLE_AREA_PX)
    return share[segment]
