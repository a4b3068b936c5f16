"""Rewrite the equations of motion without branches, for vectors of several vehicles (lanes) and for symbolic
expressions.

The source of a function is rewritten so that a decision on data becomes a selection between two results::

    if depth <= 0.0:                    test = depth > 0.0 (one truth value per vehicle)
        continue                        if any_of(test):
    ...                                     ...
    force += step                           force = select(test, force + step, force)

A type supplies the functions ``select(test, a, b)``, ``any_of(test)``, ``both_of(a, b)``, ``negate(test)``,
``sine_of``, ``cosine_of``, ``whole_number`` and, for decisions on parameters, ``require_uniform(test)``, which is the
same for all vehicles. All functions that a function calls are rewritten, too. Nothing else in the source changes: order
and number of the operations are those of a single vehicle.

The rewritten forms are those that the equations need: ``if`` without ``else``; ``if test: continue`` in a loop; ``if
test: return value`` before the last ``return``. Other forms raise :class:`NotImplementedError`.
"""

from __future__ import annotations

import ast
import builtins
import inspect
import textwrap
from collections.abc import Callable, Collection, Mapping
from typing import Any

_PARAMETERS_VARIABLE = "p"
_REPLACED_CALLS = {"np.uint64": "whole_number", "math.sin": "sine_of", "math.cos": "cosine_of"}


def replace_branches_by_selection(
    function: Any,
    namespace: Mapping[str, Any],
    *,
    wrap: Callable[[Any], Any] = lambda f: f,
    absent: Collection[str] = (),
    file: str | None = None,
) -> Any:
    """Return a copy of a function, and of the functions that it calls, in which a selection of values replaces each
    branch on data.

    Parameters
    ----------
    function : compiled function
        Function of the flight model.
    namespace : mapping
        The functions of the type that are named above, and others that take the place of the source's names.
    wrap : callable
        Compiles each rewritten function.
    absent : collection of str
        Parameters that are zero, as ``"map_node_count"`` without a map: ``if p.map_node_count > 0`` is left out.
    file : str, optional
        File of the rewritten functions; Numba caches them under its sources.
    """
    return _FunctionRewriter(dict(namespace), wrap, frozenset(absent), file).rewrite(function)


class _FunctionRewriter:
    def __init__(
        self, namespace: dict[str, Any], wrap: Callable[[Any], Any], absent: frozenset[str], file: str | None
    ) -> None:
        self._namespace, self._wrap, self._absent, self._file = namespace, wrap, absent, file
        self._made: dict[Any, Any] = {}

    def rewrite(self, function: Any) -> Any:
        if function in self._made:
            return self._made[function]
        plain = getattr(function, "py_func", function)
        tree = ast.parse(textwrap.dedent(inspect.getsource(plain)))
        definition = tree.body[0]
        assert isinstance(definition, ast.FunctionDef)
        definition.decorator_list, definition.returns = [], None
        for argument in definition.args.args:
            argument.annotation = None
        defined = {argument.arg for argument in definition.args.args}
        body = definition.body
        if isinstance(body[0], ast.Expr) and isinstance(body[0].value, ast.Constant):
            body = body[1:]
        definition.body = _StatementRewriter(self._absent).rewrite_block(body, defined)
        # Numba tells functions of a file apart by line and name.
        definition.name = f"{plain.__module__.rpartition('.')[2]}_{plain.__name__}_{len(self._absent)}"
        ast.increment_lineno(tree, plain.__code__.co_firstlineno - 1)
        ast.fix_missing_locations(tree)
        scope = {**plain.__globals__, **self._namespace}
        for name in _called_names(definition):
            value = self._namespace.get(name, plain.__globals__.get(name))
            if _is_package_function(value) and name not in self._namespace:
                scope[name] = self.rewrite(value)
        scope["__name__"] = plain.__module__ if self._file is None else __name__
        code = compile(tree, self._file or f"<{plain.__name__}>", "exec")
        exec(code, scope)
        made = self._made[function] = self._wrap(scope[definition.name])
        return made


def _is_package_function(value: Any) -> bool:
    """Return whether ``value`` is a function of this package, compiled by Numba or plain."""
    return hasattr(value, "py_func") or (inspect.isfunction(value) and value.__module__.startswith("mufly."))


def _called_names(definition: ast.FunctionDef) -> list[str]:
    names = [n.func.id for n in ast.walk(definition) if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)]
    return [n for n in dict.fromkeys(names) if not hasattr(builtins, n)]


def _assigned_names(statements: list[ast.stmt]) -> list[str]:
    names = [n.id for s in statements for n in ast.walk(s) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)]
    return list(dict.fromkeys(names))


def _make_call_node(name: str, *arguments: ast.expr) -> ast.Call:
    return ast.Call(ast.Name(name, ast.Load()), list(arguments), [])


def _make_assignment_node(name: str, value: ast.expr) -> ast.Assign:
    return ast.Assign([ast.Name(name, ast.Store())], value)


def _make_name_node(name: str) -> ast.Name:
    return ast.Name(name, ast.Load())


