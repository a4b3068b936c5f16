"""C functions from the Python source of compiled functions.

The equations of motion are Python functions that Numba compiles. Here each of them becomes a C function with the same
names, the same branches and the same operations in the same order. There is no second derivation: an edited equation is
in the C code. With ``-ffp-contract=off`` both give the same numbers, to the last bit.

The types come from the arguments: ``double``, ``int64_t``, ``bool``, tables of known shape, tuples of tables, a record
of parameters, and tuples of numbers (structs in C). The translated forms are those that equations and sensors need:

- assignments, also of tuples, to elements, and of parts of tables;
- ``if``, ``while``, ``for`` over a range or over the rows of a table;
- ``return`` of a number, a tuple or a matrix;
- arithmetic, comparisons, ``and``, ``or``, ``not``;
- calls of functions that are translated, too.

Other forms raise :class:`NotImplementedError`.

Four rules keep the results equal:

- ``min`` and ``max`` keep the first number if both are equal or one is not a number, as Numba's do;
- ``%`` and ``//`` round down, as Python's do;
- ``int`` of a number that is no index, such as NaN, gives 0: Numba leaves that open, and a table must not be left;
- sine, cosine, tangent, their inverses and the exponential function are those of the C library, which compiled Python
  calls, too.
"""

from __future__ import annotations

import ast
import inspect
import math
import re
import textwrap
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mufly.fmi.c_expressions import (
    ARITHMETIC_OPERATORS,
    C_HELPER_FUNCTIONS,
    PRECEDENCE_ADD,
    PRECEDENCE_AND,
    PRECEDENCE_ATOM,
    PRECEDENCE_COMPARE,
    PRECEDENCE_OR,
    PRECEDENCE_UNARY,
    CExpression,
    escape_c_name,
    make_arithmetic_expression,
    make_comparison_expression,
    make_conditional_expression,
    make_slice_expression,
    translate_library_call,
)
from mufly.fmi.c_types import (
    C_BOOL,
    C_DOUBLE,
    C_INT64,
    C_VOID,
    CType,
    RecordType,
    TableTupleType,
    TableType,
    TupleType,
    name_result_type,
    pointer_declaration,
)

_RESULT_ARGUMENT_MARK, _CONST_MARK = "\1", "\2"
"""Marks in C text, replaced later: the place of a returned matrix; ``const``, unless a table is written."""


@dataclass(frozen=True)
class CFunction:
    """C function translated from Python: its name, the type of its result, and which arguments it writes to.

    A function that returns a matrix writes it to a last argument in C.
    """

    name: str
    result: CType
    written: tuple[bool, ...]


