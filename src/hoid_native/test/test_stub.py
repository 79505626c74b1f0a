"""The types that are checked are those of the compiled module."""

import ast
from pathlib import Path

from nanobind.stubgen import StubGen

from hoid_native import _native

STUB = Path(__file__).parents[1] / 'hoid_native' / '_native.pyi'


def test_the_stub_is_that_of_the_module() -> None:
    """`make stubs` writes it anew."""
    stub = StubGen(_native)
    stub.put(_native)
    assert ast.dump(ast.parse(stub.get())) == ast.dump(ast.parse(STUB.read_text()))
