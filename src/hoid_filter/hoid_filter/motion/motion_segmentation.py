"""Segmentation of an RGB-D stream into static and moving regions, without a detector.

A segment of the depth image probably moves if it is in front of the surface that was visible there
before, or if points tracked on it contradict the camera motion (docs/explanation/motion.md,
decision 027).
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import (
    BoolArray,
    ByteArray,
    CameraModel,
    FloatArray,
    IntArray,
)
from hoid_filter.config import MotionConfig
from hoid_filter.extraction.pyramid import Int32Array
from hoid_filter.motion.depth_history import DepthHistory, shift_px
from hoid_filter.motion.downscaled_camera import (
    DownscaledCamera,
    DownscaledView,
    MotionView,
    depths_at,
    downscale,
    nearest_pixels,
)
from hoid_filter.motion.ego_motion import MIN_POINTS, EgoMotion, PointObservations
from hoid_filter.motion.moving_regions import (
    NO_MOVING_REGIONS,
    LabeledRegions,
    MotionLogOdds,
    MovingRegions,
    dilate_labels,
)
from hoid_filter.motion.point_tracks import PointTracks, predict_px, track

_MAX_GAP_S = 0.7  # chosen: after a longer gap between images, all points are dropped
# A point moves if its reprojection error exceeds the smaller of 6 times the noise and 3 px, and
# also exceeds the rolling-shutter shift. On five scenes, 6 was as good as or better than 4, and
# than 3 px alone (decision 027).
_OUTLIER_SIGMAS, _MAX_OUTLIER_PX = 6.0, 3.0
# Chosen: log-odds from one point, and limit for all points on a segment, per `EVIDENCE_PERIOD_S`.
_POINT_LOG_ODDS, _MAX_POINTS_LOG_ODDS = 0.6, 1.0
# Chosen: the evidence of a point that agrees with the camera motion grows with the age of its
# anchor up to this age, because a slow object moves less than the noise in a shorter time.
_FULL_WEIGHT_S = 0.2
# A tracked point has slipped to another surface if its depth changes by more than 5 % plus 3 m/s
# times the elapsed time. Chosen: above the depth noise at an edge and the speed of people indoors.
_MAX_DEPTH_CHANGE, _MAX_SPEED_MPS = 0.05, 3.0
# Chosen: depth that is used for the weight of points that are nearer or have no depth.
_MIN_WEIGHT_DEPTH_M = 0.3
# Chosen, for the velocity of a region: in a shorter time, the displacement of a point is less than
# its depth noise; with fewer points, the median does not reject an outlier.
_MIN_ELAPSED_S, _MIN_REGION_POINTS = 0.1, 3
_MAX_RESULTS = 60  # chosen: two seconds at 30 Hz; the live filter re-evaluates less
_UNSEGMENTED_AREA_PX = 2.0  # chosen: area of a point on a depth edge, which belongs to no segment


class PointPixels(NamedTuple):
    """Pixels and depths of N tracked points in the full image."""

    pixel: IntArray  # (N,) indices into the flattened full-resolution image
    depth_m: FloatArray  # (N,); 0 = no reading

    def select(self, mask: BoolArray) -> PointPixels:
        return PointPixels(self.pixel[mask], self.depth_m[mask])


class SegmentedPoints(NamedTuple):
    """Observations of N tracked points, and the segment that each lies on."""

    points: PointObservations
    segment: Int32Array  # (N,) index of the depth segment; -1 = none
    downscaled_pixel: IntArray  # (N,) flat index into the downscaled depth image


class MotionSegmentation:
    """Finds moving regions in the images of one camera by evidence from many images.

    The world frame is the camera frame of the first image since the last restart. It restarts
    after a gap between images, when stamps do not increase, and when too few points are tracked.
    """

    def __init__(self, config: MotionConfig, camera: CameraModel) -> None:
        self._config = config
        self.camera = DownscaledCamera(camera)
        self._restart()

    def _restart(self) -> None:
        self._log_odds = MotionLogOdds(self.camera, self._config.decay_s)
        self._history = DepthHistory(self.camera)
        self._ego_motion = EgoMotion(self.camera)
        self._random = np.random.default_rng(0)
        self._tracks = PointTracks.none()
        self._static_probability = np.empty(0)  # (N,) of the tracked points
        self._view: DownscaledView | None = None
        self._T_world_camera = self._T_camera_world = np.eye(4)
        self._T_previous_current = np.eye(4)
        self._turn_radps = np.zeros(3)  # turn rate of the camera in the last view

    def segment(self, view: MotionView) -> MovingRegions:
        small = downscale(view, self.camera)
        if self._view is not None and not 0 < small.stamp_s - self._view.stamp_s < _MAX_GAP_S:
            self._restart()
        predictions = [  # constant velocity, and no motion
            se3.inverse(self._T_world_camera @ self._T_previous_current),
            self._T_camera_world,
        ]
        pixels = self._track_points(view, small, predictions[0])
        tracked = self._observe_points(pixels, small)
        is_undetected = ~view.is_detected(pixels.pixel)
        self._estimate_ego_motion(tracked, is_undetected, predictions, small)
        if self._view is not None:
            turn_rad = se3.log(self._T_previous_current)[:3]
            self._turn_radps = turn_rad / (small.stamp_s - self._view.stamp_s)
        self._log_odds.update(small, self._T_previous_current, self._evidence(tracked, small))
        regions = self._described(self._log_odds.moving_regions(), tracked, small)
        self._history.add(small, self._T_world_camera, self._turn_radps)
        occupied = self._renew_anchors(tracked, small.stamp_s)
        self._add_points(view, small, occupied)
        self._view = small
        return regions._replace(camera_turn_radps=float(np.linalg.norm(self._turn_radps)))

    def _track_points(
        self, view: MotionView, small: DownscaledView, T_next_world: FloatArray
    ) -> PointPixels:
        """Track the points into a view; drop points that are lost or on another surface."""
        if self._view is None:
            return PointPixels(np.empty(0, np.int64), np.empty(0))
        predicted_px = predict_px(self._tracks, self._T_camera_world, T_next_world, self.camera)
        tracks, found = track(self._view.gray, small.gray, self._tracks, predicted_px)
        pixel = nearest_pixels(self.camera.full_px(tracks.uv_px), view.depth_m.shape)
        depth_m = depths_at(view.depth_m, pixel).astype(np.float64)
        limit_m = _MAX_DEPTH_CHANGE * tracks.depth_m
        limit_m += _MAX_SPEED_MPS * (small.stamp_s - self._view.stamp_s)
        is_same = (depth_m == 0) | (np.abs(depth_m - tracks.depth_m) < limit_m)
        known_m = np.where(depth_m > 0, depth_m, tracks.depth_m)
        self._tracks = replace(tracks, depth_m=known_m).select(is_same)
        self._static_probability = self._static_probability[found][is_same]
        return PointPixels(pixel, depth_m).select(is_same)

    def _observe_points(self, pixels: PointPixels, small: DownscaledView) -> SegmentedPoints:
        depth_m = pixels.depth_m
        observed_px = self.camera.measure(self.camera.full_px(self._tracks.uv_px), depth_m)
        downscaled_pixel = self.camera.downscaled_of_pixel[pixels.pixel]
        segment = small.segments.label.ravel()[downscaled_pixel]
        # With the factor depth, the weight of a surface falls with 1 / depth, and not with 1 /
        # depth^2 as its image area does.
        area = _area_per_point(small.segments.area_px, segment)
        area *= np.maximum(depth_m, _MIN_WEIGHT_DEPTH_M)
        points = PointObservations(
            world_m=self._tracks.anchor_m,
            observed_px=observed_px,
            camera_m=self.camera.points_m(observed_px, depth_m),
            has_depth=depth_m > 0,
            region=np.append(small.segments.region, -1)[segment],
            static_probability=self._static_probability,
            weights=np.stack([area * self._static_probability, area], axis=1),
        )
        return SegmentedPoints(points, segment, downscaled_pixel)

    def _estimate_ego_motion(
        self,
        tracked: SegmentedPoints,
        is_undetected: BoolArray,
        predictions: list[FloatArray],
        small: DownscaledView,
    ) -> None:
        """Update the camera pose from the tracked points; restart if they are too few.

        Points on detected people and objects (not `is_undetected`) are used only if fewer than
        `MIN_POINTS` others remain, because people may cover more of the image than the static
        scene (decision 027).
        """
        if self._view is None:
            return
        if len(self._tracks) < MIN_POINTS:
            self._restart()
            return
        points = tracked.points
        if MIN_POINTS <= np.count_nonzero(is_undetected) < len(is_undetected):
            points = points.select(is_undetected)

        def contradiction(T_camera_world: FloatArray) -> float:
            return self._history.contradiction(small, se3.inverse(T_camera_world))

        decides = contradiction if self._config.depth_decides else None
        estimate = self._ego_motion.estimate(points, predictions, decides)
        if estimate.contradicts_prior:
            self._log_odds.reset()
        T_world_camera = se3.inverse(estimate.T_camera_world)
        self._T_previous_current = self._T_camera_world @ T_world_camera
        self._T_world_camera, self._T_camera_world = T_world_camera, estimate.T_camera_world

    def _evidence(self, tracked: SegmentedPoints, small: DownscaledView) -> FloatArray:
        evidence = np.zeros(len(small.segments.region))
        if self._config.in_front:
            evidence += self._history.occlusion_evidence(
                small, self._T_world_camera, self._turn_radps
            )
        if self._config.off_course and len(self._tracks):
            evidence += self._point_evidence(tracked, small)
        return evidence

    def _described(
        self, regions: LabeledRegions, tracked: SegmentedPoints, small: DownscaledView
    ) -> MovingRegions:
        if not regions.num_regions:
            return NO_MOVING_REGIONS
        labels = range(1, regions.num_regions + 1)
        depths_m = [np.median(small.depth_m[regions.label == label]) for label in labels]
        return MovingRegions(
            self.camera.boxes_px(regions.boxes_xywh_px).astype(np.float32),
            np.array(depths_m, np.float64),
            self._velocities_mps(regions, tracked, small.stamp_s),
            dilate_labels(regions.label),
            self.camera,
        )

    def _velocities_mps(
        self, regions: LabeledRegions, tracked: SegmentedPoints, now_s: float
    ) -> FloatArray:
        """Return the velocities (R, 3) of regions in the world, along the camera axes, or NaN."""
        velocities_mps = np.full((regions.num_regions, 3), np.nan)
        if not len(self._tracks):
            return velocities_mps
        has_depth = tracked.points.has_depth
        world_m = se3.transform(self._T_world_camera, tracked.points.camera_m[has_depth])
        world_m -= tracked.points.world_m[has_depth]
        in_camera_axes_m = world_m @ self._T_world_camera[:3, :3]
        elapsed_s = now_s - self._tracks.anchored_s[has_depth]
        is_long = elapsed_s >= _MIN_ELAPSED_S
        point_mps = in_camera_axes_m[is_long] / elapsed_s[is_long, None]
        label = regions.label.ravel()[tracked.downscaled_pixel[has_depth][is_long]]
        for n in range(regions.num_regions):
            inside_mps = point_mps[label == n + 1]
            if len(inside_mps) >= _MIN_REGION_POINTS:
                velocities_mps[n] = np.median(inside_mps, axis=0)
        return velocities_mps

    def _point_evidence(self, tracked: SegmentedPoints, small: DownscaledView) -> FloatArray:
        """Return the log-odds (S,) that segments move, from the errors of the points on them."""
        errors_px = self._ego_motion.residuals_px(tracked.points, self._T_camera_world)
        self._ego_motion.update_noise(errors_px[tracked.points.static_probability > 0.5])
        age_s = small.stamp_s - self._tracks.anchored_s
        inlier_weight = np.minimum(age_s / _FULL_WEIGHT_S, 1.0)
        limit_px = min(_OUTLIER_SIGMAS * self._ego_motion.noise_px, _MAX_OUTLIER_PX)
        shifts_px = shift_px(
            self._turn_radps, self._tracks.anchored_radps, self.camera.gray_pinhole.fx_px
        )
        is_outlier = errors_px > np.hypot(limit_px, shifts_px)
        log_odds = _POINT_LOG_ODDS * np.where(is_outlier, 1.0, -inlier_weight)
        inside = tracked.segment >= 0
        num = len(small.segments.region)
        total = np.bincount(tracked.segment[inside], weights=log_odds[inside], minlength=num)
        return np.clip(total, -_MAX_POINTS_LOG_ODDS, _MAX_POINTS_LOG_ODDS)

    def _renew_anchors(self, tracked: SegmentedPoints, now_s: float) -> IntArray:
        """Renew the anchors that are due, or drop their points; return the pixels of the rest."""
        if not len(self._tracks):
            return np.empty(0, np.int64)
        is_due = self._tracks.renew_s <= now_s
        world_m = se3.transform(self._T_world_camera, tracked.points.camera_m)
        anchored = self._tracks.anchor(
            is_due & tracked.points.has_depth,
            world_m,
            self._turn_radps,
            now_s,
            self._config.anchor_s,
        )
        kept = ~is_due | tracked.points.has_depth
        self._tracks = anchored.select(kept)
        return tracked.downscaled_pixel[kept]

    def _add_points(self, view: MotionView, small: DownscaledView, occupied: IntArray) -> None:
        pixels = self._free_corners(view, small)
        depth_m = depths_at(view.depth_m, pixels).astype(np.float64)
        width = view.depth_m.shape[1]
        full_px = np.stack([pixels % width, pixels // width], axis=1).astype(np.float32)
        camera_m = self.camera.points_m(self.camera.measure(full_px, depth_m), depth_m)
        # Anchors are renewed at random times, so that old and new ones exist at all times: old
        # ones reveal slow motion, new ones have little pose drift.
        ages_s = self._random.uniform(0.0, self._config.anchor_s, len(pixels))
        self._tracks = self._tracks.concatenate(
            PointTracks(
                self.camera.gray_px(full_px),
                se3.transform(self._T_world_camera, camera_m),
                np.full(len(pixels), small.stamp_s),
                np.tile(self._turn_radps, (len(pixels), 1)),
                small.stamp_s + self._config.anchor_s - ages_s,
                depth_m,
            )
        )
        at = np.concatenate([occupied, self.camera.downscaled_of_pixel[pixels]])
        self._static_probability = self._log_odds.static_probability(at)

    def _free_corners(self, view: MotionView, small: DownscaledView) -> IntArray:
        """Return the strongest corner, off depth edges, in each grid cell without a point."""
        missing = self._config.num_points - len(self._tracks)
        height, width = view.depth_m.shape
        cell_px = (height * width / self._config.num_points) ** 0.5
        occupied = np.zeros((int(height / cell_px) + 1, int(width / cell_px) + 1), np.uint8)
        pixel = nearest_pixels(self.camera.full_px(self._tracks.uv_px), (height, width))
        row, column = np.divmod(pixel, width)
        occupied[(row / cell_px).astype(np.int64), (column / cell_px).astype(np.int64)] = 1
        row, column = np.divmod(view.corner_pixels, width)
        per_px = 1 / cell_px
        cell = (row * per_px).astype(np.int64) * occupied.shape[1]
        cell += (column * per_px).astype(np.int64)
        depth_m = view.depth_m.ravel()[view.corner_pixels]
        label = small.segments.label.ravel()[self.camera.downscaled_of_pixel[view.corner_pixels]]
        is_free = (occupied.ravel()[cell] == 0) & (depth_m > 0) & np.isfinite(depth_m)
        k = np.flatnonzero(is_free & (label >= 0))
        strongest = k[strongest_per_cell(cell[k], view.corner_scores[k])]
        return view.corner_pixels[strongest[: max(missing, 0)]]


def strongest_per_cell(cells: IntArray, scores: ByteArray) -> IntArray:
    """Return the index (M,) of the strongest corner in each cell, by ascending cell.

    `cells` (N,) and `scores` (N,) belong to corners; of equal scores, the first one wins.
    """
    # The sort key contains the index, because sorting plain numbers takes half the time of a
    # stable argsort.
    order = np.sort((cells * 256 - scores) * len(cells) + np.arange(len(cells))) % len(cells)
    is_first: BoolArray = np.diff(cells[order], prepend=-1) != 0
    return order[is_first]


class MotionDetector:
    """Segments motion in the views of one camera, and stores the results of the last 60 views."""

    def __init__(self, config: MotionConfig) -> None:
        self._config = config
        self._segmentation: MotionSegmentation | None = None
        self._results: deque[tuple[int, MovingRegions]] = deque(maxlen=_MAX_RESULTS)

    def detect(self, view: MotionView) -> None:
        if self._segmentation is None or self._segmentation.camera.camera != view.camera:
            self._segmentation = MotionSegmentation(self._config, view.camera)
        self._results.append((view.stamp_ns, self._segmentation.segment(view)))

    def has_result(self, stamp_ns: int) -> bool:
        return any(result_ns == stamp_ns for result_ns, _ in self._results)

    def regions_at(self, stamp_ns: int) -> MovingRegions:
        """Return the moving regions of the newest view up to a stamp, or no regions."""
        past = (moving for result_ns, moving in reversed(self._results) if result_ns <= stamp_ns)
        return next(past, NO_MOVING_REGIONS)


def _area_per_point(area_px: Int32Array, segment: Int32Array) -> FloatArray:
    """Return the image area (N,) in px that each point represents, by its segment (-1: 2 px)."""
    num_points = np.bincount(segment + 1, minlength=len(area_px) + 1)[1:]
    per_point_px = np.append(area_px / np.maximum(num_points, 1), _UNSEGMENTED_AREA_PX)
    return per_point_px[segment]
