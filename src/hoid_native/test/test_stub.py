"""The type stub matches the compiled module."""

import ast
from pathlib import Path

from nanobind.stubgen import StubGen

from hoid_native import _native

STUB = Path(__file__).parents[1] / 'hoid_native' / '_native.pyi'


def test_the_stub_matches_the_module() -> None:
    """Run `make stubs` when this fails."""
    stub = StubGen(_native)
    stub.put(_native)
    assert ast.dump(ast.parse(stub.get())) == ast.dump(ast.parse(STUB.read_text()))
