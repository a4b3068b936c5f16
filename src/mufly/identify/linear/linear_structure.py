"""Linear models with named parameters: structure from blocks, and exact simulation.

**Structure: the measured outputs decide which blocks form the model.**

    x' = A(theta) x + B(theta) (u(t - tau) - u_0),   y = C x + D (u(t - tau) - u_0) + y_0

Near hover, body axes, all quantities deviations (V. Mettler, *Identification Modeling and Characteristics of Miniature
Rotorcraft*, 2003, ch. 4; Tischler and Remple, ch. 15)::

    first-order   p' = L_p p + L_q q + L_lat lat + L_lon lon          and likewise q' with M
    second-order  as first-order, but the sticks act through one lag of tau_s: a filtered command
    hybrid        p' = L_b b + L_a a,   q' = M_a a + M_b b            rotor springs carry the fuselage
                  a' = -q - a / tau_f + (A_b b + A_lat lat + A_lon lon) / tau_f
                  b' = -p - b / tau_f + (B_a a + B_lat lat + B_lon lon) / tau_f
    yaw           r' = N_r r + N_ped ped + N_col col + N_p p [- N_fb r_fb,  r_fb' = r - K_rfb r_fb: gyro]
    attitude      phi' = p,   theta' = q                              small angles
    translation   u' = X_u u - g theta + X_a a,   v' = Y_v v + g phi + Y_b b
    heave         w' = Z_w w + Z_col col

In the hybrid model the control derivatives are products, ``L_lat = L_b B_lat / tau_f``; the flapping angles a, b are
not measured. Coupling terms (L_q, M_p, L_a, M_b, A_b, B_a, off-axis sticks) belong to the ``-coupled`` variants.

**Exact simulation over a sampled record, with separate linear unknowns.**

Between samples the inputs are linear (or constant), which a matrix exponential integrates exactly (Franklin, Powell
and Workman, *Digital Control of Dynamic Systems*, Sec. 4.3):

    x_(k+1) = Phi x_k + G_1 u_k + G_2 (u_(k+1) - u_k) / dt

Initial state, input trim and output bias enter the prediction linearly. :func:`compute_start_and_bias_responses`
returns the response to one unit of each, so that a fit can solve for them exactly (variable projection, Golub and
Pereyra 1973).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from mufly.compiled.numba_cache import cached_njit
from mufly.errors import ArgumentError
from mufly.quantities.units import GRAVITY

Array = NDArray[np.float64]

SIGNAL_UNITS = dict.fromkeys("pqr", "rad/s") | {"phi": "rad", "theta": "rad"} | dict.fromkeys("uvw", "m/s")


@dataclass(frozen=True)
class ModelParameter:
    """Model parameter with start value and bounds, in SI units.

    With ``low > 0`` the search uses the logarithm. ``meaning`` is a description for tables. ``driven_and_driving``
    names the state and the signal that a gain connects: ``start_value``, ``low`` and ``high`` then hold for signals of
    equal size, and :func:`scale_gains_to_record` scales them to the record.
    """

    symbol: str
    unit: str
    start_value: float
    low: float
    high: float
    meaning: str = ""
    driven_and_driving: tuple[str, str] = ("", "")


@dataclass(frozen=True, eq=False)
class LinearStructure:
    """Linear model whose matrices are functions of named parameters.

    Attributes
    ----------
    name : str
    states, inputs, outputs : tuple of str
    units : tuple of str
        Units of the outputs.
    parameters : tuple of ModelParameter
    make_state_space_matrices : callable
        Function from ``{symbol: value}`` to ``(A, B, C, D, delay)``; ``delay`` (s) has one entry per input.
    """

    name: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    units: tuple[str, ...]
    parameters: tuple[ModelParameter, ...]
    make_state_space_matrices: Callable[[Mapping[str, float]], tuple[Array, Array, Array, Array, Array]] = field(
        repr=False
    )

    @property
    def symbols(self) -> tuple[str, ...]:
        """Symbols of the parameters, in the order of ``parameters``."""
        return tuple(p.symbol for p in self.parameters)

    def state_space_matrices(self, values: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Return A, B, C, D and the delays (s) at the values (p,) of the parameters."""
        return self.make_state_space_matrices(dict(zip(self.symbols, values.tolist(), strict=True)))


