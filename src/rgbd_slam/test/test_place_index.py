"""A further place index needs one file and one entry in the registry."""

import numpy as np
import pytest

from hoid_common.errors import ConfigError
from hoid_common.slam_status import SlamState
from hoid_common.values import ByteArray
from rgbd_slam.config.place_config import IndexConfig, PlaceConfig
from rgbd_slam.config.slam_config import SlamConfig
from rgbd_slam.model.atlas import Atlas
from rgbd_slam.places.place_index import PLACE_INDICES, PlaceVotes, make_place_index
from rgbd_slam.slam import RgbdSlam

from .world import CAMERA, PERIOD_NS, World


class FirstKeyframe:
    """Proposes the first keyframe for every image."""

    num_queries = 0

    def __init__(self, config: IndexConfig) -> None:
        del config

    def update(self, atlas: Atlas) -> None:
        self._uids = atlas.keyframes.uid[atlas.keyframes.indices()]

    def query(self, descriptors: ByteArray) -> PlaceVotes:
        type(self).num_queries += 1
        return PlaceVotes(self._uids[:1], np.array([len(descriptors)]))


def test_an_index_of_the_registry_finds_a_lost_camera(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(PLACE_INDICES, 'first', f'{__name__}:FirstKeyframe')
    config = SlamConfig(places=PlaceConfig(index=IndexConfig(method='first')))
    slam, world = RgbdSlam(CAMERA, config), World()
    slam.process(world.features(0, np.eye(4)))
    assert slam.process(world.features(PERIOD_NS, np.eye(4)).select(np.arange(0))).state is (
        SlamState.LOST
    )
    later_ns = 30 * PERIOD_NS  # too late for a prediction
    assert slam.process(world.features(later_ns, np.eye(4))).state is SlamState.TRACKING
    assert FirstKeyframe.num_queries > 0


def test_an_unknown_index_is_refused_with_the_known_names() -> None:
    with pytest.raises(ConfigError, match='no place index is called "words"; there are hash'):
        make_place_index('words', IndexConfig())
