"""From an image to the keyframes that may show its place, one for each place."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import ByteArray, IntArray
from rgbd_slam.config.place_config import PlaceConfig
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera
from rgbd_slam.model.trajectory import main_map
from rgbd_slam.places.geometric_verification import PlaceMatch, PlaceStatus, PlaceVerifier
from rgbd_slam.places.place_recognition import PlaceIndex
from rgbd_slam.places.pose_hint import PoseHint

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
        return self._clearest(frame, np.empty(0, np.int64))

    def locate_near(self, frame: Frame, hint: PoseHint) -> FoundPlace | None:
        """Return where near a pose of the main map a frame was taken, or None.

        First by what the map shows from that pose, which has to be good to a degree or two; then
        by places, of which only those within reach count: others may look the same.
        """
        keyframes = self._atlas.keyframes
        rows = keyframes.indices()
        T_map_camera = keyframes.T_map_camera[rows]
        is_near = hint.reaches(T_map_camera) & (keyframes.map_id[rows] == main_map(keyframes))
        if not is_near.any():
            return None
        nearest = np.argsort(hint.apart(T_map_camera[is_near]).sum(0))  # a metre is as a radian
        around = rows[is_near][nearest[: 1 + self._config.neighbours]]
        match = self.verifier.search(frame, se3.inverse(hint.T_map_camera), around)
        place: FoundPlace | None = FoundPlace(int(around[0]), match)
        if match.status is not PlaceStatus.SAME_PLACE:
            place = self._clearest(frame, rows[~is_near])
        return place if place is not None and hint.reaches(place.match.pose[None])[0] else None

    def _clearest(self, frame: Frame, excluded: IntArray) -> FoundPlace | None:
        tried = [
            FoundPlace(i, self.verifier.verify(frame, i))
            for i in self.candidates(frame.descriptors, excluded)
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
