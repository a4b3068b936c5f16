"""Equation-error model of a vehicle: equations of all outputs, fitted to records and validated on others.

Each output's derivative is regressed separately (:mod:`mufly.identify.linear.equation_error`). Predictions validate
the equations together: one sample ahead, 0.2 s ahead from the measured state, and from the inputs alone over the whole
record (fourth-order Runge-Kutta, inputs linear between samples). A one-step fit near 100 % proves little, because
persistence of the last value is nearly as good; its score is reported for comparison. A failed simulation of an
unstable vehicle, or of one under feedback, also proves little, because every error grows.

Trims differ between flights and drift within a flight. A record is therefore simulated twice. The first simulation
uses the trim of the fitted records. The second, in the band of the equations, uses trim and initial state fitted to the
record, which is the usual check of the dynamics in the time domain (Tischler and Remple, ch. 14).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace

import numpy as np
from numpy.typing import NDArray

from mufly.errors import ArgumentError, InputError
from mufly.identify.fit_result import (
    FitResult,
    ParameterEstimate,
    RecordPrediction,
    compute_relative_covariance,
    correlation_matrix,
    describe_undetermined_combinations,
)
from mufly.identify.flight_record import UniformLogTable, low_pass
from mufly.identify.linear.equation_error import (
    REGRESSION_DOMAINS,
    DerivativeEquation,
    RegressionRecord,
    apply_actuator,
    candidate_terms,
    coefficient_symbol,
    find_coherent_band,
    fit_derivative_equation,
)
from mufly.identify.linear.linear_structure import SIGNAL_UNITS
from mufly.identify.residual_analysis import assess_prediction
from mufly.results import result

Array = NDArray[np.float64]
_PREDICTION_HORIZON_S = 0.2
_DIVERGENCE_RATIO = 1e6  # ratio to the size of a signal above which a simulation counts as diverged


@result
class EquationScore:
    """Prediction scores of one output of one record, in per cent (100 is exact, 0 is the mean).

    All scores but ``simulated`` exclude frequencies below the equations' bands.

    Attributes
    ----------
    record, role, output : str
    derivative : float
        Fit of the equation to the derivative in its band.
    one_step, last_value : float
        Prediction one sample ahead, as recorded; and persistence of the last value.
    ahead, last_value_ahead : float
        Prediction 0.2 s ahead from the measured state, low-passed; and persistence of the last value.
    simulated : float
        Simulation from inputs alone over the whole record, with the fitted records' trim, low-passed.
    in_band : float
        Simulation in the band with trim and initial state fitted to the record, which tests the dynamics only.
    """

    record: str
    role: str
    output: str
    derivative: float
    one_step: float
    last_value: float
    ahead: float
    last_value_ahead: float
    simulated: float
    in_band: float


@result(eq=False, json="equations poles_rad_s=poles scores notes domain")
class EquationModel:
    """Model made of the equations of all outputs, with its scores.

    Attributes
    ----------
    inputs, outputs : tuple of str
    equations : tuple of DerivativeEquation
    domain : str
    cut_hz : float
    scores : tuple of EquationScore
    simulated : tuple of (n, outputs) array
        Simulation of every record from inputs alone with the fitted trim.
    records : tuple of RegressionRecord
    notes : tuple of str
    """

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    equations: tuple[DerivativeEquation, ...]
    domain: str
    cut_hz: float
    records: tuple[RegressionRecord, ...]
    scores: tuple[EquationScore, ...] = ()
    simulated: tuple[Array, ...] = field(default=(), repr=False)
    notes: tuple[str, ...] = ()

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Return the eigenvalues (1/s) of the matrix of the outputs' linear coefficients, slowest first."""
        n = len(self.outputs)
        a = np.zeros((n, n))
        for i, e in enumerate(self.equations):
            for term, v in zip(e.terms, e.value.tolist(), strict=True):
                if len(term) == 1 and term[0] in self.outputs:
                    a[i, self.outputs.index(term[0])] = v
        found = np.linalg.eigvals(a)
        return np.asarray(found[np.argsort(np.abs(found))], dtype=np.complex128)


