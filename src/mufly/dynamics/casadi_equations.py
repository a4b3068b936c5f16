"""The flight model as a CasADi function, from the source of the equations of motion.

Each function of the model runs once on symbols, with decisions on data as selections
(:mod:`mufly.dynamics.branch_selection`). There is no second derivation: an edit of an equation also changes the CasADi
function.

Tables with a symbolic index become selections between neighbouring entries (``SX``, for vehicles without a map) or
look-ups (``MX``, for vehicles with a coefficient map or flight map).
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics.branch_selection import replace_branches_by_selection
from mufly.dynamics.equations_of_motion import state_derivative
from mufly.dynamics.model_state import INPUT_SIZE, PARAMETER_DTYPE, STATE_SIZE, model_parameters
from mufly.errors import MuflyError
from mufly.vehicle import Vehicle


def casadi_model(vehicle: Vehicle, voltage: float | None = None) -> Any:
    """Return the equations of motion as a CasADi function.

    Parameters
    ----------
    vehicle : Vehicle
    voltage : float, optional
        Constant battery voltage (V); by default the vehicle's battery model applies.

    Returns
    -------
    casadi.Function
        ``derivative = f(state, inputs, wind)``: (21,), (4,) and (3,) to (21,), as
        :func:`mufly.dynamics.state_derivative`. It is smooth except at saturations, contact and nodes of tables.

    Raises
    ------
    MuflyError
        If CasADi is not installed.

    Examples
    --------
    >>> import mufly, numpy as np
    >>> from mufly.dynamics import casadi_model, find_trim
    >>> vehicle = mufly.load_vehicle("mufly-1.1")
    >>> hover = find_trim(vehicle)
    >>> high = hover.state - np.eye(21)[2]  # 1 m above the floor
    >>> abs(float(casadi_model(vehicle, hover.battery_voltage_V)(high, hover.input, [0, 0, 0])[5])) < 1e-6
    True
    """
    try:
        import casadi
    except ImportError:
        raise MuflyError("CasADi is not installed; run: pip install casadi") from None
    p = model_parameters(vehicle, voltage)
    kind = casadi.SX if p["map_node_count"] == 0 and p["flight_map_node_count"] == 0 else casadi.MX
    names = {"state": STATE_SIZE, "inputs": INPUT_SIZE, "wind": 3}
    symbols: dict[str, Any] = {name: kind.sym(name, size) for name, size in names.items()}
    arguments = [[_CasadiSymbol(symbols[name][k]) for k in range(size)] for name, size in names.items()]
    derivative: list[Any] = [0.0] * STATE_SIZE
    replace_branches_by_selection(state_derivative, _CASADI_NAMESPACE)(
        *arguments, _SymbolIndexedParameters(p), derivative
    )
    out = casadi.vertcat(*(_unwrap_symbol(d) for d in derivative))
    return casadi.Function("derivative", list(symbols.values()), [out], list(names), ["derivative"])


class _CasadiSymbol:
    """A CasADi expression, with the operations that the equations use."""

    __array_ufunc__ = None

    def __init__(self, value: Any) -> None:
        self.value = value

    def __bool__(self) -> bool:
        raise TypeError("a symbol has no truth value; mufly.dynamics.branch_selection must rewrite this `if`")

    def __add__(self, other: Any) -> _CasadiSymbol:
        return _CasadiSymbol(self.value + _unwrap_symbol(other))

    def __radd__(self, other: Any) -> _CasadiSymbol:
        return _CasadiSymbol(_unwrap_symbol(other) + self.value)

    def __sub__(self, other: Any) -> _CasadiSymbol:
        return _CasadiSymbol(self.value - _unwrap_symbol(other))

    def __rsub__(self, other: Any) -> _CasadiSymbol:
        return _CasadiSymbol(_unwrap_symbol(other) - self.value)

    def __mul__(self, other: Any) -> _CasadiSymbol:
        return _CasadiSymbol(self.value * _unwrap_symbol(other))

    def __rmul__(self, other: Any) -> _CasadiSymbol:
        return _CasadiSymbol(_unwrap_symbol(other) * self.value)

    def __truediv__(self, other: Any) -> _CasadiSymbol:
        return _CasadiSymbol(self.value / _unwrap_symbol(other))

    def __rtruediv__(self, other: Any) -> _CasadiSymbol:
        return _CasadiSymbol(_unwrap_symbol(other) / self.value)

    def __neg__(self) -> _CasadiSymbol:
        return _CasadiSymbol(-self.value)

    def __abs__(self) -> _CasadiSymbol:
        return _apply_casadi_function("fabs", self)

    def __lt__(self, other: Any) -> _CasadiSymbol:
        return _CasadiSymbol(self.value < _unwrap_symbol(other))

    def __le__(self, other: Any) -> _CasadiSymbol:
        return _CasadiSymbol(self.value <= _unwrap_symbol(other))

    def __gt__(self, other: Any) -> _CasadiSymbol:
        return _CasadiSymbol(self.value > _unwrap_symbol(other))

    def __ge__(self, other: Any) -> _CasadiSymbol:
        return _CasadiSymbol(self.value >= _unwrap_symbol(other))

    def __eq__(self, other: object) -> Any:
        return _CasadiSymbol(self.value == _unwrap_symbol(other))

    __hash__ = None  # type: ignore[assignment]


def _unwrap_symbol(number: Any) -> Any:
    """Return the CasADi expression of a symbol, or the number."""
    return number.value if isinstance(number, _CasadiSymbol) else float(number)


def _apply_casadi_function(name: str, *numbers: Any) -> Any:
    """Return the value of CasADi's function ``name``: a float for numbers, a symbol if any argument is a symbol."""
    import casadi

    if not any(isinstance(n, _CasadiSymbol) for n in numbers):
        return float(getattr(casadi, name)(*numbers))
    return _CasadiSymbol(getattr(casadi, name)(*(_unwrap_symbol(n) for n in numbers)))


