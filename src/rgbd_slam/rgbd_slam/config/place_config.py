"""Parameters of recognising places, of verifying them and of closing loops."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from hoid_common.config import Config, param, section


@dataclass(frozen=True)
class IndexConfig(Config):
    """How keyframes are indexed and looked up."""

    num_tables: int = param(
        4, 'Number of hash tables; more find more matches.', minimum=1, maximum=16
    )
    key_bits: int = param(20, 'Number of descriptor bits in a key.', minimum=8, maximum=30)
    max_features: int = param(
        400, 'Number of features that are used of a keyframe or a query.', minimum=50
    )
    max_bucket: int = param(
        200, 'Number of descriptors that make a key too common to use.', minimum=8
    )

    max_hamming: ClassVar[int] = 40  # bits by which a match may differ


@dataclass(frozen=True)
class AlignmentConfig(Config):
    """RANSAC over feature matches."""

    hypotheses: int = param(200, 'Number of samples that are tried.', minimum=10, maximum=5000)
    min_inliers: int = param(15, 'Number of matches that must agree.', minimum=6)

    max_error_px: ClassVar[float] = 4.0  # of an inlier in octave 0


@dataclass(frozen=True)
class VerificationConfig(Config):
    """What it takes to believe that two views show one place."""

    neighbours: int = param(
        6, 'Number of keyframes around the candidate whose points are used.', minimum=0
    )
    ratio: float = param(
        0.85, 'Largest ratio of the best to the second best distance of a match, a share.',
        minimum=0.1, maximum=1.0,
    )  # fmt: skip
    min_inliers: int = param(40, 'Number of points that must be found.', minimum=10)
    min_found_share: float = param(
        0.5, 'Share of the points that should be seen which must be found.',
        minimum=0.0, maximum=1.0,
    )  # fmt: skip
    alignment: AlignmentConfig = section(AlignmentConfig)

    max_candidates: ClassVar[int] = 3  # places tried for one image
    min_votes: ClassVar[int] = 10  # matching features that make a keyframe a candidate
    max_hamming: ClassVar[int] = 60  # bits by which a match may differ
    # Share of the points in view that depth may look through.
    max_contradicted_share: ClassVar[float] = 0.1
    # Share of the points found at the best place that another may have too.
    max_rival_share: ClassVar[float] = 0.6


@dataclass(frozen=True)
class LoopConfig(Config):
    """When a loop is closed and how."""

    enabled: bool = param(
        default=True, description='Looks for loops and for other maps of the same place.'
    )
    long_way_m: float = param(
        5.0, 'Length of a way on which drift may hide even if its ends fit by chance (m).',
        minimum=0.0,
    )  # fmt: skip

    # Of adjusting the whole map after a loop, a round.
    global_iterations: ClassVar[int] = 6
    min_support: ClassVar[int] = 2  # keyframes around that must see the place too
    merge_inliers: ClassVar[int] = 60  # points that must be found to merge two maps
    # Drift believed possible anywhere, and the same per metre of path; of the heading as well.
    drift_m: ClassVar[float] = 0.1
    drift_share: ClassVar[float] = 0.04
    drift_deg: ClassVar[float] = 4.0
    drift_deg_per_m: ClassVar[float] = 1.0
    # Points that two keyframes share to be tied in the pose graph.
    essential_shared: ClassVar[int] = 100
    # Below both, at the end of a short way, the whole map needs no adjustment.
    small_m: ClassVar[float] = 0.03
    small_deg: ClassVar[float] = 1.5


@dataclass(frozen=True)
class PlaceConfig(Config):
    """All of it."""

    new_map_after_s: float = param(
        3.0, 'How long it is lost, while images come, before a new map is started (s).',
        minimum=0.1, maximum=3600.0, read_only=False,
    )  # fmt: skip
    index: IndexConfig = section(IndexConfig)
    verification: VerificationConfig = section(VerificationConfig)
    loops: LoopConfig = section(LoopConfig)
