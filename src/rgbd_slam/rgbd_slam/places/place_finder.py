"""From an image to the keyframes that may show its place, one for each place."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common.values import ByteArray, IntArray
from rgbd_slam.config.place_config import PlaceConfig
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera
from rgbd_slam.places.geometric_verification import PlaceMatch, PlaceStatus, PlaceVerifier
from rgbd_slam.places.place_recognition import PlaceIndex

NEAR_SHARED = 15  # points that make two keyframes neighbours
_RIVAL_M = 0.3  # poses further apart than this are two places


class FoundPlace(NamedTuple):
    """A verified place and the keyframe that led to it."""

    keyframe: int
    match: PlaceMatch


class PlaceFinder:
    """Finds and verifies places in a map that it does not change."""

    def __init__(self, atlas: Atlas, camera: StereoCamera, config: PlaceConfig, seed: int) -> None:
        self._atlas = atlas
        self._config = config.verification
        self._index = PlaceIndex(config.index)
        self.verifier = PlaceVerifier(atlas, camera, config.verification, seed)

    def candidates(self, descriptors: ByteArray, excluded: IntArray) -> list[int]:
        """Return keyframes that share most descriptors with an image, none near another.

        Args:
            excluded: keyframes that shall not count.
        """
        self._index.follow(self._atlas)
        keyframes = self._atlas.keyframes
        row_of = {int(keyframes.uid[i]): i for i in keyframes.indices().tolist()}
        taken = set(excluded.tolist())
        chosen: list[int] = []
        found = self._index.query(descriptors)
        for uid, votes in zip(found.uids.tolist(), found.votes.tolist(), strict=True):
            if votes < self._config.min_votes or len(chosen) == self._config.max_candidates:
                break
            i = row_of[uid]
            if i not in taken:
                chosen.append(i)
                taken.update([i, *self._atlas.covisible(i, NEAR_SHARED).tolist()])
        return chosen

    def locate(self, frame: Frame) -> FoundPlace | None:
        """Return where in the map a frame was taken, or None when that is unknown or not clear.

        Identical furniture fits in two places: then neither is believed, and a later frame
        that shows more will decide.
        """
        nothing = np.empty(0, np.int64)
        tried = [
            FoundPlace(i, self.verifier.verify(frame, i))
            for i in self.candidates(frame.descriptors, nothing)
        ]
        places = [place for place in tried if place.match.status is PlaceStatus.SAME_PLACE]
        if not places:
            return None
        best = max(places, key=lambda place: len(place.match.k))
        rivals = [place for place in places if self._are_rivals(place, best)]
        return None if rivals else best

    def _are_rivals(self, a: FoundPlace, b: FoundPlace) -> bool:
        map_id = self._atlas.keyframes.map_id
        if a is b or map_id[a.keyframe] != map_id[b.keyframe]:
            return False
        apart_m = np.linalg.norm(a.match.position_m - b.match.position_m)
        enough = len(a.match.k) > self._config.max_rival_share * len(b.match.k)
        return bool(enough and apart_m > _RIVAL_M)
