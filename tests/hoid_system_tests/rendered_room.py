"""A rendered recording as the messages that reach rgbd_slam."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

from hoid_common.ros import conversions
from hoid_filter.config import FilterConfig
from hoid_filter.feature_filter import FeatureFilter
from hoid_synth.config import SceneConfig
from hoid_synth.scene import render
from hoid_system_tests.frame_tree import OPTICAL


class Messages(NamedTuple):
    """All messages of one image."""

    stamp_ns: int
    camera: Any
    color: Any
    depth: Any
    objects: Any
    features: Any


def recording(config: SceneConfig, strategy: str, workers: int = 2) -> Iterator[Messages]:
    """Render, filter with ground-truth boxes, and yield the messages of each image."""
    camera = config.camera
    size_px = (camera.width_px, camera.height_px)
    feature_filter = FeatureFilter(FilterConfig(strategy=strategy), camera)
    for synth in render(config, workers):
        result = feature_filter.process(synth.frame, synth.detections)
        header = conversions.header_to_msg(synth.frame.stamp_ns, OPTICAL)
        yield Messages(
            synth.frame.stamp_ns,
            conversions.camera_to_msg(camera, header),
            conversions.color_to_msg(synth.frame.image_bgr, header),
            conversions.depth_to_msg(synth.frame.depth_m, header),
            conversions.dynamic_objects_to_msg(result.objects, header, size_px),
            conversions.features_to_msg(result.features, header, size_px),
        )