class CTranslation:
    """Translator of Python functions to C, which collects the functions, constants and tuples that they use.

    Parameters
    ----------
    record : numpy.dtype
        Type of the record of parameters.
    record_name : str
        Name of its C struct.
    written_in_c : mapping, optional
        Functions without translation, and their C functions, which take the size of the last array as one more
        argument and write to all arrays.
    """

    def __init__(self, record: np.dtype[Any], record_name: str, written_in_c: Mapping[Any, str] | None = None) -> None:
        self.record = RecordType(record_name, record)
        self.written_in_c = dict(written_in_c or {})
        self._functions: dict[Any, CFunction] = {}
        self._names: dict[str, object] = {}
        self._constants: dict[str, float | int | tuple[float, ...]] = {}
        self._tuples: dict[str, TupleType] = {}
        self._bodies: list[str] = []

    def add_function(self, function: Any, kinds: Sequence[CType]) -> CFunction:
        """Translate a function, and all that it calls, for arguments of the types ``kinds``.

        Raises
        ------
        NotImplementedError
            If the source has a form that has no translation.
        """
        plain = getattr(function, "py_func", function)
        key = plain, tuple(kinds)
        if key in self._functions:
            return self._functions[key]
        name = self._unique_name(plain.__name__, plain, plain.__module__)
        again = sum(known is plain for known, _ in self._functions)  # with other types
        name += f"_{again + 1}" if again else ""
        made, body = _FunctionTranslation(self, plain, name, kinds).translate()
        self._functions[key] = made
        self._bodies.append(body)
        return made

    def render_c_source(self) -> str:
        """Return the complete C text: helpers, constants, tuples and functions, each after what it depends on."""
        whole = [f"    {n} = {v}," for n, v in self._constants.items() if isinstance(v, int)]
        real = [f"static const double {n} = {v!r};" for n, v in self._constants.items() if isinstance(v, float)]
        real += [
            f"static const double {n}[{len(v)}] = {{{', '.join(map(repr, v))}}};"
            for n, v in self._constants.items()
            if isinstance(v, tuple)
        ]
        structs = []
        for name, kind in self._tuples.items():
            members = " ".join(f"{name_result_type(part)} f{k};" for k, part in enumerate(kind.parts))
            structs.append(f"typedef struct {{ {members} }} {name};")
        enum = ["enum {", *whole, "};"] if whole else []
        return "\n".join([C_HELPER_FUNCTIONS, *enum, "", *real, "", *structs, "", *self._bodies])

    def declare_tuple_struct(self, parts: Sequence[str | TupleType]) -> TupleType:
        """Return the type of a tuple with these parts; its struct will be declared in the C text."""
        kind = TupleType(tuple(parts))
        self._tuples.setdefault(kind.name, kind)
        return kind

    def declare_constant(self, name: str, value: float | int, module: str) -> CExpression:
        """Return a constant of a Python module; it will be declared in the C text."""
        number = int(value) if isinstance(value, int | np.integer) else float(value)
        c_name = self._unique_name(name, number, module)
        self._constants[c_name] = number
        return CExpression(c_name, PRECEDENCE_ATOM, C_INT64 if isinstance(number, int) else C_DOUBLE)

    def declare_table(self, name: str, values: tuple[float, ...], module: str) -> CExpression:
        """Return a tuple of numbers of a Python module as a constant table; it will be declared in the C text."""
        c_name = self._unique_name(name, values, module)
        self._constants[c_name] = values
        return CExpression(c_name, PRECEDENCE_ATOM, TableType(C_DOUBLE, (len(values),)))

    def _unique_name(self, name: str, what: object, module: str) -> str:
        """Return a C name without leading underscores, with the module's name as prefix if the name is already in
        use.
        """
        short = name.lstrip("_")
        for candidate in (short, f"{module.rpartition('.')[2]}_{short}"):
            known = self._names.setdefault(candidate, what)
            if known is what or (isinstance(what, int | float) and type(known) is type(what) and known == what):
                return candidate
        raise NotImplementedError(f"the name {name} has more than two meanings")


