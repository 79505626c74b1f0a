"""Looping WebP animations of images."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
from PIL import Image

from hoid_common.values import ByteArray

_FRAME_MS = 130
_QUALITY = 60  # chosen: text stays sharp, at 30 kB for an image of 720 px


def write_animation(
    path: Path, images_bgr: Sequence[ByteArray], width_px: int, frame_ms: int = _FRAME_MS
) -> None:
    """Write images (H, W, 3) as a looping WebP animation of a width.

    A GIF of photographs has four times the size and shows steps in smooth surfaces.
    """
    frames = [Image.fromarray(_resized(image, width_px)[..., ::-1]) for image in images_bgr]
    frames[0].save(
        path,
        format='WEBP',
        save_all=True,
        append_images=frames[1:],
        duration=frame_ms,
        loop=0,
        quality=_QUALITY,
    )


def _resized(image_bgr: ByteArray, width_px: int) -> ByteArray:
    height, width = image_bgr.shape[:2]
    size = (width_px, round(height * width_px / width))
    return cv2.resize(image_bgr, size, interpolation=cv2.INTER_AREA).astype('uint8')