def simulate_equations(
    model: EquationModel, u: Array, dt: float, first: Array, bias: Array, *,
    starts: NDArray[np.int_] | None = None, steps: int = 0,
) -> Array:  # fmt: skip
    """Simulate the outputs of an equation model from inputs and first values.

    Parameters
    ----------
    model : EquationModel
    u : (n, inputs) array
        Inputs, in the unit of the fitted records.
    dt : float
        Sample time (s).
    first : (b, outputs) array
        Initial outputs of ``b`` simultaneous simulations.
    bias : (b, outputs) array
        Biases of the derivatives.
    starts : (b,) array of int, optional
        First sample of each simulation; by default sample 0.
    steps : int
        Number of steps; by default to the end of the record.

    Returns
    -------
    (steps + 1, b, outputs) array
        Simulated outputs; not finite after divergence.
    """
    begin: NDArray[np.int_] = np.zeros(len(first), dtype=int) if starts is None else starts
    count = steps or len(u) - 1
    names = model.outputs
    late = [apply_actuator(u, e.lag_s, e.delay_s, dt) for e in model.equations]
    plans = []
    for e in model.equations:
        terms = []
        for term, v in zip(e.terms, e.value.tolist(), strict=True):
            inner = [names.index(t) for t in term if t in names]
            outer = [model.inputs.index(t) for t in term if t not in names]
            terms.append((v, inner, outer))
        plans.append(terms)
    # The contribution of the inputs alone is computed in advance, at the samples and between them.
    drive = np.zeros((len(u), len(names)))
    for i, terms in enumerate(plans):
        for v, inner, outer in terms:
            if not inner:
                drive[:, i] += v * np.prod(late[i][:, outer], axis=1)
    live = [[(v, inner, outer) for v, inner, outer in terms if inner] for terms in plans]

    def state_derivative(x: Array, at: NDArray[np.int_], share: float) -> Array:
        nearby = np.minimum(at + 1, len(u) - 1)
        out = bias + (1.0 - share) * drive[at] + share * drive[nearby]
        for i, terms in enumerate(live):
            for v, inner, outer in terms:
                part = v * x[:, inner[0]]
                for j in inner[1:]:
                    part = part * x[:, j]
                for j in outer:
                    part = part * ((1.0 - share) * late[i][at, j] + share * late[i][nearby, j])
                out[:, i] += part
        return out

    x = np.array(first, dtype=np.float64)
    path = np.empty((count + 1, *x.shape))
    path[0] = x
    with np.errstate(all="ignore"):
        for k in range(count):
            at = begin + k
            s1 = state_derivative(x, at, 0.0)
            s2 = state_derivative(x + 0.5 * dt * s1, at, 0.5)
            s3 = state_derivative(x + 0.5 * dt * s2, at, 0.5)
            s4 = state_derivative(x + dt * s3, at, 1.0)
            x = x + dt / 6.0 * (s1 + 2.0 * s2 + 2.0 * s3 + s4)
            x = np.where(np.abs(x) < _DIVERGENCE_RATIO, x, np.nan)
            path[k + 1] = x
    return path


