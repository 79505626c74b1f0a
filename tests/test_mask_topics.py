"""The masks for Nav2's costmap filters, as topics of a node that sees people walk."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from nav2_msgs.msg import CostmapFilterInfo
from nav_msgs.msg import OccupancyGrid
from people_msgs.msg import People
from tf2_msgs.msg import TFMessage

from hoid_common.ros import conversions, qos
from hoid_common.se3 import T_BODY_OPTICAL
from hoid_scene.config.navigation_config import NavigationConfig
from hoid_synth.config import SceneConfig
from hoid_system_tests.probe import Probe
from hoid_system_tests.processes import Start
from hoid_system_tests.rendered_room import recording
from hoid_system_tests.scene_peer import ScenePeer, start_scene

pytestmark = [pytest.mark.thorough, pytest.mark.alone]


def cell_at(mask: Any, x_m: float, y_m: float) -> tuple[int, int]:
    """Return row and column of the cell of a mask at a point."""
    origin, cell_m = mask.info.origin.position, mask.info.resolution
    return int((y_m - origin.y) // cell_m), int((x_m - origin.x) // cell_m)


def is_inside(mask: Any, x_m: float, y_m: float) -> bool:
    """Return whether a mask has a cell at a point: it has those of the grid."""
    row, column = cell_at(mask, x_m, y_m)
    return bool(0 <= row < mask.info.height and 0 <= column < mask.info.width)


def value_at(mask: Any, x_m: float, y_m: float) -> int:
    """Return the value of a mask at a point within it."""
    assert is_inside(mask, x_m, y_m)
    cells = np.array(mask.data, np.int8).reshape(mask.info.height, mask.info.width)
    return int(cells[cell_at(mask, x_m, y_m)])


def test_masks_close_the_way_of_walking_people_and_slow_where_they_were(
    start: Start, probe: Probe, tmp_path: Path
) -> None:
    start_scene(
        start,
        {'navigation.enabled': True, 'dense.publish_period_s': 0.2},
        {'frames.base': 'base_link'},
        map_directory=str(tmp_path),
    )
    people = probe.collect(People, 'people', wait=False)
    closed, slow = (
        probe.collect(OccupancyGrid, f'{name}_mask', qos.LATCHED, wait=False)
        for name in ('keep_out', 'speed')
    )
    infos = [
        probe.collect(CostmapFilterInfo, f'{name}_mask/info', qos.LATCHED, wait=False)
        for name in ('keep_out', 'speed')
    ]
    peer = ScenePeer(probe)
    images = list(recording(SceneConfig(num_frames=60), 'hoid+'))
    static = probe.publisher(TFMessage, '/tf_static', qos.TF_STATIC)
    frame = images[0].features.header.frame_id
    edge = conversions.transform_to_msg(T_BODY_OPTICAL, images[0].stamp_ns, 'base_link', frame)
    static.publish(TFMessage(transforms=[edge]))
    probe.spin_for(0.3)
    peer.begin(images[0].camera)
    peer.play(images)
    probe.spin_until(lambda: bool(slow and max(slow[-1].data) > 0), 'no crossings', 30.0)
    probe.spin_for(1.0)

    masks = {conversions.stamp_from_msg(msg.header.stamp): msg for msg in closed}
    assert {msg.header.frame_id for msg in masks.values()} == {'map'}
    walking = [
        (masks[stamp_ns], person)
        for msg in people
        if (stamp_ns := conversions.stamp_from_msg(msg.header.stamp)) in masks
        for person in msg.people
        if np.hypot(person.velocity.x, person.velocity.y) > NavigationConfig.walking_mps
    ]
    ahead = []
    for mask, person in walking:
        at_m = np.array([person.position.x, person.position.y])
        at_m += np.array([person.velocity.x, person.velocity.y]) * 0.5
        if is_inside(mask, *at_m):
            ahead.append(value_at(mask, *at_m))
    assert set(ahead) == {100}
    *_, last = (person for msg in people for person in msg.people)
    assert value_at(slow[-1], last.position.x, last.position.y) >= 10
    kinds = [(i[-1].type, i[-1].filter_mask_topic.split('/')[-1], i[-1].base) for i in infos]
    assert kinds == [(0, 'keep_out_mask', 0.0), (1, 'speed_mask', 100.0)]
    assert all(i[-1].filter_mask_topic.startswith('/') for i in infos)
