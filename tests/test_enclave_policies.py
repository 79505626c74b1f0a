"""The SROS2 policies allow exactly the topics and services that the nodes use."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest

from hoid_common import topics
from hoid_system_tests.probe import Probe
from hoid_system_tests.processes import Start

pytestmark = pytest.mark.thorough

POLICIES = Path(__file__).parents[1] / 'src/hoid_bringup/policies/hoid.policy.xml'
NODES: dict[
    str, list[dict[str, Any]]
] = {  # parameter sets of each node, which together create all its topics
    'hoid_detector': [
        {'model': 'synthetic', 'base_frame': 'base_link', 'expected_score_threshold': 0.2}
    ],
    'hoid_filter': [{'strategy': 'hoid+'}, {'detections.as_vision_msgs': True}],
    'rgbd_slam': [
        {},
        {'frames.publish_odom_to_base': False},
    ],
    'hoid_scene': [
        {},
        {
            'object_map.enabled': True,
            'object_map.label_cloud': True,
            'object_map.prior_score': 0.1,
            'navigation.enabled': True,
        },
    ],
}
# Topics of bags, of no node; and inputs in place of others, which the policy's comment mentions.
NOT_OF_NODES = {'CLOCK', 'GROUND_TRUTH', 'TRUE_DETECTIONS'}
_LIMIT_S = 60.0
USES = ('topic', 'service')  # tags of names in a policy
Uses = dict[str, set[str]]
"""Names by their use, as in a policy: "topics publish", "services reply", ..."""


def allowed(node: str) -> Uses:
    """Return the absolute names that the policies allow a node to use."""
    root = ET.parse(POLICIES).getroot()  # noqa: S314  # our own file
    (profile,) = root.findall(f".//profile[@node='{node}']")
    return {
        f'{rule.tag} {action}': {absolute(str(name.text), node) for name in rule}
        for rule in profile
        for action in ('publish', 'subscribe', 'reply', 'request')
        if rule.get(action) == 'ALLOW'
    }


def absolute(name: str, node: str) -> str:
    if name.startswith('/'):
        return name
    return f'/{node}/{name[2:]}' if name.startswith('~/') else f'/{name}'


def used(probe: Probe, node: str) -> Uses:
    """Return the names that a node uses in the graph."""
    ask = probe.node
    found = {
        'topics publish': ask.get_publisher_names_and_types_by_node(node, '/'),
        'topics subscribe': ask.get_subscriber_names_and_types_by_node(node, '/'),
        'services reply': ask.get_service_names_and_types_by_node(node, '/'),
        'services request': ask.get_client_names_and_types_by_node(node, '/'),
    }
    return {use: {name for name, _ in names} for use, names in found.items() if names}


def test_every_topic_and_service_is_in_the_policy() -> None:
    named = {str(name.text) for name in ET.parse(POLICIES).iter() if name.tag in USES}  # noqa: S314
    constants = {name: value for name, value in vars(topics).items() if name.isupper()}
    expected = {
        value
        for name, value in constants.items()
        if isinstance(value, str) and name not in NOT_OF_NODES
    }
    assert expected <= named


@pytest.mark.parametrize('node', NODES)
def test_a_node_uses_exactly_the_names_that_its_policy_allows(
    start: Start, probe: Probe, node: str
) -> None:
    found: Uses = {}
    for parameters in NODES[node]:
        running = start(node, f'{node}_node', parameters)
        probe.spin_until(lambda: node in probe.node.get_node_names(), f'no {node}', _LIMIT_S)
        probe.spin_until(
            lambda: 'topics publish' in used(probe, node), f'{node} publishes nothing'
        )
        probe.spin_for(3.0)
        now = used(probe, node)
        found = {use: found.get(use, set()) | now.get(use, set()) for use in found | now}
        running.stop()
        probe.spin_until(
            lambda: node not in probe.node.get_node_names(),
            f'{node} does not leave the graph',
            _LIMIT_S,
        )
    assert found == allowed(node)
