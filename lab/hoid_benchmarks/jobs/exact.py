"""An oracle filter: removes exactly the features on moving surfaces, as known to the renderer."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from hoid_benchmarks.plan.sequences import scene_of
from hoid_common.errors import InputError
from hoid_common.values import BoolArray, ByteArray, Detections, FilterResult, RgbdFrame
from hoid_filter.config import ExtractionConfig
from hoid_filter.extraction.extractor import OrbExtractor
from hoid_synth.acting.stage import set_stage
from hoid_synth.config import SceneConfig
from hoid_synth.render.tracer import Tracer

_EDGE_PX = 5  # descriptors of corners this near to a moving surface include it
_COARSE_PX = 64  # image width for which the scene is prepared; textures are not used


class ExactFilter:
    """Extracts features like the filter, and removes all on or near moving surfaces.

    Args:
        name: Name of a rendered scene.
        file: Cache file of the masks; it is written if it does not exist.
        extraction: Configuration of the feature extraction.

    Raises:
        InputError: The name is not that of a rendered scene.
    """

    def __init__(self, name: str, file: Path, extraction: ExtractionConfig) -> None:
        scene = scene_of(name)
        if scene is None:
            raise InputError(f'{name}: the moving surfaces are known for rendered scenes only')
        if not file.is_file():
            _keep(scene, file)
        self._packed: ByteArray = np.load(file, mmap_mode='r')
        self._shape = scene.height_px, scene.width_px
        self._frame_of = {scene.stamp_ns(i): i for i in range(scene.frames)}
        self._extractor = OrbExtractor(extraction)

    def process(self, frame: RgbdFrame, _: Detections | None = None) -> FilterResult:
        """Return the features of a frame that are not on moving surfaces."""
        start = time.thread_time()
        moving = np.unpackbits(self._packed[self._frame_of[frame.stamp_ns]]).view(np.bool_)
        read = time.thread_time()
        gray = np.asarray(cv2.cvtColor(frame.image_bgr, cv2.COLOR_BGR2GRAY), np.uint8)
        corners = self._extractor.detect(gray)
        kept = np.flatnonzero(~moving[corners.pixel])
        chosen = self._extractor.choose(corners, kept, int(np.count_nonzero(~moving)))
        features = self._extractor.describe(corners, chosen, frame.depth_m, frame.stamp_ns)
        spent_ms = {'filter': (read - start) * 1e3, 'extract': (time.thread_time() - read) * 1e3}
        nowhere = np.empty((0, 2), np.float32)
        return FilterResult(
            features, (), nowhere, len(corners), len(corners) - len(kept), spent_ms
        )


def moving_masks(scene: SceneConfig) -> Iterator[BoolArray]:
    """Yield the (H, W) mask of moving people and objects for each frame of a scene."""
    stage, camera = set_stage(replace(scene, width_px=_COARSE_PX)), scene.camera
    resting = Tracer(stage.static_mesh.vertices_m, stage.static_mesh.faces)
    v, u = np.mgrid[0 : camera.height_px, 0 : camera.width_px]
    x, y = (u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px
    rays = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3)
    for i, T in enumerate(stage.T_world_camera[: scene.frames]):
        mask = np.zeros(len(rays), np.bool_)
        mesh = stage.moving_mesh(i)
        if mesh is not None:
            directions = (rays @ T[:3, :3].T).astype(np.float32)
            t = Tracer(mesh.vertices_m, mesh.faces).first_hits(T[:3, 3], directions).t
            hit = np.flatnonzero(np.isfinite(t))
            mask[hit] = t[hit] < resting.first_hits(T[:3, 3], directions[hit]).t
        yield mask.reshape(u.shape)


def _keep(scene: SceneConfig, file: Path) -> None:
    """Write the dilated masks, one row of bits per frame, and rename the file when complete."""
    kernel = np.ones((2 * _EDGE_PX + 1, 2 * _EDGE_PX + 1), np.uint8)
    widened = (cv2.dilate(mask.view(np.uint8), kernel) for mask in moving_masks(scene))
    rows = np.stack([np.packbits(np.asarray(mask, np.uint8)) for mask in widened])
    file.parent.mkdir(parents=True, exist_ok=True)
    unfinished = file.with_name(f'{os.getpid()}-{file.name}')
    np.save(unfinished, rows)
    unfinished.replace(file)
