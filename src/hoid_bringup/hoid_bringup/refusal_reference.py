"""Generator of the reference page of all refusals and warnings (`make reference`).

The texts are read from the source: those of raised errors, of problems on /diagnostics and of
warnings in the log. Values are placeholders, named by the expression that gives them.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator, Sequence
from functools import cache
from itertools import product
from pathlib import Path
from typing import NamedTuple

_HEAD = """# Refusals and warnings

Written by `make reference` from the source. Values are *slanted*; where another line of this page
is quoted, there is *error*. See [Nothing is tracked](../howto/nothing_is_tracked.md) for reasons.

| kind | what happens |
|---|---|
| error | the command ends with status 1, the node does not start, or the service answers so |
| message | the node drops the message, logs this at times, and counts it on `/diagnostics` |
| problem | the node goes on as well as it can; `/diagnostics` has this until it is over |
| warning | a line in the log, or on stderr; the work goes on |
"""
_SECTIONS = {  # titles by package
    'hoid_common': 'All commands and nodes',
    'hoid_bags': 'Commands that read or write recordings, such as `info`, `play` and `run`',
    'hoid_detector': '`hoid_detector`, and commands that run a detector',
    'hoid_filter': '`hoid_filter`, and commands that filter',
    'hoid_scene': 'dense map, grid, people and objects',
    'rgbd_slam': '`rgbd_slam`, and the commands `run`, `replay` and `map`',
    'hoid_bringup': 'The commands',
}
_ERRORS = ('InputError', 'ConfigError', 'ModelError', 'NoModelError', 'MapFileError', 'SystemExit')
_KINDS = {  # of a text, by the name of the function that takes it
    **dict.fromkeys(_ERRORS, 'error'),
    'MessageError': 'message',
    'set_problem': 'problem',
    'report_problem': 'problem',
    'warning': 'warning',
}
# Kind of the text that each function returns, for functions whose callers do not show how the text
# is used.
_SPEAKERS = {
    '_change_text': 'problem',
    '_clock_message': 'problem',
    'constant_offset_text': 'problem',
    'gap': 'problem',
    'loss_message': 'problem',
    'missing_message': 'problem',
    'non_finite_warning': 'problem',
    '_provider_warning': 'problem',
    'rectification_doubt': 'warning',
    'size_mismatch': 'message',
    'warning_for': 'warning',
}
_MAX_DEPTH = 5  # of functions and variables through which a text is followed
_MAX_VARIANTS = 8  # of one text
_MIN_WORDS = 3  # shorter texts are only parts of others
_FORMAT = re.compile(r'%[-+.\d]*[sdgf]')  # a value in the text of a logging call


def refusal_reference(root: Path) -> str:
    """Return the reference page of refusals and warnings in Markdown, with a table per package.

    Args:
        root: Root folder of the source tree.

    Raises:
        ValueError: A function in `_SPEAKERS` does not exist any more.
    """
    folders = {package: _folder(root, package) for package in _SECTIONS}
    defined = {
        name
        for folder in folders.values()
        for path in folder.rglob('*.py')
        for name in _definitions(path)
    }
    if unknown := _SPEAKERS.keys() - defined:
        raise ValueError(f'_SPEAKERS names functions that nobody defines: {sorted(unknown)}')
    parts = [_HEAD]
    for package, title in _SECTIONS.items():
        rows = sorted(set(refusals(folders[package])))
        lines = [f'| {text} | {kind} |' for text, kind in rows]
        parts.append('\n'.join([f'## {title}\n', '| text | kind |', '|---|---|', *lines, '']))
    return '\n'.join(parts)


def refusals(folder: Path) -> Iterator[tuple[str, str]]:
    """Yield the text, in Markdown, and the kind of each refusal and warning of a package.

    Texts of fewer than three words are left out.

    Args:
        folder: Folder of the package's modules.
    """
    for path in sorted(folder.rglob('*.py')):
        for text, kind in (*_said(path), *_returned(path)):
            if len(text.split()) >= _MIN_WORDS:
                yield text.replace('\n', ' ').replace('|', '\\|'), kind


def _said(path: Path) -> Iterator[tuple[str, str]]:
    """Yield text and kind of each refusal or warning that a module passes to a function."""
    for call, function in _calls(path):
        name = _name_of(call.func)
        place = 1 if name.endswith('_problem') else 0
        if name in _KINDS and len(call.args) > place:
            texts = _Texts(path, function)
            for text in texts.of(call.args[place]):
                yield texts.formatted(text, call.args[place + 1 :]), _KINDS[name]


def _returned(path: Path) -> Iterator[tuple[str, str]]:
    """Yield text and kind of each refusal or warning that a module's `_SPEAKERS` return."""
    for name in _definitions(path).keys() & _SPEAKERS.keys():
        for text in _Texts(path, _tree(path)).of_name(name):
            yield text, _SPEAKERS[name]


def _folder(root: Path, package: str) -> Path:
    return root / 'bags' / package if package == 'hoid_bags' else root / 'src' / package / package


def _name_of(node: ast.expr) -> str:
    """Return the last part of a dotted name; empty for other expressions."""
    return node.attr if isinstance(node, ast.Attribute) else getattr(node, 'id', '')


@cache
def _tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding='utf-8'))


