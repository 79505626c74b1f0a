"""Kernels in C++, for the loops where numpy is measured to be too slow (docs/architecture.md).

Plain functions over numpy arrays; the library has a C interface and is loaded with ctypes, so that
it needs no Python headers and serves every Python version.
"""

from hoid_native.boxes import (
    are_boxes_fit,
    intersections_over_union,
    judge_boxes,
    overlap_ratios,
)
from hoid_native.depths import depths_off_edges_m, sample_depths_m, torso_depths_m
from hoid_native.geometry import Gates, Lens, adjust_bundle, optimize_pose
from hoid_native.kernels import (
    Bar,
    Candidates,
    Wanted,
    corner_peaks_px,
    fast_corners,
    match_along_segments,
    match_by_projection,
    orb_descriptors,
    orientations_deg,
)
from hoid_native.masks import values_at, widen
from hoid_native.regions import cover_things

__all__ = [
    'Bar',
    'Candidates',
    'Gates',
    'Lens',
    'Wanted',
    'adjust_bundle',
    'are_boxes_fit',
    'corner_peaks_px',
    'cover_things',
    'depths_off_edges_m',
    'fast_corners',
    'intersections_over_union',
    'judge_boxes',
    'match_along_segments',
    'match_by_projection',
    'optimize_pose',
    'orb_descriptors',
    'orientations_deg',
    'overlap_ratios',
    'sample_depths_m',
    'torso_depths_m',
    'values_at',
    'widen',
]
