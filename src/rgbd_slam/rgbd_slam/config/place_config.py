"""Parameters of recognising places, of verifying them and of closing loops."""

from __future__ import annotations

from dataclasses import dataclass

from hoid_common.config import Config, param


@dataclass(frozen=True)
class IndexConfig(Config):
    """How keyframes are indexed and looked up."""

    num_tables: int = param(4, 'Hash tables: more find more matches', minimum=1, maximum=16)
    key_bits: int = param(20, 'Descriptor bits in a key', minimum=8, maximum=30)
    max_features: int = param(400, 'Features used of a keyframe or a query', minimum=50)
    max_hamming: int = param(40, 'Bits by which a match may differ', minimum=1, maximum=128)
    max_bucket: int = param(200, 'Descriptors that make a key too common to use', minimum=8)


@dataclass(frozen=True)
class AlignmentConfig(Config):
    """RANSAC over feature matches."""

    hypotheses: int = param(200, 'Samples tried', minimum=10, maximum=5000)
    max_error_px: float = param(4.0, 'Error of an inlier in octave 0', minimum=0.5, maximum=20.0)
    min_inliers: int = param(15, 'Matches that must agree', minimum=6)


@dataclass(frozen=True)
class VerificationConfig(Config):
    """What it takes to believe that two views show one place."""

    max_candidates: int = param(3, 'Places tried for one image', minimum=1, maximum=20)
    min_votes: int = param(10, 'Matching features that make a keyframe a candidate', minimum=3)
    neighbours: int = param(6, 'Keyframes around the candidate whose points are used', minimum=0)
    max_hamming: int = param(60, 'Bits by which a match may differ', minimum=1, maximum=256)
    ratio: float = param(0.85, 'Best over second best distance', minimum=0.1, maximum=1.0)
    min_inliers: int = param(40, 'Points that must be found', minimum=10)
    min_found_share: float = param(
        0.5, 'Found of the points that should be', minimum=0.0, maximum=1.0
    )
    max_contradicted_share: float = param(
        0.1, 'Of the points in view that depth may look through', minimum=0.0, maximum=1.0
    )
    max_rival_share: float = param(
        0.6, 'Points found at the best place that another may have too', minimum=0.0, maximum=1.0
    )
    alignment: AlignmentConfig = AlignmentConfig()


@dataclass(frozen=True)
class LoopConfig(Config):
    """When a loop is closed and how."""

    enabled: bool = param(True, 'Look for loops and for other maps of the same place')
    min_support: int = param(2, 'Keyframes around that must see the place too', minimum=0)
    merge_inliers: int = param(60, 'Points that must be found to merge two maps', minimum=10)
    drift_m: float = param(0.1, 'Drift believed possible anywhere', minimum=0.0)
    drift_share: float = param(0.04, 'The same, per metre of path', minimum=0.0, maximum=1.0)
    drift_deg: float = param(4.0, 'Drift of the heading believed possible anywhere', minimum=0.0)
    drift_deg_per_m: float = param(1.0, 'The same, per metre of path', minimum=0.0)
    essential_shared: int = param(
        100, 'Points that two keyframes share to be tied in the pose graph', minimum=1
    )
    small_m: float = param(
        0.03, 'Corrections below, at the end of a short way, need no adjustment of the whole map',
        minimum=0.0,
    )  # fmt: skip
    small_deg: float = param(1.5, 'The same, of the heading', minimum=0.0)
    long_way_m: float = param(
        5.0, 'A way on which drift may lie hidden even if its ends fit by chance', minimum=0.0
    )
    global_iterations: int = param(
        6, 'Of adjusting the whole map after a loop, a round; 0: none', minimum=0, maximum=100
    )


@dataclass(frozen=True)
class PlaceConfig(Config):
    """All of it."""

    new_map_after_s: float = param(
        3.0, 'Lost for longer while images come, a new map is started', minimum=0.1,
        maximum=3600.0, read_only=False,
    )  # fmt: skip
    index: IndexConfig = IndexConfig()
    verification: VerificationConfig = VerificationConfig()
    loops: LoopConfig = LoopConfig()
