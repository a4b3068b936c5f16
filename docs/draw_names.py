"""Draw names of the code by a seed, for a reader who has not seen the project; or count what can be counted of them.

    python docs/draw_names.py 7             # 80 names of functions, classes and constants, 25 fields of records
    python docs/draw_names.py --count       # one-word functions, literal indices, untyped records

The reader writes down what each name stands for, from name and module alone. Somebody who knows the code counts how
many are right, drawn or wrong, and reports the three counts with the seed.
"""

from __future__ import annotations

import argparse
import ast
import random
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

SOURCE = Path(__file__).resolve().parents[1] / "src"
NAMES, FIELDS = 80, 25
RECORDS = {"m", "s", "p"}
"""Arguments by which compiled functions take records."""


@dataclass(frozen=True)
class Name:
    """A name where it is defined: what it is, its module, with the class of a method or field, and itself."""

    kind: str
    module: str
    name: str


def defined_things(node: ast.AST, place: str) -> Iterator[Name]:
    """Yield the functions, classes and annotated fields inside a module, class or function at ``place``."""
    for part in ast.iter_child_nodes(node):
        inside = place
        if isinstance(part, ast.ClassDef):
            yield Name("class", place, part.name)
            inside = f"{place}.{part.name}"
        elif isinstance(part, ast.FunctionDef) and not part.name.startswith("__"):
            yield Name("method" if isinstance(node, ast.ClassDef) else "function", place, part.name)
        elif isinstance(part, ast.AnnAssign) and isinstance(node, ast.ClassDef) and isinstance(part.target, ast.Name):
            yield Name("field", place, part.target.id)
        yield from defined_things(part, inside)


def named_things(source: Path = SOURCE) -> Iterator[Name]:
    """Yield every function, method, class, constant and annotated field below a folder."""
    for path in sorted(source.rglob("*.py")):
        module = ".".join(path.relative_to(source).with_suffix("").parts)
        tree = ast.parse(path.read_text(encoding="utf-8"))
        yield from defined_things(tree, module)
        for part in tree.body:
            if isinstance(part, ast.Assign):
                for target in part.targets:
                    for one in ast.walk(target):
                        if isinstance(one, ast.Name) and one.id.isupper():
                            yield Name("constant", module, one.id)


def drawn_names(seed: int) -> list[Name]:
    """Return the names that a seed draws, names first, then fields, each in the order of the modules."""
    every = sorted(set(named_things()), key=lambda n: (n.module, n.kind, n.name))
    names = [n for n in every if n.kind != "field"]
    fields = [n for n in every if n.kind == "field"]
    draw = random.Random(seed)
    chosen = draw.sample(names, NAMES), draw.sample(fields, FIELDS)
    return [n for part in chosen for n in sorted(part, key=every.index)]


def places_in(index: ast.expr) -> int:
    """Count the whole numbers above 2 that stand for a place in an index: ``x[17]``, ``x[17 + i]``, ``x[10:13]``.

    An offset to a named index (``x[NOMINAL_ATTITUDE + 3]``) has its name; strides (``r[3 * i + j]``) and cuts
    off the front or the back (``text[:9]``, ``y[-9:]``) are no places.
    """
    if isinstance(index, ast.Constant):
        return int(isinstance(index.value, int) and index.value > 2)
    if isinstance(index, ast.UnaryOp):
        return places_in(index.operand)
    if isinstance(index, ast.Tuple | ast.List):
        return sum(places_in(part) for part in index.elts)
    if isinstance(index, ast.Slice):
        cut = index.lower is None or isinstance(index.lower, ast.UnaryOp)
        return 0 if cut else sum(places_in(end) for end in (index.lower, index.upper) if end is not None)
    if isinstance(index, ast.BinOp) and isinstance(index.op, ast.Add | ast.Sub):
        named = any(isinstance(part, ast.Name) and part.id.isupper() for part in ast.walk(index))
        return 0 if named else places_in(index.left) + places_in(index.right)
    return 0


def unpacked_elements(tree: ast.Module) -> set[ast.expr]:
    """Return the subscripts of assignments that name all elements in turn: ``w, x, y, z = q[0], q[1], q[2], q[3]``."""
    found: set[ast.expr] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Tuple):
            parts = [part for part in node.value.elts if isinstance(part, ast.Subscript)]
            last = [p.slice.elts[-1] if isinstance(p.slice, ast.Tuple) and p.slice.elts else p.slice for p in parts]
            if [ast.unparse(k) for k in last] == [str(k) for k in range(len(node.value.elts))]:
                found.update(parts if len({ast.unparse(p.value) for p in parts}) == 1 else ())
    return found


def literal_indices(tree: ast.Module) -> int:
    """Count literal indices above 2 that a name could replace.

    Left out are subscripts of types, quaternions ``q`` and flat rotation matrices ``r``, whose places are mathematics.
    """
    unpacked, count = unpacked_elements(tree), 0
    for node in ast.walk(tree):
        if isinstance(node, ast.Subscript) and node not in unpacked:
            of = ast.unparse(node.value).rsplit(".", 1)[-1]
            is_type = of[:1].isupper() and not of.isupper()
            count += 0 if is_type or of in ("q", "r") else places_in(node.slice)
    return count


def counted_names(source: Path = SOURCE) -> dict[str, str]:
    """Return counts: one-word functions, literal indices (:func:`literal_indices`), functions with untyped records."""
    functions = [n.name.strip("_") for n in named_things(source) if n.kind in ("function", "method")]
    short = sum("_" not in name for name in functions)
    literal = untyped = 0
    for path in source.rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        literal += literal_indices(tree)
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef):
                untyped += any(
                    a.arg in RECORDS and isinstance(a.annotation, ast.Name) and a.annotation.id == "Any"
                    for a in node.args.args
                )
    share = 100 * short / len(functions)
    return {
        "functions of one word": f"{short} of {len(functions)} ({share:.0f} %)",
        "literal indices above 2": str(literal),
        "functions with an untyped record": str(untyped),
    }


def main() -> None:
    words = argparse.ArgumentParser(description=str(__doc__).split("\n")[0])
    words.add_argument("seed", nargs="?", type=int, help="draws the same names for everybody")
    words.add_argument("--count", action="store_true", help="count instead of drawing")
    said = words.parse_args()
    if said.count:
        for what, count in counted_names().items():
            print(f"{what:34s} {count}")
    elif said.seed is None:
        words.error("give a seed, or --count")
    else:
        for n in drawn_names(said.seed):
            print(f"{n.kind:9s} {n.module}  {n.name}")


if __name__ == "__main__":
    main()
