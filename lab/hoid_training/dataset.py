"""Renders the training set: a few frames of each of many homes, with ground-truth boxes.

Usage: python -m hoid_training.dataset FOLDER [--homes N] [--first SEED] [--workers N]
Existing homes are kept.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import cv2
import numpy as np
from tqdm import tqdm

from hoid_common.values import ByteArray, Float32Array, IntArray
from hoid_synth.config import LAYOUTS, PATHS, SceneConfig
from hoid_synth.scene import SceneRenderer

FIRST_SEED = 100_000  # tests use seeds below 1000
INPUT_WH = (384, 288)  # of the network
FRAMES_PER_HOME = 8
CLASSES = (  # those of the scenes, without 'keyboard', which is hardly ever visible
    'person',
    'backpack',
    'suitcase',
    'sports ball',
    'bottle',
    'cup',
    'chair',
    'couch',
    'potted plant',
    'dining table',
    'tv',
    'laptop',
    'book',
    'clock',
    'teddy bear',
)


@dataclass(frozen=True, eq=False)
class Home:
    """The labeled frames of one seed."""

    images_bgr: ByteArray  # (F, H, W, 3), with the size of the network's input
    frame: IntArray  # (N,) index of each box's frame
    boxes_xyxy_px: Float32Array  # (N, 4) in the network's input
    class_ids: IntArray  # (N,) index in CLASSES
    visible_px: Float32Array  # (N,) visible pixels at VGA


def scene_of(seed: int) -> SceneConfig:
    """Return the scene of a seed, with random camera path, layout and number of people."""
    rng = np.random.default_rng(seed)
    path = PATHS[int(rng.choice(len(PATHS), p=[0.5, 0.2, 0.1, 0.1, 0.1]))]
    layout = LAYOUTS[int(rng.random() < 0.1)]
    return SceneConfig(
        seed=seed,
        num_frames=1200 if path == 'loop' else 400,
        path=path,
        layout=layout,
        num_people=int(rng.integers(1, 5)),
        near_m=float(rng.uniform(1.2, 3.0)),
        depth_holes=False,
    )


def render_home(seed: int) -> Home:
    """Render frames spread over the recording of one seed."""
    config = scene_of(seed)
    renderer = SceneRenderer(config)
    images, frame, boxes, ids, visible = [], [], [], [], []
    rng = np.random.default_rng([seed, 7])
    for k, i in enumerate(sorted(rng.choice(config.frames, FRAMES_PER_HOME, replace=False))):
        out = renderer.frame(int(i))
        # The same scaling as the letterbox of the detector.
        images.append(cv2.resize(out.frame.image_bgr, INPUT_WH))
        counts = np.bincount(out.instance_image.ravel(), minlength=256)
        for box, name, instance in zip(
            out.detections.boxes_xyxy_px, out.detections.class_names, out.instances, strict=True
        ):
            if name not in CLASSES:
                continue
            frame.append(k)
            boxes.append(box * (INPUT_WH[0] / config.width_px))
            ids.append(CLASSES.index(name))
            visible.append(counts[instance])
    return Home(
        np.stack(images),
        np.array(frame, np.int64),
        np.array(boxes, np.float32).reshape(-1, 4),
        np.array(ids, np.int64),
        np.array(visible, np.float32),
    )


def _render_to(path: Path) -> None:
    cv2.setNumThreads(1)
    home = render_home(int(path.stem))
    partial = path.with_suffix('.part.npz')
    np.savez(
        partial,
        images_bgr=home.images_bgr,
        frame=home.frame,
        boxes_xyxy_px=home.boxes_xyxy_px,
        class_ids=home.class_ids,
        visible_px=home.visible_px,
    )
    partial.rename(path)


def load_home(path: Path) -> Home:
    """Return a rendered home from its file."""
    with np.load(path) as arrays:
        return Home(**{name: arrays[name] for name in arrays.files})


def home_files(folder: Path) -> list[Path]:
    """Return the files of a folder in order of their seeds."""
    return sorted(path for path in folder.glob('[0-9]*.npz') if path.suffixes == ['.npz'])


def main(argv: Sequence[str] | None = None) -> None:
    """Render the missing homes of a folder."""
    parser = argparse.ArgumentParser(description='Render the training set.')
    parser.add_argument('folder', type=Path)
    parser.add_argument('--homes', type=int, default=300)
    parser.add_argument('--first', type=int, default=FIRST_SEED, metavar='SEED')
    parser.add_argument('--workers', type=int, default=1)
    args = parser.parse_args(argv)
    args.folder.mkdir(parents=True, exist_ok=True)
    paths = [args.folder / f'{args.first + k}.npz' for k in range(args.homes)]
    missing = [path for path in paths if not path.exists()]
    with ProcessPoolExecutor(args.workers, get_context('spawn')) as pool:
        for _ in tqdm(pool.map(_render_to, missing), total=len(missing), unit='home'):
            pass


if __name__ == '__main__':
    main()
