"""Choice of the topics of a bag: those of an RGB-D recording, or those that a user names.

`ros2 bag record -a` records every topic of a driver: each image in several encodings, infrared and
unregistered depth beside the usable images, and images that other nodes draw.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
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
# Parts of the names of topics that have no color images of the scene, or images into which
# something was drawn.
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
    """The topics of an RGB-D recording in a bag; None: the topic is missing or ambiguous."""

    color: BagTopic
    depth: BagTopic
    camera_info: BagTopic | None
    ground_truth: BagTopic | None
    true_detections: BagTopic | None
    # Topics for registering depth to color: depth camera_info and transforms.
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


_Rank = Callable[[_Image], tuple[Any, ...]]  # the lowest rank is chosen


def find_topics(
    reader: BagReader,
    choice: TopicChoice = TopicChoice(),  # noqa: B008 - immutable
) -> RecordedTopics:
    """Return the topics of an RGB-D recording in a bag.

    Topics that the user does not name are chosen by the type of their messages, the names that
    drivers use, and the size of the images. InputError: there are no color or no depth images, a
    named topic is missing, or several are equally likely.
    """
    return _Finder(reader, choice).find(choice)


def topics_to_play(reader: BagReader, names: Sequence[str] = ()) -> tuple[BagTopic, ...]:
    """Return the named topics that have messages; without names, all such topics but /clock.

    Topics of a ROS 1 bag whose types ROS 2 lacks are left out with a warning. InputError: a named
    topic is missing or has such a type, or there are no messages.
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


