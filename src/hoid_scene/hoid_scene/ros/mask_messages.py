"""Converts the masks for navigation to messages of Nav2's costmap filters."""

from __future__ import annotations

from enum import IntEnum

from nav2_msgs.msg import CostmapFilterInfo
from nav_msgs.msg import OccupancyGrid
from std_msgs.msg import Header

from hoid_scene.navigation_masks import Mask
from hoid_scene.ros.conversions import occupancy_to_msg


class FilterType(IntEnum):
    """The kinds of costmap filters (nav2_costmap_2d/costmap_filters/filter_values.hpp)."""

    KEEP_OUT = 0
    SPEED_PERCENT = 1


# Base and multiplier: a cell of the speed mask is the percentage by which to go more slowly.
_BASES = {FilterType.KEEP_OUT: (0.0, 1.0), FilterType.SPEED_PERCENT: (100.0, -1.0)}


def mask_to_msg(mask: Mask, header: Header) -> OccupancyGrid:
    """Return the message of a mask, in the map frame of the header."""
    (x, y), _, cell_m = mask.extent
    return occupancy_to_msg(mask.cells, cell_m, (x * cell_m, y * cell_m, 0.0), header)


def filter_info_to_msg(kind: FilterType, mask_topic: str, header: Header) -> CostmapFilterInfo:
    """Return the message that tells Nav2 the topic of a mask and how to scale its values.

    Args:
        kind: The kind of the filter.
        mask_topic: Full name of the topic of the mask: Nav2's nodes have namespaces of their own.
        header: Header with the map frame.
    """
    base, multiplier = _BASES[kind]
    return CostmapFilterInfo(
        header=header,
        type=int(kind),
        filter_mask_topic=mask_topic,
        base=base,
        multiplier=multiplier,
    )
