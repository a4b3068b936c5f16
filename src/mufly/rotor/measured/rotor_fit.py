"""Fit of a rotor to a bench run: its likeliest sections, and the changes of their coefficients.

The sections are the least known part of a blade (docs/accuracy.md), so they are estimated from a bench run. For each
candidate section the coefficients of its polar become

    c_l = c_l0 exp(l + a x + a_2 y)      c_d = c_d0 exp(b x + b_2 y) + (exp(d) - 1) c_d0(Re_m)      theta = theta_0 + p

with x = log(Re / Re_m) and y = x^2 / (1 + x^2 / 4), a curvature near Re_m that flattens far from it, where no point
holds it. The added drag is the same at every Reynolds number: roughness, layer steps of prints, blunt edges and
separation cause pressure drag, which hardly depends on it (Hoerner, Fluid-Dynamic Drag, 1965, ch. V). c_d stays above
0.3 c_d0. Re_m is the geometric mean of the measured points' Reynolds numbers at 0.75 R; the ratio is limited to 0.2 to
5. ``p`` includes zero-lift angle, pitch setting and twist, which a bench cannot separate. ``l`` and ``d`` also absorb
errors of the method. With prior deviations s the seven parameters are found by least squares,

    chi^2 = sum ((T - T_m) / (0.02 T_s))^2 + sum ((Q - Q_m) / (0.03 Q_s))^2 + sum (z / s)^2

z are p, a, b, a_2, b_2 and the changes of l and d beyond those that keep thrust and torque at the geometric mean of the
measured speeds, as a, b, a_2, b_2 change (to first order, in hover). So points at one speed say nothing of the law over
the Reynolds number, and points at several speeds turn and bend it about their middle.

T_s, Q_s are the measured T_m, Q_m in hover. In axial flight, where thrust vanishes at some airspeed, they are at least
0.3 of the greatest measured load, scaled by the square of the rotor speed, because the error of a balance is a fraction
of its range. Tunnel runs separate angle and lift, because induced velocity is small where thrust vanishes: the advance
ratio without thrust gives the pitch, the one without torque (windmilling) pitch and drag together. A single point of
either kind is used (:func:`add_zero_load_points`); T_s and Q_s are then shares of the predicted loads in hover.

Points at the same pitch, speed and airspeed repeat one error of the method: m copies count as one point together.

Each fit is repeated with one, two and four times the prior deviations, equally likely (Jeffreys' prior of a scale),
because some blades differ from every candidate by more than the priors allow. The curvature H gives the covariance
H^-1, times chi^2 of the points over their degrees of freedom if that exceeds 1 (Birge, Phys. Rev. 40, 207, 1932). The
probability of a section and width follows from Laplace's approximation (MacKay, Neural Computation 4, 415, 1992): its
prior times exp(-chi^2 / 2) / sqrt(det H).

The priors are not fitted to measurements. Pitch: :mod:`mufly.rotor.effective_pitch`. Camber, which moves the zero-lift
angle by 2 rad per chord (thin airfoil, parabola): 0.3 % of the chord for a known section, 0.6 % between candidates.
Lift: 4 % (polar engines, docs/log/2026-11-28-polars.md) and 5 % (method). Drag: 8 % and 8 %. Exponents and curvatures:
0.05 and 0.2. Priors of guessed sections: :mod:`mufly.rotor.blades.blade_families`. Hub cut-out and transition have the
same effects as lift, drag and their exponents, and are not fitted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from mufly.errors import InputError, MuflyError
from mufly.results import (
    ResultColumn,
    ShownBlock,
    make_lines_block,
    make_table_block,
    result,
    select_fields,
    tabulate_results,
)
from mufly.rotor.bemt import solve_rotor_batch
from mufly.rotor.blades.blade_families import (
    GRID_ROUNDING_STD_RATIOS,
    ZERO_LIFT_RAD_PER_CAMBER_RATIO,
    find_family_priors,
    list_section_probabilities,
)
from mufly.rotor.blading import Blading, Corrections, apply_section_fit, compute_rotor_polars, prepare_blading
from mufly.rotor.effective_pitch import estimate_pitch_offset_prior
from mufly.rotor.geometry import FIT_CHANGE_LIMITS, Rotor, SectionCandidate, SectionFit, replace_rotor
from mufly.rotor.measured.bench_comparison import RotorMeasurements, reject_supersonic_points
from mufly.rotor.rotor_system import Air
from mufly.rotor.sections.polar_engines import PolarEngine
from mufly.rotor.sections.polar_table import PolarTable, stack_polars

Array = NDArray[np.float64]

FIT_PARAMETER_NAMES = (
    "pitch",
    "lift",
    "drag",
    "lift over Re",
    "drag over Re",
    "lift curvature over Re",
    "drag curvature over Re",
)
_THRUST_SCATTER_FRACTION, _TORQUE_SCATTER_FRACTION = (
    0.02,
    0.03,
)  # scatter of the method's error from point to point, relative
_PRIOR_WIDTH_FACTORS = (1.0, 2.0, 4.0)  # factors on the prior deviations
_MIN_AXIAL_LOAD_SCALE_FRACTION = 0.3  # least T_s and Q_s in axial flight, of the greatest load
_DERIVATIVE_STEP = 1e-3  # step of derivatives, in prior deviations
_MIN_CANDIDATE_PROBABILITY = 0.01  # candidates below this probability are left out of the file
_UNINFORMED_STD_RATIO, _MIN_REPORTED_CORRELATION = 0.8, 0.9


@result(eq=False)
class RotorFit:
    """Result of a fit to a bench run.

    Attributes
    ----------
    rotor : Rotor
        Fitted rotor.
    change, std, prior_std : (7,) arrays
        Estimate, posterior and prior deviation of :data:`FIT_PARAMETER_NAMES` (rad, logarithms, exponents), likeliest
        section.
    correlation : (7, 7) array
        Posterior correlation of these parameters.
    undecided : tuple of str
        Parameters that the bench run does not determine.
    measured : RotorMeasurements
    scaled_errors_before, scaled_errors_after : (2, n) arrays
        Errors of thrust and torque over ``load_scales``, without and with the fit.
    load_scales : (2, n) array
        T_s (N) and Q_s (N m) of the module docstring.
    held_out : (2,) array
        Mean absolute error of thrust and torque at held-out points; nan if there are too few.
    held_out_note : str
        Description of the held-out points.
    air : Air
        Air of the measurement.
    """

    rotor: Rotor
    change: Array
    std: Array
    prior_std: Array
    correlation: Array
    undecided: tuple[str, ...]
    measured: RotorMeasurements
    scaled_errors_before: Array
    scaled_errors_after: Array
    load_scales: Array
    held_out: Array
    held_out_note: str
    air: Air

    @property
    def section_fit(self) -> SectionFit:
        """Fit as stored in the rotor file."""
        assert self.rotor.fit is not None
        return self.rotor.fit

    def as_record(self) -> dict[str, Any]:
        """Return parameters, sections, and errors without and with the fit."""
        return {
            "rotor": self.rotor.name, "measurements": self.measured.source, "names": FIT_PARAMETER_NAMES,
            **select_fields(self, "change std prior_std correlation undecided"),
            "sections": [{"airfoils": name, "probability": share} for name, share in self.section_fit.list_sections()],
            **select_fields(self, "error_before=scaled_errors_before error_after=scaled_errors_after"),
            **select_fields(self, "held_out_error=held_out held_out=held_out_note notes=measured.notes"),
        }  # fmt: skip

    def make_printed_blocks(self) -> tuple[ShownBlock, ...]:
        """Return sections, parameters and errors as printed text."""
        sizes = ((math.degrees(1.0), "°"), (100.0, " %"), (100.0, " %"), *[(1.0, "")] * 4)
        parameters = [
            (name, f"{size * x:+.3g} ± {size * std:.2g}{unit}", f"± {size * prior:.2g}{unit}")
            for name, (size, unit), x, std, prior in zip(
                FIT_PARAMETER_NAMES, sizes, self.change, self.std, self.prior_std, strict=True
            )
        ]
        errors = {
            "as given": self.scaled_errors_before, "fitted": self.scaled_errors_after,
            self.held_out_note: self.held_out,
        }  # fmt: skip
        means = [[_mean_absolute(load) for load in both] for both in errors.values()]
        loads = [ResultColumn("0", "%", ".1f", head="thrust"), ResultColumn("1", "%", ".1f", head="torque")]
        count, source = self.measured.thrust_N.size, self.measured.source
        return (
            make_lines_block(f" fitted to {count} point(s) of {source}", head=self.rotor.name),
            make_table_block(
                ("section", "probability"), [(name, f"{share:.0%}") for name, share in self.section_fit.list_sections()]
            ),
            make_table_block(("correction of the first", "estimate", "prior std"), parameters),
            make_lines_block(*self.undecided, style="dim"),
            tabulate_results(means, loads, title="mean absolute error", names=[*errors]),
        )


def _mean_absolute(errors: Array | float) -> float:
    known = np.abs(np.atleast_1d(errors))
    known = known[np.isfinite(known)]
    return float(known.mean()) if known.size else math.nan


@dataclass(frozen=True)
class _BenchPoints:
    """Measured points, prepared for the fit."""

    pitch_rad: Array
    speed_rad_s: Array
    climb_m_s: Array
    measured_loads: Array  # (2, n) thrust, torque
    load_scales: Array  # (2, n) T_s, Q_s
    air: Air
    reynolds: float


@dataclass(frozen=True)
class _FittedSection:
    """Fit of a single candidate section."""

    log_evidence: float
    airfoils: tuple[str, ...]
    change: Array
    covariance: Array
    scaled_errors: Array  # (2, n)
    degrees_of_freedom: float
    prior_std: Array


def fit_rotor(
    rotor: Rotor,
    measurements: RotorMeasurements,
    *,
    section: Literal["guessed", "known"] = "guessed",
    family: str = "",
    air: Air | None = None,
    n_crit: float = 0.1,
    engine: PolarEngine = "neuralfoil",
    corrections: Corrections | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> RotorFit:
    """Estimate the sections of a rotor from measured points, at least one; a sweep is more informative.

    Parameters
    ----------
    rotor : Rotor
        Rotor with prior geometry and airfoils; a fit that it already contains is ignored.
    measurements : RotorMeasurements
        Measured points in hover or in axial flow, as in a wind tunnel.
    section : 'guessed' or 'known'
        Whether the airfoils of the rotor file are a guess among other candidates, or known.
    family : str
        Family of a guessed section, if known: one of :data:`mufly.rotor.blades.blade_families.BLADE_FAMILY_PRIORS`.
    air, n_crit, engine, corrections
        As for :func:`mufly.rotor.prepare_blading` and :func:`mufly.rotor.solve_rotor`.
    progress : callable, optional
        ``progress(done, total)`` after each section.

    Raises
    ------
    InputError
        If ``section`` is invalid, or no point has thrust.
    MuflyError
        If no section agrees with the measurements.
    """
    if section not in ("guessed", "known"):
        raise InputError("fit", "section", f"{section!r} is unknown", "use 'guessed' or 'known'")
    thrust = measurements.thrust_N
    # Points without thrust say something in an airstream only; negative thrust alone is a sign taken the wrong way.
    if not np.any(thrust > 0.0) and (np.any(thrust < 0.0) or not measurements.has_axial_flow):
        raise InputError(measurements.source, "thrust", "is nowhere above 0", "give points with thrust")
    plain = rotor.model_copy(update={"fit": None})
    gas = air or measurements.air
    reject_supersonic_points(rotor.radius_m, measurements, gas)
    fixes = corrections or Corrections()
    n = measurements.thrust_N.size
    chord = float(rotor.chord_m(0.75))
    wind = np.hypot(0.75 * rotor.radius_m * measurements.speed_rad_s, measurements.climb_m_s)
    re = chord * wind * gas.density_kg_m3 / gas.viscosity_Pa_s
    load = np.stack((measurements.thrust_N, measurements.torque_Nm))
    hover = np.zeros((2, 0))
    if measurements.has_axial_flow:
        still = prepare_blading(plain, n_crit=n_crit, engine=engine, corrections=fixes)
        out = solve_rotor_batch(still, pitch_rad=measurements.pitch_rad, speed_rad_s=measurements.speed_rad_s, air=gas)
        hover = np.stack((out.thrust_N, out.torque_Nm))
    bench = _BenchPoints(
        measurements.pitch_rad,
        measurements.speed_rad_s,
        measurements.climb_m_s,
        load,
        _compute_load_scales(measurements, load, hover),
        gas,
        float(np.exp(np.mean(np.log(re)))),
    )
    listed = list_section_probabilities(plain, family) if section == "guessed" else [(plain.blade.airfoils, 1.0)]
    families = find_family_priors(plain, family) if section == "guessed" or family else ()
    wide = _prior_deviations(estimate_pitch_offset_prior(plain, families).offset_std_rad, known=section == "known")
    ones = [replace_rotor(plain, {"blade.airfoils": airfoils}) for airfoils, _ in listed]
    every = {name for one in ones for name in one.airfoil_names()}
    tables = compute_rotor_polars(plain, every, n_crit=n_crit, engine=engine)
    prepared = []
    for done, (one, (airfoils, share)) in enumerate(zip(ones, listed, strict=True)):
        if progress is not None:
            progress(done, len(listed))
        prepared.append((airfoils, share, prepare_blading(one, tables, corrections=fixes)))

    def fit_subset(index: NDArray[np.intp]) -> list[_FittedSection]:
        return _fit_sections(prepared, tables, wide, _select_points(bench, index))

    everything = fit_subset(np.arange(n))
    seen, note = _select_training_points(bench)
    held = np.full(2, math.nan)
    if seen.size:
        unseen = np.setdiff1d(np.arange(n), seen)
        best = fit_subset(seen)[0]
        blading = next(b for a, _, b in prepared if a == best.airfoils)
        errors = _compute_scaled_errors(blading, tables, best.change, _select_points(bench, unseen, bench.reynolds))
        known = np.isfinite(errors)
        held = np.array([np.mean(np.abs(e[k])) if k.any() else math.nan for e, k in zip(errors, known, strict=True)])
    if progress is not None:
        progress(len(listed), len(listed))
    best = everything[0]
    before = _compute_scaled_errors(
        prepare_blading(plain, n_crit=n_crit, engine=engine, corrections=fixes),
        tables,
        np.zeros(len(FIT_PARAMETER_NAMES)),
        bench,
    )
    sigma = np.sqrt(np.diag(best.covariance))
    correlation = best.covariance / np.outer(sigma, sigma)
    weights = _section_probabilities(everything)
    kept = [(f, w) for f, w in zip(everything, weights, strict=True) if w >= _MIN_CANDIDATE_PROBABILITY]
    total = sum(w for _, w in kept)
    fit = SectionFit(
        bench=measurements.source,
        points=n,
        n_crit=plain.transition_at_n_crit(n_crit).n_crit,
        reynolds=bench.reynolds,
        pitch_rad=(float(bench.pitch_rad.min()), float(bench.pitch_rad.max())),
        speed_rad_s=(float(bench.speed_rad_s.min()), float(bench.speed_rad_s.max())),
        climb_ratio=_value_range(bench.climb_m_s / (rotor.radius_m * bench.speed_rad_s)),
        scatter=_estimate_scatter(best, 1.0 / _count_similar_points(bench)),
        candidates=tuple(
            SectionCandidate(
                airfoils=f.airfoils, probability=w / total, change=tuple(f.change.tolist()),
                covariance=tuple(tuple(row) for row in f.covariance.tolist()),
            )
            for f, w in kept
        ),
    )  # fmt: skip
    fitted_rotor = replace_rotor(plain, {"blade.airfoils": best.airfoils}).model_copy(update={"fit": fit})
    return RotorFit(
        fitted_rotor, best.change, sigma, best.prior_std, correlation,
        _describe_undetermined_parameters(sigma / best.prior_std, correlation, weights, everything),
        measurements, before, best.scaled_errors, bench.load_scales, held, note, gas,
    )  # fmt: skip


def _prior_deviations(pitch_std_rad: float, known: bool) -> Array:
    """Return the prior standard deviations of :data:`FIT_PARAMETER_NAMES`."""
    camber = 0.003 if known else GRID_ROUNDING_STD_RATIOS[0]
    pitch = math.hypot(pitch_std_rad, ZERO_LIFT_RAD_PER_CAMBER_RATIO * camber)
    return np.array([pitch, math.hypot(0.04, 0.05), math.hypot(0.08, 0.08), 0.05, 0.2, 0.05, 0.2])


def _select_points(bench: _BenchPoints, index: NDArray[np.intp], reynolds: float | None = None) -> _BenchPoints:
    return _BenchPoints(
        bench.pitch_rad[index],
        bench.speed_rad_s[index],
        bench.climb_m_s[index],
        bench.measured_loads[:, index],
        bench.load_scales[:, index],
        bench.air,
        reynolds or bench.reynolds,
    )


def _value_range(values: Array) -> tuple[float, float]:
    return float(values.min()), float(values.max())


def add_zero_load_points(
    measurements: RotorMeasurements,
    radius_m: float,
    *,
    zero_thrust: float | None = None,
    zero_torque: float | None = None,
) -> RotorMeasurements:
    """Return measurements with added points of zero thrust or zero torque, as known from a wind tunnel.

    Parameters
    ----------
    measurements : RotorMeasurements
        Their geometric mean speed and mean pitch are those of the points.
    radius_m : float
    zero_thrust, zero_torque : float, optional
        Advance ratio V / (n D) without thrust, and without torque (windmilling).

    Raises
    ------
    InputError
        If an advance ratio is not between 0 and 5.
    """
    m = measurements
    speed = float(np.exp(np.mean(np.log(m.speed_rad_s))))
    for name, ratio in (("zero thrust", zero_thrust), ("zero torque", zero_torque)):
        if ratio is None:
            continue
        if not 0.0 < ratio < 5.0:
            raise InputError("fit", name, f"is an advance ratio of {ratio:g}", "give V / (n D), between 0 and 5")
        thrust, torque = (0.0, math.nan) if name == "zero thrust" else (math.nan, 0.0)
        m = replace(
            m,
            pitch_rad=np.append(m.pitch_rad, float(np.mean(m.pitch_rad))),
            speed_rad_s=np.append(m.speed_rad_s, speed),
            thrust_N=np.append(m.thrust_N, thrust),
            torque_Nm=np.append(m.torque_Nm, torque),
            climb_m_s=np.append(m.climb_m_s, ratio * speed * radius_m / math.pi),
        )
    return m


def _find_similar_points(bench: _BenchPoints) -> NDArray[np.bool_]:
    """Return for each point which points have nearly its pitch, speed and airspeed, itself included, (n, n).

    Nearly means within 0.1 degrees, 1 % and 1 %, and with the same loads measured.
    """
    pitch, climb = bench.pitch_rad, bench.climb_m_s
    speed, known = np.log(bench.speed_rad_s), np.isfinite(bench.measured_loads)
    return np.asarray(
        (np.abs(pitch[:, None] - pitch) < math.radians(0.1))
        & (np.abs(speed[:, None] - speed) < 0.01)
        & (np.abs(climb[:, None] - climb) <= 0.01 * np.maximum(np.abs(climb[:, None]), np.abs(climb)))
        & (known[:, :, None] == known[:, None, :]).all(axis=0)
    )


def _count_similar_points(bench: _BenchPoints) -> Array:
    """Return for each point the number of points similar to it (:func:`_find_similar_points`), (n,)."""
    return np.asarray(_find_similar_points(bench).sum(axis=1), dtype=np.float64)


def _compute_load_scales(measurements: RotorMeasurements, load: Array, hover: Array) -> Array:
    """Return the scales T_s (N) and Q_s (N m) by which errors are divided (module docstring), (2, n).

    ``hover``: loads predicted without airspeed.
    """
    square = np.square(measurements.speed_rad_s)
    greatest = np.nanmax(np.where(np.isfinite(load), np.abs(load) / square, 0.0), axis=1)
    if hover.size:
        greatest = np.where(greatest > 0.0, greatest, np.max(np.abs(hover) / square, axis=1))
    least = np.where(measurements.climb_m_s != 0.0, _MIN_AXIAL_LOAD_SCALE_FRACTION * greatest[:, None] * square, 0.0)
    return np.asarray(np.maximum(np.abs(load), least), dtype=np.float64)


def _select_training_points(bench: _BenchPoints) -> tuple[NDArray[np.intp], str]:
    """Return the indices of the bench points for a trial fit, which is tested at the others, and a description.

    Copies of a point (:func:`_find_similar_points`) stay on one side. The trial fit has a point with thrust.
    """
    near, taken = _find_similar_points(bench), np.zeros(bench.speed_rad_s.size, dtype=bool)
    groups: list[NDArray[np.intp]] = []
    for first in np.lexsort((bench.climb_m_s, bench.speed_rad_s)):
        if not taken[first]:
            groups.append(np.flatnonzero(near[first] & ~taken))
            taken |= near[first]
    if len(groups) < 2:
        return np.array([], dtype=np.intp), "one point alone cannot be checked on another"
    with_thrust = [k for k, group in enumerate(groups) if np.nan_to_num(bench.measured_loads[0, group]).any()]
    if len(groups) < 4:
        middle = min(with_thrust, key=lambda k: abs(k - len(groups) // 2), default=len(groups) // 2)
        return groups[middle], "fitted to one point, checked on the others"
    even = {k % 2 for k in with_thrust} == {1}
    return (
        np.sort(np.concatenate(groups[1 if even else 0 :: 2])),
        "fitted to every second point, checked on the points between",
    )


def _apply_fit_changes(blading: Blading, tables: Mapping[str, PolarTable], change: Array, reynolds: float) -> Blading:
    """Return the blading with the changes of a fit to its polars and twist.

    It equals that of :func:`mufly.rotor.prepare_blading`, but is made faster.
    """
    names = blading.rotors[0].airfoil_names()
    polars = stack_polars([apply_section_fit(tables[name], change.tolist(), reynolds) for name in names])
    return replace(blading, polars=polars, twist_rad=blading.twist_rad + change[0])


def _compute_scaled_errors(
    blading: Blading, tables: Mapping[str, PolarTable], change: Array, bench: _BenchPoints
) -> Array:
    """Return the errors of predicted thrust and torque, divided by ``bench.load_scales``, (2, n)."""
    changed = _apply_fit_changes(blading, tables, change, bench.reynolds) if change.any() else blading
    out = solve_rotor_batch(
        changed,
        pitch_rad=bench.pitch_rad,
        speed_rad_s=bench.speed_rad_s,
        climb_m_s=bench.climb_m_s,
        air=bench.air,
    )
    return np.asarray(
        (np.stack((out.thrust_N, out.torque_Nm)) - bench.measured_loads) / bench.load_scales, dtype=np.float64
    )


def _find_load_keeping_changes(
    blading: Blading, tables: Mapping[str, PolarTable], bench: _BenchPoints, about: Array | None
) -> Array:
    """Return the changes of :data:`FIT_PARAMETER_NAMES` by each unknown z of the module docstring, (7, 7).

    Column k holds one unit of unknown k, and the changes of lift and drag that keep thrust and torque in hover at the
    geometric mean speed while the law over the Reynolds number changes. Slopes are taken at the pitch, lift and drag of
    ``about``, a change found before.
    """
    n = len(FIT_PARAMETER_NAMES)
    pitch, speed = float(np.mean(bench.pitch_rad)), float(np.exp(np.mean(np.log(bench.speed_rad_s))))
    middle = np.zeros(n)
    if about is not None:
        middle[:3] = about[:3]

    def solve_middle_loads(change: Array) -> Array:
        changed = _apply_fit_changes(blading, tables, change, bench.reynolds)
        out = solve_rotor_batch(changed, pitch_rad=pitch, speed_rad_s=speed, air=bench.air)
        return np.array([float(out.thrust_N), float(out.torque_Nm)])

    plain = solve_middle_loads(middle)
    slopes = np.stack([solve_middle_loads(middle + step) - plain for step in 0.01 * np.eye(n)], axis=1)
    slopes /= np.maximum(np.abs(slopes).max(axis=1, keepdims=True), np.finfo(float).tiny)
    turned = np.eye(n)
    # A rotor without lift in the middle cannot keep its thrust by lift: singular directions stay as they are.
    turned[1:3, 3:] = -np.linalg.pinv(slopes[:, 1:3], rcond=1e-3) @ slopes[:, 3:]
    return turned


def _fit_sections(
    prepared: Sequence[tuple[tuple[str, ...], float, Blading]],
    tables: Mapping[str, PolarTable],
    wide: Array,
    bench: _BenchPoints,
) -> list[_FittedSection]:
    """Fit the rotor with each candidate section; return the fits, the likeliest first."""
    size = np.outer((_THRUST_SCATTER_FRACTION, _TORQUE_SCATTER_FRACTION), np.sqrt(_count_similar_points(bench))).ravel()
    known = np.isfinite(bench.measured_loads.ravel())
    found = []
    for airfoils, share, blading in prepared:
        ended: Array | None = None
        for factor in _PRIOR_WIDTH_FACTORS:
            change_per_z = factor * _find_load_keeping_changes(blading, tables, bench, ended) * wide

            def weighted_residuals(z: Array, blading: Blading = blading, change_per_z: Array = change_per_z) -> Array:
                off = _compute_scaled_errors(blading, tables, change_per_z @ z, bench).ravel() / size
                return np.concatenate((off[known], z))

            def residual_jacobian(z: Array, miss: Callable[[Array], Array] = weighted_residuals) -> Array:
                # SciPy's steps are relative to z: near z = 0 they are smaller than the solver's tolerance.
                here = miss(z)
                return np.stack(
                    [(miss(z + step) - here) / _DERIVATIVE_STEP for step in _DERIVATIVE_STEP * np.eye(wide.size)],
                    axis=1,
                )

            start: Array = np.zeros(wide.size)
            if not np.isfinite(weighted_residuals(start)).all():
                continue
            solved = least_squares(weighted_residuals, start, jac=residual_jacobian, max_nfev=100)
            # Near stall there may be two minima, and rounding differences between processors decide which one is found;
            # therefore the fit also starts from the solution with the previous width.
            if ended is not None:
                start = np.asarray(np.linalg.solve(change_per_z, ended), dtype=np.float64)
                again = least_squares(weighted_residuals, start, jac=residual_jacobian, max_nfev=100)
                solved = again if again.cost < solved.cost else solved
            ended = change_per_z @ solved.x
            if np.any(np.abs(ended) > FIT_CHANGE_LIMITS):  # the rotor file would refuse them
                continue
            jacobian = np.asarray(solved.jac, dtype=np.float64)
            curvature, data = jacobian.T @ jacobian, jacobian[: -wide.size]
            inverse = np.linalg.inv(curvature)
            several = np.broadcast_to(1.0 / _count_similar_points(bench), bench.measured_loads.shape).ravel()
            freedom = float(several[known].sum() - np.trace(inverse @ data.T @ data))
            chi2 = float(np.sum(solved.fun[: -wide.size] ** 2))
            birge = max(1.0, chi2 / freedom) if freedom > 0.5 else 1.0
            evidence = (
                math.log(share / len(_PRIOR_WIDTH_FACTORS)) - solved.cost - 0.5 * float(np.linalg.slogdet(curvature)[1])
            )
            found.append(
                _FittedSection(
                    evidence, airfoils, ended, birge * change_per_z @ inverse @ change_per_z.T,
                    _compute_scaled_errors(blading, tables, ended, bench), freedom,
                    np.sqrt(np.sum(change_per_z**2, axis=1)),
                )
            )  # fmt: skip
    found.sort(key=lambda f: -f.log_evidence)
    if not found or not _mean_absolute(found[0].scaled_errors[0]) < 0.25:
        raise MuflyError(
            "no section with plausible corrections predicts the measured thrust within 25 %; check units, pitch, "
            "radius, number of blades and the direction of the twist"
        )
    return found


def _section_probabilities(found: Sequence[_FittedSection]) -> Array:
    evidence = np.array([f.log_evidence for f in found])
    weights = np.exp(evidence - evidence.max())
    return np.asarray(weights / weights.sum(), dtype=np.float64)


def _estimate_scatter(best: _FittedSection, weights: Array) -> tuple[float, float]:
    """Return the scatter of single points about the fit, of scaled thrust and torque errors, from its residuals.

    ``weights`` (n,): share of each point in those similar to it, so that copies count as one.
    """
    known = np.isfinite(best.scaled_errors)
    used = float((known * weights).sum())
    grow = math.sqrt(used / max(best.degrees_of_freedom, 1.0)) if used > 5.0 else 1.0
    out = []
    for errors, least in zip(best.scaled_errors, (_THRUST_SCATTER_FRACTION, _TORQUE_SCATTER_FRACTION), strict=True):
        one = np.isfinite(errors)
        rms = math.sqrt(np.average(errors[one] ** 2, weights=weights[one])) if one.any() else 0.0
        out.append(max(least, grow * rms))
    return out[0], out[1]


def _describe_undetermined_parameters(
    shrunk: Array, correlation: Array, weights: Array, found: Sequence[_FittedSection]
) -> tuple[str, ...]:
    words = [
        f"the bench data hardly determine {name}"
        for name, s in zip(FIT_PARAMETER_NAMES, shrunk.tolist(), strict=True)
        if s > _UNINFORMED_STD_RATIO
    ]
    words += [
        f"{FIT_PARAMETER_NAMES[i]} and {FIT_PARAMETER_NAMES[j]} cannot be separated (correlation "
        f"{correlation[i, j]:+.2f})"
        for i in range(len(FIT_PARAMETER_NAMES))
        for j in range(i + 1, len(FIT_PARAMETER_NAMES))
        if abs(correlation[i, j]) > _MIN_REPORTED_CORRELATION
    ]
    shares: dict[str, float] = {}
    for f, weight in zip(found, weights.tolist(), strict=True):
        name = "/".join(dict.fromkeys(f.airfoils))
        shares[name] = shares.get(name, 0.0) + weight
    if max(shares.values()) < 0.5:
        several = ", ".join(sorted(shares, key=lambda name: -shares[name])[:4])
        words.append(f"sections that fit equally well: {several}")
    return tuple(words)