class _Finder:
    """Finds the topics of a recording among those that have messages."""

    def __init__(self, reader: BagReader, choice: TopicChoice) -> None:
        self._path = reader.path
        self._presets = (
            [CAMERA_TOPICS[choice.preset]] if choice.preset else list(CAMERA_TOPICS.values())
        )
        filled = [topic for topic in reader.topics if topic.num_messages and topic.is_readable]
        sources = {part.source for part in reader.parts}
        self._topics = [t for t in filled if t.name not in sources] + list(reader.parts)
        self._problem: str | None = None  # why images may be missing
        images = list(self._images(reader))
        self._problem = reader.fault or self._problem
        self._colors = [image for image in images if not image.head.is_depth]
        self._depths = [image for image in images if image.head.is_depth]

    def _images(self, reader: BagReader) -> Iterator[_Image]:
        """Yield the image topics whose first message is an image."""
        for topic in self._topics:
            if topic.is_video:  # the size is known without decoding it
                yield _Image(topic, ImageHead(is_depth=False, size_px=topic.video_px))
            elif topic.type_name in _IMAGES:
                first = next(reader.messages([topic.name]), None)
                try:
                    if first is not None:
                        yield _Image(topic, image_head(first.data, topic))
                except MessageError as error:
                    self._problem = self._problem or f'{self._path}: {topic.name}: {error}'

    def find(self, choice: TopicChoice) -> RecordedTopics:
        """Return the topics (see `find_topics`)."""
        color = self._choose('color', '--rgb', choice.color, self._colors, self._rank_of_color)
        depth = self._choose(
            'depth', '--depth', choice.depth, self._depths, self._rank_of_depth(color)
        )
        infos = [t for t in self._topics if t.type_name == types.CAMERA_INFO]
        info = self._named_info(choice.camera_info, infos) or self._color_info(color, infos)
        others = [topic for topic in infos if topic != info]
        names = self._info_names(depth, 'depth_image')
        return RecordedTopics(
            color.topic,
            depth.topic,
            info,
            self._only(topics.GROUND_TRUTH, types.POSE_STAMPED),
            self._only(topics.TRUE_DETECTIONS, types.DETECTION_ARRAY),
            next((topic for topic in others if topic.name in names), None),
            self._only(topics.TF_STATIC.lstrip('/'), types.TF_MESSAGE),
            self._only('extrinsics/depth_to_color', types.EXTRINSICS),
        )

    def _rank_of_color(self, image: _Image) -> tuple[Any, ...]:
        """Rank the suite's topic first, then driver topics, then others by words in the name."""
        text = image.base.lower()
        return (
            not _is_of_driver(image, _OWN, 'rgb_image', self._depths),
            not _is_of_driver(image, self._presets, 'rgb_image', self._depths),
            any(word in text for word in _OTHER_COLOR_WORDS),
            not any(word in text for word in _COLOR_WORDS),
            _RECTIFIED in text,  # camera_info describes the raw image
        )

    def _rank_of_depth(self, color: _Image) -> _Rank:
        """Return a function that ranks depth topics: likely registered to color comes first."""

        def rank(image: _Image) -> tuple[Any, ...]:
            text = image.base.lower()
            return (
                not _is_of_driver(image, _OWN, 'depth_image', [color]),
                not _is_of_driver(image, self._presets, 'depth_image', [color]),
                any(word in text for word in _OTHER_DEPTH_WORDS),
                None not in (image.head.size_px, color.head.size_px)
                and image.head.size_px != color.head.size_px,
                not any(word in text for word in _REGISTERED_WORDS),
                -_num_shared_parts(image.base, color.base),
                _RECTIFIED in text,
            )

        return rank

    def _choose(
        self, kind: str, option: str, name: str, found: list[_Image], rank: _Rank
    ) -> _Image:
        """Return the topic `name`; with an empty name, the found topic with the least rank.

        Of several encodings, raw is preferred, then compressedDepth. InputError: there is no such
        topic, or topics with different images have the least rank.
        """
        if name:
            wanted = f'/{name.strip("/")}'
            found = [i for i in found if wanted in (i.topic.name, i.base)]
            if not found:
                raise InputError(
                    f'{self._path}: {option} {name}: has no such {kind} images; see "hoid info"'
                )
        if not found:
            raise InputError(self._problem or f'{self._path}: has no {kind} images')
        best = min(map(rank, found))
        chosen = [image for image in found if rank(image) == best]
        if len({image.base for image in chosen}) > 1:
            names = ', '.join(sorted({image.base for image in chosen}))
            raise InputError(
                f'{self._path}: several topics could be {kind}: {names}; give {option} TOPIC'
            )
        return min(
            chosen,
            key=lambda i: (i.topic.type_name != types.IMAGE, not i.topic.name.endswith('Depth')),
        )

    def _named_info(self, name: str, found: list[BagTopic]) -> BagTopic | None:
        """Return the camera_info that the user names; None if `name` is empty."""
        matching = [topic for topic in found if topic.name == f'/{name.strip("/")}']
        if name and not matching:
            raise InputError(
                f'{self._path}: --info {name}: has no such camera_info; see "hoid info"'
            )
        return matching[0] if matching else None

    def _color_info(self, color: _Image, found: list[BagTopic]) -> BagTopic | None:
        """Return the camera_info beside the color topic, or else the only one of the bag."""
        names = self._info_names(color, 'rgb_image')
        at_place = [topic for name in names for topic in found if topic.name == name]
        return at_place[0] if at_place else found[0] if len(found) == 1 else None

    def _info_names(self, image: _Image, field: str) -> list[str]:
        """Return names that the camera_info of an `rgb_image` or `depth_image` may have."""
        names = [topics.camera_info_beside(image.topic.name)]
        if image.base.endswith(_VIEWER_IMAGE):  # a recording of RealSense Viewer
            names.append(f'{image.base.removesuffix(_VIEWER_IMAGE)}/info/camera_info')
        if field == 'rgb_image':
            names += [
                image.base.removesuffix(preset.rgb_image) + preset.camera_info
                for preset in self._presets
                if _is_called(image.base, preset.rgb_image)
            ]
        return names

    def _only(self, name: str, type_name: str) -> BagTopic | None:
        """Return the only topic of a name and type; None if there is none or several."""
        matching = [
            t for t in self._topics if t.type_name == type_name and _is_called(t.name, name)
        ]
        return matching[0] if len(matching) == 1 else None


def _is_of_driver(
    image: _Image, presets: Sequence[CameraTopics], field: str, partners: Sequence[_Image]
) -> bool:
    """Return whether an image and one of its partners have one driver's names in one namespace.

    `field` is the kind of the image: `rgb_image` or `depth_image`.
    """
    other = 'depth_image' if field == 'rgb_image' else 'rgb_image'
    bases = {partner.base for partner in partners}
    for preset in presets:
        own, its = getattr(preset, field), getattr(preset, other)
        if _is_called(image.base, own) and f'{image.base.removesuffix(own)}{its}' in bases:
            return True
    return False


def _num_shared_parts(first: str, second: str) -> int:
    """Return how many leading parts (between slashes) two topic names have in common."""
    parts = zip(first.split('/'), second.split('/'), strict=False)
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], parts))


def _is_called(topic: str, name: str) -> bool:
    return topic.endswith(f'/{name}')
