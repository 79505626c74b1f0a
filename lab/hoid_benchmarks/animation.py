"""Looping GIF animations of images."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from hoid_common.values import ByteArray

_FRAME_MS = 130
_COLORS = 64


def write_animation(path: Path, images_bgr: Sequence[ByteArray], width_px: int) -> None:
    """Write images (H, W, 3) as a looping GIF of a width."""
    frames = [
        Image.fromarray(_resized(image, width_px)[..., ::-1]).quantize(
            _COLORS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE
        )
        for image in images_bgr
    ]
    frames[0].save(
        path, save_all=True, append_images=frames[1:], duration=_FRAME_MS, loop=0, optimize=True
    )


def _resized(image_bgr: ByteArray, width_px: int) -> ByteArray:
    height, width = image_bgr.shape[:2]
    size = (width_px, round(height * width_px / width))
    return np.asarray(cv2.resize(image_bgr, size, interpolation=cv2.INTER_AREA), np.uint8)
