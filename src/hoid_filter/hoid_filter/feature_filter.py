"""The filter: returns the features of the static scene from an RGB-D image and detections."""

from __future__ import annotations

import time
from collections import Counter
from typing import NamedTuple

import cv2
import numpy as np

from hoid_common.errors import MessageError
from hoid_common.sync import MAX_COPY_AGE_NS, Rate
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
    ObjectState,
    RgbdFrame,
)
from hoid_filter.config import FilterConfig
from hoid_filter.detections.sanitize import sanitize
from hoid_filter.extraction.extractor import OrbExtractor
from hoid_filter.extraction.pyramid import Corners
from hoid_filter.motion.downscaled_camera import MotionView
from hoid_filter.motion.motion_segmentation import MotionDetector
from hoid_filter.motion.moving_regions import NO_MOVING_REGIONS
from hoid_filter.strategy import FilterInput, ObjectVerdicts, Verdict, make_strategy


class DetectedCorners(NamedTuple):
    """An image and all its FAST corners, before masking and description."""

    frame: RgbdFrame
    corners: Corners
    elapsed_s: float  # duration of corner detection


class FinalVerdict(NamedTuple):
    """The final classification of an image whose features were published provisionally."""

    objects: tuple[DynamicObject, ...]  # static objects included
    feature_verdicts: FeatureVerdicts  # which of the published features are dynamic
    verdict: Verdict  # as the strategy returned it


