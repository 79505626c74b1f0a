"""A place index in a package of its own: compares an image with every keyframe."""

import numpy as np

from hoid_common.values import ByteArray
from rgbd_slam.config.place_config import IndexConfig
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.model.keyframes import NO_POINT
from rgbd_slam.places.place_index import PlaceVotes


class ExhaustiveIndex:
    """Counts the descriptors of an image that are similar to one of a keyframe."""

    def __init__(self, config: IndexConfig) -> None:
        self._max_hamming = config.max_hamming
        self._descriptors: dict[int, ByteArray] = {}  # (N, 32) by uid of the keyframe

    def update(self, atlas: Atlas) -> None:
        """Copy the descriptors of the map points that each keyframe of the map observes."""
        keyframes = atlas.keyframes
        self._descriptors = {
            int(keyframes.uid[i]): keyframes.descriptors[
                i, keyframes.point_of_feature[i] != NO_POINT
            ]
            for i in keyframes.indices()
        }

    def query(self, descriptors: ByteArray) -> PlaceVotes:
        """Return the keyframes that match descriptors (N, 32), most votes first."""
        uids = np.array(list(self._descriptors), np.int64)
        votes = np.array([self._votes(descriptors, uid) for uid in self._descriptors], np.int64)
        order = np.argsort(-votes, kind='stable')
        return PlaceVotes(uids[order], votes[order])

    def _votes(self, descriptors: ByteArray, uid: int) -> int:
        different_bits = descriptors[:, None] ^ self._descriptors[uid]  # (N, M, 32)
        distances = np.bitwise_count(different_bits).sum(axis=2)
        return int((distances.min(axis=1, initial=256) <= self._max_hamming).sum())
