"""Rendering of all frames of a scene, in several processes."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from multiprocessing import get_context

import cv2

from hoid_common.values import (
    ByteArray,
    Detections,
    Float32Array,
    FloatArray,
    RgbdFrame,
)
from hoid_synth import truth
from hoid_synth.acting.stage import set_stage
from hoid_synth.config import SceneConfig
from hoid_synth.render.renderer import Renderer

_FRAMES_PER_TASK = 4
_TASKS_AHEAD_PER_WORKER = 3


@dataclass(frozen=True, eq=False)
class SynthFrame:
    """One rendered frame with its ground truth."""

    index: int
    frame: RgbdFrame
    T_world_camera: FloatArray  # (4, 4)
    detections: Detections  # ground-truth boxes of the visible pixels, with scores 1
    instances: tuple[int, ...]  # instance of each detection
    handled: tuple[bool, ...]  # whether the object of each detection is in somebody's hands
    instance_image: ByteArray  # (H, W), 0 = background; index of Stage.world.class_names
    true_depth_m: Float32Array  # (H, W), without errors of the sensor


class SceneRenderer:
    """Renders the frames of a configuration in any order."""

    def __init__(self, config: SceneConfig) -> None:
        self.stage = set_stage(config)
        self._renderer = Renderer(self.stage)
        self._rendering = lru_cache(2)(self._renderer.render)

    def frame(self, i: int) -> SynthFrame:
        """Render frame i."""
        stage, stamp_ns = self.stage, self.stage.config.stamp_ns(i)
        out = self._rendering(i)
        image_bgr = self._rendering(i - i % stage.config.color_every).image_bgr
        seen = truth.visible_objects(stage, i, stamp_ns, out.instances)
        return SynthFrame(
            index=i,
            frame=RgbdFrame(stamp_ns, image_bgr, out.depth_m),
            T_world_camera=stage.T_world_camera[i],
            detections=seen.detections,
            instances=seen.instances,
            handled=seen.handled,
            instance_image=out.instances,
            true_depth_m=out.true_depth_m,
        )


def render(config: SceneConfig, workers: int = 1) -> Iterator[SynthFrame]:
    """Yield the frames in order; the number of worker processes does not change a byte of them."""
    if workers <= 1:
        renderer = SceneRenderer(config)
        for i in range(config.frames):
            yield renderer.frame(i)
        return
    context = get_context('spawn')  # a fork would copy this process without its threads
    with ProcessPoolExecutor(workers, context, _start_worker, (config,)) as pool:
        tasks = iter(range(0, config.frames, _FRAMES_PER_TASK))
        waiting: deque[Future[list[SynthFrame]]] = deque()
        for first in tasks:
            waiting.append(
                pool.submit(_render_task, first, min(first + _FRAMES_PER_TASK, config.frames))
            )
            if len(waiting) > workers * _TASKS_AHEAD_PER_WORKER:
                yield from waiting.popleft().result()
        while waiting:
            yield from waiting.popleft().result()


class _Worker:
    """The renderer of this worker process."""

    renderer: SceneRenderer


def _start_worker(config: SceneConfig) -> None:
    cv2.setNumThreads(1)
    _Worker.renderer = SceneRenderer(config)


def _render_task(first: int, end: int) -> list[SynthFrame]:
    return [_Worker.renderer.frame(i) for i in range(first, end)]