def identify_equation_model(
    records: Sequence[UniformLogTable], inputs: Mapping[str, str], outputs: Mapping[str, str], *,
    held_out: Sequence[UniformLogTable] = (), products: bool = False, without: Sequence[str] = (),
    domain: str = "frequency", cut_hz: float = 5.0, low_hz: float | None = None,
    most_s: float = 0.2, all_terms: bool = False, progress: Callable[[int, int], None] | None = None,
) -> EquationModel:  # fmt: skip
    """Fit the equations of all outputs to one or several records, and score them on the fitted and on held-out
    records.

    Parameters
    ----------
    records, held_out : sequence of UniformLogTable
        Records to fit, and records that are only predicted.
    inputs, outputs : dict
        Model name -> column, as for :func:`mufly.identify.identify_linear_model`.
    products : bool
        Whether products of two rates are candidates, too.
    without : sequence of str
        Symbols of excluded terms, ``"L_p"``.
    domain : {"time", "frequency"}
    cut_hz : float
        Highest frequency of the band.
    low_hz : float, optional
        Lowest frequency of the band; by default each output gets the band in which the inputs explain it.
    most_s : float
        Upper end of the range of lag and delay of the inputs (s); 0 for neither.
    all_terms : bool
        Use all candidates instead of stepwise choice.
    progress : callable, optional
        Called with (steps done, steps).

    Raises
    ------
    InputError
        If columns are missing, signals are constant, or a record is too short or sampled too slowly for ``cut_hz``.
    """
    if domain not in REGRESSION_DOMAINS:
        raise ArgumentError("domain", "", f"{domain!r} is unknown", f"use one of: {', '.join(REGRESSION_DOMAINS)}")
    outs, names = tuple(outputs), tuple(inputs)
    for o in outs:
        if o not in SIGNAL_UNITS:
            raise ArgumentError("outputs", o, "is not an output of a linear model", f"use {', '.join(SIGNAL_UNITS)}")
    flown, notes = [], []
    for role, several in (("fit", records), ("held out", held_out)):
        for r in several:
            if cut_hz >= 0.45 / r.dt:
                raise ArgumentError(
                    "cut_hz", "", f"{cut_hz:g} Hz is too high for {r.name}, sampled at {1.0 / r.dt:.4g} Hz",
                    f"give less than {0.45 / r.dt:.3g} Hz",
                )  # fmt: skip
            if len(r.time_s) * r.dt < 10.0 / cut_hz:
                raise InputError(
                    r.name, "", f"lasts {len(r.time_s) * r.dt:.3g} s", f"give at least {10.0 / cut_hz:.3g} s"
                )
            y, u = r.stack_columns(outputs, "outputs"), r.stack_columns(inputs, "inputs")
            flown.append(RegressionRecord(f"{r.name}, {r.time_s[0]:.1f} to {r.time_s[-1]:.1f} s", role, r.time_s, y, u))
            notes += [f"{r.name}: {n}" for n in r.column_notes(inputs, outputs)]
    fitted = np.concatenate([f.inputs - f.inputs.mean(0) for f in flown if f.role == "fit"])
    moving = fitted.std(axis=0) > 1e-9 * np.maximum(1.0, np.abs(fitted).max(axis=0))
    for name, moves in zip(names, moving, strict=True):
        if not moves:
            notes.append(
                f"{name} never moved in the fitted records and was omitted: the data hold no information about it"
            )
    if not moving.any():
        raise ArgumentError("inputs", ",".join(names), "never move in the fitted part", "use another part or record")
    names = tuple(n for n, moves in zip(names, moving, strict=True) if moves)
    flown = [replace(f, inputs=f.inputs[:, moving]) for f in flown]
    terms = candidate_terms(names, outs, products=products)
    known = {coefficient_symbol(o, t): (o, t) for o in outs for t in terms}
    for symbol in without:
        if symbol not in known:
            raise ArgumentError("without", symbol, "is not a candidate", f"the candidates are {', '.join(known)}")
    steps, found = len(outs) + len(flown), []
    for k, o in enumerate(outs):
        pool = [t for t in terms if coefficient_symbol(o, t) not in without]
        band = find_coherent_band(flown, k, cut_hz) if low_hz is None else (low_hz, cut_hz)
        found.append(
            fit_derivative_equation(
                flown,
                o,
                outs,
                names,
                pool,
                domain=domain,
                low_hz=band[0],
                cut_hz=band[1],
                most_s=most_s,
                fixed=all_terms,
            )
        )
        if progress is not None:
            progress(k + 1, steps)
    model = EquationModel(names, outs, tuple(found), domain, cut_hz, tuple(flown), notes=tuple(notes))
    fastest = float(model.poles.real.max())
    if fastest > 0.0:
        own = [
            s
            for e in found
            for t, s, v in zip(e.terms, e.coefficient_symbols, e.value, strict=True)
            if t == (e.output,) and v > 0
        ]
        remedy = f"; compare --without {','.join(own)}" if own else ""
        notes.append(
            f"the equations together are unstable (pole at {fastest:+.2g} 1/s) and cannot be simulated for long: "
            "either the vehicle is unstable, or a feedback that rejects disturbances has inverted the sign "
            f"of a damping{remedy}"
        )
        model = replace(model, notes=tuple(notes))
    scores, simulated = [], []
    for k, f in enumerate(flown):
        some, path = _score_record(model, f)
        scores += some
        simulated.append(path)
        if progress is not None:
            progress(len(outs) + k + 1, steps)
    return replace(model, scores=tuple(scores), simulated=tuple(simulated))


