"""Kernels in C++, for the loops where numpy is measured to be too slow (docs/architecture.md).

Functions over numpy arrays. An array of another dtype or shape than a kernel takes is refused with
a TypeError, values that a kernel cannot work on with a ValueError; one with gaps is copied. Where
`NDArray[Any]` stands, any real dtype is taken.
"""

from hoid_native._native import (
    Candidates,
    Gates,
    MatchThreshold,
    QueryConstraints,
    StereoParams,
    adjust_bundle,
    are_boxes_fit,
    corner_peaks_px,
    cover_things,
    depths_off_edges_m,
    fast_corners,
    intersections_over_union,
    judge_boxes,
    judge_matches,
    match_along_segments,
    match_by_projection,
    optimize_pose,
    orb_descriptors,
    orientations_deg,
    overlap_ratios,
    sample_depths_m,
    torso_depths_m,
    values_at,
    widen,
)

__all__ = [
    'Candidates',
    'Gates',
    'MatchThreshold',
    'QueryConstraints',
    'StereoParams',
    'adjust_bundle',
    'are_boxes_fit',
    'corner_peaks_px',
    'cover_things',
    'depths_off_edges_m',
    'fast_corners',
    'intersections_over_union',
    'judge_boxes',
    'judge_matches',
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
