"""Parameters of place recognition, geometric verification and loop closing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from hoid_common.config import Config, param, section


@dataclass(frozen=True)
class IndexConfig(Config):
    """How keyframes are indexed by their descriptors and looked up."""

    method: str = param(
        'hash',  # places_and_loops.md: recall at 1 of 0.975 against 0.650 of binary words
        'Name of the place index, which finds keyframes that resemble an image: `hash`, or an '
        'entry point in the group rgbd_slam.place_indices of another package.',
        expert=True,
    )
    # Number of hash tables. More tables find more matches and take more time and memory.
    # places_and_loops.md: recall at 1 of 0.975 against 0.650 of binary words.
    num_tables: int = param(4, internal=True)
    # Number of descriptor bits in a hash key. Longer keys find fewer and better matches.
    # places_and_loops.md, as above.
    key_bits: int = param(20, internal=True)
    # Not tuned: largest number of features of a keyframe or image that are indexed or looked up.
    max_features: ClassVar[int] = 400
    # Not tuned: number of descriptors with the same key in one segment of the index beyond which
    # the key is ignored there as too common.
    max_bucket: ClassVar[int] = 200
    # Not tuned; ORB-SLAM3's strict limit is 50 (ORBmatcher.cc, TH_LOW).
    max_hamming: ClassVar[int] = 40  # largest distance of two matching descriptors [bits]


@dataclass(frozen=True)
class VerificationConfig(Config):
    """The geometric evidence that two views show the same place.

    The values are not tuned: with all of them together, no false loop was closed on the recordings
    of docs/results/places_and_loops.md, one with repeated identical furniture among them.
    """

    max_candidates: ClassVar[int] = 3  # largest number of places that are verified for one image
    min_votes: ClassVar[int] = 10  # matching features that make a keyframe a candidate
    max_hamming: ClassVar[int] = 60  # largest distance of two matching descriptors [bits]
    # A place is rejected if more than this share of the points in view is contradicted: all depths
    # measured around such a point lie behind it.
    max_contradicted_share: ClassVar[float] = 0.1
    # A recognized place is ambiguous if more than this share of its number of found points is
    # found at a second place.
    max_second_place_share: ClassVar[float] = 0.6
    # Number of keyframes around a candidate place whose points are matched as well. A larger
    # number finds places that are seen from farther away and takes more time.
    neighbors: ClassVar[int] = 6
    # Largest ratio of the best to the second best descriptor distance of a match with a
    # candidate place.
    ratio: ClassVar[float] = 0.85
    # Number of map points that must be found at a recognized place. A larger number rejects more
    # false places and more true ones.
    min_inliers: ClassVar[int] = 40
    # A place is rejected if the ratio of the number of points found to the number expected in view
    # is smaller. The ratio distinguishes a place from one with identical furniture.
    min_found_share: ClassVar[float] = 0.5


@dataclass(frozen=True)
class LoopConfig(Config):
    """When a loop is closed, and how the map is corrected."""

    enabled: bool = param(
        default=True,  # places_and_loops.md: 0.30 of the ATE is left, in the median
        description='Whether to close loops and to merge maps that show the same place. Set it '
        'to false to see the drift of the visual odometry.',
    )
    # Not tuned, except where another source is named.
    global_iterations: ClassVar[int] = 6  # of each solution of the global bundle adjustment
    # Number of keyframes near the new one that must recognize the place as well. ORB-SLAM asks for
    # three consistent groups of keyframes.
    min_support: ClassVar[int] = 2
    merge_inliers: ClassVar[int] = 60  # points that must be found to merge two maps
    # Largest drift, in position and in rotation, that a loop may correct: a constant part plus a
    # part that is proportional to the length of the path between its ends.
    drift_m: ClassVar[float] = 0.1
    drift_share: ClassVar[float] = 0.04
    drift_deg: ClassVar[float] = 4.0
    drift_deg_per_m: ClassVar[float] = 1.0
    # Number of points that two keyframes must share for an edge of the essential graph (Mur-Artal
    # et al., T-RO 2015, theta).
    essential_shared: ClassVar[int] = 100
    # Distance and angle: a short loop whose correction is smaller than both needs no global
    # adjustment.
    small_m: ClassVar[float] = 0.03
    small_deg: ClassVar[float] = 1.5
    # Length of the path between the ends of a loop from which the map around it is adjusted
    # globally even if the correction is small.
    long_path_m: ClassVar[float] = 5.0


@dataclass(frozen=True)
class PlaceConfig(Config):
    """Place recognition, loop closing and the start of new maps."""

    new_map_after_s: float = param(
        3.0,  # not tuned
        'Longest time for which the camera is lost before a new map is started (s). Where the '
        'camera sees surfaces that are not in the map, 0.4 s are enough. Raise it if needless '
        'maps are started; lower it if poses are missing for too long after a loss.',
        limits=(0.1, 3600.0),
        read_only=False,
    )
    index: IndexConfig = section(IndexConfig)
    verification: VerificationConfig = section(VerificationConfig)
    loops: LoopConfig = section(LoopConfig)