class FeatureFilter:
    """Detects corners, classifies objects, and describes the corners on static surface.

    `process` runs all stages. The live filter calls them one by one, because motion segmentation
    takes longest: `detect_corners`, `select_and_describe` with the moving regions of an earlier
    image, `detect_motion`, `reevaluate`.

    While `camera` is None, or not of the size of the images, motion is not segmented, and 3-D
    positions of objects are NaN.
    """

    def __init__(self, config: FilterConfig, camera: CameraModel | None = None) -> None:
        self._config = config
        self.camera = camera
        self._extractor = OrbExtractor(config.extraction)
        self.reset()
        self.counters: Counter[str] = Counter()

    def reconfigure(self, config: FilterConfig) -> None:
        """Apply all parameters except those of the extraction, and forget earlier images."""
        self._config = config
        self.reset()

    def reset(self) -> None:
        """Forget all earlier images, tracked objects and moving regions."""
        self._strategy = make_strategy(self._config)
        self._motion = (
            MotionDetector(self._config.motion) if self._strategy.senses_motion else None
        )
        self._motion_rate = Rate(self._config.motion.rate_hz)
        self._detected_mask: BoolArray | None = None  # (h, w), of the last image selected
        self._original: RgbdFrame | None = None  # last image that was no copy (see `_is_copy`)

    def process(
        self, frame: RgbdFrame, detections: Detections | None, *, for_picture: bool = False
    ) -> FilterResult:
        """Return the features on static surface and the objects of the next image.

        `detections` belong to this image, or to an older one from which boxes are predicted. None:
        the detector has sent no message; empty: it found nothing. With `for_picture`, the result
        has the pixels of removed features. MessageError if color and depth differ in size.
        """
        detected = self.detect_corners(frame)
        start = time.perf_counter()
        self.detect_motion(detected)
        motion_ms = (time.perf_counter() - start) * 1e3
        result = self.select_and_describe(detected, detections, for_picture=for_picture)
        result.stage_ms['filter'] += motion_ms
        return result

    def detect_corners(self, frame: RgbdFrame) -> DetectedCorners:
        """Return the FAST corners; MessageError if color and depth differ in size."""
        check_sizes(frame)
        start = time.perf_counter()
        gray = cv2.cvtColor(frame.image_bgr, cv2.COLOR_BGR2GRAY)
        corners = self._extractor.detect(np.asarray(gray, np.uint8))
        return DetectedCorners(frame, corners, time.perf_counter() - start)

    def detect_motion(self, detected: DetectedCorners) -> None:
        """Segment motion in an image from `camera`, if it is due by rate and not repeated."""
        frame, corners, _ = detected
        if self.camera is None or self.camera.size_px != frame.size_px:
            self.counters['images without their camera'] += 1
            return
        if self._motion is None or not self._motion_rate.take_due(frame.stamp_ns):
            return
        if self._is_copy(frame):
            return
        view = MotionView(
            frame.stamp_ns,
            self.camera,
            corners.pyramid.levels[0],
            frame.depth_m,
            corners.pixel,
            corners.score,
            self._detected_mask,
        )
        self._motion.detect(view)

    def _is_copy(self, frame: RgbdFrame) -> bool:
        """Return whether a color image is repeated with new depth: static surface would move."""
        original = self._original
        if (
            original is not None
            and 0 < frame.stamp_ns - original.stamp_ns <= MAX_COPY_AGE_NS
            and _are_equal(frame.image_bgr, original.image_bgr)
            and not _are_equal(frame.depth_m, original.depth_m)
        ):
            self.counters['repeated color images'] += 1
            return True
        self._original = frame
        return False

    @property
    def needs_detections(self) -> bool:
        return self._strategy.needs_detections

    def is_motion_known(self, stamp_ns: int) -> bool:
        """Return whether motion at this stamp is segmented already, or need not be."""
        if self._motion is None or not self._motion_rate.is_due(stamp_ns):
            return True
        return self._motion.has_result(stamp_ns)

    def select_and_describe(
        self,
        detected: DetectedCorners,
        detections: Detections | None,
        *,
        for_picture: bool = False,
    ) -> FilterResult:
        """Return the features on static surface and all objects; arguments as in `process`.

        It uses the moving regions of the newest segmented image, and stores the mask of detected
        dynamic objects for `detect_motion`.
        """
        frame, corners, corners_s = detected
        start_s = time.perf_counter()
        verdict = self._classify(frame.stamp_ns, detections, frame.depth_m, corners.pixel)
        self._detected_mask = verdict.detected_mask
        classified_s = time.perf_counter()
        chosen = self._extractor.choose(corners, verdict.kept, verdict.static_area_px)
        is_dynamic = [reason is not ObjectState.AT_REST for reason in verdict.objects.reasons]
        dynamic_xyxy_px = verdict.objects.boxes_xyxy_px[is_dynamic]
        features = self._extractor.describe(
            corners, chosen, frame.depth_m, frame.stamp_ns, dynamic_xyxy_px
        )
        done_s = time.perf_counter()
        return FilterResult(
            features=features,
            objects=self._objects(verdict.objects, frame.size_px),
            removed_uv_px=self._removed(corners, verdict, for_picture),
            num_features_in=len(corners),
            num_removed=0 if verdict.kept is None else len(corners) - len(verdict.kept),
            stage_ms={
                'extract': (corners_s + done_s - classified_s) * 1e3,
                'filter': (classified_s - start_s) * 1e3,
            },
        )

    def reevaluate(
        self,
        features: Features,
        depth_m: Float32Array,
        detections: Detections | None,
    ) -> FinalVerdict:
        """Classify an image again, with newer detections and motion, and return the result.

        `features` are the result of `select_and_describe` for the image, at most a second ago.
        `detections` belong to the image, or to the nearest image that has any; None: those given
        before.
        """
        height, width = depth_m.shape
        u, v = np.rint(features.uv_px).astype(np.int64).T
        pixels = np.clip(v, 0, height - 1) * width + np.clip(u, 0, width - 1)
        verdict = self._classify(features.stamp_ns, detections, depth_m, pixels)
        is_dynamic = np.zeros(len(features), np.bool_)
        if verdict.kept is not None:
            is_dynamic[:] = True
            is_dynamic[verdict.kept] = False
        return FinalVerdict(
            self._objects(verdict.objects, (width, height)),
            FeatureVerdicts(features.stamp_ns, is_dynamic),
            verdict,
        )

    def _classify(
        self,
        stamp_ns: int,
        detections: Detections | None,
        depth_m: Float32Array,
        corner_pixels: IntArray,
    ) -> Verdict:
        height, width = depth_m.shape
        if detections is not None:
            valid = sanitize(detections, width, height, self._config.max_detections)
            self.counters['boxes refused'] += valid.num_refused
            self.counters['boxes clipped'] += valid.num_clipped
            detections = valid.detections
        moving = NO_MOVING_REGIONS if self._motion is None else self._motion.regions_at(stamp_ns)
        image = FilterInput(stamp_ns, detections, depth_m, corner_pixels, moving)
        return self._strategy.classify(image)

    def _removed(self, corners: Corners, verdict: Verdict, wanted: bool) -> Float32Array:
        """Return the pixels (N, 2) of features that the filter removed; empty if not `wanted`."""
        if not wanted or verdict.kept is None:
            return np.empty((0, 2), np.float32)
        chosen = self._extractor.choose(corners, None, corners.pyramid.levels[0].size)
        removed = np.setdiff1d(chosen, verdict.kept, assume_unique=True)
        return corners.uv_px[removed].astype(np.float32)

    def _objects(
        self, found: ObjectVerdicts, size_px: tuple[int, int]
    ) -> tuple[DynamicObject, ...]:
        boxes = found.boxes_xyxy_px.astype(np.float64)
        centers = np.full((len(boxes), 3), np.nan)
        sizes = np.full((len(boxes), 2), np.nan)
        if self.camera is not None and self.camera.size_px == size_px:
            focal_px = np.array([self.camera.fx_px, self.camera.fy_px])
            principal_px = np.array([self.camera.cx_px, self.camera.cy_px])
            imaged_px = ((boxes[:, :2] + boxes[:, 2:]) / 2).astype(np.float32)
            middle_px = self.camera.undistort_px(imaged_px)
            centers[:, :2] = (middle_px - principal_px) / focal_px * found.depths_m[:, None]
            centers[:, 2] = found.depths_m
            sizes = (boxes[:, 2:] - boxes[:, :2]) / focal_px * found.depths_m[:, None]
        rows = zip(
            found.class_names,
            map(tuple, boxes.tolist()),
            found.scores.tolist(),
            found.track_ids.tolist(),
            found.reasons,
            found.overlap_ratios.tolist(),
            found.depth_gaps_m.tolist(),
            map(tuple, centers.tolist()),
            map(tuple, sizes.tolist()),
            map(tuple, found.velocities_mps.tolist()),
            strict=True,
        )
        return tuple(DynamicObject(*row) for row in rows)


def _are_equal(a: np.ndarray, b: np.ndarray) -> bool:
    # Chosen: compare every 64th row first; different images differ in most rows.
    few = slice(None, None, 64)
    return np.array_equal(a[few], b[few]) and np.array_equal(a, b)


def check_sizes(frame: RgbdFrame) -> None:
    if frame.image_bgr.shape[:2] != frame.depth_m.shape:
        raise MessageError(
            f'depth image is {frame.depth_m.shape[1]}x{frame.depth_m.shape[0]} but color is '
            f'{frame.image_bgr.shape[1]}x{frame.image_bgr.shape[0]}: register depth to color'
        )
