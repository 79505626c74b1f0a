import numpy as np
import pytest

from hoid_common.values import ByteArray
from rgbd_slam.config.place_config import IndexConfig
from rgbd_slam.places.hash_index import HashIndex


def _descriptors(seed: int, count: int = 300) -> ByteArray:
    return np.random.default_rng(seed).integers(0, 256, (count, 32), dtype=np.uint8)


def _seen_again(descriptors: ByteArray, seed: int, flip: float = 0.06) -> ByteArray:
    """Return descriptors with bits flipped at random, as another view of the features has them."""
    flips = np.random.default_rng(seed).random((len(descriptors), 256)) < flip
    return descriptors ^ np.packbits(flips, axis=1)


def _index_of(num_places: int) -> HashIndex:
    index = HashIndex(IndexConfig())
    for uid in range(num_places):
        index.insert({uid: _descriptors(uid)})
    return index


def test_an_identical_image_gets_all_votes_and_strangers_none() -> None:
    votes = _index_of(40).query(_descriptors(17))
    assert votes.uids.tolist() == [17]
    assert votes.votes.tolist() == [300]


def test_a_noisy_view_finds_its_place_among_many() -> None:
    index = _index_of(60)
    for uid in (0, 31, 59):
        votes = index.query(_seen_again(_descriptors(uid), seed=1))
        assert votes.uids[0] == uid
        assert votes.votes[0] > 100


def test_votes_come_most_first_and_equal_ones_by_uid() -> None:
    index = HashIndex(IndexConfig())
    place = _descriptors(3)
    for uid, count in ((9, 100), (4, 300), (7, 100)):
        index.insert({uid: place[:count]})
    votes = index.query(place)
    assert votes.uids.tolist() == [4, 7, 9]
    assert votes.votes.tolist() == [300, 100, 100]


def test_a_removed_keyframe_is_not_found_before_and_after_merging() -> None:
    index = _index_of(5)
    index.query(_descriptors(2))
    index.remove(2)
    assert len(index.query(_descriptors(2)).uids) == 0
    for uid in range(10, 30):  # enough to make the segments join, which drops the removed rows
        index.insert({uid: _descriptors(uid)})
        index.query(_descriptors(uid))
    assert len(index.query(_descriptors(2)).uids) == 0
    assert index.query(_descriptors(4)).uids.tolist() == [4]


def test_removing_a_keyframe_that_was_never_queried_or_never_added() -> None:
    index = HashIndex(IndexConfig())
    index.insert({1: _descriptors(1)})
    index.remove(1)
    index.remove(2)
    assert len(index.query(_descriptors(1)).uids) == 0


def test_a_key_shared_by_too_many_descriptors_says_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(IndexConfig, 'max_bucket', 8)
    index = HashIndex(IndexConfig())
    common = np.tile(_descriptors(0, 1), (50, 1))
    index.insert({1: common})
    assert len(index.query(common).uids) == 0


def test_an_image_without_features_matches_nothing() -> None:
    assert len(_index_of(3).query(np.empty((0, 32), np.uint8)).uids) == 0


def test_more_features_than_the_limit_are_thinned_evenly() -> None:
    index = HashIndex(IndexConfig())
    place = _descriptors(0, 1000)
    index.insert({1: place})
    assert index.query(place).votes.tolist() == [IndexConfig.max_features]


def test_keyframes_added_at_once_are_found_as_those_added_one_by_one() -> None:
    at_once, one_by_one = _index_of(40), HashIndex(IndexConfig())
    for uid in range(40):
        one_by_one.insert({uid: _descriptors(uid)})
        one_by_one.query(_descriptors(uid))
    for uid in (0, 21, 39):
        seen = _seen_again(_descriptors(uid), seed=2)
        expected, found = at_once.query(seen), one_by_one.query(seen)
        np.testing.assert_array_equal(found.uids, expected.uids)
        np.testing.assert_array_equal(found.votes, expected.votes)
