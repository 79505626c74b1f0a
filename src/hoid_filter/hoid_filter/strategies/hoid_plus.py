"""The strategy `hoid+`: the paper's rules on tracked boxes, with memory and masks cut by depth."""

from __future__ import annotations

import numpy as np

from hoid_common.values import PERSON, BoolArray, ByteArray, Detections, Float32Array, Reason
from hoid_filter.config import FilterConfig
from hoid_filter.detections.overlap import areas_px2
from hoid_filter.detections.tracks import BoxTracker, TrackLimits
from hoid_filter.motion.moving_regions import MovingRegions
from hoid_filter.strategies.depth_regions import STRIDE_PX, subsample, subsampled_pixels
from hoid_filter.strategies.dynamic_mask import (
    Masks,
    dynamic_certainty,
    make_masks,
    moving_certainty,
)
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
        certainty = dynamic_certainty(snapshot, found.reasons, low_depth_m, plus)
        detected_mask = certainty > 0
        regions = self._add_undetected(image, certainty)
        min_corners = plus.min_static_share * self._config.extraction.num_features
        masks = make_masks(certainty, image, plus, min_corners)
        verdict = _verdict(snapshot, found, masks)._replace(detected_mask=detected_mask)
        return append_objects(verdict, moving_verdict(regions, masks))

    def _add_undetected(self, image: FilterInput, certainty: ByteArray) -> MovingRegions:
        """Return the moving regions that no detection covers, and add all moving pixels to a mask.

        Args:
            image: The image.
            certainty: (h, w) mask of the detected dynamic objects, which is changed.
        """
        regions = image.moving_regions
        label = regions.label_at(subsampled_pixels(image.depth_m.shape))
        area = np.bincount(label.ravel(), minlength=len(regions.depths_m) + 1)[1:]
        detected_area = np.bincount(label[certainty > 0], minlength=len(area) + 1)[1:]
        np.maximum(certainty, moving_certainty(label), out=certainty)
        return regions.select(np.flatnonzero(detected_area < _MAX_DETECTED_SHARE * area))

    def _unsure(self, detections: Detections, image_area_px2: int) -> BoolArray:
        """Return the (N,) flags of people with a low score over most of the image.

        Depth does not tell such a false detection: at arm's length a desk is as wide as a person.
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


def _verdict(snapshot: TrackSnapshot, found: Interactions, masks: Masks) -> Verdict:
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
        static_area_px=masks.static_area_px,
        kept=masks.kept,
        seeds=masks.seeds,
        fallback_step=masks.step,
        dynamic_mask=masks.dynamic,
    )
