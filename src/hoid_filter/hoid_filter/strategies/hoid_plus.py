"""The strategy `hoid+`: the HOID paper's rules on tracked boxes, masks limited by depth."""

from __future__ import annotations

import numpy as np

from hoid_common.values import PERSON, BoolArray, ByteArray, Detections, Float32Array, ObjectState
from hoid_filter.config import FilterConfig
from hoid_filter.detections.sanitize import areas_px2
from hoid_filter.detections.tracks import BoxTracker
from hoid_filter.motion.moving_regions import MovingRegions
from hoid_filter.strategies.dynamic_mask import (
    STRIDE_PX,
    mask_objects,
    masked,
    subsample,
    subsampled_pixels,
)
from hoid_filter.strategies.interaction import (
    Interactions,
    TrackSnapshot,
    classify_interactions,
)
from hoid_filter.strategies.motion_only import moving_objects
from hoid_filter.strategy import FilterInput, ObjectVerdicts, Verdict
from hoid_native import box_center_depths_m, person_depths_m

# Chosen: a moving region with a larger ratio on detected dynamic objects is a part of them, and is
# not reported as another object.
_MAX_DETECTED_RATIO = 0.5


class HoidPlus:
    """Tracks people and objects, and masks those pixels of dynamic objects that depth confirms.

    With `motion.enabled`, it also masks all moving regions.
    """

    needs_detections = True

    def __init__(self, config: FilterConfig) -> None:
        self._config = config
        self.senses_motion = config.motion.enabled
        self._tracker = BoxTracker(config)

    def classify(self, image: FilterInput) -> Verdict:
        plus = self._config.plus
        if image.detections is not None:
            unsure = self._unsure(
                image.detections, image.depth_m.size, are_blurred=self._turns_fast(image)
            )
            self._tracker.observe(image.detections, unsure)
        low_depth_m = subsample(image.depth_m)
        snapshot = self._snapshot(image, low_depth_m)
        found = classify_interactions(snapshot, self._config)
        detected_mask = mask_objects(snapshot, found.reasons, low_depth_m, plus)
        label = image.moving_regions.label_at(subsampled_pixels(image.depth_m.shape))
        undetected = _undetected(image.moving_regions, label, detected_mask)
        objects = _tracked_objects(snapshot, found).joined(moving_objects(undetected))
        return masked(detected_mask | (label > 0), image, objects, detected_mask)

    def _unsure(
        self, detections: Detections, image_area_px2: int, *, are_blurred: bool
    ) -> BoolArray:
        """Return (N,) which people are doubtful: low score, and a large box or `are_blurred`.

        Such detections are often false, and depth does not reveal it: at arm's length a desk is as
        wide as a person.
        """
        plus = self._config.plus
        is_suspicious = np.full(len(detections), are_blurred)
        if plus.doubt_large_people:
            max_area_px2 = plus.doubt_area * image_area_px2
            is_suspicious |= areas_px2(detections.boxes_xyxy_px) > max_area_px2
        if not is_suspicious.any():
            return is_suspicious
        is_weak = detections.scores < plus.doubt_score
        is_person = np.array([name == PERSON for name in detections.class_names], np.bool_)
        return is_suspicious & is_weak & is_person

    def _turns_fast(self, image: FilterInput) -> bool:
        plus = self._config.plus
        turn_radps = image.moving_regions.camera_turn_radps
        return plus.doubt_in_turns and turn_radps > plus.doubt_turn_radps

    def _snapshot(self, image: FilterInput, low_depth_m: Float32Array) -> TrackSnapshot:
        """Return the tracks and their depths at the stamp of the image."""
        height, width = image.depth_m.shape
        if self._turns_fast(image):
            self._tracker.drop_missed()
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
    """Return the moving regions that lie mostly outside the mask of detected objects.

    `label` (h, w) is 1 + the index of the region at each pixel, or 0 outside all regions.
    """
    area = np.bincount(label.ravel(), minlength=len(regions.depths_m) + 1)[1:]
    detected_area = np.bincount(label[detected_mask], minlength=len(area) + 1)[1:]
    return regions.select(np.flatnonzero(detected_area < _MAX_DETECTED_RATIO * area))


def _tracked_objects(snapshot: TrackSnapshot, found: Interactions) -> ObjectVerdicts:
    tracks = snapshot.tracks
    reported = [
        n
        for n, track in enumerate(tracks)
        if not track.is_missed or found.reasons[n] is not ObjectState.AT_REST
    ]
    return ObjectVerdicts.of(
        snapshot.boxes_xyxy_px[reported].astype(np.float32),
        tuple(tracks[n].class_name for n in reported),
        np.array([tracks[n].score for n in reported], np.float32),
        tuple(found.reasons[n] for n in reported),
        track_ids=np.array([tracks[n].track_id for n in reported], np.int64),
        overlap_ratios=found.overlap_ratios[reported],
        depths_m=snapshot.depths_m[reported],
        depth_gaps_m=found.depth_gaps_m[reported],
    )
