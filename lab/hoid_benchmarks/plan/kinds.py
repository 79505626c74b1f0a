"""The origin of a sequence's images: recorded, recorded with people pasted in, or rendered."""

from __future__ import annotations

from collections.abc import Iterable

from hoid_benchmarks.plan.sequences import PEOPLE_SUFFIX, scene_options

RENDERED, PASTED, RECORDED = 'rendered', 'recorded, with people pasted in', 'recorded'


def kind_of(sequence: str) -> str:
    """Return the origin of the images of a sequence: `RENDERED`, `PASTED` or `RECORDED`."""
    if scene_options(sequence):
        return RENDERED
    return PASTED if sequence.endswith(PEOPLE_SUFFIX) else RECORDED


def kinds_text(sequences: Iterable[str], quote: str = '') -> str:
    """Return a sentence with the origin of the images of each sequence; empty without sequences.

    Names are left out where all sequences are of one kind.

    Args:
        sequences: Names of sequences, which may repeat.
        quote: Text before and after each name.
    """
    names: dict[str, list[str]] = {}
    for sequence in dict.fromkeys(sequences):
        names.setdefault(kind_of(sequence), []).append(f'{quote}{sequence}{quote}')
    if len(names) == 1:
        return f'{next(iter(names)).capitalize()}.'
    text = '; '.join(f'{kind}: {", ".join(each)}' for kind, each in names.items())
    return f'{text[0].upper()}{text[1:]}.' if text else ''
