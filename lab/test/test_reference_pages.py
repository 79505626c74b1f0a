"""The reference pages are what `make reference` writes, and are complete."""

from __future__ import annotations

import re
from pathlib import Path

from hoid_benchmarks.publish.command_reference import command_reference
from hoid_benchmarks.publish.message_reference import message_reference
from hoid_benchmarks.publish.parameter_reference import parameter_reference
from hoid_bringup.cli import COMMANDS
from hoid_bringup.live.node_specs import NODE_CONFIGS

PAGE = Path(__file__).parents[2] / 'docs' / 'reference' / 'parameters.md'


def test_the_page_is_what_make_reference_writes() -> None:
    assert PAGE.read_text() == parameter_reference(), 'run "make reference"'


def test_the_page_of_commands_is_what_make_reference_writes() -> None:
    page = PAGE.with_name('commands.md').read_text()
    assert page == command_reference(), 'run "make reference"'
    assert re.findall('^## hoid (.*)$', page, re.MULTILINE) == list(COMMANDS)


def test_the_page_of_messages_is_what_make_reference_writes() -> None:
    page = PAGE.with_name('messages.md').read_text()
    assert page == message_reference(PAGE.parents[2] / 'src/hoid_msgs'), 'run "make reference"'
    fields = re.findall(r'^- `(.*?)`', page.partition('## SetMode')[2], re.MULTILINE)
    assert fields == ['MAPPING=mapping', 'LOCALIZATION=localization', 'string mode']


def test_the_page_names_every_parameter_of_every_node() -> None:
    sections = dict(text.split('\n', 1) for text in parameter_reference().split('\n## ')[1:])
    assert list(sections) == ['All nodes', *NODE_CONFIGS]
    shared = sections['All nodes'].split('### For experts')
    for node, config in NODE_CONFIGS.items():
        own = sections[node].split('### For experts')
        for leaf in config.node_params():
            row = f'\n- `{leaf.name}` ('
            assert (row in own[leaf.spec.expert]) + (row in shared[leaf.spec.expert]) == 1