_TYPICAL_RATE_PER_ANGLE_1_S = 3.0  # 1/s: assumed size of an unmeasured rate over the size of its angle
_INTEGRAL_OF_SIGNAL = {"p": "phi", "q": "theta", "phi": "v", "theta": "u"}


def scale_gains_to_record(structure: LinearStructure, u: Array, y: Array) -> LinearStructure:
    """Return a structure whose start gains and bounds are scaled to the signals of a record.

    In ``x' = a x + k z`` with rates ``|a|`` below about 60 1/s and signals of standard deviation ``s_x``, ``s_z``, the
    ratio ``k s_z / s_x`` is not far above 60 1/s for any unit of ``z`` (share of stick travel, share of motor voltage,
    microseconds). Bounds of this ratio hold for every vehicle and log; bounds in 1/s^2 do not.

    Parameters
    ----------
    structure : LinearStructure
    u, y : (n, inputs), (n, outputs) array
        Inputs and outputs; NaN without a measurement.
    """
    size = dict(zip(structure.inputs, np.nanstd(u, axis=0).tolist(), strict=True))
    size |= dict(zip(structure.outputs, np.nanstd(y, axis=0).tolist(), strict=True))

    def estimate_signal_size(name: str) -> float:
        if name in size:
            return size[name]
        inner = _INTEGRAL_OF_SIGNAL.get(name)
        if inner is None:
            return 0.0
        return _TYPICAL_RATE_PER_ANGLE_1_S * estimate_signal_size(inner) / (GRAVITY if inner in "uv" else 1.0)

    parameters = []
    for p in structure.parameters:
        row, column = (estimate_signal_size(name) if name else 1.0 for name in p.driven_and_driving)
        factor = row / column if row > 0.0 and column > 0.0 else 1.0
        start, low, high = (factor * v for v in (p.start_value, p.low, p.high))
        parameters.append(ModelParameter(p.symbol, p.unit, start, low, high, p.meaning))
    return replace(structure, parameters=tuple(parameters))


