"""The network: a small convolutional backbone, a feature pyramid, and one shared head."""

from __future__ import annotations

import torch
from torch import Tensor, nn

STRIDES_PX = (8, 16, 32)
_NECK = 64
_HEAD = 48
_PRIOR = 0.01  # score of every class before training


class Conv(nn.Sequential):
    """Convolution, batch norm, ReLU."""

    def __init__(self, inputs: int, outputs: int, size: int = 3, stride: int = 1) -> None:
        super().__init__(
            nn.Conv2d(inputs, outputs, size, stride, size // 2, bias=False),
            nn.BatchNorm2d(outputs),
            nn.ReLU(inplace=True),
        )


class Split(nn.Module):
    """A block that passes half of the channels on, the others through residual convolutions."""

    def __init__(self, channels: int, repeats: int) -> None:
        super().__init__()
        half = channels // 2
        self.enter = Conv(channels, channels, 1)
        self.steps = nn.ModuleList(Conv(half, half) for _ in range(repeats))
        self.leave = Conv(channels, channels, 1)

    def forward(self, x: Tensor) -> Tensor:
        """Return features of the same shape."""
        kept, y = self.enter(x).chunk(2, 1)
        for step in self.steps:
            y = y + step(y)
        return self.leave(torch.cat([kept, y], 1))


class Context(nn.Module):
    """Spatial pyramid pooling: adds maxima over three sizes of windows."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.enter = Conv(channels, channels // 2, 1)
        self.pool = nn.MaxPool2d(5, 1, 2)
        self.leave = Conv(2 * channels, channels, 1)

    def forward(self, x: Tensor) -> Tensor:
        """Return features of the same shape."""
        y = [self.enter(x)]
        for _ in range(3):
            y.append(self.pool(y[-1]))
        return self.leave(torch.cat(y, 1))


class Detector(nn.Module):
    """Predicts boxes and class logits on the cells of three feature levels."""

    def __init__(self, num_classes: int) -> None:
        super().__init__()
        self.low = nn.Sequential(
            Conv(3, 16, 3, 2), Conv(16, 32, 3, 2), Split(32, 1), Conv(32, 64, 3, 2), Split(64, 2)
        )
        self.middle = nn.Sequential(Conv(64, 96, 3, 2), Split(96, 2))
        self.high = nn.Sequential(Conv(96, 128, 3, 2), Split(128, 1), Context(128))
        self.lateral = nn.ModuleList(Conv(c, _NECK, 1) for c in (64, 96, 128))
        self.merge = nn.ModuleList(Conv(_NECK, _NECK) for _ in range(2))
        self.down = nn.MaxPool2d(2)
        self.merge_up = nn.ModuleList(Split(_NECK, 1) for _ in range(2))
        self.tower = nn.Sequential(Conv(_NECK, _HEAD), Conv(_HEAD, _HEAD))
        self.classes = nn.Conv2d(_HEAD, num_classes, 1)
        self.sides = nn.Conv2d(_HEAD, 4, 1)
        nn.init.constant_(self.classes.bias, float(torch.tensor(_PRIOR).logit()))
        nn.init.constant_(self.sides.bias, 1.0)

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor]:
        """Return boxes (B, N, 4), xyxy in pixels, and class logits (B, N, C).

        Args:
            image: (B, 3, H, W) RGB in [0, 1]; H and W must be multiples of 32.
        """
        boxes, logits = [], []
        for stride, level in zip(STRIDES_PX, self._levels(image), strict=True):
            y = self.tower(level)
            height, width = int(y.shape[2]), int(y.shape[3])
            center = cell_centers(height, width, stride).to(image.device)
            sides = nn.functional.softplus(self.sides(y).flatten(2).transpose(1, 2).float())
            sides = sides * (2 * stride)
            boxes.append(torch.cat([center - sides[..., :2], center + sides[..., 2:]], -1))
            logits.append(self.classes(y).flatten(2).transpose(1, 2).float())
        return torch.cat(boxes, 1), torch.cat(logits, 1)

    def _levels(self, image: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        c3 = self.low(image)
        c4 = self.middle(c3)
        c5 = self.high(c4)
        p3, p4, p5 = (f(c) for f, c in zip(self.lateral, (c3, c4, c5), strict=True))
        p4 = self.merge[1](p4 + nn.functional.interpolate(p5, scale_factor=2.0))
        p3 = self.merge[0](p3 + nn.functional.interpolate(p4, scale_factor=2.0))
        p4 = self.merge_up[0](p4 + self.down(p3))
        p5 = self.merge_up[1](p5 + self.down(p4))
        return p3, p4, p5


def cell_centers(height: int, width: int, stride_px: int) -> Tensor:
    """Return the cell centers (height * width, 2) of a level, x and y in pixels of the input."""
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing='ij')
    return (torch.stack([x, y], -1).reshape(-1, 2).float() + 0.5) * stride_px
