"""Writes a rendered scene as an MCAP bag with ground-truth poses and boxes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hoid_bags.bag import bag_messages
from hoid_bags.bag.bag_writer import BagWriter
from hoid_bags.progress import progress
from hoid_bags.storage.bag_types import CAMERA_INFO, DETECTION_ARRAY, IMAGE, IMU, POSE_STAMPED
from hoid_common import topics
from hoid_common.io import images
from hoid_common.values import CameraModel
from hoid_synth.config import SceneConfig
from hoid_synth.imu import ImuTrack, imu_track
from hoid_synth.scene import SynthFrame, render

_TYPES = {
    topics.CAMERA_INFO: CAMERA_INFO,
    topics.RGB_IMAGE: IMAGE,
    topics.DEPTH_IMAGE: IMAGE,
    topics.GROUND_TRUTH: POSE_STAMPED,
    topics.TRUE_DETECTIONS: DETECTION_ARRAY,
}


def write_bag(
    config: SceneConfig,
    bag: Path,
    workers: int = 1,
    *,
    imu: bool = False,
    show_progress: bool = False,
) -> None:
    """Render a scene into a bag.

    Args:
        config: The scene.
        bag: The folder to create.
        workers: Number of rendering processes.
        imu: Whether to write the samples of an IMU as well.
        show_progress: Whether to draw a progress bar on stderr.

    Raises:
        InputError: The bag exists already, or cannot be written. No partial bag is left.
    """
    with BagWriter(bag) as writer:
        for topic, type_name in _TYPES.items():
            writer.add_topic(topic, type_name)
        track = None
        if imu:
            writer.add_topic(topics.IMU, IMU)
            track = imu_track(config)
        num_samples = 0
        frames = render(config, workers)
        for frame in progress(frames, config.frames, 'frames', show=show_progress):
            if track is not None:
                num_samples = _write_imu(writer, track, num_samples, frame.frame.stamp_ns)
            _write(writer, frame, config.camera)


def _write_imu(writer: BagWriter, track: ImuTrack, first: int, end_ns: int) -> int:
    """Write the samples from an index on up to a stamp; return the index of the next one."""
    end = int(np.searchsorted(track.stamps_ns, end_ns))
    for k in range(first, end):
        stamp_ns = int(track.stamps_ns[k])
        message = bag_messages.imu(stamp_ns, track.accelerations_mps2[k], track.rates_radps[k])
        writer.write(topics.IMU, stamp_ns, message)
    return end


def _write(writer: BagWriter, synth: SynthFrame, camera: CameraModel) -> None:
    stamp_ns = synth.frame.stamp_ns
    depth_mm = np.rint(synth.frame.depth_m * np.float32(images.MM_PER_M)).astype(np.uint16)
    messages = {
        topics.CAMERA_INFO: bag_messages.camera_info(stamp_ns, camera),
        topics.TRUE_DETECTIONS: bag_messages.detection_array(synth.detections, camera),
        topics.GROUND_TRUTH: bag_messages.pose_stamped(stamp_ns, synth.T_world_camera),
        topics.RGB_IMAGE: bag_messages.image(stamp_ns, synth.frame.image_bgr, 'bgr8'),
        topics.DEPTH_IMAGE: bag_messages.image(stamp_ns, depth_mm, '16UC1'),
    }
    for topic, message in messages.items():
        writer.write(topic, stamp_ns, message)
