"""Measures from which turn rate on `hoid+` should doubt people of low score (decision 050).

    python lab/scripts/turned_people.py PEOPLE STATIC [--detector yolox_nano] [--degrees 12]
        [--hz 0.8] [--images 450] [--limits RADPS ...]

PEOPLE is a TUM folder into whose images people were pasted, STATIC the recording without them. Its
images are turned about the vertical axis, as if the camera swung left and right, so that a real
detector sees people while the camera turns. Each limit has a row with the share of the corners on
people that are kept, and the share of those on static surface that are removed.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import ClassVar

import cv2
import numpy as np
from tqdm import tqdm

from hoid_bags.tum.tum_folder import open_tum_folder
from hoid_benchmarks.jobs.labeled import Labeled, pasted_people
from hoid_benchmarks.jobs.masks import Tally
from hoid_common import se3
from hoid_common.errors import HoidError
from hoid_common.values import S_PER_NS, CameraModel, Float32Array
from hoid_detector.config import DetectorConfig
from hoid_detector.model.model_path import find_model
from hoid_detector.onnx_detector import OnnxDetector
from hoid_filter.config import FilterConfig, PlusConfig
from hoid_filter.feature_filter import FeatureFilter

_EDGE_PX = 5  # corners this near to a person are not counted as static
_LIMITS_RADPS = 0.35, 0.5, 0.8, 1.6, 100.0  # the last one: nothing is doubted


def filter_with_limit(limit_radps: float, camera: CameraModel) -> FeatureFilter:
    """Return a filter with `hoid+` that doubts people above a turn rate."""

    @dataclass(frozen=True)
    class Limited(PlusConfig):
        doubt_turn_radps: ClassVar[float] = limit_radps

    return FeatureFilter(replace(FilterConfig(), plus=Limited()), camera)


def turned(shown: Labeled, camera: CameraModel, yaw_rad: float) -> Labeled:
    """Return an image as a camera would see it that is turned about the vertical axis.

    Pixels that the image does not show become black, without depth, and static.
    """
    K = np.array(
        [[camera.fx_px, 0, camera.cx_px], [0, camera.fy_px, camera.cy_px], [0, 0, 1]], np.float64
    )
    R_turned_camera = se3.exp(np.array([0.0, yaw_rad, 0.0, 0.0, 0.0, 0.0]))[:3, :3]
    H = K @ R_turned_camera @ np.linalg.inv(K)
    frame = shown.frame
    height, width = frame.depth_m.shape
    depth_m, moving = (
        cv2.warpPerspective(image, H, (width, height), flags=cv2.INTER_NEAREST)
        for image in (frame.depth_m, shown.moving.view(np.uint8))
    )
    v, u = np.mgrid[:height, :width]
    pixels = np.stack([u, v, np.ones_like(u)]).reshape(3, -1)
    old_z = (R_turned_camera.T @ np.linalg.inv(K) @ pixels)[2].reshape(height, width)
    image = cv2.warpPerspective(frame.image_bgr, H, (width, height))
    new = replace(
        frame,
        image_bgr=np.asarray(image, np.uint8),
        depth_m=np.asarray(depth_m / old_z, np.float32),
    )
    return Labeled(new, np.asarray(moving, np.bool_), None)


def count(tally: Tally, shown: Labeled, uv_px: Float32Array, *, kept: bool) -> None:
    """Count corners at (N, 2) positions that are all kept, or all removed."""
    kernel = np.ones((2 * _EDGE_PX + 1, 2 * _EDGE_PX + 1), np.uint8)
    near = cv2.dilate(shown.moving.view(np.uint8), kernel) > 0
    u, v = np.rint(uv_px).astype(np.int64).T
    tally.add(shown.moving[v, u], ~near[v, u], np.full(len(u), kept))


def main() -> int:
    """Print a table with a row for each limit."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('people', type=Path)
    parser.add_argument('static', type=Path)
    parser.add_argument('--detector', default='yolox_nano')
    parser.add_argument('--degrees', type=float, default=12.0)
    parser.add_argument('--hz', type=float, default=0.8)
    parser.add_argument('--images', type=int, default=450)
    parser.add_argument('--limits', type=float, nargs='+', default=_LIMITS_RADPS)
    args = parser.parse_args()
    try:
        tallies = tallies_by_limit(args)
    except HoidError as error:
        sys.stderr.write(f'turned_people: {error}\n')
        return 1
    sys.stdout.write('| limit rad/s | corners on people kept | static corners removed |\n')
    sys.stdout.write('|---|---|---|\n')
    for limit, tally in tallies.items():
        kept, removed, _ = tally.shares()
        sys.stdout.write(f'| {limit:.2f} | {100 * kept:.2f} % | {100 * removed:.2f} % |\n')
    return 0


def tallies_by_limit(args: argparse.Namespace) -> dict[float, Tally]:
    """Return the counts of corners for each limit of the turn rate."""
    people, static = open_tum_folder(args.people), open_tum_folder(args.static)
    detector = OnnxDetector(find_model(args.detector), DetectorConfig())
    filters = {limit: filter_with_limit(limit, people.camera) for limit in args.limits}
    tallies = {limit: Tally() for limit in filters}
    first_ns = people.pairs[0][0].stamp_ns
    for seen in tqdm(islice(pasted_people(people, static), args.images), unit='image'):
        elapsed_s = S_PER_NS * (seen.frame.stamp_ns - first_ns)
        yaw_rad = np.deg2rad(args.degrees) * np.sin(2 * np.pi * args.hz * elapsed_s)
        shown = turned(seen, people.camera, yaw_rad)
        found = detector.detect(shown.frame.image_bgr, shown.frame.stamp_ns)
        for limit, feature_filter in filters.items():
            result = feature_filter.process(shown.frame, found, for_picture=True)
            count(tallies[limit], shown, result.features.uv_px, kept=True)
            count(tallies[limit], shown, result.removed_uv_px, kept=False)
    return tallies


if __name__ == '__main__':
    sys.exit(main())
