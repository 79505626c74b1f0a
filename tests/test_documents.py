"""What the documents promise: that they are short, and that their links lead somewhere."""

from __future__ import annotations

import pkgutil
import re
from dataclasses import fields
from pathlib import Path

import pytest

from hoid_bringup.run.summary import Summary

ROOT = Path(__file__).parents[1]
PAGES = sorted([ROOT / 'README.md', *ROOT.glob('docs/**/*.md'), *ROOT.glob('src/*/README.md')])
MOST_CHARACTERS, MOST_RESULTS, MOST_PROSE_LINES, LONGEST_LINE, MOST_WORDS = 6000, 6, 3, 170, 11500
GENERATED = (
    'reference/parameters',
    'reference/commands',
    'reference/messages',
    'decisions/index',
    'results/literature',
)


def test_readme_is_two_screens_long() -> None:
    text = (ROOT / 'README.md').read_text()
    assert len(text) <= MOST_CHARACTERS
    results = text.partition('## Results')[2].partition('##')[0]
    rows = [line for line in results.splitlines() if line.startswith('|')]
    assert 0 < len(rows) - 2 <= MOST_RESULTS
    for paragraph in re.sub(r'```.*?```', '', text, flags=re.DOTALL).split('\n\n'):
        if not paragraph.lstrip().startswith(('|', '-', '#', '!')):
            lines = paragraph.strip().splitlines()
            assert len(lines) <= MOST_PROSE_LINES, paragraph
            assert all(len(line) <= LONGEST_LINE for line in lines), paragraph


@pytest.mark.parametrize('page', PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_lines_of_prose_are_short(page: Path) -> None:
    text = re.sub(r'```.*?```', '', page.read_text(), flags=re.DOTALL)
    lines = [line for line in text.splitlines() if not line.startswith('|')]
    assert [line for line in lines if len(line) > LONGEST_LINE] == []


@pytest.mark.parametrize('page', PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r'```.*?```', '', page.read_text(), flags=re.DOTALL)
    for target in re.findall(r'\]\(([^)\s]+)\)', text):
        if not target.startswith(('http://', 'https://', '#')):
            assert (page.parent / target.partition('#')[0]).exists(), target


def test_all_that_is_written_by_hand_is_short() -> None:
    words = 0
    for page in (ROOT / 'README.md', *ROOT.glob('docs/**/*.md')):
        if not str(page.with_suffix('')).endswith(GENERATED):
            made = r'<!-- bench.*?<!-- /bench -->|<!-- printed -->.*?<!-- /printed -->'
            text = re.sub(made, '', page.read_text(), flags=re.DOTALL)
            words += len(text.split())
    assert 5000 < words <= MOST_WORDS


def test_every_number_of_a_run_is_explained() -> None:
    page = (ROOT / 'docs/reference/files.md').read_text()
    assert [field.name for field in fields(Summary) if f'`{field.name}`' not in page] == []


def test_code_that_pages_name_is_there() -> None:
    for page in PAGES:
        text = page.read_text()
        for name in re.findall(r'`((?:hoid_[a-z]+|rgbd_slam)(?:\.\w+){2,})`', text):
            assert pkgutil.resolve_name(name), name
        for path in re.findall(r'`((?:src|tests|benchmarks|examples)/[\w./]+)`', text):
            assert (ROOT / path).exists(), f'{page}: {path}'
