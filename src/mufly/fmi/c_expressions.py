"""C expressions (text, precedence and type), and the operations that build them from Python source.

The text has the operations of the Python source in the same order; :mod:`mufly.fmi.c_translation` gives the rules that
keep the results equal.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from mufly.fmi.c_types import C_BOOL, C_DOUBLE, C_INT64, CType, TableType

C_HELPER_FUNCTIONS = """\
static inline double smaller(double a, double b) { return b < a ? b : a; }
static inline double greater(double a, double b) { return b > a ? b : a; }
static inline int64_t smaller_int(int64_t a, int64_t b) { return b < a ? b : a; }
static inline int64_t greater_int(int64_t a, int64_t b) { return b > a ? b : a; }
static inline int64_t whole_part(double x) { return x > -1e15 && x < 1e15 ? (int64_t)x : 0; }
static inline double squared(double x) { return x * x; }
static inline int64_t quotient(int64_t a, int64_t b) { return a / b - (a % b != 0 && (a < 0) != (b < 0)); }
static inline int64_t remainder_int(int64_t a, int64_t b) { return a - quotient(a, b) * b; }
static inline double remainder_real(double a, double b)
{
    const double rest = fmod(a, b);
    return rest == 0.0 ? copysign(0.0, b) : (rest < 0.0) != (b < 0.0) ? rest + b : rest;
}
"""
"""C functions that the text of expressions calls."""
_C_KEYWORDS = frozenset((
    "auto", "bool", "case", "char", "const", "default", "do", "double", "enum", "extern", "false", "float", "goto",
    "inline", "int", "long", "register", "restrict", "short", "signed", "sizeof", "static", "struct", "switch", "true",
    "typedef", "union", "unsigned", "void", "volatile",
))  # fmt: skip
_MATH_FUNCTIONS = ("sqrt", "sin", "cos", "tan", "asin", "atan2", "exp", "copysign", "ceil")
_FLOAT_TEST_FUNCTIONS = ("isnan", "isfinite")
(
    PRECEDENCE_TERNARY,
    PRECEDENCE_OR,
    PRECEDENCE_AND,
    PRECEDENCE_COMPARE,
    PRECEDENCE_ADD,
    PRECEDENCE_MULTIPLY,
    PRECEDENCE_UNARY,
    PRECEDENCE_ATOM,
) = range(8)  # precedences
ARITHMETIC_OPERATORS = {
    ast.Add: ("+", PRECEDENCE_ADD),
    ast.Sub: ("-", PRECEDENCE_ADD),
    ast.Mult: ("*", PRECEDENCE_MULTIPLY),
    ast.Div: ("/", PRECEDENCE_MULTIPLY),
}
_FOLDED_OPERATORS: dict[type[ast.operator], Callable[[int, int], int]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
}  # fmt: skip
_COMPARISON_OPERATORS = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}


@dataclass(frozen=True)
class CExpression:
    """C text of an expression, its precedence and its type."""

    text: str
    level: int
    kind: CType

    def as_operand(self, level: int) -> str:
        """Return the C text of an operand, in brackets if its own precedence is below ``level``."""
        return self.text if self.level >= level else f"({self.text})"


def make_slice_expression(held: CExpression, first: str, stop: str) -> CExpression:
    """Return the C expression of a part of a table: rows ``first`` to ``stop`` (excluded)."""
    assert isinstance(held.kind, TableType)
    is_known = first.isdecimal() and stop.isdecimal()
    kind = TableType(held.kind.element, (int(stop) - int(first) if is_known else -1, *held.kind.shape[1:]))
    return CExpression(
        held.text if first == "0" else f"{held.as_operand(PRECEDENCE_ADD)} + {first}", PRECEDENCE_ADD, kind
    )


def make_comparison_expression(signs: Sequence[ast.cmpop], sides: Sequence[CExpression]) -> CExpression:
    """Return the C form of a comparison, also of a chain such as ``a < b < c``."""
    texts = [side.as_operand(PRECEDENCE_ADD) for side in sides]
    parts = [f"{a} {_COMPARISON_OPERATORS[type(o)]} {b}" for o, a, b in zip(signs, texts, texts[1:], strict=False)]
    return CExpression(" && ".join(parts), PRECEDENCE_COMPARE if len(parts) == 1 else PRECEDENCE_AND, C_BOOL)


def make_conditional_expression(test: CExpression, a: CExpression, b: CExpression) -> CExpression:
    """Return the C form of ``a if test else b``."""
    kind = a.kind if a.kind == b.kind else C_DOUBLE
    chosen = f"{a.as_operand(PRECEDENCE_ADD)} : {b.as_operand(PRECEDENCE_ADD)}"
    text = f"{test.as_operand(PRECEDENCE_COMPARE)} ? {chosen}"
    return CExpression(f"({text})", PRECEDENCE_ATOM, kind)


def make_arithmetic_expression(form: type[ast.operator], left: CExpression, right: CExpression) -> CExpression | None:
    """Return the C form of an arithmetic operation on two numbers; None if it has none."""
    if not {left.kind, right.kind} <= {C_DOUBLE, C_INT64}:
        return None
    kind = C_INT64 if left.kind == right.kind == C_INT64 else C_DOUBLE
    texts = (left.text, right.text)
    if kind == C_INT64 and form in _FOLDED_OPERATORS and left.text.isdecimal() and right.text.isdecimal():
        folded = _FOLDED_OPERATORS[form](int(left.text), int(right.text))
        if folded >= 0:
            return CExpression(str(folded), PRECEDENCE_ATOM, C_INT64)
    if form is ast.Pow and right.text == "2" and left.kind == C_DOUBLE:
        return CExpression(f"squared({left.text})", PRECEDENCE_ATOM, C_DOUBLE)
    if form is ast.BitAnd and kind == C_INT64:
        return CExpression(
            f"({left.as_operand(PRECEDENCE_ADD)} & {right.as_operand(PRECEDENCE_ADD)})", PRECEDENCE_ATOM, C_INT64
        )
    if form is ast.FloorDiv and kind == C_INT64:
        return CExpression(f"quotient({', '.join(texts)})", PRECEDENCE_ATOM, C_INT64)
    if form is ast.Mod:
        return CExpression(
            f"remainder_{'int' if kind == C_INT64 else 'real'}({', '.join(texts)})", PRECEDENCE_ATOM, kind
        )
    if form not in ARITHMETIC_OPERATORS:
        return None
    sign, level = ARITHMETIC_OPERATORS[form]
    if sign == "/" and kind == C_INT64:
        return CExpression(
            f"(double){left.as_operand(PRECEDENCE_ATOM)} / (double){right.as_operand(PRECEDENCE_ATOM)}",
            level,
            C_DOUBLE,
        )
    # C groups from the left, as Python does: an operand on the right of the same precedence needs brackets.
    return CExpression(f"{left.as_operand(level)} {sign} {right.as_operand(level + 1)}", level, kind)


def translate_library_call(name: str, arguments: Sequence[CExpression]) -> CExpression | None:
    """Return the C form of a call from ``math``, NumPy or Python's built-in functions; None for other functions."""
    texts = ", ".join(a.text for a in arguments)
    function = name.removeprefix("math.")
    if name.startswith("math.") and function in _MATH_FUNCTIONS:
        text = f"{function}({texts})"
        return CExpression(
            f"whole_part({text})" if function == "ceil" else text,
            PRECEDENCE_ATOM,
            C_INT64 if function == "ceil" else C_DOUBLE,
        )
    if name.startswith("math.") and function in _FLOAT_TEST_FUNCTIONS:
        return CExpression(f"({function}({texts}) != 0)", PRECEDENCE_ATOM, C_BOOL)
    if name == "np.rint":
        return CExpression(f"rint({texts})", PRECEDENCE_ATOM, C_DOUBLE)
    if name == "abs" and arguments[0].kind == C_DOUBLE:
        return CExpression(f"fabs({texts})", PRECEDENCE_ATOM, C_DOUBLE)
    if name == "int":
        return CExpression(f"whole_part({texts})", PRECEDENCE_ATOM, C_INT64)
    if name in ("min", "max") and len(arguments) == 2:
        is_whole = all(a.kind == C_INT64 for a in arguments)
        c_name = {"min": "smaller", "max": "greater"}[name] + ("_int" if is_whole else "")
        return CExpression(f"{c_name}({texts})", PRECEDENCE_ATOM, C_INT64 if is_whole else C_DOUBLE)
    return None


def escape_c_name(name: str) -> str:
    """Return a name for use in C: a keyword of C gets an underscore at its end."""
    return f"{name}_" if name in _C_KEYWORDS or name == "_" else name
