"""The interface of place indices, and the registry that selects one by name.

To add an index, for example of learned descriptors, implement `PlaceIndex` in a class and declare
an entry point in the group `rgbd_slam.place_indices`.
"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import entry_points
from typing import NamedTuple, Protocol, cast

from hoid_common.errors import ConfigError
from hoid_common.values import ByteArray, IntArray
from rgbd_slam.config.place_config import IndexConfig
from rgbd_slam.model.atlas import Atlas

ENTRY_POINT_GROUP = 'rgbd_slam.place_indices'
PLACE_INDICES = {'hash': 'rgbd_slam.places.hash_index:HashIndex'}


class PlaceVotes(NamedTuple):
    """Keyframes that resemble an image, the most similar first."""

    uids: IntArray  # (K,)
    votes: IntArray  # (K,) number of features of the image that support each keyframe


class PlaceIndex(Protocol):
    """Finds the keyframes of a map that resemble an image."""

    def __init__(self, config: IndexConfig) -> None: ...

    def update(self, atlas: Atlas) -> None:
        """Add new keyframes of a map, and remove those that are not in the map any more.

        All work for new keyframes is done here, so that `query` is fast.
        """

    def query(self, descriptors: ByteArray) -> PlaceVotes:
        """Return the keyframes that resemble an image with descriptors (N, 32), with votes."""


def make_place_index(name: str, config: IndexConfig) -> PlaceIndex:
    """Return an empty place index of the kind `name`; ConfigError if there is no such kind."""
    names = {point.name: point.value for point in entry_points(group=ENTRY_POINT_GROUP)}
    names |= PLACE_INDICES
    if name not in names:
        raise ConfigError(f'no place index is called "{name}"; there are {", ".join(names)}')
    module, class_name = names[name].split(':')
    return cast('type[PlaceIndex]', getattr(import_module(module), class_name))(config)