def _select_value(test: Any, a: Any, b: Any) -> Any:
    if not isinstance(test, _CasadiSymbol):
        return a if test else b
    return _apply_casadi_function("if_else", test, a, b)


def _integer_part(number: Any) -> Any:
    """Return a number, rounded towards zero to an integer."""
    if not isinstance(number, _CasadiSymbol):
        return int(number)
    return _select_value(number >= 0.0, _apply_casadi_function("floor", number), _apply_casadi_function("ceil", number))


def _greatest_value(*numbers: Any) -> Any:
    if not any(isinstance(n, _CasadiSymbol) for n in numbers):
        return max(numbers)
    out = numbers[0]
    for n in numbers[1:]:
        out = _apply_casadi_function("fmax", out, n)
    return out


def _least_value(*numbers: Any) -> Any:
    if not any(isinstance(n, _CasadiSymbol) for n in numbers):
        return min(numbers)
    out = numbers[0]
    for n in numbers[1:]:
        out = _apply_casadi_function("fmin", out, n)
    return out


_CASADI_NAMESPACE: dict[str, Any] = {
    "math": SimpleNamespace(sqrt=lambda x: _apply_casadi_function("sqrt", x)),
    "sine_of": lambda x: _apply_casadi_function("sin", x),
    "cosine_of": lambda x: _apply_casadi_function("cos", x),
    "min": _least_value,
    "max": _greatest_value,
    "int": _integer_part,
    "select": _select_value,
    "any_of": lambda test: isinstance(test, _CasadiSymbol) or bool(test),
    "both_of": lambda a, b: b if a is True else _select_value(a, b, False),
    "negate": lambda test: 1.0 - test if isinstance(test, _CasadiSymbol) else not test,
    "require_uniform": bool,
    "whole_number": lambda n: n,
}


class _SymbolIndexedParameters:
    """A record of parameters with tables that take a symbolic index."""

    def __init__(self, record: np.void) -> None:
        for name in PARAMETER_DTYPE.names or ():
            value = record[name]
            if value.ndim:
                setattr(self, name, _SymbolIndexedTable(value))
            else:
                setattr(self, name, int(value) if value.dtype.kind == "i" else float(value))


class _SymbolIndexedTable:
    def __init__(self, numbers: NDArray[Any]) -> None:
        self._numbers = numbers
        self.shape = numbers.shape
        self._looked_up: Any = None

    def __getitem__(self, index: Any) -> Any:
        if not isinstance(index, _CasadiSymbol):
            return self._numbers[index].item()
        import casadi

        if isinstance(index.value, casadi.MX):
            if self._looked_up is None:
                self._looked_up = casadi.MX(casadi.DM(self._numbers))
            return _CasadiSymbol(self._looked_up[index.value])
        return _CasadiSymbol(self._bisect_table(index.value, 0, len(self._numbers)))

    def _bisect_table(self, index: Any, first: int, end: int) -> Any:
        """Return the table's entry at a symbolic index, as nested selections (bisection)."""
        import casadi

        if end - first == 1:
            return casadi.SX(float(self._numbers[first]))
        middle = (first + end) // 2
        if np.ptp(self._numbers[first:end]) == 0.0:
            return casadi.SX(float(self._numbers[first]))
        return casadi.if_else(
            index < middle, self._bisect_table(index, first, middle), self._bisect_table(index, middle, end)
        )
