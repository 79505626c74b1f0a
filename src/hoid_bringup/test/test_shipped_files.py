"""The RViz and Foxglove layouts use only topics that the suite publishes."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from hoid_common import topics

SRC = Path(__file__).parents[2]
SHOWN = {
    topics.DETECTIONS, topics.FEATURES, topics.DYNAMIC_OBJECTS, topics.ODOM, topics.PATH,
    topics.MAP_POINTS, topics.CLOUD_MAP, topics.GRID_MAP, topics.KEYFRAMES, topics.SLAM_STATUS,
    topics.TRACKED_OBJECTS, topics.TRACKED_OBJECT_MARKERS, topics.OBJECT_MAP_MARKERS,
    topics.DEBUG_IMAGE.replace('~', 'hoid_filter'),
    topics.DEBUG_IMAGE.replace('~', 'hoid_detector'),
}  # fmt: skip


def test_rviz_shows_only_what_is_published() -> None:
    document = yaml.safe_load((SRC / 'hoid_bringup/rviz/hoid.rviz').read_text())
    shown = document['Visualization Manager']['Displays']
    names = {display['Topic']['Value'] for display in shown if 'Topic' in display}
    assert len(names) >= 8
    assert names <= SHOWN


def test_foxglove_shows_only_what_is_published() -> None:
    layout = json.loads((SRC / 'hoid_bringup/foxglove/hoid.json').read_text())
    names = set(re.findall(r'"(/[a-z][\w/]*)', json.dumps(layout)))
    assert len(names) >= 10
    assert {name.lstrip('/') for name in names} <= SHOWN | {'diagnostics'}
    assert set(panels(layout['layout'])) == layout['configById'].keys()


def panels(node: str | dict[str, Any]) -> Iterator[str]:
    """Yield the panels of a Foxglove layout, which is a tree of split windows."""
    if isinstance(node, str):
        yield node
        return
    for side in ('first', 'second'):
        yield from panels(node[side])
