"""From an RGB-D image and what a detector saw in it to the features of the static world."""

from __future__ import annotations

import dataclasses
import time
from collections import Counter
from typing import NamedTuple

import cv2
import numpy as np

from hoid_common.errors import MessageError
from hoid_common.values import (
    BoolArray,
    CameraModel,
    Detections,
    DynamicObject,
    Features,
    FeatureVerdicts,
    FilterResult,
    Float32Array,
    IntArray,
    Reason,
    RgbdFrame,
)
from hoid_filter.config import FilterConfig
from hoid_filter.detections.aligned_detections import FilterInput, Verdict
from hoid_filter.detections.sanitize import sanitize
from hoid_filter.extraction.extractor import OrbExtractor
from hoid_filter.extraction.pyramid import Corners
from hoid_filter.motion.moving_regions import NOTHING, MotionSense
from hoid_filter.motion.small_view import MotionView
from hoid_filter.rules.registry import make_strategy


class DetectedCorners(NamedTuple):
    """An image and its corners, which need no detections: they are found while these are made."""

    frame: RgbdFrame
    corners: Corners
    took_s: float


class FinalWord(NamedTuple):
    """What an image that was judged before turns out to show."""

    objects: tuple[DynamicObject, ...]
    verdicts: FeatureVerdicts
    verdict: Verdict  # by which pixels are masked


