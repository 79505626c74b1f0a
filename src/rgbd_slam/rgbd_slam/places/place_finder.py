"""Search for the place of an image: candidates from the place index, verified by geometry."""

from __future__ import annotations

import logging
from typing import NamedTuple

import numpy as np

from hoid_common import se3
from hoid_common.values import S_PER_NS, ByteArray, IntArray
from rgbd_slam.config.place_config import PlaceConfig
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.frame import Frame, StereoCamera
from rgbd_slam.model.map_tables import NEAR_SHARED
from rgbd_slam.model.trajectory import main_map
from rgbd_slam.places.geometric_verification import PlaceMatch, PlaceVerifier
from rgbd_slam.places.place_index import PlaceIndex, make_place_index
from rgbd_slam.places.pose_hint import PoseHint

_logger = logging.getLogger(__name__)

_AMBIGUOUS_M = 0.3  # not tuned: verified poses that are farther apart are two places


class FoundPlace(NamedTuple):
    """A verified place, and the candidate keyframe that was verified."""

    keyframe: int  # row of the candidate
    match: PlaceMatch


class Candidate(NamedTuple):
    """A keyframe that resembles an image, and the result of their comparison, for the log."""

    stamp_ns: int  # stamp of the image
    place_stamp_ns: int  # stamp of the keyframe
    # Whether the keyframe is in another map than that in which the image is tracked.
    is_in_other_map: bool
    doubt: str  # why the image does not show this place; the kind of reason comes before a colon

    def __str__(self) -> str:
        where = ', in another map' if self.is_in_other_map else ''
        return (
            f'image {S_PER_NS * self.stamp_ns:.3f} and keyframe '
            f'{S_PER_NS * self.place_stamp_ns:.3f}{where}: {self.doubt or "the same place"}'
        )


class PlaceFinder:
    """Finds and verifies places in a map, without changing it.

    Raises:
        ConfigError: No place index has the configured name.
    """

    def __init__(self, atlas: Atlas, camera: StereoCamera, config: PlaceConfig, seed: int) -> None:
        self._atlas = atlas
        self._config = config.verification
        self._index_config = config.index
        self._index = make_place_index(config.index.method, config.index)
        self.verifier = PlaceVerifier(atlas, camera, config.verification, seed)

    def index_of(self, atlas: Atlas) -> PlaceIndex:
        """Return a new place index of another map; any thread may call this."""
        index = make_place_index(self._index_config.method, self._index_config)
        index.update(atlas)
        return index

    def use_index(self, index: PlaceIndex) -> None:
        """Use an index from `index_of`, because its map has replaced the running map."""
        self._index = index

    def index_places(self) -> None:
        """Index new keyframes, and remove those that are not in the map any more."""
        self._index.update(self._atlas)

    def candidates(self, descriptors: ByteArray, excluded: IntArray) -> list[int]:
        """Return the rows of the keyframes most similar to an image's descriptors (N, 32).

        Of keyframes that share at least 15 points, only one is returned, and none in `excluded`.
        """
        self.index_places()
        keyframes = self._atlas.keyframes
        taken = set(excluded.tolist())
        chosen: list[int] = []
        found = self._index.query(descriptors)
        for uid, votes in zip(found.uids.tolist(), found.votes.tolist(), strict=True):
            if votes < self._config.min_votes or len(chosen) == self._config.max_candidates:
                break
            i = keyframes.index_of(uid)
            if i is not None and i not in taken:
                chosen.append(i)
                taken.update([i, *self._atlas.covisible(i, NEAR_SHARED).tolist()])
        return chosen

    def locate(self, frame: Frame, *, in_main_map: bool = False) -> FoundPlace | None:
        """Return the place of a frame in the map; None if none is found or it is ambiguous.

        With identical furniture, two distant places in one map may be verified with about as many
        points. Then neither is returned; a later frame that shows more may resolve the ambiguity.
        With `in_main_map`, only the main map is searched: other maps are not related to it.
        """
        keyframes, excluded = self._atlas.keyframes, np.empty(0, np.int64)
        if in_main_map:
            rows = keyframes.indices()
            excluded = rows[keyframes.map_id[rows] != main_map(keyframes)]
        return self._unambiguous_place(frame, excluded)

    def locate_near(self, frame: Frame, hint: PoseHint) -> FoundPlace | None:
        """Return the place of a frame near a hint of its pose in the main map; None if not found.

        First, map points are searched where the hint predicts them, which works if it is accurate
        to one or two degrees. If that fails, candidates of the index near the hint are verified.
        The found pose must be near the hint too (`PoseHint.reaches`).
        """
        keyframes = self._atlas.keyframes
        rows = keyframes.indices()
        T_map_camera = keyframes.T_map_camera[rows]
        is_near = hint.reaches(T_map_camera) & (keyframes.map_id[rows] == main_map(keyframes))
        if not is_near.any():
            return None
        # 1 m counts as much as 1 rad.
        nearest = np.argsort(hint.distances(T_map_camera[is_near]).sum(0))
        around = rows[is_near][nearest[: 1 + self._config.neighbors]]
        match = self.verifier.search(frame, se3.inverse(hint.T_map_camera), around)
        if match is not None:
            place: FoundPlace | None = FoundPlace(int(around[0]), match)
        else:
            place = self._unambiguous_place(frame, rows[~is_near])
        is_near_hint = place is not None and hint.reaches(place.match.T_map_camera[None])[0]
        return place if is_near_hint else None

    def _unambiguous_place(self, frame: Frame, excluded: IntArray) -> FoundPlace | None:
        """Return the verified place with most inliers; None if another has about as many."""
        candidates = self.candidates(frame.descriptors, excluded)
        places = []
        for i in candidates:
            match = self.verifier.verify(frame, i)
            place_stamp_ns = int(self._atlas.keyframes.stamp_ns[i])
            found = Candidate(frame.stamp_ns, place_stamp_ns, True, self.verifier.doubt)
            _logger.debug('%s', found)
            if match is not None:
                places.append(FoundPlace(i, match))
        if not places:
            return None
        best = max(places, key=lambda place: len(place.match.k))
        is_ambiguous = any(self._are_ambiguous(place, best) for place in places)
        return None if is_ambiguous else best

    def _are_ambiguous(self, a: FoundPlace, b: FoundPlace) -> bool:
        """Return whether `a` is not at the best place `b`, but has about as many inliers."""
        map_id = self._atlas.keyframes.map_id
        if a is b or map_id[a.keyframe] != map_id[b.keyframe]:
            return False
        distance_m = np.linalg.norm(a.match.position_m - b.match.position_m)
        has_support = len(a.match.k) > self._config.max_second_place_share * len(b.match.k)
        return bool(has_support and distance_m > _AMBIGUOUS_M)
