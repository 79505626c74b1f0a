"""Augmentation of the training images: zoom, mirroring, brightness, blur and noise."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import cv2
import numpy as np
import torch

from hoid_common.values import ByteArray, Float32Array, IntArray
from hoid_training.dataset import Home
from hoid_training.loss import Labels

VIEW_WH = (320, 224)
_ZOOM = (0.72, 1.35)
_MIN_VISIBLE_PX = 150  # at VGA; objects with fewer visible pixels are ignored in training
_MIN_SHARE = 0.1  # of a box that must lie within the view; otherwise it is ignored


class Sample(NamedTuple):
    """One labeled image."""

    image_bgr: ByteArray  # (H, W, 3)
    boxes: Float32Array  # (N, 4) xyxy, px
    class_ids: IntArray  # (N,)
    visible_px: Float32Array  # (N,)


def samples(home: Home) -> list[Sample]:
    """Return the images of a home with their labels."""
    out = []
    for k, image in enumerate(home.images_bgr):
        own = home.frame == k
        out.append(
            Sample(image, home.boxes_xyxy_px[own], home.class_ids[own], home.visible_px[own])
        )
    return out


def batches(
    pool: list[Sample], size: int, rng: np.random.Generator
) -> Iterator[tuple[torch.Tensor, Labels]]:
    """Yield one epoch of augmented batches: images (B, 3, H, W) RGB in [0, 1], and labels."""
    order = rng.permutation(len(pool))
    for start in range(0, len(order) - size + 1, size):
        yield collated([varied(pool[int(k)], rng) for k in order[start : start + size]])


def collated(group: list[Sample]) -> tuple[torch.Tensor, Labels]:
    """Return samples of equal size as a batch of images (B, 3, H, W) and labels."""
    images = np.stack([cv2.cvtColor(s.image_bgr, cv2.COLOR_BGR2RGB) for s in group])
    most = max(1, *(len(s.class_ids) for s in group))
    boxes = np.zeros((len(group), most, 4), np.float32)
    ids = np.zeros((len(group), most), np.int64)
    visible = np.zeros((len(group), most), np.float32)
    for k, s in enumerate(group):
        boxes[k, : len(s.boxes)] = s.boxes
        ids[k, : len(s.boxes)] = s.class_ids
        visible[k, : len(s.boxes)] = s.visible_px
    shown = torch.from_numpy(visible)
    tensor = torch.from_numpy(images).permute(0, 3, 1, 2).float() / 255
    valid = shown >= _MIN_VISIBLE_PX
    labels = Labels(torch.from_numpy(boxes), torch.from_numpy(ids), valid, (shown > 0) & ~valid)
    return tensor.to(memory_format=torch.channels_last), labels


def varied(s: Sample, rng: np.random.Generator) -> Sample:
    """Return a randomly augmented sample of the size VIEW_WH."""
    zoom = float(np.exp(rng.uniform(*np.log(_ZOOM))))
    height, width = s.image_bgr.shape[:2]
    shift = np.array([VIEW_WH[0] - zoom * width, VIEW_WH[1] - zoom * height]) * rng.random(2)
    to_view = np.array([[zoom, 0, shift[0]], [0, zoom, shift[1]]], np.float64)
    warped = cv2.warpAffine(
        s.image_bgr, to_view, VIEW_WH, flags=cv2.INTER_LINEAR, borderValue=(114, 114, 114)
    )
    image = np.asarray(warped, np.uint8)
    full = s.boxes * zoom + np.tile(shift, 2).astype(np.float32)
    boxes = np.clip(full, 0, [*VIEW_WH, *VIEW_WH]).astype(np.float32)
    share = _area(boxes) / np.maximum(_area(full), 1e-6)
    if rng.random() < 0.5:
        image = np.ascontiguousarray(image[:, ::-1])
        boxes = boxes[:, [2, 1, 0, 3]] * [-1, 1, -1, 1] + [VIEW_WH[0], 0, VIEW_WH[0], 0]
    kept = share > 0.02
    visible = np.where(share > _MIN_SHARE, s.visible_px * share * zoom**2, 1.0)
    return Sample(
        _relit(image, rng),
        boxes[kept].astype(np.float32),
        s.class_ids[kept],
        visible[kept].astype(np.float32),
    )


def _area(boxes: Float32Array) -> Float32Array:
    return np.asarray((boxes[:, 2:] - boxes[:, :2]).prod(1))


def _relit(image: ByteArray, rng: np.random.Generator) -> ByteArray:
    """Return the image with random brightness, color, blur and noise."""
    gain = np.exp(rng.normal(0, 0.18)) * np.exp(rng.normal(0, 0.06, 3))
    saturation = rng.uniform(0.6, 1.3)
    mix = (saturation * np.eye(3) + (1 - saturation) / 3) * gain
    out = cv2.transform(image, np.column_stack([mix, np.full(3, rng.normal(0, 6))]))
    if rng.random() < 0.3:
        out = cv2.GaussianBlur(out, (0, 0), float(rng.uniform(0.3, 1.0)))
    if rng.random() < 0.25:
        noise = np.float32(rng.uniform(0, 5)) * rng.standard_normal(out.shape, np.float32)
        out = np.clip(out + noise, 0, 255).astype(np.uint8)
    return np.asarray(out, np.uint8)
