"""No circle of imports: of two files that need each other, each is half a file."""

import ast
import graphlib
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import mufly

_PACKAGE = Path(mufly.__file__).parent
_FILES = {
    ".".join(("mufly", *path.relative_to(_PACKAGE).with_suffix("").parts)).removesuffix(".__init__"): path
    for path in _PACKAGE.rglob("*.py")
}


def _statements(block: ast.AST) -> Iterator[ast.AST]:
    """All statements in a block; expressions hold no import, and are most of a tree."""
    for part in ("body", "orelse", "handlers", "finalbody", "cases"):
        for statement in getattr(block, part, ()):
            yield statement
            yield from _statements(statement)


def _imports(name: str, path: Path) -> set[str]:
    """Modules of the package that a file imports, inside functions and for annotations too."""
    found = set()
    for n in _statements(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(n, ast.ImportFrom) and n.module:
            inner = {f"{n.module}.{alias.name}" for alias in n.names}
            found |= {m if m in _FILES else n.module for m in inner}
        elif isinstance(n, ast.Import):
            found |= {alias.name for alias in n.names}
    return (found & set(_FILES)) - {name}


def test_no_circle_of_imports() -> None:
    graph = {name: _imports(name, path) for name, path in _FILES.items()}
    try:
        tuple(graphlib.TopologicalSorter(graph).static_order())
    except graphlib.CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))


_IMPORTS_BY_STRING = {
    "mufly",  # its rooms, on first use
    "mufly.bench.rig.ni_daq",  # an optional library
    "mufly.bridges",  # names that it also imports for type checkers
    "mufly.bridges.ros_node",  # messages of ROS 2
    "mufly.station",  # names that it also imports for type checkers
    "mufly.study.benchmark.prediction_codes",  # a function of the user
    "mufly.study.sweeps",  # an optional library
}


def test_no_circle_hides_behind_a_string() -> None:
    """Neither the graph above nor an editor follows ``import_module("mufly.rotor")``."""
    called = re.compile(r"\b(import_module|__import__)\(")
    found = {name for name, path in _FILES.items() if called.search(path.read_text(encoding="utf-8"))}
    assert found == _IMPORTS_BY_STRING
