"""Choice of topics of a bag: those of an RGB-D recording, and those that a user names."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from hoid_bags.bag import bag_types as types
from hoid_bags.bag.bag_reader import BagMessage, BagReader, BagTopic
from hoid_bags.bag.image_messages import is_depth
from hoid_common import topics
from hoid_common.errors import InputError, MessageError

_COLOR_WORDS = ('rgb', 'color', 'colour')
_REGISTERED_WORDS = ('aligned', 'registered', 'to_color', 'to_rgb')
_SUFFIXES = ('/compressedDepth', '/compressed')
_IMAGES = (types.IMAGE, types.COMPRESSED_IMAGE)


class RecordedTopics(NamedTuple):
    """The topics of an RGB-D recording in a bag."""

    color: BagTopic
    depth: BagTopic
    camera_info: BagTopic | None
    ground_truth: BagTopic | None
    true_detections: BagTopic | None


def find_topics(reader: BagReader) -> RecordedTopics:
    """Return the topics of an RGB-D recording in a bag.

    They are found by the suite's names in any namespace, else by type and content.

    Raises:
        InputError: There are no color or no depth images, or several topics of one kind.
    """
    filled = [topic for topic in reader.topics if topic.num_messages]
    firsts = {t: next(reader.messages([t.name]), None) for t in filled if t.type_name in _IMAGES}
    images = [topic for topic, first in firsts.items() if first is not None]
    is_depth = {
        t.name: first is not None and _is_depth(first, t, reader.path)
        for t, first in firsts.items()
    }
    color = _choose(
        reader,
        'color',
        topics.RGB_IMAGE,
        _COLOR_WORDS,
        [t for t in images if not is_depth[t.name]],
    )
    depth = _choose(
        reader,
        'depth',
        topics.DEPTH_IMAGE,
        _REGISTERED_WORDS,
        [t for t in images if is_depth[t.name]],
    )
    return RecordedTopics(
        color,
        depth,
        _camera_info(color, [t for t in filled if t.type_name == types.CAMERA_INFO]),
        _named(filled, topics.GROUND_TRUTH, types.POSE_STAMPED),
        _named(filled, topics.TRUE_DETECTIONS, types.DETECTION_ARRAY),
    )


def base_name(topic: str) -> str:
    """Return the name of an image topic without the suffix of image_transport."""
    for suffix in _SUFFIXES:
        topic = topic.removesuffix(suffix)
    return topic


def topics_to_play(reader: BagReader, names: Sequence[str] = ()) -> tuple[BagTopic, ...]:
    """Return the topics with messages that have these names; without names, all but /clock.

    Args:
        reader: The bag.
        names: Names with or without leading slash.

    Raises:
        InputError: The bag lacks one of the names, or none of the topics has messages.
    """
    by_name = {topic.name: topic for topic in reader.topics}
    absolute = [f'/{name.lstrip("/")}' for name in names]
    for name in absolute:
        if name not in by_name:
            raise InputError(f'{reader.path}: has no topic "{name}"; see "hoid info"')
    absolute = absolute or [name for name in by_name if name != topics.CLOCK]
    filled = tuple(by_name[name] for name in absolute if by_name[name].num_messages)
    if not filled:
        raise InputError(f'{reader.path}: holds no messages to play')
    return filled


def _is_depth(first: BagMessage, topic: BagTopic, path: Path) -> bool:
    try:
        return is_depth(first.data, topic)
    except MessageError as error:
        raise InputError(f'{path}: {topic.name}: {error}') from error


def _choose(
    reader: BagReader, kind: str, name: str, words: Sequence[str], found: list[BagTopic]
) -> BagTopic:
    """Return the topic with the given name, else the only one, else the only one with a word."""
    if not found:
        raise InputError(reader.fault or f'{reader.path}: has no {kind} images')
    tests: tuple[Callable[[BagTopic], bool], ...] = (
        lambda topic: _is_called(base_name(topic.name), name),
        lambda _: True,
        lambda topic: any(word in topic.name.lower() for word in words),
    )
    for test in tests:
        passed = [topic for topic in found if test(topic)]
        if passed and len({base_name(topic.name) for topic in passed}) == 1:
            return min(passed, key=lambda topic: topic.type_name != types.IMAGE)
    names = ', '.join(topic.name for topic in found)
    raise InputError(
        f'{reader.path}: several topics could be {kind}: {names}; record one as "{name}" or alone'
    )


def _camera_info(color: BagTopic, found: list[BagTopic]) -> BagTopic | None:
    """Return the camera_info in the namespace of the color images, else the only one."""
    beside = base_name(color.name).rpartition('/')[0] + '/camera_info'
    at_place = [topic for topic in found if topic.name == beside]
    return at_place[0] if at_place else found[0] if len(found) == 1 else None


def _named(found: list[BagTopic], name: str, type_name: str) -> BagTopic | None:
    matching = [t for t in found if t.type_name == type_name and _is_called(t.name, name)]
    return matching[0] if len(matching) == 1 else None


def _is_called(topic: str, name: str) -> bool:
    return topic.endswith(f'/{name}')
