"""Assignment of objects to cells of the feature maps, and the loss.

Assignment: Feng et al., TOOD: Task-aligned One-stage Object Detection, 2021. Boxes: Zheng et al.,
Distance-IoU Loss, 2020.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits, one_hot

_CELLS_PER_OBJECT = 9
_SCORE_POWER, _IOU_POWER = 0.5, 4.0
_SMALLEST_PX = 12.0  # smaller objects are assigned as if they had this size
_BOX_WEIGHT = 2.5


class Labels(NamedTuple):
    """The objects of a batch, padded to the same number."""

    boxes: Tensor  # (B, M, 4) xyxy, px
    class_ids: Tensor  # (B, M) int64
    valid: Tensor  # (B, M) bool: whether the entry is an object to be found
    ignored: Tensor  # (B, M) bool: too little is visible to count as found or missed


def iou(a: Tensor, b: Tensor) -> Tensor:
    """Return the intersection over union of boxes (..., 4), xyxy; shapes are broadcast."""
    low, high = torch.maximum(a[..., :2], b[..., :2]), torch.minimum(a[..., 2:], b[..., 2:])
    shared = (high - low).clamp(min=0).prod(-1)
    areas = (a[..., 2:] - a[..., :2]).prod(-1) + (b[..., 2:] - b[..., :2]).prod(-1)
    return shared / (areas - shared + 1e-6)


def distance_iou(a: Tensor, b: Tensor) -> Tensor:
    """Return the distance-IoU of boxes (..., 4), equation (7)."""
    low, high = torch.minimum(a[..., :2], b[..., :2]), torch.maximum(a[..., 2:], b[..., 2:])
    diagonal = (high - low).square().sum(-1) + 1e-6
    gap = (a[..., :2] + a[..., 2:] - b[..., :2] - b[..., 2:]).square().sum(-1) / 4
    return iou(a, b) - gap / diagonal


def assign(
    boxes: Tensor, scores: Tensor, centers: Tensor, labels: Labels
) -> tuple[Tensor, Tensor, Tensor]:
    """Return for each cell (B, N) its object's index, whether it has one, and its target score.

    Args:
        boxes: (B, N, 4) predicted boxes.
        scores: (B, N, C) predicted scores in [0, 1].
        centers: (N, 2) centers of the cells.
        labels: The objects.
    """
    overlap = iou(labels.boxes[:, :, None], boxes[:, None])  # (B, M, N)
    ids = labels.class_ids[:, :, None].expand(-1, -1, boxes.shape[1])
    own_score = scores.transpose(1, 2).gather(1, ids)
    fit = own_score**_SCORE_POWER * overlap**_IOU_POWER
    fit = (fit + 1e-9) * (_covers(labels.boxes, centers) & labels.valid[:, :, None])
    best = fit.topk(_CELLS_PER_OBJECT, dim=-1)
    chosen = torch.zeros_like(fit).scatter_(-1, best.indices, (best.values > 0).float())
    fit = fit * chosen
    value, index = fit.max(1)  # one object per cell
    positive = value > 0
    chosen = chosen * one_hot(index, fit.shape[1]).transpose(1, 2) * positive[:, None]
    best_fit = (fit * chosen).amax(-1, keepdim=True)
    best_overlap = (overlap * chosen).amax(-1, keepdim=True)
    target = (fit * chosen * best_overlap / (best_fit + 1e-12)).amax(1)
    return index, positive, target


def _covers(boxes: Tensor, centers: Tensor) -> Tensor:
    """Return whether (B, M, N) the center of a cell lies in a box; small boxes are enlarged."""
    middle = (boxes[..., :2] + boxes[..., 2:]) / 2
    half = ((boxes[..., 2:] - boxes[..., :2]) / 2).clamp(min=_SMALLEST_PX / 2)
    return ((centers - middle[:, :, None]).abs() < half[:, :, None]).all(-1)


def loss(boxes: Tensor, logits: Tensor, centers: Tensor, labels: Labels) -> Tensor:
    """Return the mean loss of a batch."""
    with torch.no_grad():
        index, positive, target = assign(boxes, logits.sigmoid(), centers, labels)
    wanted = torch.zeros_like(logits)
    own_class = labels.class_ids.gather(1, index)
    wanted.scatter_(2, own_class[..., None], (target * positive)[..., None])
    silent = (_covers(labels.boxes, centers) & labels.ignored[:, :, None]).any(1) & ~positive
    entropy = binary_cross_entropy_with_logits(logits, wanted, reduction='none')
    total = wanted.sum().clamp(min=1)
    class_loss = (entropy * ~silent[..., None]).sum() / total
    own_box = labels.boxes.gather(1, index[..., None].expand(-1, -1, 4))
    miss = 1 - distance_iou(boxes[positive], own_box[positive])
    box_loss = (miss * target[positive]).sum() / total
    return class_loss + _BOX_WEIGHT * box_loss
