"""Choice of the topics of a bag: the topics of an RGB-D recording, or topics that a user names.

`ros2 bag record -a` leaves every topic of a driver: each image in several encodings, infrared and
unregistered depth beside the usable images, and images that other nodes draw. The choice follows
what the messages contain and what the drivers call them.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from itertools import takewhile
from typing import Any, NamedTuple

from hoid_bags.bag.bag_reader import BagReader
from hoid_bags.bag.contents import BagTopic
from hoid_bags.bag.image_messages import ImageHead, image_head
from hoid_bags.storage import bag_types as types
from hoid_common import topics
from hoid_common.camera_topics import CAMERA_TOPICS, CameraTopics
from hoid_common.errors import InputError, MessageError

_LOG = logging.getLogger(__name__)
_IMAGES = (types.IMAGE, types.COMPRESSED_IMAGE)
_COLOR_WORDS = ('rgb', 'color', 'colour')
_REGISTERED_WORDS = ('aligned', 'registered', 'to_color', 'to_rgb')
# Parts of the names of topics whose images are no color images of the scene, or into which
# something is drawn.
_OTHER_COLOR_WORDS = (
    'infra', '/ir', 'mono', 'fisheye', 'depth', 'disparity', 'confidence', 'debug', 'overlay',
    'mask', 'detection', 'annotated', 'result',
)  # fmt: skip
_OTHER_DEPTH_WORDS = (
    'confidence', 'disparity', 'debug', 'static_depth', 'mask', 'infra', '/ir', 'amplitude',
)  # fmt: skip
_RECTIFIED = 'rect'
_VIEWER_IMAGE = '/image/data'
_OWN = (CAMERA_TOPICS['bag'],)  # the suite's own names, which come before those of a driver


class TopicChoice(NamedTuple):
    """Topics that a user names; `find_topics` chooses the topics whose names are empty."""

    color: str = ''
    depth: str = ''
    camera_info: str = ''
    preset: str = ''  # driver whose topic names are preferred, a key of `CAMERA_TOPICS`; '': any


class RecordedTopics(NamedTuple):
    """The topics of an RGB-D recording in a bag; None: there is no such topic, or no clear one."""

    color: BagTopic
    depth: BagTopic
    camera_info: BagTopic | None
    ground_truth: BagTopic | None
    true_detections: BagTopic | None
    # What registers depth to color: the camera of depth, and where it is.
    depth_info: BagTopic | None = None
    static_frames: BagTopic | None = None
    extrinsics: BagTopic | None = None  # realsense2_camera's depth_to_color

    def __str__(self) -> str:
        info = self.camera_info.name if self.camera_info else 'none'
        return f'color {self.color.name}, depth {self.depth.name}, camera_info {info}'


class _Image(NamedTuple):
    topic: BagTopic
    head: ImageHead

    @property
    def base(self) -> str:
        return topics.image_base(self.topic.name)


def find_topics(
    reader: BagReader,
    choice: TopicChoice = TopicChoice(),  # noqa: B008 - immutable
) -> RecordedTopics:
    """Return the topics of an RGB-D recording in a bag.

    Args:
        choice: Topics that the user names. The others are chosen by the type of their messages,
            the names that drivers use, and the size of the images.

    Raises:
        InputError: There are no color or no depth images, a named topic is missing, or several
            topics are equally likely.
    """
    filled = [topic for topic in reader.topics if topic.num_messages and topic.is_readable]
    sources = {part.source for part in reader.parts}
    filled = [t for t in filled if t.name not in sources] + list(reader.parts)
    images, problems = _images(reader, [t for t in filled if t.type_name in _IMAGES])
    colors = [image for image in images if not image.head.is_depth]
    depths = [image for image in images if image.head.is_depth]
    presets = [CAMERA_TOPICS[choice.preset]] if choice.preset else list(CAMERA_TOPICS.values())
    problem = reader.fault or (problems[0] if problems else None)
    color = _color(reader, choice.color, colors, depths, presets, problem)
    depth = _depth(reader, choice.depth, depths, color, presets, problem)
    infos = [t for t in filled if t.type_name == types.CAMERA_INFO]
    info = _named_topic(reader, choice.camera_info, infos) or _camera_info(color, infos, presets)
    return RecordedTopics(
        color.topic,
        depth.topic,
        info,
        _truth(filled, topics.GROUND_TRUTH, types.POSE_STAMPED),
        _truth(filled, topics.TRUE_DETECTIONS, types.DETECTION_ARRAY),
        _depth_info(depth, [topic for topic in infos if topic != info], presets),
        _truth(filled, topics.TF_STATIC.lstrip('/'), types.TF_MESSAGE),
        _truth(filled, 'extrinsics/depth_to_color', types.EXTRINSICS),
    )


def topics_to_play(reader: BagReader, names: Sequence[str] = ()) -> tuple[BagTopic, ...]:
    """Return those of the named topics that have messages.

    Args:
        names: Names of topics, with or without leading slash; empty: all topics except /clock
            and, with a warning, those of a ROS 1 bag whose types ROS 2 lacks.

    Raises:
        InputError: The bag lacks one of the topics, ROS 2 lacks its type, or none of them has
            messages.
    """
    by_name = {topic.name: topic for topic in reader.topics}
    absolute = [f'/{name.lstrip("/")}' for name in names]
    for name in absolute:
        if name not in by_name:
            raise InputError(f'{reader.path}: has no topic "{name}"; see "hoid info"')
        if not by_name[name].is_readable:
            raise InputError(f'{reader.path}: {_unreadable_text([by_name[name]])}')
    chosen = [by_name[name] for name in absolute]
    chosen = chosen or [topic for topic in readable_topics(reader) if topic.name != topics.CLOCK]
    if filled := tuple(topic for topic in chosen if topic.num_messages):
        return filled
    raise InputError(f'{reader.path}: holds no messages to play')


def readable_topics(reader: BagReader) -> list[BagTopic]:
    """Return the topics of a bag that can be read; a warning names the types of the others."""
    if left_out := [topic for topic in reader.topics if not topic.is_readable]:
        _LOG.warning('%s: %s', reader.path, _unreadable_text(left_out))
    return [topic for topic in reader.topics if topic.is_readable]


def _unreadable_text(found: Sequence[BagTopic]) -> str:
    kinds = sorted({topic.type_name for topic in found})
    return f'{len(found)} topics left out, whose types ROS 2 lacks: {", ".join(kinds)}'


def _images(reader: BagReader, found: list[BagTopic]) -> tuple[list[_Image], list[str]]:
    """Return the image topics whose first message is an image, and lines about the other topics.

    A topic without any readable message is left out of both lists.
    """
    images, problems = [], []
    for topic in found:
        if topic.is_video:  # the size is known without decoding it
            images.append(_Image(topic, ImageHead(is_depth=False, size_px=topic.video_px)))
            continue
        first = next(reader.messages([topic.name]), None)
        try:
            if first is not None:
                images.append(_Image(topic, image_head(first.data, topic)))
        except MessageError as error:
            problems.append(f'{reader.path}: {topic.name}: {error}')
    return images, problems


def _color(
    reader: BagReader, name: str, found: list[_Image], depths: list[_Image],
    presets: Sequence[CameraTopics], problem: str | None,
) -> _Image:  # fmt: skip
    """Return the color topic `name`; with an empty name, the best of the found topics.

    The suite's own topic is best, then that of a driver, then the one whose name fits best.

    Raises:
        InputError: There is no such topic, or several topics are equally good.
    """

    def rank(image: _Image) -> tuple[Any, ...]:
        text = image.base.lower()
        return (
            not _is_of_driver(image, _OWN, 'rgb_image', depths),
            not _is_of_driver(image, presets, 'rgb_image', depths),
            any(word in text for word in _OTHER_COLOR_WORDS),
            not any(word in text for word in _COLOR_WORDS),
            _RECTIFIED in text,  # camera_info describes the raw image
        )

    return _choose(reader, 'color', '--rgb', name, found, rank, problem)


def _depth(
    reader: BagReader, name: str, found: list[_Image], color: _Image,
    presets: Sequence[CameraTopics], problem: str | None,
) -> _Image:  # fmt: skip
    """Return the depth topic `name`; with an empty name, the likeliest to be registered to color.

    The suite's own topic comes first, then that of a driver, then the size of the images and the
    name of the topic decide.

    Raises:
        InputError: There is no such topic, or several topics are equally likely.
    """

    def rank(image: _Image) -> tuple[Any, ...]:
        text = image.base.lower()
        return (
            not _is_of_driver(image, _OWN, 'depth_image', [color]),
            not _is_of_driver(image, presets, 'depth_image', [color]),
            any(word in text for word in _OTHER_DEPTH_WORDS),
            None not in (image.head.size_px, color.head.size_px)
            and image.head.size_px != color.head.size_px,
            not any(word in text for word in _REGISTERED_WORDS),
            -_num_shared_parts(image.base, color.base),
            _RECTIFIED in text,
        )

    return _choose(reader, 'depth', '--depth', name, found, rank, problem)


def _choose(
    reader: BagReader, kind: str, option: str, name: str, found: list[_Image],
    rank: Callable[[_Image], tuple[Any, ...]], problem: str | None,
) -> _Image:  # fmt: skip
    """Return the topic `name`; with an empty name, the found topic with the least rank.

    Of several encodings of the images, raw is preferred, then compressedDepth.

    Raises:
        InputError: There is no such topic, or topics with different images have the least rank.
    """
    if name:
        wanted = f'/{name.strip("/")}'
        found = [i for i in found if wanted in (i.topic.name, i.base)]
        if not found:
            raise InputError(
                f'{reader.path}: {option} {name}: has no such {kind} images; see "hoid info"'
            )
    if not found:
        raise InputError(problem or f'{reader.path}: has no {kind} images')
    best = min(map(rank, found))
    chosen = [image for image in found if rank(image) == best]
    if len({image.base for image in chosen}) > 1:
        names = ', '.join(sorted({image.base for image in chosen}))
        raise InputError(
            f'{reader.path}: several topics could be {kind}: {names}; give {option} TOPIC'
        )
    return min(
        chosen,
        key=lambda i: (i.topic.type_name != types.IMAGE, not i.topic.name.endswith('Depth')),
    )


def _is_of_driver(
    image: _Image, presets: Sequence[CameraTopics], field: str, partners: Sequence[_Image]
) -> bool:
    """Return whether an image and one of its partners have one driver's names in one namespace.

    Args:
        field: Kind of the image: 'rgb_image' or 'depth_image'.
    """
    other = 'depth_image' if field == 'rgb_image' else 'rgb_image'
    bases = {partner.base for partner in partners}
    for preset in presets:
        own, its = getattr(preset, field), getattr(preset, other)
        if _is_called(image.base, own) and f'{image.base.removesuffix(own)}{its}' in bases:
            return True
    return False


def _camera_info(
    color: _Image, found: list[BagTopic], presets: Sequence[CameraTopics]
) -> BagTopic | None:
    """Return the camera_info topic beside the color topic, or the only camera_info of the bag.

    The result is None if no camera_info is beside the color topic, and the bag has none or more
    than one.
    """
    names = _info_names(color, 'rgb_image', presets)
    at_place = [topic for name in names for topic in found if topic.name == name]
    return at_place[0] if at_place else found[0] if len(found) == 1 else None


def _depth_info(
    depth: _Image, found: list[BagTopic], presets: Sequence[CameraTopics]
) -> BagTopic | None:
    names = _info_names(depth, 'depth_image', presets)
    return next((topic for topic in found if topic.name in names), None)


def _info_names(image: _Image, field: str, presets: Sequence[CameraTopics]) -> list[str]:
    """Return the names that the camera_info of an image topic may have, the likeliest first.

    Args:
        field: Its kind: 'rgb_image' or 'depth_image'.
    """
    names = [topics.camera_info_beside(image.topic.name)]
    if image.base.endswith(_VIEWER_IMAGE):  # RealSense Viewer
        names.append(f'{image.base.removesuffix(_VIEWER_IMAGE)}/info/camera_info')
    if field == 'rgb_image':
        names += [
            image.base.removesuffix(preset.rgb_image) + preset.camera_info
            for preset in presets
            if _is_called(image.base, preset.rgb_image)
        ]
    return names


def _num_shared_parts(first: str, second: str) -> int:
    """Return how many leading parts (between slashes) two topic names have in common."""
    parts = zip(first.split('/'), second.split('/'), strict=False)
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], parts))


def _named_topic(reader: BagReader, name: str, found: list[BagTopic]) -> BagTopic | None:
    """Return the camera_info that the user names; None if `name` is empty.

    Raises:
        InputError: The bag has no such topic.
    """
    if not name:
        return None
    for topic in found:
        if topic.name == f'/{name.strip("/")}':
            return topic
    raise InputError(f'{reader.path}: --info {name}: has no such camera_info; see "hoid info"')


def _truth(found: list[BagTopic], name: str, type_name: str) -> BagTopic | None:
    matching = [t for t in found if t.type_name == type_name and _is_called(t.name, name)]
    return matching[0] if len(matching) == 1 else None


def _is_called(topic: str, name: str) -> bool:
    return topic.endswith(f'/{name}')
