"""Tables in Markdown."""

from collections.abc import Iterable, Sequence


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table of GitHub's Markdown."""
    head, *lines = (f'| {" | ".join(line)} |\n' for line in (header, *rows))
    return f'{head}|{"---|" * len(header)}\n' + ''.join(lines)