class _ExpressionRewriter(ast.NodeTransformer):
    """Replace ``a and b``, sine, cosine and integer conversion by functions that the type of the numbers supplies."""

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.expr:
        self.generic_visit(node)
        if not isinstance(node.op, ast.And) or len(node.values) != 2:
            raise NotImplementedError("only `a and b`")
        return _make_call_node("both_of", *node.values)

    def visit_Call(self, node: ast.Call) -> ast.expr:
        self.generic_visit(node)
        name = _REPLACED_CALLS.get(ast.unparse(node.func))
        return node if name is None else _make_call_node(name, *node.args)


class _StatementRewriter:
    """Rewrites the statements of one function."""

    def __init__(self, absent: frozenset[str]) -> None:
        self._absent, self._count = absent, 0

    def rewrite_block(self, statements: list[ast.stmt], defined: set[str]) -> list[ast.stmt]:
        out: list[ast.stmt] = []
        for k, statement in enumerate(statements):
            rest = statements[k + 1 :]
            if isinstance(statement, ast.If):
                if self._depends_on_absent_parameter(statement.test):
                    continue
                if statement.orelse:
                    raise NotImplementedError("an `if` with an `else` cannot be translated")
                last = statement.body[-1]
                if isinstance(last, ast.Continue):
                    if len(statement.body) > 1:
                        raise NotImplementedError("a branch with statements before `continue` cannot be translated")
                    test = _make_call_node("negate", _ExpressionRewriter().visit(statement.test))
                    return out + self._rewrite_if_without_branch(test, rest, defined)
                if isinstance(last, ast.Return) and last.value is not None:
                    return out + self._rewrite_early_return(statement, last.value, rest, defined)
                out += self._rewrite_if_without_branch(
                    _ExpressionRewriter().visit(statement.test), statement.body, defined
                )
                continue
            if isinstance(statement, ast.For):
                inner = set(defined) | set(_assigned_names([statement]))
                names = {n.id for n in ast.walk(statement.target) if isinstance(n, ast.Name)}
                statement.body = self.rewrite_block(statement.body, set(defined) | names) or [ast.Pass()]
                defined |= inner
                out.append(statement)
                continue
            out.append(_ExpressionRewriter().visit(statement))
            defined |= set(_assigned_names([statement]))
        return out

    def _depends_on_absent_parameter(self, test: ast.expr) -> bool:
        if isinstance(test, ast.BoolOp) and isinstance(test.op, ast.And):
            return any(self._depends_on_absent_parameter(part) for part in test.values)
        left = test.left if isinstance(test, ast.Compare) else None
        return (
            isinstance(left, ast.Attribute)
            and ast.unparse(left.value) == _PARAMETERS_VARIABLE
            and left.attr in self._absent
        )

    def _unused_name(self, kind: str) -> str:
        self._count += 1
        return f"{kind}_{self._count}"

    def _rewrite_if_without_branch(self, test: ast.expr, body: list[ast.stmt], defined: set[str]) -> list[ast.stmt]:
        """Rewrite ``if test: body`` without a branch: an assigned variable keeps its previous value where ``test`` is
        false.
        """
        stores = [n for s in body for n in ast.walk(s) if isinstance(n, ast.Subscript) and isinstance(n.ctx, ast.Store)]
        if stores or any(isinstance(s, ast.Expr) for s in body):  # writes to arrays: the same for all vehicles
            return [ast.If(_make_call_node("require_uniform", test), self.rewrite_block(body, defined), [])]
        merged = [name for name in _assigned_names(body) if name in defined]
        test_name = self._unused_name("test")
        kept = {name: self._unused_name("kept") for name in merged}
        inside: list[ast.stmt] = [_make_assignment_node(kept[name], _make_name_node(name)) for name in merged]
        inside += self.rewrite_block(body, set(defined))
        inside += [
            _make_assignment_node(
                n, _make_call_node("select", _make_name_node(test_name), _make_name_node(n), _make_name_node(kept[n]))
            )
            for n in merged
        ]
        return [
            _make_assignment_node(test_name, test),
            ast.If(_make_call_node("any_of", _make_name_node(test_name)), inside, []),
        ]

    def _rewrite_early_return(
        self, guard: ast.If, value: ast.expr, rest: list[ast.stmt], defined: set[str]
    ) -> list[ast.stmt]:
        """Rewrite ``if test: return value`` without a branch: the last ``return`` selects between both values."""
        if len(guard.body) > 1 or not isinstance(rest[-1], ast.Return) or rest[-1].value is None:
            raise NotImplementedError("`if test: return value` with further statements, or without a last return")
        test_name, value_name = self._unused_name("test"), self._unused_name("value")
        out: list[ast.stmt] = [
            _make_assignment_node(test_name, _ExpressionRewriter().visit(guard.test)),
            _make_assignment_node(value_name, _ExpressionRewriter().visit(value)),
        ]  # fmt: skip
        out += self.rewrite_block(rest[:-1], defined)
        last = _ExpressionRewriter().visit(rest[-1].value)
        return [
            *out,
            ast.Return(_make_call_node("select", _make_name_node(test_name), _make_name_node(value_name), last)),
        ]
