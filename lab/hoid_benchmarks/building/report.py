"""Tables and files of the results of the building benchmark."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from hoid_benchmarks.jobs.code import Code
from hoid_benchmarks.markdown import markdown_table
from hoid_bringup.run.provenance import machine

_ROOT = Path(__file__).parents[3]


@dataclass(frozen=True)
class Outcome:
    """The result of one scenario.

    Args:
        scenario: Name of the scenario.
        title: What was measured, for the line above the table.
        columns: Names of the values in the table, and their formats.
        rows: The values by name; values without a column are written to the file only.
    """

    scenario: str
    title: str
    columns: Mapping[str, str]
    rows: Sequence[Mapping[str, Any]]

    def table(self) -> str:
        """Return the table in Markdown."""
        rows = [[_text(row[name], of) for name, of in self.columns.items()] for row in self.rows]
        return f'{self.title}\n\n{markdown_table(list(self.columns), rows)}'

    def write(self, folder: Path, seed: int) -> Path:
        """Write all values as JSON, with the code and machine that they come from."""
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f'{self.scenario}.json'
        code = asdict(Code.of(_ROOT))
        rows = [{name: _finite(value) for name, value in row.items()} for row in self.rows]
        content = {'code': code, 'machine': machine(), 'seed': seed, 'rows': rows}
        path.write_text(json.dumps(content, indent=1) + '\n')
        return path


def _finite(value: Any) -> Any:
    """Return the value, or 'never' for an infinite time, which JSON does not have."""
    return 'never' if isinstance(value, float) and math.isinf(value) else value


def _text(value: Any, of: str) -> str:
    return '-' if value is None else format(value, of)
