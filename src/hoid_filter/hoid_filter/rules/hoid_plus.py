"""The strategy `hoid+`: the HOID rules with a memory, a sense of depth, and a way out."""

from __future__ import annotations

import numpy as np

from hoid_common.values import PERSON, BoolArray, ByteArray, Detections, Float32Array, Reason
from hoid_filter.config import FilterConfig
from hoid_filter.detections.aligned_detections import FilterInput, Verdict, joined
from hoid_filter.detections.overlap import areas_px2
from hoid_filter.detections.tracks import BoxTracker, Patience
from hoid_filter.motion.moving_regions import Moving
from hoid_filter.rules.depth_regions import SHRINK, shrink, small_pixels
from hoid_filter.rules.dynamic_mask import (
    Masks,
    dynamic_confidence_mask,
    make_masks,
    moving_confidence,
)
from hoid_filter.rules.interaction import Interactions, TrackSnapshot, judge_interactions
from hoid_filter.rules.motion_only import moving_verdict
from hoid_native import sample_depths_m, torso_depths_m

_KNOWN_SHARE = 0.5  # of what moves that is on something detected: it has been told already


class HoidPlus:
    """Follows people and objects over time and masks those that move, no more than needed."""

    def __init__(self, config: FilterConfig) -> None:
        self._config = config
        plus = config.plus
        coast_s = plus.coast_s if plus.bridge_misses else 0.0
        self._tracker = BoxTracker(
            Patience(config.prediction_limit_s, coast_s, plus.rest_s, plus.doubt_detections)
        )

    def judge(self, view: FilterInput) -> Verdict:
        """Return the verdict on what is detected, and on what is predicted to move (last)."""
        plus = self._config.plus
        self._observe(view)
        small_depth_m = shrink(view.depth_m)
        snapshot = self._snapshot(view, small_depth_m)
        found = judge_interactions(snapshot, self._config)
        confidence = dynamic_confidence_mask(snapshot, found.reasons, small_depth_m, plus)
        detected = confidence > 0
        moving = self._undetected(view, confidence)
        enough = plus.min_static_share * self._config.extraction.num_features
        masks = make_masks(confidence, view, plus, enough)
        verdict = _verdict(snapshot, found, masks)._replace(detected=detected)
        return joined(verdict, moving_verdict(moving, masks))

    def _undetected(self, view: FilterInput, confidence: ByteArray) -> Moving:
        """Return what moves and was not detected; what moves is added to the confidence (h, w).

        A region mostly on what is known to move is a part of it and stands not for itself.
        """
        moving = view.moving
        label = moving.label_at(small_pixels(view.depth_m.shape))
        area = np.bincount(label.ravel(), minlength=len(moving.depths_m) + 1)[1:]
        known = np.bincount(label[confidence > 0], minlength=len(area) + 1)[1:]
        np.maximum(confidence, moving_confidence(label), out=confidence)
        return moving.select(np.flatnonzero(known < _KNOWN_SHARE * area))

    def _observe(self, view: FilterInput) -> None:
        if view.detections is not None:
            self._tracker.observe(
                view.detections, self._doubtful(view.detections, view.depth_m.size)
            )

    def _doubtful(self, detections: Detections, image_area_px2: int) -> BoolArray:
        """Return the (N,) flags of weak people over most of the image.

        Their depth is no witness: at arm's length a desk is as wide as a person.
        """
        plus = self._config.plus
        if not plus.doubt_large_people:
            return np.zeros(len(detections), np.bool_)
        large = areas_px2(detections.boxes_xyxy_px) > plus.doubt_area * image_area_px2
        if not large.any():
            return large
        weak = detections.scores < plus.doubt_score
        is_person = np.array([name == PERSON for name in detections.class_names], np.bool_)
        return large & weak & is_person

    def _snapshot(self, view: FilterInput, small_depth_m: Float32Array) -> TrackSnapshot:
        height, width = view.depth_m.shape
        tracks, boxes = self._tracker.advance(view.stamp_ns, width, height)
        depths_m = sample_depths_m(view.depth_m, boxes, self._config.sample_box_px)
        people = [n for n, track in enumerate(tracks) if track.is_person]
        known_m = np.array([tracks[n].torso_m for n in people])
        depths_m[people] = torso_depths_m(small_depth_m, boxes[people] / SHRINK, known_m)
        for n in people:
            tracks[n].torso_m = float(depths_m[n])
        return TrackSnapshot(view.stamp_ns, tracks, boxes, depths_m)


def _verdict(snapshot: TrackSnapshot, found: Interactions, masks: Masks) -> Verdict:
    """Return what is seen or dynamic; a static object that was missed is not reported."""
    tracks = snapshot.tracks
    shown = [
        n
        for n, track in enumerate(tracks)
        if not track.missed or found.reasons[n] is not Reason.STATIC
    ]
    return Verdict(
        boxes_xyxy_px=snapshot.boxes_xyxy_px[shown].astype(np.float32),
        class_names=tuple(tracks[n].class_name for n in shown),
        scores=np.array([tracks[n].score for n in shown], np.float32),
        track_ids=np.array([tracks[n].track_id for n in shown], np.int64),
        reasons=tuple(found.reasons[n] for n in shown),
        overlap_ratios=found.overlap_ratios[shown],
        depths_m=snapshot.depths_m[shown],
        depth_gaps_m=found.depth_gaps_m[shown],
        static_area_px=masks.static_area_px,
        kept=masks.kept,
        seeds=masks.seeds,
        fallback_step=masks.step,
        moves=masks.moves,
    )