def _score_record(model: EquationModel, f: RegressionRecord) -> tuple[list[EquationScore], Array]:
    dt, n, names = f.dt, len(f.time_s), model.outputs
    low = max(e.band_hz[0] for e in model.equations)
    cut = max(e.band_hz[1] for e in model.equations)
    smooth = low_pass(f.outputs, dt, cut)
    fitted = [r.name for r in model.records if r.role == "fit"]
    place = fitted.index(f.name) if f.role == "fit" else None
    bias = np.array([e.bias.mean() if place is None else e.bias[place] for e in model.equations])

    inner = replace(f, outputs=_band_pass(f.outputs, dt, low), inputs=_band_pass(f.inputs, dt, low))
    trim = np.zeros(len(names)) if low else bias  # band-pass filtering removes the trim

    def simulate_steps_from_starts(first: Array, starts: NDArray[np.int_], steps: int) -> Array:
        many = np.tile(trim, (len(starts), 1))
        return simulate_equations(model, inner.inputs, dt, first[starts], many, starts=starts, steps=steps)[-1]

    every, steps = np.arange(n - 1), min(max(1, round(_PREDICTION_HORIZON_S / dt)), n // 2)
    some, slow = np.arange(0, n - steps, max(1, n // 600)), low_pass(inner.outputs, dt, cut)
    # Score of the equation: one step from the low-passed state against the low-passed change.
    told, true = (simulate_steps_from_starts(slow, every, 1) - slow[:-1]) / dt, np.diff(slow, axis=0) / dt
    one, far = simulate_steps_from_starts(inner.outputs, every, 1), simulate_steps_from_starts(slow, some, steps)
    whole = simulate_equations(model, f.inputs, dt, smooth[:1], bias[None, :])[:, 0]
    tame = whole if not np.isfinite(whole).all() else low_pass(whole, dt, cut)
    own = _simulate_with_own_trim(model, replace(inner, outputs=slow), trim)
    edge = min(round(1.0 / ((low or cut) * dt)), n // 5)
    kept = slice(edge, n - edge)
    scores = []
    for k, (o, e) in enumerate(zip(names, model.equations, strict=True)):
        pair = _band_pass(np.column_stack([true[:, k], told[:, k]]), dt, *e.band_hz)[kept]
        scores.append(
            EquationScore(
                f.name, f.role, o,
                _fit_percent(pair[:, 0], pair[:, 1]),
                _fit_percent(inner.outputs[1:, k], one[:, k]),
                _fit_percent(inner.outputs[1:, k], inner.outputs[:-1, k]),
                _fit_percent(slow[some + steps, k], far[:, k]),
                _fit_percent(slow[some + steps, k], slow[some, k]),
                _fit_percent(smooth[:, k], tame[:, k]),
                _fit_percent(slow[kept, k], own[kept, k]),
            )
        )  # fmt: skip
    return scores, whole


def _band_pass(signal: Array, dt: float, low: float, cut: float | None = None) -> Array:
    """Return a signal (n, k) without content below ``low`` and above ``cut`` (Hz)."""
    smooth = signal if cut is None else low_pass(signal, dt, cut)
    return smooth - low_pass(smooth, dt, low) if low > 0.0 else smooth


def _fit_percent(measured: Array, predicted: Array) -> float:
    """Return the fit in per cent; minus infinity for a diverged simulation."""
    return assess_prediction(measured, predicted).fit_percent if np.isfinite(predicted).all() else float("-inf")


def _simulate_with_own_trim(model: EquationModel, f: RegressionRecord, bias: Array) -> Array:
    """Simulate a record with trim and initial state that one Gauss-Newton step (two if nonlinear) fits to it."""
    m, first = len(model.outputs), f.outputs[0].copy()
    size = f.outputs.std(axis=0)
    path = simulate_equations(model, f.inputs, f.dt, first[None, :], bias[None, :])[:, 0]
    for _ in range(2):
        h = 1e-3 * np.where(size > 0.0, size, 1.0)
        starts = np.concatenate([first + np.diag(h), np.tile(first, (m, 1))])
        trims = np.concatenate([np.tile(bias, (m, 1)), bias + np.diag(h)])
        moved = simulate_equations(model, f.inputs, f.dt, starts, trims)
        if not (np.isfinite(moved).all() and np.isfinite(path).all()):
            return path
        slopes = (moved - path[:, None, :]) / np.r_[h, h][None, :, None] / np.where(size > 0.0, size, 1.0)
        rows = slopes.transpose(0, 2, 1).reshape(-1, 2 * m)
        missed = ((f.outputs - path) / np.where(size > 0.0, size, 1.0)).ravel()
        change = np.linalg.lstsq(rows, missed, rcond=1e-10)[0]
        first, bias = first + change[:m], bias + change[m:]
        path = simulate_equations(model, f.inputs, f.dt, first[None, :], bias[None, :])[:, 0]
        if not any(len(t) > 1 for e in model.equations for t in e.terms):
            break
    return path


def equation_fit_result(model: EquationModel) -> FitResult:
    """Return an equation model as a fit result, whose predictions are simulated from the inputs alone."""
    estimates, symbols, blocks = [], [], []
    for e in model.equations:
        symbols += list(e.coefficient_symbols)
        blocks.append(e.covariance)
        for symbol, unit, value, std in zip(
            e.coefficient_symbols, e.coefficient_units, e.value.tolist(), e.std.tolist(), strict=True
        ):
            estimates.append(ParameterEstimate.from_std(symbol, "", unit, float("nan"), value, std, quantile=1.96))
    size = sum(len(b) for b in blocks)
    covariance = np.zeros((size, size))
    at = 0
    for b in blocks:
        covariance[at : at + len(b), at : at + len(b)] = b
        at += len(b)
    values = np.array([e.value for e in estimates])
    records = tuple(
        RecordPrediction(
            f.name,
            "fit" if f.role == "fit" else "held out",
            f.time_s,
            model.outputs,
            tuple(SIGNAL_UNITS[o] for o in model.outputs),
            f.outputs,
            path,
            np.full(len(model.outputs), np.nan),
            f.inputs,
            model.inputs,
        )
        for f, path in zip(model.records, model.simulated, strict=True)
    )
    words = f"equation error, {model.domain} domain, stepwise, up to {model.cut_hz:g} Hz"
    return FitResult(
        "equation error", tuple(estimates), covariance, correlation_matrix(covariance),
        describe_undetermined_combinations(symbols, compute_relative_covariance(covariance, values)),
        float(np.mean([1.0 - e.R2 for e in model.equations])), (), words, len(records), 0.0, True,
        "regression: no search", records,
    )  # fmt: skip


ReportTable = tuple[tuple[str, ...], tuple[tuple[str, ...], ...]]


def equation_table(model: EquationModel) -> ReportTable:
    """Return header and rows of the equations' terms, with lag and delay of the inputs."""
    rows = []
    for e in model.equations:
        low, high = e.band_hz
        about = (f"{e.output}'", f"{low:.2g} to {high:.2g}", f"{100.0 * e.R2:.0f} %")
        for k, (symbol, unit) in enumerate(zip(e.coefficient_symbols, e.coefficient_units, strict=True)):
            numbers = (f"{e.value[k]:.4g}", f"{e.std[k]:.2g}", f"{e.std_white[k]:.2g}")
            rows.append((*(about if k == 0 else ("", "", "")), symbol, *numbers, unit))
        if not e.terms:
            rows.append((*about, "no term", "", "", "", ""))
        if any(set(t) & set(model.inputs) for t in e.terms):
            for name, value, std in (("lag", e.lag_s, e.lag_std_s), ("delay", e.delay_s, e.delay_std_s)):
                rows.append(("", "", "", name, f"{value:.3g}", "held" if np.isnan(std) else f"{std:.2g}", "", "s"))
    return ("equation", "band (Hz)", "explained", "term", "value", "std", "std if white", "unit"), tuple(rows)


def tabulate_term_selection(model: EquationModel) -> ReportTable:
    """Return header and rows of the stepwise choice of terms."""
    rows = [
        (f"{e.output}'", s.term, f"{s.F:.1f}", f"{e.F_in:.1f}", f"{100 * s.R2:.1f} %", f"{s.PSE:.3f}")
        for e in model.equations for s in e.steps
    ]  # fmt: skip
    return ("equation", "term", "F", "F to come in", "explained", "predicted square error"), tuple(rows)


def score_table(model: EquationModel) -> ReportTable:
    """Return header and rows of the prediction scores, in per cent."""

    def format_percent(value: float) -> str:
        return "diverges" if np.isneginf(value) else "< -999" if value < -999.0 else f"{value:.1f}"

    place = {f.name: k + 1 for k, f in enumerate(model.records)}
    rows = []
    for s in model.scores:
        numbers = (
            s.derivative,
            s.one_step,
            s.last_value,
            s.ahead,
            s.last_value_ahead,
            s.in_band,
            s.simulated,
        )
        rows.append((f"{place[s.record]}, {s.role}", s.output, *map(format_percent, numbers)))
    ahead = f"{_PREDICTION_HORIZON_S:g} s"
    heads = ("record", "output", "slope", "1 step", "(last)", ahead, "(last)", "in band", "whole")
    return heads, tuple(rows)


SCORES_EXPLANATION = (
    "Fits: 100 is exact, 0 the mean. Slope: of the derivative, by the equation itself. One step: a sample ahead of the "
    "measured state, beside what keeping the last value reaches; likewise for 0.2 s. In band: simulated "
    "from inputs alone "
    "over the record, with its own trim; all these without what lies below the equations' band. Whole: "
    "simulated with "
    "the fitted records' trim, without filter."
)
