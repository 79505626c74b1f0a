"""Parameters are few for a user, and their descriptions are complete sentences."""

from __future__ import annotations

import re

import pytest

from hoid_bringup.live.node_specs import NODE_CONFIGS
from hoid_bringup.run.run_config import RunConfig
from hoid_common.config import Param

MOST_OF_A_USER = 12
UNIT = re.compile(
    r'\((s|m|m/s|Hz|pixels|degrees|degrees/s|bits|gray levels|%)\)|'
    r'\bshare\b|\bnumber\b|from 0 to 1|\(without unit\)',
    re.IGNORECASE,
)
LEAVES = [
    pytest.param(leaf, id=f'{node}-{leaf.name}')
    for node, config in NODE_CONFIGS.items()
    for leaf in config.node_params()
]


@pytest.mark.parametrize('node', NODE_CONFIGS)
def test_a_user_sees_few_parameters(node: str) -> None:
    users = [leaf.name for leaf in NODE_CONFIGS[node].node_params() if not leaf.spec.expert]
    assert 'expert' in users
    assert len(users) <= MOST_OF_A_USER, users


@pytest.mark.parametrize('leaf', LEAVES)
def test_a_description_has_full_sentences_and_the_unit(leaf: Param) -> None:
    text, value = leaf.spec.description, leaf.value
    sentences = re.findall(r'[A-Z][^.]*(?:\.{3}[^.]*|\.\w[^.]*)*\.(?= |$)', text)
    assert ' '.join(sentences) == text
    assert all(len(sentence.split()) >= 3 for sentence in sentences)
    if isinstance(value, int | float) and not isinstance(value, bool):
        assert UNIT.search(text), text
    if not leaf.spec.expert:
        assert len(sentences) >= 2, 'what it does, and when to change it'


def test_every_parameter_is_described_once() -> None:
    descriptions = [
        leaf.spec.description for c in NODE_CONFIGS.values() for leaf in c.node_params()
    ]
    shared = {'input', 'expert', 'autostart', 'alignment'}  # and sections of several nodes
    own = [
        leaf.spec.description
        for config in NODE_CONFIGS.values()
        for leaf in config.node_params()
        if not shared & set(leaf.name.split('.'))
    ]
    assert len(own) < len(descriptions)
    assert {text for text in own if own.count(text) > 1} <= {
        # of tracking, of places and of triangulation, which match for themselves
        'Largest ratio of the best to the second best distance of a match, a share.',
    }


def test_runs_have_the_parameters_of_the_nodes_by_the_same_names() -> None:
    names = {leaf.name for leaf in RunConfig().node_params()}
    stages = ('detector', 'filter', 'slam', 'scene')
    assert names == {
        f'{stage}.{leaf.name}'
        for stage, config in zip(stages, NODE_CONFIGS.values(), strict=True)
        for leaf in config.node_params()
    }
