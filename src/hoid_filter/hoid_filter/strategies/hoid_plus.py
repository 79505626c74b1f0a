"""The strategy `hoid+`: the paper's rules on tracked boxes, with memory and masks cut by depth."""

from __future__ import annotations

import numpy as np

from hoid_common.values import PERSON, BoolArray, ByteArray, Detections, Float32Array, Reason
from hoid_filter.config import FilterConfig
from hoid_filter.detections.overlap import areas_px2
from hoid_filter.detections.tracks import BoxTracker, TrackLimits
from hoid_filter.motion.moving_regions import MovingRegions
from hoid_filter.strategies.depth_regions import STRIDE_PX, subsample, subsampled_pixels
from hoid_filter.strategies.dynamic_mask import Mask, dilate_mask, mask_objects
from hoid_filter.strategies.interaction import (
    Interactions,
    TrackSnapshot,
    classify_interactions,
)
from hoid_filter.strategies.motion_only import moving_verdict
from hoid_filter.strategy import FilterInput, Verdict, append_objects
from hoid_native import box_center_depths_m, person_depths_m

# Chosen: a moving region that lies mostly on detected dynamic objects is no object of its own.
_MAX_DETECTED_SHARE = 0.5


class HoidPlus:
    """Tracks people and objects, and masks the dynamic ones no further than depth shows them."""

    needs_detections = True

    def __init__(self, config: FilterConfig) -> None:
        self._config = config
        self.senses_motion = config.motion.enabled
        plus = config.plus
        coast_s = plus.coast_s if plus.bridge_misses else 0.0
        self._tracker = BoxTracker(
            TrackLimits(config.prediction_limit_s, coast_s, plus.rest_s, plus.doubt_detections)
        )

    def classify(self, image: FilterInput) -> Verdict:
        """Return the verdict on tracked objects, followed by undetected moving regions."""
        plus = self._config.plus
        if image.detections is not None:
            unsure = self._unsure(image.detections, image.depth_m.size)
            self._tracker.observe(image.detections, unsure)
        low_depth_m = subsample(image.depth_m)
        snapshot = self._snapshot(image, low_depth_m)
        found = classify_interactions(snapshot, self._config)
        detected_mask = mask_objects(snapshot, found.reasons, low_depth_m, plus)
        label = image.moving_regions.label_at(subsampled_pixels(image.depth_m.shape))
        mask = dilate_mask(detected_mask | (label > 0), image)
        verdict = _verdict(snapshot, found, mask)._replace(detected_mask=detected_mask)
        undetected = _undetected(image.moving_regions, label, detected_mask)
        return append_objects(verdict, moving_verdict(undetected, mask))

    def _unsure(self, detections: Detections, image_area_px2: int) -> BoolArray:
        """Return the (N,) flags of people with a low score over most of the image.

        Depth does not reveal such a false detection: at arm's length a desk is as wide as a
        person.
        """
        plus = self._config.plus
        if not plus.doubt_large_people:
            return np.zeros(len(detections), np.bool_)
        is_large = areas_px2(detections.boxes_xyxy_px) > plus.doubt_area * image_area_px2
        if not is_large.any():
            return is_large
        is_weak = detections.scores < plus.doubt_score
        is_person = np.array([name == PERSON for name in detections.class_names], np.bool_)
        return is_large & is_weak & is_person

    def _snapshot(self, image: FilterInput, low_depth_m: Float32Array) -> TrackSnapshot:
        """Return the tracks at the stamp of the image, and update the torso depth of people."""
        height, width = image.depth_m.shape
        tracks, boxes = self._tracker.advance(image.stamp_ns, width, height)
        depths_m = box_center_depths_m(image.depth_m, boxes, self._config.sample_box_px)
        people = [n for n, track in enumerate(tracks) if track.is_person]
        previous_m = np.array([tracks[n].torso_m for n in people])
        depths_m[people] = person_depths_m(low_depth_m, boxes[people] / STRIDE_PX, previous_m)
        for n in people:
            tracks[n].torso_m = float(depths_m[n])
        return TrackSnapshot(image.stamp_ns, tracks, boxes, depths_m)


def _undetected(
    regions: MovingRegions, label: ByteArray, detected_mask: BoolArray
) -> MovingRegions:
    """Return the moving regions that lie mostly outside the detected dynamic objects.

    Args:
        regions: Of the image.
        label: (h, w) their labels at low resolution.
        detected_mask: (h, w), the detected dynamic objects.
    """
    area = np.bincount(label.ravel(), minlength=len(regions.depths_m) + 1)[1:]
    detected_area = np.bincount(label[detected_mask], minlength=len(area) + 1)[1:]
    return regions.select(np.flatnonzero(detected_area < _MAX_DETECTED_SHARE * area))


def _verdict(snapshot: TrackSnapshot, found: Interactions, mask: Mask) -> Verdict:
    """Return the verdict on all tracks but static ones that the detector missed."""
    tracks = snapshot.tracks
    reported = [
        n
        for n, track in enumerate(tracks)
        if not track.is_missed or found.reasons[n] is not Reason.STATIC
    ]
    return Verdict(
        boxes_xyxy_px=snapshot.boxes_xyxy_px[reported].astype(np.float32),
        class_names=tuple(tracks[n].class_name for n in reported),
        scores=np.array([tracks[n].score for n in reported], np.float32),
        track_ids=np.array([tracks[n].track_id for n in reported], np.int64),
        reasons=tuple(found.reasons[n] for n in reported),
        overlap_ratios=found.overlap_ratios[reported],
        depths_m=snapshot.depths_m[reported],
        depth_gaps_m=found.depth_gaps_m[reported],
        static_area_px=mask.static_area_px,
        kept=mask.kept,
        dynamic_mask=mask.is_dynamic,
    )
