"""Tables in Markdown."""

from collections.abc import Iterable, Sequence


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table of GitHub's Markdown."""
    lines = [header, ('---',) * len(header), *rows]
    return ''.join(f'| {" | ".join(line)} |\n' for line in lines)
