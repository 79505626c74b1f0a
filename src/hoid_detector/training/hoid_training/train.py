"""Trains the detector for rendered scenes and writes it as ONNX.

Usage: python -m hoid_training.train FOLDER MODEL.onnx [--epochs N]
FOLDER is what `hoid_training.dataset` rendered.
"""

from __future__ import annotations

import argparse
import copy
import logging
import time
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import nn

from hoid_training.augment import VIEW_WH, batches, samples
from hoid_training.dataset import CLASSES, load
from hoid_training.export import write_onnx
from hoid_training.loss import loss
from hoid_training.network import STRIDES_PX, Detector, cell_centers

SEED = 1

_LOG = logging.getLogger(__name__)
_BATCH = 16
_LEARNING_RATE = 2.5e-3
_WEIGHT_DECAY = 0.02
_WARM_UP_STEPS = 200
_AVERAGE = 0.998  # of the weights, per step


class Average:
    """The running mean of a network's weights, which is what ships."""

    def __init__(self, network: nn.Module) -> None:
        self.network = copy.deepcopy(network).eval()
        self._steps = 0

    def update(self, network: nn.Module) -> None:
        """Move a little towards the network."""
        self._steps += 1
        keep = min(_AVERAGE, self._steps / (self._steps + 10))
        mine, its = self.network.state_dict(), network.state_dict()
        with torch.no_grad():
            for name, value in mine.items():
                if value.dtype.is_floating_point:
                    value.mul_(keep).add_(its[name], alpha=1 - keep)
                else:
                    value.copy_(its[name])


def train(folder: Path, model: Path, epochs: int, num_classes: int) -> None:
    """Train from the fixed seed; write the model after every epoch."""
    torch.manual_seed(SEED)
    rng = np.random.default_rng(SEED)
    pool = samples(load(folder))
    network = Detector(num_classes).to(memory_format=torch.channels_last)
    average = Average(network)
    optimizer = torch.optim.AdamW(
        network.parameters(), _LEARNING_RATE, betas=(0.9, 0.98), weight_decay=_WEIGHT_DECAY
    )
    total = epochs * (len(pool) // _BATCH)
    schedule = torch.optim.lr_scheduler.LambdaLR(
        optimizer,
        lambda k: min(k / _WARM_UP_STEPS, 0.5 * (1 + np.cos(np.pi * min(k / total, 1))) + 0.01),
    )
    centers = torch.cat([cell_centers(VIEW_WH[1] // s, VIEW_WH[0] // s, s) for s in STRIDES_PX])
    for epoch in range(epochs):
        start_s, losses = time.time(), []
        for images, labels in batches(pool, _BATCH, rng):
            with torch.autocast('cpu', torch.bfloat16):
                boxes, logits = network(images)
            cost = loss(boxes, logits, centers, labels)
            optimizer.zero_grad()
            cost.backward()
            nn.utils.clip_grad_norm_(network.parameters(), 10.0)
            optimizer.step()
            schedule.step()
            average.update(network)
            losses.append(cost.item())
        took_s = time.time() - start_s
        _LOG.info('epoch %d/%d: loss %.3f, %.0f s', epoch + 1, epochs, np.mean(losses), took_s)
        write_onnx(average.network, model)


def main(argv: Sequence[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description='Train the detector for rendered scenes.')
    parser.add_argument('folder', type=Path)
    parser.add_argument('model', type=Path)
    parser.add_argument('--epochs', type=int, default=60)
    parser.add_argument('--threads', type=int, default=1)
    args = parser.parse_args(argv)
    logging.basicConfig(level=logging.INFO, format='%(message)s')
    torch.set_num_threads(args.threads)
    cv2.setNumThreads(1)
    train(args.folder, args.model, args.epochs, len(CLASSES))


if __name__ == '__main__':
    main()