class FeatureFilter:
    """Finds corners, judges objects, masks the dynamic ones, spreads and describes the rest.

    What moves without being detected takes longest to find. `process` looks for it first; who has
    no time calls the verbs one by one: the features of `select_and_describe` then go by what moved
    before, and `judge_again` tells after `sense_motion` which of them move.
    """

    def __init__(self, config: FilterConfig, camera: CameraModel | None = None) -> None:
        """Take the camera, if known, for the 3-D centres of objects in images of its size."""
        self._config = config
        self.camera = camera
        self._extractor = OrbExtractor(config.extraction)
        self.reset()
        self.counters: Counter[str] = Counter()

    def reconfigure(self, config: FilterConfig) -> None:
        """Take over parameters that may change at run time; what was remembered is forgotten."""
        self._config = config
        self.reset()

    def reset(self) -> None:
        """Forget what was remembered of earlier images, as when their stamps start anew."""
        self._strategy = make_strategy(self._config)
        self._motion = MotionSense(self._config.motion) if self._config.senses_motion else None
        self._detected: BoolArray | None = None  # in the last image

    def process(
        self, frame: RgbdFrame, detections: Detections | None, *, for_picture: bool = False
    ) -> FilterResult:
        """Return the features of the static world and the verdict on every object.

        Args:
            frame: images of equal size, in order of time.
            detections: of this image, or older ones to be predicted to it; None when the detector
                said nothing (which is not the same as seeing nothing).
            for_picture: also report where the features were that the verdict removed.
        """
        detected = self.detect_corners(frame)
        start = time.thread_time()
        self.sense_motion(detected)
        sensed_ms = (time.thread_time() - start) * 1e3
        result = self.select_and_describe(detected, detections, for_picture=for_picture)
        result.stage_ms['filter'] += sensed_ms
        return result

    def detect_corners(self, frame: RgbdFrame) -> DetectedCorners:
        """Find the corners of an image; raises MessageError when its two images differ in size."""
        check_sizes(frame)
        start = time.thread_time()
        gray = cv2.cvtColor(frame.image_bgr, cv2.COLOR_BGR2GRAY)
        corners = self._extractor.detect(np.asarray(gray, np.uint8))
        return DetectedCorners(frame, corners, time.thread_time() - start)

    def sense_motion(self, detected: DetectedCorners) -> None:
        """Find what moves in an image without being detected; images come in order of time."""
        frame, corners, _ = detected
        if self.camera is None or self.camera.size_px != frame.size_px:
            self.counters['images without their camera'] += 1
            return
        if self._motion is None:
            return
        view = MotionView(
            frame.stamp_ns,
            self.camera,
            corners.pyramid.levels[0],
            frame.depth_m,
            corners.pixel,
            corners.score,
            self._detected,
        )
        self._motion.sense(view)

    def is_motion_known(self, stamp_ns: int) -> bool:
        """Return whether motion has been looked for in an image, if it ever is."""
        return self._motion is None or self._motion.has_sensed(stamp_ns)

    def select_and_describe(
        self,
        detected: DetectedCorners,
        detections: Detections | None,
        *,
        for_picture: bool = False,
    ) -> FilterResult:
        """Return what `process` does, by what is known by now to move."""
        frame, corners, detected_s = detected
        found = time.thread_time()
        verdict = self._judge(frame.stamp_ns, detections, frame.depth_m, corners.pixel)
        self._detected = verdict.detected
        self.counters['frames with too few static features'] += verdict.fallback_step > 0
        judged = time.thread_time()
        chosen = self._extractor.choose(corners, verdict.kept, verdict.static_area_px)
        moving = [reason is not Reason.STATIC for reason in verdict.reasons]
        features = self._extractor.describe(
            corners, chosen, frame.depth_m, frame.stamp_ns, verdict.boxes_xyxy_px[moving]
        )
        if verdict.seeds is not None:
            features = dataclasses.replace(features, may_seed=verdict.seeds[chosen])
        done = time.thread_time()
        return FilterResult(
            features=features,
            objects=self._objects(verdict, frame.size_px),
            removed_uv_px=self._removed(corners, verdict, for_picture),
            num_features_in=len(corners),
            num_removed=0 if verdict.kept is None else len(corners) - len(verdict.kept),
            stage_ms={
                'extract': (detected_s + done - judged) * 1e3,
                'filter': (judged - found) * 1e3,
            },
        )

    def judge_again(
        self,
        features: Features,
        depth_m: Float32Array,
        detections: Detections | None,
    ) -> FinalWord:
        """Return what is known by now of an image and its features.

        Args:
            features: Of the image, one of the last second, as `select_and_describe` gave them.
            depth_m: (H, W) of the image.
            detections: Of the image, or of a later one that the detector took instead; None when
                there are no more than were given with the image.
        """
        height, width = depth_m.shape
        u, v = np.rint(features.uv_px).astype(np.int64).T
        pixels = np.clip(v, 0, height - 1) * width + np.clip(u, 0, width - 1)
        verdict = self._judge(features.stamp_ns, detections, depth_m, pixels)
        is_dynamic = np.zeros(len(features), np.bool_)
        if verdict.kept is not None:
            is_dynamic[:] = True
            is_dynamic[verdict.kept] = False
        if verdict.seeds is not None:
            is_dynamic |= ~verdict.seeds
        return FinalWord(
            self._objects(verdict, (width, height)),
            FeatureVerdicts(features.stamp_ns, is_dynamic),
            verdict,
        )

    def _judge(
        self,
        stamp_ns: int,
        detections: Detections | None,
        depth_m: Float32Array,
        corner_pixels: IntArray,
    ) -> Verdict:
        height, width = depth_m.shape
        if detections is not None:
            fit = sanitize(detections, width, height, self._config.max_detections)
            self.counters['boxes refused'] += fit.num_refused
            self.counters['boxes clipped'] += fit.num_clipped
            detections = fit.detections
        moving = NOTHING if self._motion is None else self._motion.at(stamp_ns)
        view = FilterInput(stamp_ns, detections, depth_m, corner_pixels, moving)
        return self._strategy.judge(view)

    def _removed(self, corners: Corners, verdict: Verdict, wanted: bool) -> Float32Array:
        """Return where the features were that would have been chosen had nothing been masked."""
        if not wanted or verdict.kept is None:
            return np.empty((0, 2), np.float32)
        chosen = self._extractor.choose(corners, None, corners.pyramid.levels[0].size)
        removed = np.setdiff1d(chosen, verdict.kept, assume_unique=True)
        return corners.uv_px[removed].astype(np.float32)

    def _objects(self, verdict: Verdict, size_px: tuple[int, int]) -> tuple[DynamicObject, ...]:
        boxes = verdict.boxes_xyxy_px.astype(np.float64)
        centers = np.full((len(boxes), 3), np.nan)
        sizes = np.full((len(boxes), 2), np.nan)
        if self.camera is not None and self.camera.size_px == size_px:
            focal_px = np.array([self.camera.fx_px, self.camera.fy_px])
            principal_px = np.array([self.camera.cx_px, self.camera.cy_px])
            imaged_px = ((boxes[:, :2] + boxes[:, 2:]) / 2).astype(np.float32)
            middle_px = self.camera.undistort_px(imaged_px)
            centers[:, :2] = (middle_px - principal_px) / focal_px * verdict.depths_m[:, None]
            centers[:, 2] = verdict.depths_m
            sizes = (boxes[:, 2:] - boxes[:, :2]) / focal_px * verdict.depths_m[:, None]
        rows = zip(
            verdict.class_names,
            map(tuple, boxes.tolist()),
            verdict.scores.tolist(),
            verdict.track_ids.tolist(),
            verdict.reasons,
            verdict.overlap_ratios.tolist(),
            verdict.depth_gaps_m.tolist(),
            map(tuple, centers.tolist()),
            map(tuple, sizes.tolist()),
            map(tuple, verdict.known_velocities_mps().tolist()),
            strict=True,
        )
        return tuple(DynamicObject(*row) for row in rows)


def check_sizes(frame: RgbdFrame) -> None:
    """Raise MessageError when colour and depth are not of one size."""
    if frame.image_bgr.shape[:2] != frame.depth_m.shape:
        raise MessageError(
            f'depth image is {frame.depth_m.shape[1]}x{frame.depth_m.shape[0]} but colour is '
            f'{frame.image_bgr.shape[1]}x{frame.image_bgr.shape[0]}: register depth to colour'
        )
