"""Measures the normal of a horizontal surface by the depth and the reference poses of a recording.

    python lab/scripts/floor_normal.py SEQUENCE [--low -0.25] [--high 0.3] [--every 8]

SEQUENCE is a TUM folder or a bag with reference poses whose z axis points up. A plane is fitted in
each image to the points between two heights [m] of the reference. The reference may be tilted: on
`fr1_xyz`, floor and desk lean by over 2 degrees in the same direction.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from hoid_bags.sequence import open_sequence
from hoid_common import se3
from hoid_common.errors import HoidError, InputError
from hoid_common.values import FloatArray
from hoid_scene.dense.depth_view import pixel_rays

_STRIDE, _FAR_M, _SAME_IMAGE_NS = 4, 4.0, 20_000_000
_NEAR_M, _MIN_POINTS, _TRIALS = 0.012, 600, 300
_MIN_WIDTH_M = 0.1  # standard deviation along the narrower side of a plane that shows its tilt
_LEVEL = 0.95  # smallest z of the normal of a floor, which excludes walls


def plane_of(points_m: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, int] | None:
    """Return the upward unit normal (3,) of the largest plane, and its number of points."""
    corners = points_m[rng.integers(len(points_m), size=(_TRIALS, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    offsets_m = np.abs(points_m @ normals.T - (corners[:, 0] * normals).sum(axis=1))
    near = offsets_m[:, (offsets_m < _NEAR_M).sum(axis=0).argmax()] < _NEAR_M
    for _ in range(4):
        if np.count_nonzero(near) < _MIN_POINTS:
            return None
        center_m = points_m[near].mean(axis=0)
        variances, axes = np.linalg.eigh(np.cov((points_m[near] - center_m).T))
        normal = axes[:, 0] * np.sign(axes[2, 0])
        near = np.abs((points_m - center_m) @ normal) < _NEAR_M
    is_floor = normal[2] > _LEVEL and variances[1] > _MIN_WIDTH_M**2
    return (normal, int(np.count_nonzero(near))) if is_floor else None


def main() -> int:
    """Print the mean normal, and its angle to the vertical of the reference."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('sequence', type=Path)
    parser.add_argument('--low', type=float, default=-0.25)
    parser.add_argument('--high', type=float, default=0.3)
    parser.add_argument('--every', type=int, default=8)
    args = parser.parse_args()
    sequence = open_sequence(args.sequence)
    reference = sequence.ground_truth
    if reference is None:
        raise InputError(f'{args.sequence} has no reference poses')
    rays, rng = pixel_rays(sequence.camera, _STRIDE).reshape(-1, 3), np.random.default_rng(0)
    found = []
    for i, frame in enumerate(sequence):
        k = int(np.abs(reference.stamps_ns - frame.stamp_ns).argmin())
        is_known = abs(int(reference.stamps_ns[k]) - frame.stamp_ns) < _SAME_IMAGE_NS
        if i % args.every or not is_known:
            continue
        z = frame.depth_m[::_STRIDE, ::_STRIDE].reshape(-1, 1)
        near = (z[:, 0] > 0) & (z[:, 0] < _FAR_M)
        points_m = se3.transform(reference.T_world_camera[k], (rays * z)[near].astype(np.float64))
        points_m = points_m[(points_m[:, 2] > args.low) & (points_m[:, 2] < args.high)]
        if len(points_m) >= _MIN_POINTS and (plane := plane_of(points_m, rng)) is not None:
            found.append(plane)
    if not found:
        raise InputError(f'{args.sequence}: no image shows a plane between these heights')
    mean = np.average([n for n, _ in found], axis=0, weights=[count for _, count in found])
    mean /= np.linalg.norm(mean)
    angle_deg = np.degrees(np.arccos(mean[2]))
    sys.stdout.write(
        f'{len(found)} images: normal {mean.round(3).tolist()}, {angle_deg:.2f} degrees off\n'
    )
    return 0


if __name__ == '__main__':
    try:
        sys.exit(main())
    except HoidError as error:
        sys.stderr.write(f'floor_normal: {error}\n')
        sys.exit(1)
