"""The README is short, and the link targets, code and files that pages name exist."""

from __future__ import annotations

import pkgutil
import re
from dataclasses import fields
from pathlib import Path

import pytest

from hoid_benchmarks.publish.results_file import read_kept
from hoid_bringup.run.summary import Summary
from hoid_common.camera_topics import CAMERA_TOPICS

ROOT = Path(__file__).parents[1]
PAGES = sorted(
    [
        *ROOT.glob('*.md'),
        *ROOT.glob('docs/**/*.md'),
        *ROOT.glob('src/*/README.md'),
        *ROOT.glob('lab/**/README.md'),
    ]
)
MOST_README_CHARACTERS = 6000
MOST_DECISION_WORDS = 300


def test_readme_has_at_most_6000_characters() -> None:
    assert len((ROOT / 'README.md').read_text()) <= MOST_README_CHARACTERS


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as GitHub and MkDocs make them."""
    headings = re.findall(r'^#+ (.+)$', page.read_text(), re.MULTILINE)
    return {re.sub(r'[^\w\- ]', '', heading.lower()).replace(' ', '-') for heading in headings}


def test_readme_has_the_measured_errors_of_the_real_camera() -> None:
    kept = read_kept(ROOT / 'docs/results/hand_held.json')['office']
    errors = {row.cells[1]: row.cells[3:5] for row in kept.rows}
    shown = ', '.join(errors[name][0].split()[0] for name in ('hoid+', 'motion', 'none'))
    assert f'`hoid+` and `motion` equal no filter ({shown} m)' in (ROOT / 'README.md').read_text()
    assert errors['motion'][1] == errors['hoid+'][1] == 'equal'


@pytest.mark.parametrize('page', PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_link_targets_exist(page: Path) -> None:
    text = re.sub(r'```.*?```', '', page.read_text(), flags=re.DOTALL)
    for target in re.findall(r'\]\(([^)\s]+)\)', text):
        if target.startswith(('http://', 'https://')):
            continue
        name, _, anchor = target.partition('#')
        path = page.parent / name if name else page
        assert path.exists(), target
        assert not anchor or path.suffix != '.md' or anchor in anchors(path), target


@pytest.mark.parametrize(
    'page', sorted(ROOT.glob('docs/decisions/0*.md')), ids=lambda p: p.name[:3]
)
def test_a_decision_has_at_most_300_words_and_a_table(page: Path) -> None:
    lines = page.read_text().splitlines()
    words = ' '.join(line for line in lines if not line.startswith('|')).split()
    assert len(words) <= MOST_DECISION_WORDS


def test_every_field_of_the_summary_is_documented() -> None:
    page = (ROOT / 'docs/reference/files.md').read_text()
    assert [field.name for field in fields(Summary) if f'`{field.name}`' not in page] == []


def test_the_graph_has_every_topic_of_readme() -> None:
    graph = (ROOT / 'docs/images/graph.svg').read_text()
    rows = (ROOT / 'README.md').read_text().split('## Topics that matter')[1].split('\nMore:')[0]
    topics = re.findall(r'`(\S+?)`', rows)
    assert len(topics) > 10
    assert [topic for topic in topics if topic not in graph] == []


def test_code_named_in_pages_exists() -> None:
    for page in PAGES:
        text = page.read_text()
        for name in re.findall(r'`((?:hoid_[a-z]+|rgbd_slam)(?:\.\w+){2,})`', text):
            assert pkgutil.resolve_name(name), name
        for path in re.findall(r'`((?:src|bags|lab|tests|examples)/[\w./]+)`', text):
            assert (ROOT / path).exists(), f'{page}: {path}'


def test_the_topics_of_every_camera_preset_are_documented() -> None:
    page = (ROOT / 'docs/howto/another_camera.md').read_text()
    for name, camera in CAMERA_TOPICS.items():
        cells = ' | '.join(f'`{topic}`' for topic in (name, *camera.topics()))
        assert name == 'bag' or f'| {cells} |' in page, name
