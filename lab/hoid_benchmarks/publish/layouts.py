"""Sketches of the layouts for RViz and Foxglove, drawn from the layout files."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

from hoid_common.io.yaml_file import read_yaml

LAYOUTS = Path('docs/images/layouts.svg')
_RVIZ = Path('src/hoid_bringup/rviz/hoid.rviz')
_FOXGLOVE = Path('src/hoid_bringup/foxglove/hoid.json')
_WIDTH, _HEIGHT, _GAP, _HEAD, _LINE = 900, 290, 8, 34, 19  # pixels
_STYLE = """
    text{font:13px system-ui, Segoe UI, Helvetica, Arial, sans-serif;fill:#2a303a}
    .title{font-weight:600} .window{fill:#eef1f5;stroke:#9aa3b0} .panel{fill:#fff;stroke:#9aa3b0}
    @media (prefers-color-scheme: dark) {
      text{fill:#e3e7ee} .window{fill:#1b1f27;stroke:#5b6472} .panel{fill:#262c36;stroke:#5b6472}
    }
"""
_KINDS = {
    '3D': '3-D view', 'Image': 'Image', 'Plot': 'Plot', 'RawMessages': 'Message',
    'DiagnosticSummary': 'Diagnostics',
}  # fmt: skip


class _Panel(NamedTuple):
    """One panel of a window, in pixels."""

    x: float
    y: float
    width: float
    height: float
    lines: Sequence[str]  # title, then what it shows


def layouts_svg(root: Path) -> str:
    """Return the sketches of both layouts, one below the other, as SVG.

    Args:
        root: Root of the project.
    """
    windows = (
        ('RViz', list(_rviz(read_yaml(root / _RVIZ)))),
        ('Foxglove', list(_foxglove(json.loads((root / _FOXGLOVE).read_text('utf-8'))))),
    )
    parts = [_window(name, panels, k) for k, (name, panels) in enumerate(windows)]
    height = len(windows) * (_HEIGHT + _HEAD + _GAP)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {height}" role="img">\n'
        '  <title>Panels of the layouts for RViz and Foxglove</title>\n'
        f'  <style>{_STYLE}  </style>\n' + ''.join(parts) + '</svg>\n'
    )


def _rviz(layout: Mapping[str, Any]) -> Iterator[_Panel]:
    displays = layout['Visualization Manager']['Displays']
    shown = [(d['Name'], d['Topic']['Value'], d['Class']) for d in displays if 'Topic' in d]
    in_3d = [f'{name}: {topic}' for name, topic, kind in shown if not kind.endswith('/Image')]
    images = [f'{name}: {topic}' for name, topic, kind in shown if kind.endswith('/Image')]
    yield _Panel(0, 0, 560, _HEIGHT, ['3-D view', *in_3d])
    yield _Panel(560, 0, _WIDTH - 560, _HEIGHT, ['Image', *images])


def _foxglove(layout: Mapping[str, Any]) -> Iterator[_Panel]:
    yield from _split(layout['layout'], layout['configById'], (0, 0, _WIDTH, _HEIGHT))


def _split(
    node: Any, configs: Mapping[str, Any], box: tuple[float, float, float, float]
) -> Iterator[_Panel]:
    """Yield the panels of a tree of splits, in a box (x, y, width, height)."""
    x, y, width, height = box
    if isinstance(node, str):
        yield _Panel(*box, [_KINDS[node.partition('!')[0]], *_topics(configs[node])])
        return
    share = node.get('splitPercentage', 50) / 100
    if node['direction'] == 'row':
        first = (x, y, share * width, height)
        second = (x + share * width, y, (1 - share) * width, height)
    else:
        first = (x, y, width, share * height)
        second = (x, y + share * height, width, (1 - share) * height)
    yield from _split(node['first'], configs, first)
    yield from _split(node['second'], configs, second)


def _topics(config: Mapping[str, Any]) -> list[str]:
    """Return what a panel of Foxglove shows: the title of a plot, or names of topics."""
    if 'paths' in config:
        return [config['title']]
    image = config.get('imageMode', {}).get('imageTopic')
    one = image or config.get('topicPath') or config.get('topicToRender')
    named = [one, *config.get('topics', ())]
    return [str(topic).removeprefix('/') for topic in named if topic]


def _window(name: str, panels: Sequence[_Panel], k: int) -> str:
    top = k * (_HEIGHT + _HEAD + _GAP) + _HEAD
    lines = [
        f'  <text class="title" x="4" y="{top - 12}">{name}</text>\n',
        f'  <rect class="window" x="1" y="{top}" width="{_WIDTH - 2}" height="{_HEIGHT}"/>\n',
    ]
    for panel in panels:
        left, up = panel.x + _GAP / 2, top + panel.y + _GAP / 2
        lines.append(
            f'  <rect class="panel" x="{left:g}" y="{up:g}" width="{panel.width - _GAP:g}" '
            f'height="{panel.height - _GAP:g}" rx="4"/>\n'
        )
        for row, words in enumerate(panel.lines):
            kind = ' class="title"' if row == 0 else ''
            y = up + _LINE * (row + 1)
            lines.append(f'  <text{kind} x="{left + 10:g}" y="{y:g}">{escape(words)}</text>\n')
    return ''.join(lines)
