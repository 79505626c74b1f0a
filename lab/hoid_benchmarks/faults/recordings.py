"""Recordings as drivers and `ros2 bag record` leave them: stamps, units, frames and calibrations.

Each has the images of a camera that moves along a wall. What is read must be what was written, or
the recording must be refused in one line.
"""

from __future__ import annotations

import io
import logging
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from hoid_bags.bag import bag_messages
from hoid_bags.bag.bag_sequence import BagSequence
from hoid_bags.bag.bag_writer import BagWriter
from hoid_bags.bag.stamps import header
from hoid_bags.storage import bag_types
from hoid_bags.storage.bag_types import Message
from hoid_benchmarks.faults.damage import Rng
from hoid_benchmarks.faults.samples import Samples
from hoid_bringup import cli
from hoid_common.errors import HoidError
from hoid_common.io.depth import is_reading
from hoid_common.io.tum_text import read_tum
from hoid_common.values import ByteArray, CameraModel, Float32Array

SILENT = 98
"""Exit status of a child that read wrong data without an error."""
RAW = CameraModel(160, 120, 150.0, 151.0, 79.5, 59.5, (0.2, -0.6, 0.001, 0.002, 0.1))
_RECTIFIED = CameraModel(160, 120, 140.0, 141.0, 78.0, 60.0)
_COLOR, _DEPTH, _INFO = '/cam/color/image_raw', '/cam/depth/image_raw', '/cam/color/camera_info'
_NUM_FRAMES, _START_NS, _PERIOD_NS = 8, 1_305_031_102_000_000_000, 100_000_000
_MS = 1_000_000
_WALL_MM, _STEP_PX, _BLOCK_PX = 2000, 3, 4
_MAX_ERROR_M = 0.02


@dataclass(frozen=True)
class _Image:
    """A color image with its depth, and the messages that a driver makes of it."""

    stamp_ns: int
    image_bgr: ByteArray  # (H, W, 3)
    depth_m: Float32Array  # (H, W)
    color: Message
    depth: Message
    info: Message


