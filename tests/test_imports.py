"""No circle of imports: of two files that need each other, each is half a file."""

import ast
import graphlib
from pathlib import Path

import pytest

import mufly

_PACKAGE = Path(mufly.__file__).parent
_FILES = {
    ".".join(("mufly", *path.relative_to(_PACKAGE).with_suffix("").parts)).removesuffix(".__init__"): path
    for path in _PACKAGE.rglob("*.py")
}
ROOMS = sorted(p.parent.name for p in _PACKAGE.glob("*/__init__.py"))


def _imports(name: str, path: Path, *, typing: bool = False) -> set[str]:
    """Modules of the package that a file imports, inside functions too; for annotations only, if asked."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for_types = {
        id(n)
        for block in ast.walk(tree)
        if isinstance(block, ast.If) and "TYPE_CHECKING" in ast.unparse(block.test)
        for n in ast.walk(block)
    }
    found = set()
    for n in ast.walk(tree):
        if isinstance(n, ast.ImportFrom) and n.module and (typing or id(n) not in for_types):
            for alias in n.names:
                inner = f"{n.module}.{alias.name}"
                found.add(inner if inner in _FILES else n.module)
        elif isinstance(n, ast.Import) and (typing or id(n) not in for_types):
            found |= {alias.name for alias in n.names}
    return (found & set(_FILES)) - {name}


@pytest.mark.parametrize("room", ROOMS)
def test_no_circle_of_imports_inside_a_room(room: str) -> None:
    inside = {n: p for n, p in _FILES.items() if n.startswith(f"mufly.{room}.") and p.name != "__init__.py"}
    graph = {n: _imports(n, p) & set(inside) for n, p in inside.items()}
    try:
        tuple(graphlib.TopologicalSorter(graph).static_order())
    except graphlib.CycleError as error:
        pytest.fail(" -> ".join(error.args[1]))
