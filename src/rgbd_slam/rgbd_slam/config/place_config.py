"""Parameters of place recognition, geometric verification and loop closing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from hoid_common.config import Config, param, section


@dataclass(frozen=True)
class IndexConfig(Config):
    """How the descriptors of keyframes are indexed and looked up."""

    method: str = param(
        'hash',  # places_and_loops.md: recall at 1 of 0.975 against 0.650 of binary words
        'Name of the place index, which finds keyframes that resemble an image: `hash`, or an '
        'entry point in the group rgbd_slam.place_indices of another package.',
        expert=True,
    )
    # Number of hash tables. More tables find more matches, but take more time and memory.
    # places_and_loops.md: recall at 1 of 0.975 against 0.650 of binary words.
    num_tables: int = param(4, internal=True)
    # Number of descriptor bits in a hash key. Longer keys find fewer and better matches.
    # places_and_loops.md, as above.
    key_bits: int = param(20, internal=True)
    # Largest number of features per keyframe or image that are indexed or looked up. Not tuned.
    max_features: ClassVar[int] = 400
    # In a segment of the index, a key that more than this number of descriptors share is ignored
    # as too common. Not tuned.
    max_bucket: ClassVar[int] = 200
    # Largest distance of two matching descriptors (bits). Not tuned; ORB-SLAM3's strict limit is
    # 50 (ORBmatcher.cc, TH_LOW).
    max_hamming: ClassVar[int] = 40  # largest distance of two matching descriptors [bits]


@dataclass(frozen=True)
class VerificationConfig(Config):
    """Thresholds for the geometric evidence that two views show the same place.

    The values are not tuned. With all of them together, no false loop was closed on the recordings
    of docs/results/places_and_loops.md, one of which has repeated identical furniture.
    """

    max_candidates: ClassVar[int] = 3  # largest number of places that are verified for one image
    # Least number of matching features for a keyframe to become a candidate.
    min_votes: ClassVar[int] = 10
    max_hamming: ClassVar[int] = 60  # largest distance of two matching descriptors [bits]
    # A place is rejected if more than this ratio of its points in view is contradicted by depth:
    # all depths measured around such a point are larger.
    max_contradicted_share: ClassVar[float] = 0.1
    # A recognized place is ambiguous if, at another place, more than this ratio of its number of
    # points is found as well.
    max_second_place_share: ClassVar[float] = 0.6
    # Number of keyframes around a candidate place whose points are matched too. A larger number
    # finds places that are seen from farther away, but takes more time.
    neighbors: ClassVar[int] = 6
    # Largest ratio of the best to the second best descriptor distance of a match at a candidate
    # place.
    ratio: ClassVar[float] = 0.85
    # Least number of map points that must be found at a recognized place. A larger number rejects
    # more false places, but also more true ones.
    min_inliers: ClassVar[int] = 40
    # A place is rejected if the ratio of points found to points expected in view is smaller. The
    # ratio distinguishes a place from another one with identical furniture.
    min_found_share: ClassVar[float] = 0.5


@dataclass(frozen=True)
class LoopConfig(Config):
    """When a loop is closed, and how the map is corrected then."""

    enabled: bool = param(
        default=True,  # places_and_loops.md: 0.30 of the ATE is left, in the median
        description='Whether to close loops and to merge maps that show the same place. Set it '
        'to false to see the drift of the visual odometry.',
    )
    # Not tuned, except where another source is named.
    global_iterations: ClassVar[int] = 6  # of each solution of the global bundle adjustment
    # Least number of keyframes near the new one that must recognize the place as well. ORB-SLAM
    # needs three consistent groups of keyframes.
    min_support: ClassVar[int] = 2
    # Least number of points that must be found to merge two maps.
    merge_inliers: ClassVar[int] = 60
    # Largest drift in position and rotation that a loop may correct: a constant part, plus a part
    # in proportion to the length of the path between the ends of the loop.
    drift_m: ClassVar[float] = 0.1
    drift_share: ClassVar[float] = 0.04
    drift_deg: ClassVar[float] = 4.0
    drift_deg_per_m: ClassVar[float] = 1.0
    # Least number of points that two keyframes of an edge of the essential graph share (Mur-Artal
    # et al., T-RO 2015, theta).
    essential_shared: ClassVar[int] = 100
    # A short loop needs no global adjustment if its correction is below both this distance and
    # this angle.
    small_m: ClassVar[float] = 0.03
    small_deg: ClassVar[float] = 1.5
    # If the path between the ends of a loop is longer, the map around the loop is adjusted
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
