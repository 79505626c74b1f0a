"""Print a digest of each kernel's result for fixed synthetic input, as JSON.

Usage: digests.py [FOLDER], to load the compiled module from FOLDER instead of the installed one.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np


def load_from(folder: str) -> None:
    """Load the compiled module in a folder in place of the installed one."""
    (file,) = Path(folder).glob('_native.*.so')
    spec = importlib.util.spec_from_file_location('hoid_native._native', file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    sys.modules[spec.name] = module


def main() -> None:
    if len(sys.argv) > 1:
        load_from(sys.argv[1])
    results = {**features_and_matches(), **poses(), **masks(), **motion(), **objects()}
    sys.stdout.write(json.dumps({name: digest(value) for name, value in results.items()}))


def digest(value: Any) -> str:
    parts: Iterable[Any] = value if isinstance(value, tuple) else (value,)
    data = b''.join(np.ascontiguousarray(part).tobytes() for part in parts)
    return hashlib.sha256(data).hexdigest()[:16]


def features_and_matches() -> dict[str, Any]:
    import hoid_native as kernels  # noqa: PLC0415  once `load_from` has chosen the module

    rng = np.random.default_rng(0)
    image = np.kron(rng.integers(0, 256, (40, 50)), np.ones((6, 7))).astype(np.uint8)
    image += rng.integers(0, 9, image.shape).astype(np.uint8)
    corners = kernels.fast_corners([image], np.full((1, 2), 1.5, np.float32), 12, 20)
    x, y = corners.xy_px.T.copy()
    angle_deg = kernels.orientations_deg(image, x, y)
    descriptors = kernels.orb_descriptors(image, x, y, angle_deg)
    key_bits = np.arange(0, 240, 6).astype(np.uint8).reshape(2, 20)
    octave = rng.integers(0, 4, len(x))
    measured = np.stack([x, y, x - 15], 1).astype(np.float32)
    low, high = (np.clip(octave + d, 0, 3).astype(np.int8) for d in (-1, 1))
    queries = kernels.QueryConstraints(low, high, descriptors)
    features = kernels.Candidates(measured, octave.astype(np.uint8), descriptors)
    threshold = kernels.MatchThreshold(80, 0.9)
    near = measured.T + rng.normal(0, 4, measured.T.shape)
    segments = np.concatenate([near[:2].T - 30, near[:2].T + 20], 1)
    radius_px = np.full(len(x), 15.0)
    return {
        'fast_corners': corners,
        'spread_evenly': kernels.spread_evenly(
            measured[:, :2], octave.astype(np.uint8), corners.score, np.array([9, 7, 5, 3]), 1e4
        ),
        'subpixel_offsets_px': kernels.subpixel_offsets_px(image, x, y),
        'orientations_deg': angle_deg,
        'orb_descriptors': descriptors,
        'match_by_projection': kernels.match_by_projection(
            near, radius_px, queries, features, threshold
        ),
        'hash_keys': kernels.hash_keys(descriptors, key_bits),
        'match_along_segments': kernels.match_along_segments(
            segments, np.arange(2.0, 6.0), queries, features, threshold
        ),
    }


def poses() -> dict[str, Any]:
    import hoid_native as kernels  # noqa: PLC0415

    rng = np.random.default_rng(1)
    camera = kernels.StereoParams(500.0, 510.0, 320.0, 240.0, 40.0, 0.3, 0.02)
    gates = kernels.Gates(5.991, 7.815)
    points = rng.uniform([-1.5, -1, 1.5], [1.5, 1, 5], (200, 3))
    T = np.tile(np.eye(4), (8, 1, 1))
    T[:, 0, 3] = 0.1 * np.arange(8)
    seen = (points[None] + T[:, None, :3, 3]).reshape(-1, 3)
    u = 500 * seen[:, 0] / seen[:, 2] + 320
    measured = np.stack([u, 510 * seen[:, 1] / seen[:, 2] + 240, u - 40 / seen[:, 2]], 1)
    measured += rng.normal(0, 0.7, measured.shape)
    measured[rng.random(len(measured)) < 0.3, 2] = np.nan
    moved = T.copy()
    moved[:5, 1, 3] += 0.02
    camera_index, point_index = (part.ravel() for part in np.mgrid[:8, :200])
    weight = np.ones(len(measured))
    return {
        'optimize_pose': kernels.optimize_pose(
            camera, gates, points, measured[:200], weight[:200], moved[0]
        ),
        'evaluate_matches': kernels.evaluate_matches(
            camera, gates, points, measured[:200], weight[:200], moved[0]
        ),
        'most_biasing_region': kernels.most_biasing_region(
            camera, gates, points, measured[:200], weight[:200], T[0], 0.5
        ),
        'move_points': moved_points(),
        'point_statistics': kernels.point_statistics(
            moved,
            np.arange(8),
            rng.integers(0, 8, (8, 200)).astype(np.uint8),
            rng.integers(0, 256, (8, 200, 32)).astype(np.uint8),
            points,
            np.arange(200) % 9,
            np.tile(np.arange(8), 200),
            np.arange(200).repeat(8),
            np.arange(200).repeat(8),
            1.2 ** np.arange(6),
        ),
        'adjust_bundle': kernels.adjust_bundle(
            camera, gates, moved, 5, points, camera_index, point_index, measured, weight, 2, 6
        ),
    }


def moved_points() -> tuple[Any, Any]:
    import hoid_native as kernels  # noqa: PLC0415

    rng = np.random.default_rng(4)
    position_m, direction = rng.normal(size=(50, 3)), rng.normal(size=(50, 3)).astype(np.float32)
    which = rng.integers(-1, 4, 50)
    kernels.move_points(rng.normal(size=(4, 4, 4)), which, position_m, direction)
    return position_m, direction


def masks() -> dict[str, Any]:
    import hoid_native as kernels  # noqa: PLC0415

    rng = np.random.default_rng(2)
    depth_m = np.kron(rng.uniform(0.5, 4, (12, 16)), np.ones((10, 10))).astype(np.float32)
    depth_m += rng.normal(0, 0.005, depth_m.shape).astype(np.float32)
    depth_m[rng.random(depth_m.shape) < 0.1] = 0
    first = rng.uniform(0, (130, 90), (30, 2))
    boxes = np.concatenate([first, first + rng.uniform(5, 30, (30, 2))], 1)
    roles = rng.integers(0, 3, 30).astype(np.uint8)
    pixels = rng.integers(0, depth_m.size, 2000)
    areas = np.round(boxes).astype(np.int32)
    far_m = kernels.box_center_depths_m(depth_m, boxes, 10)
    dynamic = kernels.segment_objects(depth_m, areas, far_m, np.full(30, 0.3), roles > 1)
    return {
        'box_center_depths_m': far_m,
        'person_depths_m': kernels.person_depths_m(depth_m, boxes, far_m),
        'classify_boxes': kernels.classify_boxes(depth_m, pixels, boxes, roles, 10, 0.4, 0.2),
        'classify_boxes by reach': kernels.classify_boxes(
            depth_m, pixels[:50], boxes, roles, 10, 0.4, 0.2, 3.0
        ),
        'segment_objects': dynamic,
        'overlap_ratios': kernels.overlap_ratios(boxes, boxes),
        'intersections_over_union': kernels.intersections_over_union(boxes, boxes),
    }


def motion() -> dict[str, Any]:
    import hoid_native as kernels  # noqa: PLC0415

    rng = np.random.default_rng(3)
    depth_m = np.kron(rng.uniform(1, 4, (6, 8)), np.ones((8, 8))).astype(np.float32)
    before_m = depth_m + rng.normal(0, 0.1, depth_m.shape).astype(np.float32)
    depth_m[rng.random(depth_m.shape) < 0.1] = 0
    camera, margin = kernels.Pinhole(50.0, 50.0, 31.5, 23.5), (0.05, 0.01, 0.002)
    T = np.eye(4)
    T[:3, 3] = 0.05, -0.02, 0.1
    found = kernels.depth_segments(depth_m, 10)
    range_m = np.stack([before_m - 0.1, before_m + 0.1], axis=2).astype(np.float32)
    points = rng.uniform([-1, -1, 1], [1, 1, 4], (200, 3))
    u, v = (50 * points[:, :2] / points[:, 2:]).T + np.array([[31.5], [23.5]])
    measured = np.stack([u, v, u - 5 / points[:, 2]], 1) + rng.normal(0, 0.5, (200, 3))
    stereo = kernels.StereoParams(50.0, 50.0, 31.5, 23.5, 5.0, 1.0, 0.0)
    poses = np.stack([np.eye(4), T])
    return {
        'depth_segments': found,
        'occlusion_log_odds': kernels.occlusion_log_odds(
            camera,
            depth_m,
            found.label,
            len(found.region),
            [(T, range_m, 0.2), (np.eye(4), range_m, 0.1)],
            margin,
            (1.5, 0.1, 0.25),
        ),
        'propagate_log_odds': kernels.propagate_log_odds(
            camera,
            T,
            depth_m,
            before_m,
            before_m,
            margin,
            0.9,
            found.label,
            rng.normal(0, 2, len(found.region)).astype(np.float32),
            3.5,
        ),
        'register_depth': kernels.register_depth(
            depth_m,
            rng.uniform(-1, 1, (*depth_m.shape, 3)).astype(np.float32)
            + np.array([0, 0, 1.5], np.float32),
            T[:3, 3].astype(np.float32),
            np.array([1.7, 2.3], np.float32),
            camera,
            (70, 50),
        ),
        'score_poses': kernels.score_poses(
            stereo, 1.0, 3.0, poses, points, measured, rng.random((200, 2))
        ),
        'align_triples': kernels.align_triples(
            points, points + rng.normal(0, 0.1, points.shape), rng.integers(0, 200, (30, 3))
        ),
    }


def objects() -> dict[str, Any]:
    import hoid_native as kernels  # noqa: PLC0415

    rng = np.random.default_rng(5)
    depth_m = np.kron(rng.uniform(1, 4, (6, 8)), np.ones((8, 8))).astype(np.float32)
    depth_m += rng.normal(0, 0.005, depth_m.shape).astype(np.float32)
    points = np.moveaxis(np.mgrid[:48, :64], 0, -1).reshape(-1, 2) / 50 - 0.5
    points = np.column_stack([points, np.ones(len(points))]) * depth_m.reshape(-1, 1)
    first = rng.integers(0, (40, 24), (9, 2))
    boxes = np.concatenate([first, first + rng.integers(8, 24, (9, 2))], 1).astype(np.int32)
    T, grid, ends = np.tile(np.eye(4), (9, 1, 1)), (0.05, 10), np.arange(100, 1000, 100)
    low, high = rng.uniform(-2, 0, (9, 3)), rng.uniform(1, 4, (9, 3))
    voxels, others = (kernels.voxels_of(part, *grid) for part in (points, points + 0.02))
    merged = kernels.merged_voxels(voxels, others, 1.5, 500)
    solid = kernels.solid_voxels(merged, 1.0, 0.4, 0.2, 10)
    cells = np.unique(kernels.voxel_keys(merged.means_m[solid], *grid))
    uv, rows = rng.uniform(0, 60, (900, 2)), np.arange(900)
    z, flags = rng.uniform(1, 4, 900), rng.random(900) < 0.7
    return {
        'object_surfaces': kernels.object_surfaces(
            depth_m, points, 0.02, boxes, (boxes[:, 2:] - boxes[:, :2]).prod(1).astype(float),
            np.arange(9) == 4, np.arange(9) != 3, np.arange(9) != 5,
            T, low, high, rng.integers(-1, 9, depth_m.size).astype(np.int32),
        ),
        'voxel_keys': kernels.voxel_keys(points, *grid),
        'voxels_of': voxels,
        'merged_voxels': merged,
        'solid_voxels': solid,
        'pixels_on_surface': kernels.pixels_on_surface(
            depth_m, points, (4, 4, 60, 40), T[0], cells, *grid
        ),
        'share_on_surface': kernels.share_on_surface(points, T[0], cells, *grid),
        'transformed_parts': kernels.transformed_parts(points[:900], ends, T),
        'seen_voxels': kernels.seen_voxels(depth_m, rows, uv, z, flags, ends, (0.06, 0.006)),
        'missed_voxels': kernels.missed_voxels(uv, flags, np.array([9.0, 9, 40, 30]), rows, 64),
        'pair_scores': kernels.pair_scores(
            points[:900], ends, boxes, T, low, high, uv, flags, ends, np.ones((9, 9), np.bool_)
        ),
    }  # fmt: skip


if __name__ == '__main__':
    main()