class _FunctionTranslation:
    """Translates one function."""

    def __init__(self, owner: CTranslation, function: Callable[..., Any], name: str, kinds: Sequence[CType]) -> None:
        self._owner, self._function, self._name = owner, function, name
        tree = ast.parse(textwrap.dedent(inspect.getsource(function))).body[0]
        assert isinstance(tree, ast.FunctionDef)
        self._tree = tree
        self._arguments = [a.arg for a in tree.args.args]
        if len(self._arguments) != len(kinds):
            raise NotImplementedError(f"{function.__name__}: {len(kinds)} arguments")
        self._kinds: dict[str, CType] = dict(zip(self._arguments, kinds, strict=True))
        self._globals = function.__globals__
        self._roots = {name: name for name in self._arguments}  # argument that a table is part of
        stores = (n.id for n in ast.walk(tree) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store))
        self._store_counts = Counter([*stores, *self._arguments])
        self._known_integers: dict[str, str] = {}
        self._written: set[str] = set()
        self._result: CType | None = None
        self._lines: list[str] = []
        self._hoisted: list[str] = []
        self._depth, self._count = 1, 0

    def translate(self) -> tuple[CFunction, str]:
        self._translate_block(self._tree.body)
        result: CType = C_VOID if self._result is None else self._result
        arguments = []
        for argument in self._arguments:
            kind = self._kinds[argument]
            constant = "" if argument in self._written else "const "
            if isinstance(kind, TableType):
                arguments.append(constant + pointer_declaration(kind, escape_c_name(argument)))
            elif isinstance(kind, TableTupleType):
                arguments += [
                    constant + pointer_declaration(part, f"{argument}_{k}") for k, part in enumerate(kind.parts)
                ]
            elif isinstance(kind, RecordType):
                arguments.append(f"const {kind.name} *{argument}")
            else:
                arguments.append(f"{name_result_type(kind)} {escape_c_name(argument)}")
        if isinstance(result, TableType):
            arguments.append(pointer_declaration(result, "result_"))
        head = f"static {name_result_type(result)} {self._name}({', '.join(arguments)})"
        about = (inspect.getdoc(self._function) or "").partition("\n\n")[0].replace("*/", "* /").split()
        place = f"{self._function.__module__}.{self._function.__name__}"
        comment = textwrap.wrap(
            f"{' '.join(about)} Source: {place}.", 114, initial_indent="/* ", subsequent_indent="   "
        )
        written = tuple(a in self._written for a in self._arguments)
        text = "\n".join(
            [*comment[:-1], f"{comment[-1]} */", *_wrap_code(head), "{", *self._hoisted, *self._lines, "}", ""]
        )
        mark = f"{_CONST_MARK}(.*?){_CONST_MARK}"
        text = re.sub(mark, lambda found: "" if found[1] in (*self._written, "") else "const ", text)
        return CFunction(self._name, result, written), text

    # Statements

    def _emit_line(self, text: str) -> None:
        self._lines += _wrap_code("    " * self._depth + text)

    def _unsupported_form_error(self, node: ast.AST) -> NotImplementedError:
        """Return the error that ends the export at a form of Python for which the translation has no rule."""
        return NotImplementedError(f"{self._function.__name__}: no C form of `{ast.unparse(node)}`")

    def _translate_block(self, statements: Sequence[ast.stmt]) -> None:
        for statement in statements:
            self._translate_statement(statement)

    def _translate_nested_block(self, statements: Sequence[ast.stmt]) -> None:
        self._depth += 1
        self._translate_block(statements)
        self._depth -= 1

    def _translate_statement(self, node: ast.stmt) -> None:
        match node:
            case ast.Expr(value=ast.Constant()):
                pass
            case ast.Expr(value=ast.Call()):
                self._emit_line(f"{self._translate_expression(node.value).text};")
            case ast.Assign(targets=[ast.Tuple() as targets]):
                self._translate_tuple_assignment(targets, node.value)
            case ast.Assign(targets=[ast.Name(id=name)]) if self._is_alias(node.value):
                self._declare_table_alias(name, self._translate_expression(node.value), self._root_argument(node.value))
            case ast.Assign():
                value = self._translate_expression(node.value) if not _is_new_array(node.value) else None
                for target in node.targets:
                    if value is None:
                        self._declare_array(target, node.value)
                    else:
                        self._translate_assignment(target, value)
            case ast.AugAssign():
                place = self._translate_target(node.target)
                if type(node.op) in ARITHMETIC_OPERATORS:
                    sign = ARITHMETIC_OPERATORS[type(node.op)][0]
                    self._emit_line(f"{place} {sign}= {self._translate_expression(node.value).text};")
                else:
                    read = ast.parse(ast.unparse(node.target), mode="eval").body
                    changed = self._translate_expression(ast.BinOp(read, node.op, node.value))
                    self._emit_line(f"{place} = {changed.text};")
            case ast.If():
                self._emit_line(f"if ({self._translate_expression(node.test).text}) {{")
                self._translate_nested_block(node.body)
                if node.orelse:
                    self._emit_line("} else {")
                    self._translate_nested_block(node.orelse)
                self._emit_line("}")
            case ast.For(target=ast.Name(id=name), iter=ast.Call(func=ast.Name(id="range"), args=bounds), orelse=[]):
                limits = [self._translate_expression(b).text for b in bounds]
                first, end = ("0", limits[0]) if len(limits) == 1 else limits
                c_name = escape_c_name(name)
                if name in self._kinds:  # its value after the loop would be another in C
                    raise self._unsupported_form_error(node.target)
                self._kinds[name] = C_INT64
                self._emit_line(f"for (int64_t {c_name} = {first}; {c_name} < {end}; {c_name}++) {{")
                self._translate_nested_block(node.body)
                self._emit_line("}")
                del self._kinds[name]
            case ast.For(target=ast.Name(id=name), iter=ast.Name(id=looped), orelse=[]):
                rows = self._translate_expression(node.iter)
                if not isinstance(rows.kind, TableType) or name in self._kinds:
                    raise self._unsupported_form_error(node.target)
                row = TableType(rows.kind.element, rows.kind.shape[1:])
                index = f"{name}_row"
                self._emit_line(f"for (int64_t {index} = 0; {index} < {rows.kind.shape[0]}; {index}++) {{")
                self._kinds[name], self._roots[name] = row, self._roots.get(looped, "")
                mark = f"{_CONST_MARK}{self._roots[name]}{_CONST_MARK}"
                self._emit_line(f"    {mark}{pointer_declaration(row, escape_c_name(name))} = {rows.text}[{index}];")
                self._translate_nested_block(node.body)
                self._emit_line("}")
                del self._kinds[name]
            case ast.While(orelse=[]):
                self._emit_line(f"while ({self._translate_expression(node.test).text}) {{")
                self._translate_nested_block(node.body)
                self._emit_line("}")
            case ast.Continue():
                self._emit_line("continue;")
            case ast.Break():
                self._emit_line("break;")
            case ast.Return(value=None):
                self._emit_line("return;")
            case ast.Return(value=ast.expr() as value):
                self._translate_return(value)
            case _:
                raise self._unsupported_form_error(node)

    def _is_alias(self, node: ast.expr) -> bool:
        """Return whether an expression is a table, or a part of one, that exists already."""
        match node:
            case ast.Call(func=ast.Name(id="borrow_arrays"), args=[ast.Subscript() | ast.Name() as inner]):
                return self._is_alias(inner)
            case ast.Name(id=name):
                return isinstance(self._kinds.get(name), TableType)
            case ast.Subscript():
                return isinstance(self._translate_expression(node).kind, TableType)
            case ast.Attribute(value=ast.Name(id=name)) if isinstance(self._kinds.get(name), RecordType):
                return isinstance(self._translate_expression(node).kind, TableType)
        return False

    def _root_argument(self, node: ast.expr) -> str:
        """Return the function argument that a table belongs to; "" for a local table."""
        match node:
            case ast.Call(args=[inner]) | ast.Subscript(value=inner) | ast.Attribute(value=inner):
                return self._root_argument(inner)
            case ast.Name(id=name):
                return self._roots.get(name, "")
        return ""

    def _declare_table_alias(self, name: str, value: CExpression, root: str) -> None:
        """Declare a name as an alias of a table or of a part of a table."""
        assert isinstance(value.kind, TableType)
        if value.text == escape_c_name(name):  # the same array under the same name
            return
        declared = f"{_CONST_MARK}{root}{_CONST_MARK}{pointer_declaration(value.kind, escape_c_name(name))}"
        known = self._kinds.get(name)
        if known is not None and (known, self._roots.get(name)) != (value.kind, root):
            raise NotImplementedError(f"{self._function.__name__}: {name} already names another table")
        if known is not None:
            self._emit_line(f"{escape_c_name(name)} = {value.text};")
        elif self._depth > 1:
            self._hoisted.append(f"    {declared};")
            self._emit_line(f"{escape_c_name(name)} = {value.text};")
        else:
            self._emit_line(f"{declared} = {value.text};")
        self._kinds[name], self._roots[name] = value.kind, root

    def _translate_return(self, node: ast.expr) -> None:
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "np.array" and isinstance(node.args[0], ast.List):
            rows = [row.elts for row in node.args[0].elts if isinstance(row, ast.List)]
            if rows:
                self._result = TableType(C_DOUBLE, (len(rows), len(rows[0])))
                for i, row in enumerate(rows):
                    for k, entry in enumerate(row):
                        self._emit_line(f"result_[{i}][{k}] = {self._translate_expression(entry).text};")
                return
            value = self._translate_expression(ast.Tuple(node.args[0].elts, ast.Load()))
        else:
            value = self._translate_expression(node)
        if self._result is not None and self._result != value.kind:
            raise self._unsupported_form_error(node)
        self._result = value.kind
        self._emit_line(f"return {value.text};")

    def _translate_tuple_assignment(self, target: ast.Tuple, value: ast.expr) -> None:
        if isinstance(value, ast.Tuple) and any(self._makes_table(v) for v in value.elts):
            stored = [t.id if isinstance(t, ast.Name) else "" for t in target.elts]
            for j, (one, part) in enumerate(zip(target.elts, value.elts, strict=True)):
                if {n.id for n in ast.walk(part) if isinstance(n, ast.Name)} & {*stored[:j]}:
                    raise self._unsupported_form_error(value)
                self._translate_statement(ast.Assign([one], part))
            return
        if isinstance(value, ast.Tuple):
            values = [self._translate_expression(v) for v in value.elts]
            names = [ast.unparse(t.value if isinstance(t, ast.Subscript) else t) for t in target.elts]
            read = [{n.id for n in ast.walk(v) if isinstance(n, ast.Name)} for v in value.elts]
            if any(names[k] in read[j] for j in range(len(names)) for k in range(j)):
                values = [self._emit_local_constant(v) for v in values]
        else:
            whole = self._translate_expression(value)
            if isinstance(whole.kind, TableTupleType) and isinstance(value, ast.Name):
                for k, (one, table) in enumerate(zip(target.elts, whole.kind.parts, strict=True)):
                    assert isinstance(one, ast.Name)
                    self._declare_table_alias(one.id, CExpression(f"{value.id}_{k}", PRECEDENCE_ATOM, table), value.id)
                return
            if isinstance(whole.kind, TableType) and whole.kind.shape == (len(target.elts),):
                for k, one in enumerate(target.elts):
                    self._translate_assignment(
                        one,
                        CExpression(f"{whole.as_operand(PRECEDENCE_ATOM)}[{k}]", PRECEDENCE_ATOM, whole.kind.element),
                    )
                return
            if not isinstance(whole.kind, TupleType) or len(whole.kind.parts) != len(target.elts):
                raise self._unsupported_form_error(value)
            if all(isinstance(t, ast.Name) and t.id == "_" for t in target.elts):
                return
            name = self._emit_local_constant(whole).text
            values = [CExpression(f"{name}.f{k}", PRECEDENCE_ATOM, part) for k, part in enumerate(whole.kind.parts)]
        for one, number in zip(target.elts, values, strict=True):
            if not (isinstance(one, ast.Name) and one.id == "_"):
                self._translate_assignment(one, number)

    def _makes_table(self, node: ast.expr) -> bool:
        """Return whether an expression gives an array: a new one, an existing one, or the result of a function."""
        if _is_new_array(node) or self._is_alias(node):
            return True
        return isinstance(node, ast.Call) and isinstance(self._translate_expression(node).kind, TableType)

    def _emit_local_constant(self, value: CExpression) -> CExpression:
        """Emit a local C constant that stores a value; return its name as an expression."""
        self._count += 1
        name = f"t{self._count}_"
        self._emit_line(f"const {name_result_type(value.kind)} {name} = {value.text};")
        return CExpression(name, PRECEDENCE_ATOM, value.kind)

    def _translate_assignment(self, target: ast.expr, value: CExpression) -> None:
        if not isinstance(target, ast.Name):
            self._emit_line(f"{self._translate_target(target)} = {value.text};")
            return
        name, known = escape_c_name(target.id), self._kinds.get(target.id)
        if isinstance(value.kind, TableType):
            if _RESULT_ARGUMENT_MARK not in value.text or known is not None or self._depth > 1:
                raise self._unsupported_form_error(target)
            self._emit_line(f"{value.kind.element} {name}{''.join(f'[{n}]' for n in value.kind.shape)};")
            self._emit_line(value.text.replace(_RESULT_ARGUMENT_MARK, name) + ";")
        elif value.kind == C_INT64 and value.text.isdecimal() and self._store_counts[target.id] == 1:
            self._known_integers[target.id] = value.text
        elif known is not None:
            if known != value.kind and (known, value.kind) != (C_DOUBLE, C_INT64):
                raise self._unsupported_form_error(target)
            self._emit_line(f"{name} = {value.text};")
            return
        elif self._depth > 1:
            self._hoisted.append(f"    {name_result_type(value.kind)} {name};")
            self._emit_line(f"{name} = {value.text};")
        else:
            self._emit_line(f"{name_result_type(value.kind)} {name} = {value.text};")
        self._kinds[target.id] = value.kind

    def _declare_array(self, target: ast.expr, value: ast.expr) -> None:
        assert isinstance(value, ast.Call)
        shape = value.args[0]
        sizes = [self._translate_expression(n).text for n in (shape.elts if isinstance(shape, ast.Tuple) else [shape])]
        if not isinstance(target, ast.Name) or not all(s.isdecimal() for s in sizes):
            raise self._unsupported_form_error(value)
        self._emit_line(f"double {escape_c_name(target.id)}{''.join(f'[{n}]' for n in sizes)};")
        self._kinds[target.id] = TableType(C_DOUBLE, tuple(map(int, sizes)))

    def _translate_target(self, target: ast.expr) -> str:
        if isinstance(target, ast.Subscript) and isinstance(target.value, ast.Name):
            self._written.add(self._roots.get(target.value.id, ""))
        return self._translate_expression(target).text

    # Expressions

    def _translate_expression(self, node: ast.expr) -> CExpression:
        match node:
            case ast.Constant(value=bool(value)):
                return CExpression(str(value).lower(), PRECEDENCE_ATOM, C_BOOL)
            case ast.Constant(value=int(value) | float(value)):
                return CExpression(repr(value), PRECEDENCE_ATOM, C_INT64 if isinstance(value, int) else C_DOUBLE)
            case ast.Name(id=name) if name in self._known_integers:
                return CExpression(self._known_integers[name], PRECEDENCE_ATOM, C_INT64)
            case ast.Name(id=name) if isinstance(tables := self._kinds.get(name), TableTupleType):
                return CExpression(", ".join(f"{name}_{k}" for k in range(len(tables.parts))), PRECEDENCE_ATOM, tables)
            case ast.Name(id=name) if name in self._kinds:
                return CExpression(escape_c_name(name), PRECEDENCE_ATOM, self._kinds[name])
            case ast.Name(id=name) if isinstance(self._globals.get(name), int | float):
                return self._owner.declare_constant(name, self._globals[name], self._function.__module__)
            case ast.Name(id=name) if isinstance(values := self._globals.get(name), tuple):
                return self._owner.declare_table(name, values, self._function.__module__)
            case ast.Attribute(value=array, attr="size") if (
                isinstance(table := self._translate_expression(array).kind, TableType) and -1 not in table.shape
            ):
                return CExpression(str(math.prod(table.shape)), PRECEDENCE_ATOM, C_INT64)
            case ast.Attribute(value=ast.Name(id="math"), attr=name):
                return CExpression(
                    {"inf": "INFINITY", "nan": "NAN"}.get(name) or repr(getattr(math, name)), PRECEDENCE_ATOM, C_DOUBLE
                )
            case ast.Attribute(value=ast.Name(id=name), attr=field):
                return self._translate_field(node, name, field)
            case ast.Subscript():
                return self._translate_element(node)
            case ast.UnaryOp(op=ast.USub()):
                operand = self._translate_expression(node.operand)
                text = operand.as_operand(PRECEDENCE_UNARY)
                return CExpression(
                    f"-{text if not text.startswith('-') else f'({text})'}", PRECEDENCE_UNARY, operand.kind
                )
            case ast.UnaryOp(op=ast.Not()):
                return CExpression(f"!({self._translate_expression(node.operand).text})", PRECEDENCE_UNARY, C_BOOL)
            case ast.BinOp():
                left, right = self._translate_expression(node.left), self._translate_expression(node.right)
                if (combined := make_arithmetic_expression(type(node.op), left, right)) is not None:
                    return combined
            case ast.BoolOp():
                sign, level = ("&&", PRECEDENCE_AND) if isinstance(node.op, ast.And) else ("||", PRECEDENCE_OR)
                parts = [self._translate_expression(v).as_operand(PRECEDENCE_COMPARE) for v in node.values]
                return CExpression(f" {sign} ".join(parts), level, C_BOOL)
            case ast.Compare():
                sides = [self._translate_expression(v) for v in (node.left, *node.comparators)]
                return make_comparison_expression(node.ops, sides)
            case ast.IfExp():
                test, a, b = (self._translate_expression(v) for v in (node.test, node.body, node.orelse))
                return make_conditional_expression(test, a, b)
            case ast.Tuple():
                return self._translate_tuple([self._translate_expression(v) for v in node.elts], node)
            case ast.Call():
                return self._translate_call(node)
        raise self._unsupported_form_error(node)

    def _translate_field(self, node: ast.expr, name: str, field: str) -> CExpression:
        kind = self._kinds.get(name)
        if not isinstance(kind, RecordType) or kind.fields.fields is None:
            raise self._unsupported_form_error(node)
        of = kind.fields.fields[field][0]
        element = C_DOUBLE if of.base.kind == "f" else C_INT64
        return CExpression(f"{name}->{field}", PRECEDENCE_ATOM, TableType(element, of.shape) if of.shape else element)

    def _constant_tuple_index(self, node: ast.expr) -> int:
        """Return the value of a tuple's index, which is a literal or the name of an integer in the module."""
        match node:
            case ast.Constant(value=int(k)) | ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=int(k))):
                return k if isinstance(node, ast.Constant) else -k
            case ast.Name(id=name) if name not in self._kinds and isinstance(self._globals.get(name), int):
                return int(self._globals[name])
        raise self._unsupported_form_error(node)

    def _translate_element(self, node: ast.Subscript) -> CExpression:
        match node.value, node.slice:
            case ast.Attribute(attr="shape", value=array), ast.Constant(value=int(k)):
                kind = self._translate_expression(array).kind
                if isinstance(kind, TableType):
                    return CExpression(str(kind.shape[k]), PRECEDENCE_ATOM, C_INT64)
                raise self._unsupported_form_error(node)
        held = self._translate_expression(node.value)
        if isinstance(held.kind, TupleType):
            parts = [CExpression(f"{held.text}.f{k}", PRECEDENCE_ATOM, part) for k, part in enumerate(held.kind.parts)]
            if isinstance(node.slice, ast.Slice):
                bounds = (
                    None if b is None else self._constant_tuple_index(b) for b in (node.slice.lower, node.slice.upper)
                )
                return self._translate_tuple(parts[slice(*bounds)], node)
            return parts[self._constant_tuple_index(node.slice)]
        if isinstance(held.kind, TableTupleType) and isinstance(node.value, ast.Name):
            k = self._constant_tuple_index(node.slice)
            return CExpression(f"{node.value.id}_{k}", PRECEDENCE_ATOM, held.kind.parts[k])
        if not isinstance(held.kind, TableType):
            raise self._unsupported_form_error(node)
        if isinstance(node.slice, ast.Name) and isinstance(part := self._globals.get(node.slice.id), slice):
            return make_slice_expression(held, str(part.start), str(part.stop))
        if isinstance(node.slice, ast.Slice):
            lower, upper = node.slice.lower, node.slice.upper
            first = "0" if lower is None else self._translate_expression(lower).as_operand(PRECEDENCE_ADD)
            return make_slice_expression(
                held, first, str(held.kind.shape[0]) if upper is None else self._translate_expression(upper).text
            )
        index = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        inner = held.kind.shape[len(index) :]
        text = held.as_operand(PRECEDENCE_ATOM) + "".join(f"[{self._translate_expression(i).text}]" for i in index)
        return CExpression(text, PRECEDENCE_ATOM, TableType(held.kind.element, inner) if inner else held.kind.element)

    def _translate_tuple(self, parts: Sequence[CExpression], node: ast.expr) -> CExpression:
        kinds = [p.kind for p in parts if isinstance(p.kind, str | TupleType)]
        if len(kinds) != len(parts):
            raise self._unsupported_form_error(node)
        kind = self._owner.declare_tuple_struct(kinds)
        return CExpression(f"({kind.name}){{{', '.join(p.text for p in parts)}}}", PRECEDENCE_ATOM, kind)

    def _translate_call(self, node: ast.Call) -> CExpression:
        name = ast.unparse(node.func)
        if name in ("np.uint64", "borrow_arrays"):
            return self._translate_expression(node.args[0])
        values = [a.value if isinstance(a, ast.Starred) else a for a in node.args]
        arguments = [self._translate_expression(a) for a in values]
        if (in_library := translate_library_call(name, arguments)) is not None:
            return in_library
        texts = ", ".join(a.text for a in arguments)
        called = self._globals.get(name)
        if not callable(called) or node.keywords:
            raise self._unsupported_form_error(node)
        if (in_c := self._owner.written_in_c.get(called)) is not None:
            self._written.update(map(self._root_argument, values))
            last = arguments[-1].kind
            assert isinstance(last, TableType)
            return CExpression(f"{in_c}({texts}, {math.prod(last.shape)})", PRECEDENCE_ATOM, C_VOID)
        kinds: list[CType] = []
        written_to: list[ast.expr] = []
        for value, argument in zip(values, arguments, strict=True):
            tables = argument.kind.parts if isinstance(argument.kind, TableTupleType) else None
            is_spread = tables is not None and len(values) != len(
                inspect.signature(_without_decorator(called)).parameters
            )
            kinds += tables if tables is not None and is_spread else [argument.kind]
            written_to += [value] * (len(tables) if tables is not None and is_spread else 1)
        made = self._owner.add_function(called, kinds)
        for value, is_written in zip(written_to, made.written, strict=True):
            if is_written:
                self._written.add(self._root_argument(value))
        if isinstance(made.result, TableType):
            return CExpression(f"{made.name}({texts}, {_RESULT_ARGUMENT_MARK})", PRECEDENCE_ATOM, made.result)
        return CExpression(f"{made.name}({texts})", PRECEDENCE_ATOM, made.result)


def _without_decorator(function: Any) -> Callable[..., Any]:
    return getattr(function, "py_func", function)


def _is_new_array(node: ast.expr) -> bool:
    return isinstance(node, ast.Call) and ast.unparse(node.func) == "np.empty"


def _wrap_code(line: str) -> list[str]:
    """Break a long line at spaces; continuations are indented."""
    indent = " " * (len(line) - len(line.lstrip()) + 4)
    return textwrap.wrap(line, 120, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)
