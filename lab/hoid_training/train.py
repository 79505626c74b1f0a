"""Trains the synthetic detector and writes it as ONNX.

Usage: python -m hoid_training.train FOLDER MODEL.onnx [--minutes N] [--weights MODEL.pt]
FOLDER contains the homes of `hoid_training.dataset`, which may still be running.
"""

from __future__ import annotations

import argparse
import copy
import logging
import math
import time
from collections.abc import Sequence
from itertools import chain
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import nn

from hoid_training.augment import VIEW_WH, Sample, batches, samples
from hoid_training.dataset import CLASSES, home_files, load_home
from hoid_training.export import write_onnx
from hoid_training.loss import Labels, loss
from hoid_training.network import STRIDES_PX, Detector, cell_centers

SEED = 1

_LOG = logging.getLogger(__name__)
_BATCH = 16
_WEIGHT_DECAY = 0.02
_WARM_UP_STEPS = 200
_PASSES = 4  # over the images in one epoch
_AVERAGE = 0.998  # decay of the running mean of the weights per step
_CENTERS = torch.cat([cell_centers(VIEW_WH[1] // s, VIEW_WH[0] // s, s) for s in STRIDES_PX])


class Average:
    """Running mean of the weights of a network, which is exported."""

    def __init__(self, network: nn.Module) -> None:
        self.network = copy.deepcopy(network).eval()
        self._steps = 0

    def update(self, network: nn.Module) -> None:
        """Update the mean with the current weights."""
        self._steps += 1
        keep = min(_AVERAGE, self._steps / (self._steps + 10))
        mine, its = self.network.state_dict(), network.state_dict()
        with torch.no_grad():
            for name, value in mine.items():
                if value.dtype.is_floating_point:
                    value.mul_(keep).add_(its[name], alpha=1 - keep)
                else:
                    value.copy_(its[name])


class Schedule:
    """Learning rate, which rises in the first steps and then falls until the time is over."""

    def __init__(self, minutes: float, highest: float) -> None:
        self._start_s, self._given_s, self._steps = time.monotonic(), 60 * minutes, 0
        self._highest = highest

    @property
    def done(self) -> float:
        """Return the elapsed share of the time, in [0, 1]."""
        return min((time.monotonic() - self._start_s) / self._given_s, 1.0)

    def next_rate(self) -> float:
        """Return the learning rate of the next step."""
        self._steps += 1
        falling = 0.5 * (1 + math.cos(math.pi * self.done)) + 0.005
        return self._highest * min(self._steps / _WARM_UP_STEPS, falling)


class Pool:
    """Images of a folder of homes; new homes may be added during training."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._known: set[Path] = set()
        self.samples: list[Sample] = []

    def grow(self) -> None:
        """Load the homes that were rendered since the last call."""
        for path in home_files(self._folder):
            if path not in self._known:
                self._known.add(path)
                self.samples += samples(load_home(path))


def train(folder: Path, model: Path, schedule: Schedule, weights: Path | None) -> None:
    """Train from the fixed seed or from given weights, and write the model after every epoch."""
    torch.manual_seed(SEED)
    rng = np.random.default_rng(SEED)
    network = Detector(len(CLASSES)).to(memory_format=torch.channels_last)
    if weights is not None:
        network.load_state_dict(torch.load(weights))
    average, pool = Average(network), Pool(folder)
    optimizer = torch.optim.AdamW(
        network.parameters(), betas=(0.9, 0.98), weight_decay=_WEIGHT_DECAY
    )
    epoch = 0
    while schedule.done < 1:
        pool.grow()
        start_s, losses = time.monotonic(), []
        passes = (batches(pool.samples, _BATCH, rng) for _ in range(_PASSES))
        for images, labels in chain.from_iterable(passes):
            if schedule.done >= 1:
                break
            optimizer.param_groups[0]['lr'] = schedule.next_rate()
            losses.append(_step(network, optimizer, images, labels))
            average.update(network)
        epoch += 1
        _LOG.info(
            'epoch %d: %d images, loss %.3f, %.0f s, %.0f %% of the time',
            *(epoch, len(pool.samples), np.mean(losses), time.monotonic() - start_s),
            100 * schedule.done,
        )
        torch.save(average.network.state_dict(), model.with_suffix('.pt'))
        write_onnx(average.network, model)


def _step(
    network: Detector, optimizer: torch.optim.Optimizer, images: torch.Tensor, labels: Labels
) -> float:
    """Do one optimization step, and return the loss."""
    with torch.autocast('cpu', torch.bfloat16):
        boxes, logits = network(images)
    cost = loss(boxes, logits, _CENTERS, labels)
    optimizer.zero_grad()
    cost.backward()
    nn.utils.clip_grad_norm_(network.parameters(), 10.0)
    optimizer.step()
    return float(cost.item())


def main(argv: Sequence[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description='Train the detector for rendered scenes.')
    parser.add_argument('folder', type=Path)
    parser.add_argument('model', type=Path)
    parser.add_argument('--minutes', type=float, default=70)
    parser.add_argument('--rate', type=float, default=2.5e-3, help='highest learning rate')
    parser.add_argument('--weights', type=Path, help='continue from the weights in a .pt file')
    parser.add_argument('--threads', type=int, default=1)
    args = parser.parse_args(argv)
    logging.basicConfig(level=logging.INFO, format='%(message)s')
    torch.set_num_threads(args.threads)
    cv2.setNumThreads(1)
    train(args.folder, args.model, Schedule(args.minutes, args.rate), args.weights)


if __name__ == '__main__':
    main()