class SearchCoordinates:
    """Search coordinates of parameters: the logarithm of positive parameters; other parameters divided by their scale.

    Attributes
    ----------
    low, high, linear_scale : (p,) array
        Bounds, and scale of linear parameters: the size of the value, or a fiftieth of the bounds' distance.
    is_logarithmic : (p,) array of bool
        Whether the coordinate is the logarithm of the parameter.
    """

    def __init__(self, parameters: Sequence[ModelParameter], values: Array) -> None:
        self.low, self.high = (np.array([getattr(p, side) for p in parameters]) for side in ("low", "high"))
        self.is_logarithmic = self.low > 0.0
        self.linear_scale = np.maximum(np.abs(values), 0.02 * (self.high - self.low))

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds of the search coordinates."""
        return self.to_search_coordinates(self.low), self.to_search_coordinates(self.high)

    def to_search_coordinates(self, values: Array) -> Array:
        """Return the search coordinates of parameter values (p,)."""
        return np.where(
            self.is_logarithmic,
            np.log(np.where(self.is_logarithmic, values, 1.0)),
            values / self.linear_scale,
        )

    def to_values(self, z: Array) -> Array:
        """Return the parameter values (p,), clipped to their bounds, at search coordinates ``z``."""
        values = np.where(self.is_logarithmic, np.exp(np.where(self.is_logarithmic, z, 0.0)), z * self.linear_scale)
        return np.clip(values, self.low, self.high)

    def value_derivatives(self, z: Array) -> Array:
        """Return the derivatives (p,) of the parameter values with respect to the search coordinates."""
        return np.where(self.is_logarithmic, self.to_values(z), self.linear_scale)


class StructureBuilder:
    """Builder of a linear structure: collects its states, parameters and matrix entries.

    An entry is a matrix, a row, a column, and a function that computes its value from the parameters.
    """

    def __init__(self, inputs: tuple[str, ...]) -> None:
        self.inputs = inputs
        self.states: list[str] = []
        self.parameters: dict[str, ModelParameter] = {}
        self.matrix_entries: list[tuple[str, str, str, Callable[[Mapping[str, float]], float]]] = []

    def add_parameter(
        self, symbol: str, unit: str, start: float, low: float, high: float, meaning: str,
        between: tuple[str, str] = ("", ""),
    ) -> None:  # fmt: skip
        self.parameters.setdefault(symbol, ModelParameter(symbol, unit, start, low, high, meaning, between))

    def add_constant_entry(self, row: str, column: str, value: float) -> None:
        self.matrix_entries.append(("A", row, column, lambda _: value))

    def add_free_entry(
        self, row: str, column: str, symbol: str, unit: str, start: float, bound: float | tuple[float, float],
        meaning: str, over: str = "",
    ) -> None:  # fmt: skip
        """Add an entry of A, or of B if ``column`` is an input, that equals a free parameter.

        With ``over``, the entry is the free parameter divided by the parameter of that name.
        """
        low, high = bound if isinstance(bound, tuple) else (-bound, bound)
        source, state = column.removesuffix("_f"), {"a": "q", "b": "p"}.get(row, row)
        gain = source in self.inputs or (source in ("u", "v") and row in ("p", "q"))
        self.add_parameter(symbol, unit, start, low, high, meaning, (state, source) if gain else ("", ""))
        matrix = "B" if column in self.inputs else "A"
        self.matrix_entries.append((matrix, row, column, lambda v: v[symbol] / v[over] if over else v[symbol]))

    def add_negative_inverse_entry(self, row: str, symbol: str) -> None:
        self.matrix_entries.append(("A", row, row, lambda v: -1.0 / v[symbol]))

    def build_structure(self, name: str, outputs: tuple[str, ...], driven: set[str], skew: float) -> LinearStructure:
        # A lagged stick drives its own state; the delay belongs to the stick.
        for i in self.inputs:
            if i in driven:
                self.add_parameter(f"tau_{i}", "s", 0.04, -skew, _MAX_INPUT_DELAY_S, f"delay of {i}")
        row = {s: k for k, s in enumerate(self.states)}
        column = {s: k for k, s in enumerate(self.inputs)}
        nx, nu, ny = len(row), len(column), len(outputs)
        c = np.zeros((ny, nx))
        c[np.arange(ny), [row[o] for o in outputs]] = 1.0
        places = [
            (m == "A", row[r], row[c_] if m == "A" else column[c_], value) for m, r, c_, value in self.matrix_entries
        ]

        def make_state_space_matrices(v: Mapping[str, float]) -> tuple[Array, Array, Array, Array, Array]:
            a, b = np.zeros((nx, nx)), np.zeros((nx, nu))
            for in_a, i, j, value in places:
                (a if in_a else b)[i, j] += value(v)
            delay = np.array([v.get(f"tau_{i}", 0.0) for i in self.inputs])
            return a, b, c, np.zeros((ny, nu)), delay

        return LinearStructure(
            name, tuple(self.states), self.inputs, outputs, tuple(SIGNAL_UNITS[o] for o in outputs),
            tuple(self.parameters.values()), make_state_space_matrices,
        )  # fmt: skip


ANGULAR_RESPONSE_MODELS = ("first-order", "second-order", "hybrid")
MODEL_EXTRAS = ("coupled", "collective", "gyro", "speed", "skew")
_MAX_OUTPUT_SKEW_S = 0.3
_MAX_INPUT_DELAY_S = 0.3  # largest delay of an input
_STICK_OF_RATE = {"p": "lat", "q": "lon"}
_FLAPPING_OF_RATE = {"p": "b", "q": "a"}
_MOMENT_LETTER = {"p": "L", "q": "M"}


def build_helicopter_structure(
    inputs: tuple[str, ...], outputs: tuple[str, ...], *, angular: str = "hybrid", coupled: bool = False,
    collective: bool = False, gyro: bool = False, speed: bool = False, skew_s: float = 0.0,
) -> LinearStructure:  # fmt: skip
    """Build the structure of a helicopter's linear model.

    Parameters
    ----------
    inputs : tuple of str
        Some of lat, lon, ped, col; constant inputs should be omitted.
    outputs : tuple of str
        Some of p, q, r, phi, theta, u, v, w; they decide which blocks are used.
    angular : str
        Block of roll and pitch: one of ``ANGULAR_RESPONSE_MODELS``.
    coupled : bool
        Whether to add coupling terms between roll and pitch.
    collective : bool
        Whether collective acts on roll and pitch.
    gyro : bool
        Whether to add the feedback r_fb of the yaw gyro.
    speed : bool
        Whether to add speed stability L_v, M_u (needs u, v among the outputs).
    skew_s : float
        Largest time by which an input may act earlier than recorded (s), for logs with late time stamps of inputs.

    Raises
    ------
    InputError
        If a name is unknown, or the block cannot be built.
    """
    _check_signals(inputs, outputs, angular)
    b = StructureBuilder(inputs)
    roll, pitch = bool({"p", "phi", "v"} & set(outputs)), bool({"q", "theta", "u"} & set(outputs))
    b.states = (["p"] if roll else []) + (["q"] if pitch else [])
    sticks = [i for i in ("lat", "lon") if i in inputs]
    rates = tuple(b.states)
    if angular == "hybrid":
        b.states += [_FLAPPING_OF_RATE[r] for r in rates]
    if angular == "second-order":
        b.states += [f"{s}_f" for s in sticks]
        for s in sticks:
            b.add_parameter(f"tau_s_{s}", "s", 0.15, 0.02, 2.0, f"lag of the {s} command")
            b.add_negative_inverse_entry(f"{s}_f", f"tau_s_{s}")
            b.matrix_entries.append(("B", f"{s}_f", s, lambda v, s=s: 1.0 / v[f"tau_s_{s}"]))  # type: ignore[misc]
    for r in rates:
        _add_rate_dynamics(b, r, rates, sticks, angular, coupled)
        if collective and "col" in inputs:
            b.add_free_entry(r, "col", f"{_MOMENT_LETTER[r]}_col", "1/s^2", 0.0, 200.0, f"collective into {r}")
        _add_stick_inputs(b, r, rates, sticks, angular, coupled)
    _add_attitude_and_translation(b, rates, outputs, angular, speed)
    if "r" in outputs:
        _add_yaw_dynamics(b, inputs, rates, coupled, gyro)
    if "w" in outputs:
        b.states.append("w")
        b.add_free_entry("w", "w", "Z_w", "1/s", -0.5, (-20.0, 0.0), "heave damping")
        if "col" in inputs:
            b.add_free_entry("w", "col", "Z_col", "m/s^2", -10.0, 300.0, "collective into heave")
    extras = zip(MODEL_EXTRAS, (coupled, collective, gyro, speed, skew_s > 0.0), strict=True)
    name = "-".join([angular, *(word for word, wanted in extras if wanted)])
    return b.build_structure(name, outputs, {e[2] for e in b.matrix_entries if e[0] == "B"}, skew_s)


def _add_rate_dynamics(
    b: StructureBuilder, r: str, rates: tuple[str, ...], sticks: Sequence[str], angular: str, coupled: bool
) -> None:
    """Add the dynamics of the rate ``r`` ("p" or "q") to the structure.

    They are flapping if ``angular`` is "hybrid", else damping.
    """
    big, flap, other = _MOMENT_LETTER[r], _FLAPPING_OF_RATE[r], "q" if r == "p" else "p"
    if angular != "hybrid":
        b.add_free_entry(r, r, f"{big}_{r}", "1/s", -3.0, (-60.0, 0.0), f"damping, {r}")
        if coupled and other in rates:
            b.add_free_entry(r, other, f"{big}_{other}", "1/s", 0.0, 30.0, f"coupling of {other} into {r}")
        return
    b.add_free_entry(r, flap, f"{big}_{flap}", "1/s^2", 60.0, (0.5, 2000.0), f"flapping spring, {r}")
    b.add_constant_entry(flap, r, -1.0)
    b.add_parameter("tau_f", "s", 0.1, 0.01, 3.0, "time constant of flapping")
    b.add_negative_inverse_entry(flap, "tau_f")
    for s in sticks:
        if s == _STICK_OF_RATE[r] or coupled:
            symbol, start = f"{flap.upper()}_{s}", 0.5 if s == _STICK_OF_RATE[r] else 0.0
            b.add_free_entry(flap, s, symbol, "rad", start, 20.0, f"flapping command, {s}", over="tau_f")


def _add_stick_inputs(
    b: StructureBuilder, r: str, rates: tuple[str, ...], sticks: Sequence[str], angular: str, coupled: bool
) -> None:
    """Add to the structure the moments with which the sticks drive the rate ``r`` ("p" or "q").

    If ``angular`` is "hybrid", the sticks act on flapping instead, and the entries, if ``coupled``, couple both axes.
    """
    big, flap, other = _MOMENT_LETTER[r], _FLAPPING_OF_RATE[r], _FLAPPING_OF_RATE["q" if r == "p" else "p"]
    if angular != "hybrid":
        for s in sticks:
            if s == _STICK_OF_RATE[r] or coupled:
                column = f"{s}_f" if angular == "second-order" else s
                start = 3.0 if s == _STICK_OF_RATE[r] else 0.0
                b.add_free_entry(r, column, f"{big}_{s}", "1/s^2", start, 200.0, f"{s} into {r}")
    elif coupled and len(rates) == 2:
        b.add_free_entry(r, other, f"{big}_{other}", "1/s^2", 0.0, 1000.0, f"cross spring, {r}")
        b.add_free_entry(flap, other, f"{flap.upper()}_{other}", "1", 0.0, 20.0, "cross flapping", over="tau_f")


def build_structure_by_name(name: str, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> LinearStructure:
    """Build the structure with a name such as ``"first-order-coupled"`` or ``"helicopter"``.

    The name is one of ``ANGULAR_RESPONSE_MODELS``, followed by any of ``MODEL_EXTRAS``; ``"helicopter"`` stands for
    ``"hybrid-coupled-gyro"``, Mettler's structure. With ``skew`` inputs may act up to 0.3 s earlier than recorded.

    Raises
    ------
    InputError
        If the name is unknown.
    """
    text = "hybrid-coupled-gyro" if name == "helicopter" else name
    base = next((a for a in ANGULAR_RESPONSE_MODELS if text == a or text.startswith(a + "-")), None)
    words = text[len(base) :].strip("-").split("-") if base is not None else []
    words = [w for w in words if w]
    if base is None or not set(words) <= set(MODEL_EXTRAS):
        raise ArgumentError(
            "model", "", f"{name!r} is unknown",
            f"use auto, helicopter, or {', '.join(ANGULAR_RESPONSE_MODELS)} followed by any of "
            f"-{', -'.join(MODEL_EXTRAS)}",
        )  # fmt: skip
    return build_helicopter_structure(
        inputs, outputs, angular=base, coupled="coupled" in words, collective="collective" in words,
        gyro="gyro" in words, speed="speed" in words, skew_s=_MAX_OUTPUT_SKEW_S if "skew" in words else 0.0,
    )  # fmt: skip


def _add_attitude_and_translation(
    b: StructureBuilder, rates: tuple[str, ...], outputs: tuple[str, ...], angular: str, speed: bool
) -> None:
    for r in rates:
        angle, vel, symbol, g = ("phi", "v", "Y", GRAVITY) if r == "p" else ("theta", "u", "X", -GRAVITY)
        if {angle, vel} & set(outputs):
            b.states.append(angle)
            b.add_constant_entry(angle, r, 1.0)
        if vel in outputs:
            b.states.append(vel)
            b.add_free_entry(vel, vel, f"{symbol}_{vel}", "1/s", -0.2, (-10.0, 0.0), f"drag, {vel}")
            b.add_constant_entry(vel, angle, g)
            if angular == "hybrid":
                b.add_constant_entry(vel, _FLAPPING_OF_RATE[r], g)
            if speed:
                b.add_free_entry(r, vel, f"{_MOMENT_LETTER[r]}_{vel}", "rad/(m s)", 0.0, 60.0, "speed stability")


def _add_yaw_dynamics(
    b: StructureBuilder, inputs: tuple[str, ...], rates: tuple[str, ...], coupled: bool, gyro: bool
) -> None:
    b.states.append("r")
    b.add_free_entry("r", "r", "N_r", "1/s", -1.0, (-60.0, 0.0), "yaw damping")
    if "ped" in inputs:
        b.add_free_entry("r", "ped", "N_ped", "1/s^2", 10.0, 500.0, "pedal into yaw")
    if "col" in inputs:
        b.add_free_entry("r", "col", "N_col", "1/s^2", 0.0, 200.0, "collective into yaw")
    for r in rates if coupled else ():
        b.add_free_entry("r", r, f"N_{r}", "1/s", 0.0, 30.0, f"coupling of {r} into yaw")
    if gyro:
        # Only the product of Mettler's N_ped and K_r is identifiable from r; the state is scaled so that K_r is 1.
        b.states.append("r_fb")
        b.add_constant_entry("r_fb", "r", 1.0)
        b.add_parameter("K_rfb", "1/s", 3.0, 0.02, 60.0, "gyro, washout")
        b.matrix_entries.append(("A", "r_fb", "r_fb", lambda v: -v["K_rfb"]))
        b.add_parameter("N_fb", "1/s^2", 10.0, 1e-3, 500.0, "gyro's feedback into yaw")
        b.matrix_entries.append(("A", "r", "r_fb", lambda v: -v["N_fb"]))


def _check_signals(inputs: tuple[str, ...], outputs: tuple[str, ...], angular: str) -> None:
    for what, names, known, example in (
        ("input", inputs, ("lat", "lon", "ped", "col"), "lat"),
        ("output", outputs, tuple(SIGNAL_UNITS), "p"),
    ):
        for name in names:
            if name not in known:
                raise ArgumentError(
                    f"{what}s", name, f"is no {what} of the helicopter model",
                    f"use {', '.join(known)}; write {example}=COLUMN to select its column",
                )  # fmt: skip
    if angular not in ANGULAR_RESPONSE_MODELS:
        raise ArgumentError("model", "", f"{angular!r} is unknown", f"use one of: {', '.join(ANGULAR_RESPONSE_MODELS)}")
    if not outputs or not inputs:
        raise ArgumentError("outputs", "", "a model needs inputs and outputs", "name at least one of each")


def discretise_first_order_hold(a: Array, b: Array, dt: float, *, hold: bool = False) -> tuple[Array, Array, Array]:
    """Discretise x' = a x + b u; return Phi, G_1, G_2 of x_(k+1) = Phi x_k + G_1 u_k + G_2 u'_k.

    u' is the slope of the inputs; ``G_2`` is zero for a zero-order hold (``hold``).

    Raises
    ------
    FloatingPointError
        If an unstable model overflows within one sample.
    """
    n, k = b.shape
    block = np.zeros((n + 2 * k, n + 2 * k))
    block[:n, :n], block[:n, n : n + k], block[n : n + k, n + k :] = a, b, np.eye(k)
    e = expm(block * dt)
    if not np.isfinite(e).all():
        raise FloatingPointError("the model overflows within one sample")
    g2 = np.zeros((n, k)) if hold else e[:n, n + k :]
    return e[:n, :n], e[:n, n : n + k], g2


def delay_inputs(u: Array, delay_s: Array, dt: float, *, hold: bool = False) -> Array:
    """Return the inputs (n, k) delayed by ``delay_s`` (k,); before the record they equal their first value."""
    if hold:
        shift = np.rint(delay_s / dt).astype(int)
        index = np.maximum(np.arange(len(u))[:, None] - shift[None, :], 0)
        return np.take_along_axis(u, index, axis=0)
    t = dt * np.arange(len(u))
    columns = [np.interp(t - delay_s[j], t, u[:, j]) for j in range(u.shape[1])]
    return np.column_stack(columns)


@cached_njit
def _propagate_states(phi: Array, drive: Array, x0: Array) -> Array:  # pragma: no cover (compiled)
    n, nx = drive.shape[0] + 1, phi.shape[0]
    x = np.empty((n, nx))
    x[0] = x0
    for k in range(n - 1):
        for i in range(nx):
            total = drive[k, i]
            for j in range(nx):
                total += phi[i, j] * x[k, j]
            x[k + 1, i] = total
    return x


@cached_njit
def _propagate_outputs(phi: Array, c: Array, first: Array, constant: Array, n: int) -> Array:  # pragma: no cover
    """Return y = c x, (n, ny, m), of m sequences x_(k+1) = phi x_k + ``constant`` that begin at ``first`` (nx, m)."""
    ny, nx, m = c.shape[0], phi.shape[0], first.shape[1]
    y = np.empty((n, ny, m))
    x, new = first.copy(), np.empty((nx, m))
    for k in range(n):
        for o in range(ny):
            for l in range(m):
                total = 0.0
                for i in range(nx):
                    total += c[o, i] * x[i, l]
                y[k, o, l] = total
        for i in range(nx):
            for l in range(m):
                total = constant[i, l]
                for j in range(nx):
                    total += phi[i, j] * x[j, l]
                new[i, l] = total
        x, new = new, x
    return y


def simulate_linear_structure(
    structure: LinearStructure,
    values: Array,
    u: Array,
    dt: float,
    *,
    x0: Array | None = None,
    hold: bool = False,
) -> tuple[Array, Array]:
    """Simulate a structure from inputs and an initial state; return its outputs and states.

    Parameters
    ----------
    structure : LinearStructure
    values : (p,) array
        Parameters of the structure (SI).
    u : (n, inputs) array
        Inputs as deviations from trim.
    dt : float
        Sample time (s).
    x0 : (states,) array, optional
        Initial state; zero by default.
    hold : bool
        Whether inputs are constant between samples; linear by default.

    Returns
    -------
    y : (n, outputs) array
        Outputs, in their units.
    x : (n, states) array
        States (SI).
    """
    a, b, c, d, delay = structure.state_space_matrices(values)
    phi, g1, g2 = discretise_first_order_hold(a, b, dt, hold=hold)
    ud = delay_inputs(u, delay, dt, hold=hold)
    drive = ud[:-1] @ g1.T + np.diff(ud, axis=0) @ g2.T / dt
    x = _propagate_states(phi, np.ascontiguousarray(drive), np.zeros(len(a)) if x0 is None else x0)
    return x @ c.T + ud @ d.T, x


def compute_start_and_bias_responses(structure: LinearStructure, values: Array, n: int, dt: float) -> Array:
    """Return the output response to one unit of each initial state, input trim and output bias.

    Returns
    -------
    (n, outputs, states + inputs + outputs) array
    """
    a, b, c, d, _ = structure.state_space_matrices(values)
    phi, g1, _ = discretise_first_order_hold(a, b, dt)
    nx, nu, ny = len(a), b.shape[1], len(c)
    first = np.hstack([np.eye(nx), np.zeros((nx, nu))])
    constant = np.hstack([np.zeros((nx, nx)), -g1])
    moved = _propagate_outputs(phi, np.ascontiguousarray(c), first, constant, n)
    moved[:, :, nx:] -= d
    return np.concatenate([moved, np.broadcast_to(np.eye(ny), (n, ny, ny))], axis=2)