def wall_images() -> list[_Image]:
    """Return the images of a camera that moves along a flat wall."""
    width_px, height_px = RAW.size_px
    coarse = np.random.default_rng(3).integers(
        0, 256, (height_px // _BLOCK_PX, width_px // 2, 3), dtype=np.uint8
    )
    wall = cv2.resize(coarse, (width_px * 2, height_px), interpolation=cv2.INTER_CUBIC)
    depth_mm = np.full((height_px, width_px), _WALL_MM, np.uint16)
    made = []
    for i in range(_NUM_FRAMES):
        stamp_ns = _START_NS + i * _PERIOD_NS
        view = wall[:, i * _STEP_PX : i * _STEP_PX + width_px]
        image_bgr = np.ascontiguousarray(view, np.uint8)
        depth_mm = depth_mm + np.uint16(1)  # so that each depth image differs
        color = bag_messages.image(stamp_ns, image_bgr, 'bgr8')
        depth = bag_messages.image(stamp_ns, depth_mm, '16UC1')
        info = bag_messages.camera_info(stamp_ns, RAW)
        depth_m = (depth_mm / 1000).astype(np.float32)
        made.append(_Image(stamp_ns, image_bgr, depth_m, color, depth, info))
    return made


def _write(bag: Path, images: list[_Image], color: str = _COLOR) -> None:
    with BagWriter(bag) as writer:
        writer.add_topic(color, bag_types.IMAGE)
        writer.add_topic(_DEPTH, bag_types.IMAGE)
        writer.add_topic(_INFO, bag_types.CAMERA_INFO)
        for number, image in enumerate(images):
            log_ns = _START_NS + number * _PERIOD_NS
            writer.write(_INFO, log_ns, image.info)
            writer.write(_DEPTH, log_ns, image.depth)
            writer.write(color, log_ns, image.color)


def reading(
    bag: Path, images: list[_Image], cameras: tuple[CameraModel, ...], least: int
) -> Callable[[], int]:
    """Return a function that reads a bag and compares it with what was written.

    Args:
        bag: The bag.
        images: The images by the stamps with which they must be found.
        cameras: Of which one must be found.
        least: Least number of images that must be found.
    """
    expected = {image.stamp_ns: image for image in images}

    def work() -> int:
        try:
            found = BagSequence(bag)
            frames = list(found)
        except HoidError as error:
            sys.stderr.write(f'hoid run: {error}\n')
            return 1
        is_right = len(frames) >= least and found.camera in cameras
        for frame in frames:
            image = expected.get(frame.stamp_ns)
            is_right &= image is not None and np.array_equal(frame.image_bgr, image.image_bgr)
            is_right &= image is not None and _is_same_depth(frame.depth_m, image.depth_m)
        return 0 if is_right else SILENT

    return work


def _unless_silent(work: Callable[[], int]) -> int:
    """Return the status of a function, or SILENT if it accepts its input without a warning."""
    lines = io.StringIO()
    handler = logging.StreamHandler(lines)
    logging.getLogger().addHandler(handler)
    try:
        status = work()
    finally:
        logging.getLogger().removeHandler(handler)
    return status if status or lines.getvalue() else SILENT


def _is_same_depth(read_m: Float32Array, written_m: Float32Array) -> bool:
    """Return whether readings within the range are unchanged, and no others are left."""
    is_good = is_reading(written_m)
    return bool(
        np.allclose(read_m[is_good], written_m[is_good], atol=1e-4)
        and not is_reading(read_m[~is_good]).any()
    )


def _stamped(message: Message, stamp_ns: int) -> Message:
    """Return a message of an image with another stamp."""
    return replace(message, header=header(stamp_ns, message.header.frame_id))


def repeated_stamps(_samples: Samples, place: Path, rng: Rng | None) -> Callable[[], int]:
    """Give some images the stamp of the image before them; the first with a stamp counts."""
    images = written = wall_images()
    if rng is not None:
        written = list(images)
        for i in rng.choice(np.arange(1, _NUM_FRAMES), int(rng.integers(1, 3)), replace=False):
            before = written[i - 1].stamp_ns
            written[i] = replace(
                images[i],
                stamp_ns=before,
                color=_stamped(images[i].color, before),
                depth=_stamped(images[i].depth, before),
            )
        first = {image.stamp_ns: image for image in reversed(written)}
        images = list(first.values())
    _write(place / 'bag', written)
    return reading(place / 'bag', images, (RAW,), _NUM_FRAMES - 3)


def offset_stamps(_samples: Samples, place: Path, rng: Rng | None) -> Callable[[], int]:
    """Date all depth images earlier or later, by another clock, or not at all."""
    images = written = wall_images()
    if rng is not None:
        offset_ns = int(rng.choice([5, -15, 25, -30, 45, -1_305_000_000_000, 86_400_000])) * _MS
        is_unset = rng.random() < 0.2
        written = [
            replace(i, depth=_stamped(i.depth, 0 if is_unset else i.stamp_ns + offset_ns))
            for i in images
        ]
    _write(place / 'bag', written)
    return reading(place / 'bag', images, (RAW,), _NUM_FRAMES)


def empty_frame_id(_samples: Samples, place: Path, rng: Rng | None) -> Callable[[], int]:
    """Leave out the frame of color images, of depth images, or of both."""
    images = written = wall_images()
    if rng is not None:
        which = rng.integers(1, 4)
        written = [
            replace(
                image,
                color=_nameless(image.color) if which & 1 else image.color,
                depth=_nameless(image.depth) if which & 2 else image.depth,
            )
            for image in images
        ]
    _write(place / 'bag', written)
    return reading(place / 'bag', images, (RAW,), _NUM_FRAMES)


def _nameless(message: Message) -> Message:
    return replace(message, header=replace(message.header, frame_id=''))


def depth_units(_samples: Samples, place: Path, rng: Rng | None) -> Callable[[], int]:
    """Write depth as floats in meters, or, wrongly, in millimeters."""
    images = wall_images()
    if rng is not None:
        factor = float(rng.choice([1.0, 1000.0]))
        images = [_with_depth(image, image.depth_m, factor) for image in images]
    _write(place / 'bag', images)
    return reading(place / 'bag', images, (RAW,), _NUM_FRAMES)


def extreme_depths(_samples: Samples, place: Path, rng: Rng | None) -> Callable[[], int]:
    """Put values into depth images that no camera measures."""
    images = wall_images()
    if rng is not None:
        images = [_with_depth(image, _with_extremes(image.depth_m, rng)) for image in images]
    _write(place / 'bag', images)
    return reading(place / 'bag', images, (RAW,), _NUM_FRAMES)


def _with_extremes(depth_m: Float32Array, rng: Rng) -> Float32Array:
    extremes = np.array([np.nan, np.inf, -np.inf, -1, 1e-30, 1e30, 3e38, 0], np.float32)
    is_extreme = rng.random(depth_m.shape) < 0.3
    return np.where(is_extreme, rng.choice(extremes, depth_m.shape), depth_m)


def _with_depth(image: _Image, depth_m: Float32Array, factor: float = 1.0) -> _Image:
    depth = bag_messages.image(image.stamp_ns, depth_m * np.float32(factor), '32FC1')
    return replace(image, depth_m=depth_m, depth=depth)


def rectified_images(_samples: Samples, place: Path, rng: Rng | None) -> Callable[[], int]:
    """Record rectified images with the camera_info of the raw ones, or with one of their own."""
    images, topic, camera = wall_images(), _COLOR, RAW
    if rng is not None:
        topic = str(rng.choice([_COLOR, '/cam/color/image_rect', '/cam/color/image_rect_color']))
        is_own = rng.random() < 0.3
        camera = _RECTIFIED if is_own or topic != _COLOR else RAW
        projection = np.hstack([_RECTIFIED.matrix, np.zeros((3, 1))]).ravel()
        infos = [
            bag_messages.camera_info(i.stamp_ns, _RECTIFIED)
            if is_own
            else replace(i.info, p=projection)
            for i in images
        ]
        images = [replace(i, info=info) for i, info in zip(images, infos, strict=True)]
    _write(place / 'bag', images, topic)
    return reading(place / 'bag', images, (camera,), _NUM_FRAMES)


def changed_camera(_samples: Samples, place: Path, rng: Rng | None) -> Callable[[], int]:
    """Change the calibration within a recording: that must be said, and one of them is used."""
    images = written = wall_images()
    if rng is not None:
        first = int(rng.integers(1, _NUM_FRAMES))
        other = [
            replace(image, info=bag_messages.camera_info(image.stamp_ns, _RECTIFIED))
            for image in images
        ]
        written = images[:first] + other[first:]
    _write(place / 'bag', written)
    work = reading(place / 'bag', images, (RAW, _RECTIFIED), _NUM_FRAMES)
    return work if rng is None else lambda: _unless_silent(work)


def bad_truth(_samples: Samples, place: Path, rng: Rng | None) -> Callable[[], int]:
    """Put rows without a pose into ground truth; the other rows must count."""
    stamps_ns = _START_NS + _PERIOD_NS * np.arange(50)
    positions_m = 0.1 * np.random.default_rng(0).standard_normal((50, 3)).cumsum(axis=0)
    lines = [
        f'{ns // 10**9}.{ns % 10**9:09d} {x:.6f} {y:.6f} {z:.6f} 0 0 0 1'
        for ns, (x, y, z) in zip(stamps_ns.tolist(), positions_m.tolist(), strict=True)
    ]
    (place / 'estimate.txt').write_text('\n'.join(lines) + '\n')
    if rng is not None:
        for i in rng.choice(50, int(rng.integers(1, 30)), replace=False):
            stamp = lines[i].split()[0]
            bad = ('nan nan nan 0 0 0 1', '0 0 0 nan 0 0 1', '0 0 0 0 0 0 0', 'inf 0 0 0 0 0 1')
            lines[i] = f'{stamp} {bad[int(rng.integers(len(bad)))]}'
    truth = place / 'truth.txt'
    truth.write_text('\n'.join(lines) + '\n')
    return lambda: _evaluated(place / 'estimate.txt', truth)


def _evaluated(estimate: Path, truth: Path) -> int:
    """Evaluate an estimate that is right wherever there is truth."""
    status = cli.main(['evaluate', str(estimate), str(truth)])
    if status == 0:
        read = read_tum(truth)
        places_m = read_tum(estimate)
        rows = np.searchsorted(places_m.stamps_ns, read.stamps_ns)
        error_m = places_m.T_world_camera[rows, :3, 3] - read.T_world_camera[:, :3, 3]
        status = 0 if np.abs(error_m).max() < _MAX_ERROR_M else SILENT
    return status
