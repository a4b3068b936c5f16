"""A linear model as functions of named parameters, and how one is put together entry by entry."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

__all__ = ["UNITS", "Builder", "Parameter", "Structure"]

Array = NDArray[np.float64]

UNITS = {
    "p": "rad/s",
    "q": "rad/s",
    "r": "rad/s",
    "phi": "rad",
    "theta": "rad",
    "u": "m/s",
    "v": "m/s",
    "w": "m/s",
}


@dataclass(frozen=True)
class Parameter:
    """One parameter: where the search starts and what it may be.

    ``low > 0`` makes the search work with its logarithm. SI units; ``meaning`` is for tables.
    """

    symbol: str
    unit: str
    start: float
    low: float
    high: float
    meaning: str = ""


@dataclass(frozen=True, eq=False)
class Structure:
    """A linear model whose matrices are functions of named parameters.

    Attributes
    ----------
    name : str
    states, inputs, outputs : tuple of str
    units : tuple of str
        Of the outputs.
    parameters : tuple of Parameter
    fill : callable
        From ``{symbol: value}`` to ``(A, B, C, D, delay)``; ``delay`` (s) has one entry an input.
    """

    name: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    units: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    fill: Callable[[Mapping[str, float]], tuple[Array, Array, Array, Array, Array]] = field(repr=False)

    @property
    def symbols(self) -> tuple[str, ...]:
        """Symbols of the parameters, in order."""
        return tuple(p.symbol for p in self.parameters)

    def matrices(self, values: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Return A, B, C, D and the delays (s) at the values (p,) of the parameters."""
        return self.fill(dict(zip(self.symbols, values.tolist(), strict=True)))


class Builder:
    """Collects states, parameters and matrix entries; an entry is (matrix, row, column, function of the values)."""

    def __init__(self, inputs: tuple[str, ...]) -> None:
        self.inputs = inputs
        self.states: list[str] = []
        self.parameters: dict[str, Parameter] = {}
        self.entries: list[tuple[str, str, str, Callable[[Mapping[str, float]], float]]] = []

    def parameter(self, symbol: str, unit: str, start: float, low: float, high: float, meaning: str) -> None:
        self.parameters.setdefault(symbol, Parameter(symbol, unit, start, low, high, meaning))

    def constant(self, row: str, column: str, value: float) -> None:
        self.entries.append(("A", row, column, lambda _: value))

    def free(
        self, row: str, column: str, symbol: str, unit: str, start: float, bound: float | tuple[float, float],
        meaning: str, over: str = "",
    ) -> None:  # fmt: skip
        """One free entry of A or B (by the name of its column), divided by the parameter ``over`` if given."""
        low, high = bound if isinstance(bound, tuple) else (-bound, bound)
        self.parameter(symbol, unit, start, low, high, meaning)
        matrix = "B" if column in self.inputs else "A"
        self.entries.append((matrix, row, column, lambda v: v[symbol] / v[over] if over else v[symbol]))

    def minus_inverse(self, row: str, symbol: str) -> None:
        self.entries.append(("A", row, row, lambda v: -1.0 / v[symbol]))

    def finish(
        self, name: str, outputs: tuple[str, ...], driven: set[str], most: float, skew: float
    ) -> Structure:
        # A lagged stick drives its own state; the delay belongs to the stick.
        for i in self.inputs:
            if i in driven and most + skew > 0.0:
                self.parameter(f"tau_{i}", "s", min(0.04, 0.5 * most), -skew, most, f"delay of {i}")
        row = {s: k for k, s in enumerate(self.states)}
        column = {s: k for k, s in enumerate(self.inputs)}
        nx, nu, ny = len(row), len(column), len(outputs)
        c = np.zeros((ny, nx))
        c[np.arange(ny), [row[o] for o in outputs]] = 1.0
        places = [
            (m == "A", row[r], row[c_] if m == "A" else column[c_], value) for m, r, c_, value in self.entries
        ]

        def fill(v: Mapping[str, float]) -> tuple[Array, Array, Array, Array, Array]:
            a, b = np.zeros((nx, nx)), np.zeros((nx, nu))
            for in_a, i, j, value in places:
                (a if in_a else b)[i, j] += value(v)
            delay = np.array([v.get(f"tau_{i}", 0.0) for i in self.inputs])
            return a, b, c, np.zeros((ny, nu)), delay

        return Structure(
            name, tuple(self.states), self.inputs, outputs, tuple(UNITS[o] for o in outputs),
            tuple(self.parameters.values()), fill,
        )  # fmt: skip