def _calls(path: Path) -> Iterator[tuple[ast.Call, ast.AST]]:
    """Yield all calls in a module, each with the innermost function around it, or the module."""
    waiting: list[tuple[ast.AST, ast.AST]] = [(_tree(path), _tree(path))]
    for node, function in waiting:
        inner = node if isinstance(node, ast.FunctionDef) else function
        waiting += [(child, inner) for child in ast.iter_child_nodes(node)]
        if isinstance(node, ast.Call):
            yield node, function


@cache
def _definitions(path: Path) -> dict[str, ast.AST]:
    """Return functions, methods and constants of a module by name."""
    tree = _tree(path)
    found = {n.name: n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef)}
    constants: dict[str, ast.AST] = {}
    for node in tree.body:
        if isinstance(node, ast.Assign):
            target, value = node.targets[0], node.value
            if isinstance(target, ast.Name):
                constants[target.id] = value
            elif isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
                constants |= {_name_of(t): v for t, v in zip(target.elts, value.elts, strict=True)}
    return constants | found


def _find(path: Path, name: str) -> tuple[Path, ast.AST] | None:
    """Return the file and the definition of a name that a module has; None: it is not found.

    The module at `path` may define the name, or import it from another module of the suite.
    """
    if name in _definitions(path):
        return path, _definitions(path)[name]
    for node in ast.walk(_tree(path)):
        if isinstance(node, ast.ImportFrom) and name in {alias.name for alias in node.names}:
            package, *inner = (node.module or '').split('.')
            root = next(p for p in path.parents if (p / 'colcon.meta').is_file())
            module = _folder(root, package).joinpath(*inner).with_suffix('.py')
            return _find(module, name) if module.is_file() else None
    return None


class _Texts(NamedTuple):
    """Finds the texts that expressions in a function can have as values."""

    path: Path  # of the module
    function: ast.AST
    depth: int = 0  # number of functions and variables that were followed
    followed: frozenset[str] = frozenset()  # their names, to end recursion

    def of(self, node: ast.AST | None) -> list[str]:  # noqa: PLR0911 - one for each kind
        """Return the texts of an expression, with placeholders for values; [] if it has none."""
        match node:
            case ast.Constant(value=str() as text):
                return [text]
            case ast.JoinedStr(values=values):
                return self._joined(values)
            case ast.BinOp(left=left, op=ast.Add(), right=right):
                return [a + b for a, b in product(self.of(left), self.of(right))]
            case ast.IfExp(body=body, orelse=orelse):
                return self.of(body) + self.of(orelse)
            case ast.BoolOp(values=values):
                return [text for value in values for text in self.of(value)]
            case ast.Call(func=function):
                return self.of_name(_name_of(function))
            case ast.Name(id=name):
                return self._of_variable(name) or self.of_name(name)
        return []

    def formatted(self, text: str, values: Sequence[ast.expr]) -> str:
        """Return a text of a logging call, with placeholders for its arguments."""
        if not values:
            return text
        left = iter(values)

        def placeholder(_: re.Match[str]) -> str:
            return ' or '.join(filter(None, self._placeholders(next(left))))

        return _FORMAT.sub(placeholder, text)

    def of_name(self, name: str) -> list[str]:
        """Return the texts of a constant, or those that a function returns."""
        found = None
        if name and name not in self.followed and self.depth < _MAX_DEPTH:
            found = _find(self.path, name)
        if found is None:
            return []
        path, node = found
        inner = _Texts(path, node, self.depth + 1, self.followed | {name})
        if not isinstance(node, ast.FunctionDef):
            return inner.of(node)
        returned = (n.value for n in ast.walk(node) if isinstance(n, ast.Return | ast.Yield))
        return [text for value in returned for text in inner.of(value)]

    def _of_variable(self, name: str) -> list[str]:
        """Return the texts that are assigned to a variable in the function."""
        if name in self.followed or self.depth >= _MAX_DEPTH:
            return []
        inner = self._replace(depth=self.depth + 1, followed=self.followed | {name})
        values = [
            node.value
            for node in ast.walk(self.function)
            if isinstance(node, ast.Assign | ast.NamedExpr)
            for target in (node.targets if isinstance(node, ast.Assign) else [node.target])
            if _name_of(target) == name
        ]
        return [text for value in values for text in inner.of(value)]

    def _joined(self, values: Sequence[ast.expr]) -> list[str]:
        parts = [
            self._placeholders(value.value)
            if isinstance(value, ast.FormattedValue)
            else self.of(value)
            for value in values
        ]
        return list(map(''.join, product(*parts)))[:_MAX_VARIANTS]

    def _number(self, name: str) -> float | None:
        """Return the value of a constant; None: `name` is not in capitals, or is no number."""
        found = _find(self.path, name) if name.isupper() else None
        value = found[1].value if found and isinstance(found[1], ast.Constant) else None
        return value if isinstance(value, int | float) else None

    def _placeholders(self, node: ast.expr) -> list[str]:
        """Return what stands for a value: the text of a constant or variable, or else a name."""
        if isinstance(node, ast.IfExp):
            return self._placeholders(node.body) + self._placeholders(node.orelse)
        if texts := [] if isinstance(node, ast.Attribute) else self.of(node):
            return texts
        if (number := self._number(_name_of(node))) is not None:
            return [f'{number:g}']
        while isinstance(node, ast.Subscript | ast.Call):
            node = node.value if isinstance(node, ast.Subscript) else node.func
        name = _name_of(node).strip('_').lower()
        return [f'*{name}*' if name else '...']


if __name__ == '__main__':
    sys.stdout.write(refusal_reference(Path(sys.argv[1])))
