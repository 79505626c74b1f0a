"""Looping GIF animations of images."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from hoid_common.values import ByteArray

_FRAME_MS = 130
_COLORS = 128


def write_animation(
    path: Path, images_bgr: Sequence[ByteArray], width_px: int, frame_ms: int = _FRAME_MS
) -> None:
    """Write images (H, W, 3) as a looping GIF of a width.

    All images have the colors of the first one and the last one, so that a surface does not
    flicker. Dithering keeps smooth surfaces from falling into steps.
    """
    frames = [Image.fromarray(_resized(image, width_px)[..., ::-1]) for image in images_bgr]
    ends = Image.fromarray(np.vstack([np.asarray(frames[0]), np.asarray(frames[-1])]))
    palette = ends.quantize(_COLORS, Image.Quantize.MEDIANCUT)
    drawn = [frame.quantize(palette=palette) for frame in frames]
    drawn[0].save(
        path, save_all=True, append_images=drawn[1:], duration=frame_ms, loop=0, optimize=True
    )


def _resized(image_bgr: ByteArray, width_px: int) -> ByteArray:
    height, width = image_bgr.shape[:2]
    size = (width_px, round(height * width_px / width))
    return np.asarray(cv2.resize(image_bgr, size, interpolation=cv2.INTER_AREA), np.uint8)
