"""A bench run makes a rotor: which section fits, and what has to change in its coefficients; how sure a prediction is.

The sections of a blade are the least known part of it (docs/validation.md), so a run on a bench is asked for them. For
each section that is possible the coefficients of its polar become

    c_l = c_l0 (Re / Re_m)^a exp(l)        c_d = c_d0 (Re / Re_m)^b exp(d)        theta = theta_0 + p

Re_m is the geometric mean of the measured points' Reynolds numbers at 0.75 R, the ratio is kept within 0.2 and 5; ``p``
stands for the zero-lift angle, the pitch setting and the twist, which no hover can tell apart; ``l`` and ``d`` also
for what the method itself gets wrong. With prior deviations s the five are found by least squares,

    chi^2 = sum ((T / T_m - 1) / 0.02)^2 + sum ((Q / Q_m - 1) / 0.03)^2 + sum (x / s)^2

whose curvature H gives their covariance H^-1, times chi^2 of the points over their degrees of freedom where that is
more than 1 (Birge, Phys. Rev. 40, 207, 1932). How probable a section is follows from Laplace's approximation (MacKay,
Neural Computation 4, 415, 1992): its prior times exp(-chi^2 / 2) / sqrt(det H).

Priors, none of them fitted to a measurement: the pitch setting 0.5 degrees, and a section's camber, which moves the
zero-lift angle by 2 rad a chord (thin airfoil, parabola): 0.3 % of the chord for a section that is known, 0.6 %
between those of the list. Lift 4 % (engines of polars, docs/polars.md) and 5 % (method); drag 8 % and 8 %; exponents
0.05 and 0.2. Sections whose camber is guessed: 4 +- 2.5 %, with any thickness of the list; the rotor file's own has a
third of the probability. Hub cut-out and transition do to thrust and torque what lift, drag and their exponents do as
well, and are left as they are.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from mufly.errors import InputError, MuflyError
from mufly.results import result
from mufly.rotor.bemt import hover_batch
from mufly.rotor.blading import Blading, Corrections, fitted, prepare
from mufly.rotor.geometry import Candidate, Rotor, SectionFit, replace_rotor
from mufly.rotor.measurements import Measurements
from mufly.rotor.sections import engines
from mufly.rotor.sections.engines import Engine
from mufly.rotor.sections.polar_table import PolarTable, stack_polars
from mufly.rotor.system import Air

Array = NDArray[np.float64]

CHANGES = ("pitch", "lift", "drag", "lift over Re", "drag over Re")
_SIGMA_THRUST, _SIGMA_TORQUE = 0.02, 0.03  # what a method misses of one point and not of the next
_ZERO_LIFT_PER_CAMBER = 2.0  # rad per chord: thin-airfoil theory, parabolic camber line
_DRAG_PER_THICKNESS = 2.0  # skin friction of a section of thickness t: 1 + 2 t
_CAMBER, _THICKNESS = (0, 2, 4, 6, 8), (3, 6, 9, 12)  # % of the chord
_OWN = 1.0 / 3.0
_KEPT = 0.01  # candidates below this probability are left out of the file
_SAYS_LITTLE, _TOGETHER = 0.8, 0.9


@result(eq=False)
class RotorFit:
    """What a bench run says about a rotor.

    Attributes
    ----------
    rotor : Rotor
        The rotor with it.
    change, std, prior_std : (5,) arrays
        Of the likeliest section: :data:`CHANGES` (rad, logarithms, exponents).
    correlation : (5, 5) array
    undecided : tuple of str
        What the bench cannot tell, in words.
    measured : Measurements
    before, after : (2, n) arrays
        Thrust and torque over measured ones less one: of the rotor as it was given, and of the fit.
    held_out : (2,) array
        Mean size of that error at points that a fit did not see; nan where there are too few.
    held_out_note : str
        Which points these were.
    """

    rotor: Rotor
    change: Array
    std: Array
    prior_std: Array
    correlation: Array
    undecided: tuple[str, ...]
    measured: Measurements
    before: Array
    after: Array
    held_out: Array
    held_out_note: str

    @property
    def fit(self) -> SectionFit:
        """What stands in the rotor file."""
        assert self.rotor.fit is not None
        return self.rotor.fit


@dataclass(frozen=True)
class _Bench:
    """Points as the fit sees them."""

    pitch: Array
    speed: Array
    thrust: Array
    torque: Array
    air: Air
    reynolds: float


@dataclass(frozen=True)
class _Found:
    """One section, fitted."""

    evidence: float
    airfoils: tuple[str, ...]
    change: Array
    covariance: Array
    errors: Array  # (2, n)
    freedom: float


def fit_rotor(
    rotor: Rotor,
    measurements: Measurements,
    *,
    section: Literal["guessed", "known"] = "guessed",
    air: Air | None = None,
    n_crit: float = 0.1,
    engine: Engine = "neuralfoil",
    corrections: Corrections | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> RotorFit:
    """Find the sections of a rotor from measured points; one is enough, a sweep says more.

    Parameters
    ----------
    rotor : Rotor
        As it is believed to be; a fit that it holds already is left out.
    measurements : Measurements
        The bench.
    section : 'guessed' or 'known'
        Whether the airfoils of the rotor file are one guess among others, or known.
    air, n_crit, engine, corrections
        As for :func:`mufly.rotor.prepare` and :func:`mufly.rotor.hover`.
    progress : callable, optional
        Sections done, and in all.

    Raises
    ------
    InputError
        If ``section`` is neither.
    MuflyError
        If no section comes near to the measurements.
    """
    if section not in ("guessed", "known"):
        raise InputError("fit", "section", f"{section!r} is unknown", "use 'guessed' or 'known'")
    plain, gas, fixes = rotor.model_copy(update={"fit": None}), air or Air(), corrections or Corrections()
    n = measurements.thrust_N.size
    chord = float(rotor.chord_m(0.75))
    re = 0.75 * rotor.radius_m * chord * measurements.speed_rad_s * gas.density_kg_m3 / gas.viscosity_Pa_s
    bench = _Bench(
        measurements.pitch_rad, measurements.speed_rad_s, measurements.thrust_N, measurements.torque_Nm, gas,
        float(np.exp(np.mean(np.log(re)))),
    )  # fmt: skip
    listed = _sections(plain) if section == "guessed" else [(plain.blade.airfoils, 1.0)]
    wide = _widths(known=section == "known")
    tables = engines.polars({a for airfoils, _ in listed for a in airfoils}, n_crit=n_crit, engine=engine)
    prepared = []
    for done, (airfoils, share) in enumerate(listed):
        if progress is not None:
            progress(done, len(listed))
        one = replace_rotor(plain, {"blade.airfoils": airfoils})
        prepared.append((airfoils, share, prepare(one, tables, corrections=fixes)))

    def of(index: NDArray[np.intp]) -> list[_Found]:
        return _all(prepared, tables, wide, _part(bench, index))

    everything = of(np.arange(n))
    seen, note = _seen(bench.speed)
    held = np.full(2, math.nan)
    if seen.size:
        unseen = np.setdiff1d(np.arange(n), seen)
        best = of(seen)[0]
        blading = next(b for a, _, b in prepared if a == best.airfoils)
        errors = _errors(blading, tables, best.change, _part(bench, unseen, bench.reynolds))
        known = np.isfinite(errors)
        held = np.array(
            [np.mean(np.abs(e[k])) if k.any() else math.nan for e, k in zip(errors, known, strict=True)]
        )
    if progress is not None:
        progress(len(listed), len(listed))
    best = everything[0]
    before = _errors(
        prepare(plain, n_crit=n_crit, engine=engine, corrections=fixes), tables, np.zeros(5), bench
    )
    sigma = np.sqrt(np.diag(best.covariance))
    correlation = best.covariance / np.outer(sigma, sigma)
    weights = _weights(everything)
    kept = [(f, w) for f, w in zip(everything, weights, strict=True) if w >= _KEPT]
    total = sum(w for _, w in kept)
    fit = SectionFit(
        bench=measurements.source,
        points=n,
        n_crit=n_crit,
        reynolds=bench.reynolds,
        pitch_rad=(float(bench.pitch.min()), float(bench.pitch.max())),
        speed_rad_s=(float(bench.speed.min()), float(bench.speed.max())),
        scatter=_scatter(best),
        candidates=tuple(
            Candidate(
                airfoils=f.airfoils, probability=w / total, change=tuple(f.change.tolist()),
                covariance=tuple(tuple(row) for row in f.covariance.tolist()),
            )
            for f, w in kept
        ),
    )  # fmt: skip
    fitted_rotor = replace_rotor(plain, {"blade.airfoils": best.airfoils}).model_copy(update={"fit": fit})
    return RotorFit(
        fitted_rotor, best.change, sigma, wide, correlation, _undecided(sigma / wide, correlation, weights, everything),
        measurements, before, best.errors, held, note,
    )  # fmt: skip


def _widths(known: bool) -> Array:
    """Prior standard deviations of :data:`CHANGES`."""
    camber = 0.003 if known else 0.01 * (_CAMBER[1] - _CAMBER[0]) / math.sqrt(12.0)
    pitch = math.hypot(math.radians(0.5), _ZERO_LIFT_PER_CAMBER * camber)
    return np.array([pitch, math.hypot(0.04, 0.05), math.hypot(0.08, 0.08), 0.05, 0.2])


def _sections(rotor: Rotor) -> list[tuple[tuple[str, ...], float]]:
    """Sections that a small blade may have, with their prior probabilities; the rotor's own first."""
    listed: dict[tuple[str, ...], float] = {
        # Thin plates are bent in the middle, thicker sections before it.
        (f"naca{m}{(5 if t < 5 else 4) if m else 0}{t:02d}",): math.exp(-0.5 * ((m - 4.0) / 2.5) ** 2)
        for m in _CAMBER
        for t in _THICKNESS
    }
    total = sum(listed.values())
    shares = {k: (1.0 - _OWN) * v / total for k, v in listed.items()}
    own = rotor.blade.airfoils
    return list({own: shares.pop(own, 0.0) + _OWN, **shares}.items())


def _part(bench: _Bench, index: NDArray[np.intp], reynolds: float | None = None) -> _Bench:
    return _Bench(
        bench.pitch[index], bench.speed[index], bench.thrust[index], bench.torque[index], bench.air,
        reynolds or bench.reynolds,
    )  # fmt: skip


def _seen(speed: Array) -> tuple[NDArray[np.intp], str]:
    """Points that a fit is shown to see how it does at the others."""
    n = speed.size
    if n < 2:
        return np.array([], dtype=np.intp), "one point alone cannot be checked on another"
    order = np.argsort(speed, kind="stable")
    if n < 4:
        return order[n // 2 : n // 2 + 1], "fitted to one point, checked on the others"
    return np.sort(order[::2]), "fitted to every other point, checked on those between"


def _changed(blading: Blading, tables: Mapping[str, PolarTable], change: Array, reynolds: float) -> Blading:
    """What :func:`mufly.rotor.prepare` makes of a rotor with this fit, without laying it out again."""
    names = blading.rotors[0].airfoil_names()
    polars = stack_polars([fitted(tables[name], change.tolist(), reynolds) for name in names])
    return replace(blading, polars=polars, twist_rad=blading.twist_rad + change[0])


def _errors(blading: Blading, tables: Mapping[str, PolarTable], change: Array, bench: _Bench) -> Array:
    """Errors of thrust and torque, relative, (2, n)."""
    changed = _changed(blading, tables, change, bench.reynolds) if change.any() else blading
    out = hover_batch(changed, pitch_rad=bench.pitch, speed_rad_s=bench.speed, air=bench.air)
    return np.stack((out.thrust_N / bench.thrust - 1.0, out.torque_Nm / bench.torque - 1.0))


def _all(
    prepared: Sequence[tuple[tuple[str, ...], float, Blading]],
    tables: Mapping[str, PolarTable],
    wide: Array,
    bench: _Bench,
) -> list[_Found]:
    """Every section fitted, the likeliest first."""
    size = np.repeat([_SIGMA_THRUST, _SIGMA_TORQUE], bench.thrust.size)
    known = np.isfinite(np.concatenate((bench.thrust, bench.torque)))
    found = []
    for airfoils, share, blading in prepared:

        def miss(z: Array, blading: Blading = blading) -> Array:
            off = _errors(blading, tables, z * wide, bench).ravel() / size
            return np.concatenate((off[known], z))

        if not np.isfinite(miss(np.zeros(5))).all():
            continue
        solved = least_squares(miss, np.zeros(5), method="lm", diff_step=np.array([1e-3]), max_nfev=100)
        jacobian = np.asarray(solved.jac, dtype=np.float64)
        curvature, data = jacobian.T @ jacobian, jacobian[:-5]
        inverse = np.linalg.inv(curvature)
        freedom = float(known.sum() - np.trace(inverse @ data.T @ data))
        chi2 = float(np.sum(solved.fun[:-5] ** 2))
        birge = max(1.0, chi2 / freedom) if freedom > 0.5 else 1.0
        evidence = math.log(share) - solved.cost - 0.5 * float(np.linalg.slogdet(curvature)[1])
        found.append(
            _Found(
                evidence, airfoils, solved.x * wide, birge * inverse * np.outer(wide, wide),
                _errors(blading, tables, solved.x * wide, bench), freedom,
            )
        )  # fmt: skip
    found.sort(key=lambda f: -f.evidence)
    if not found or not np.nanmean(np.abs(found[0].errors[0])) < 0.25:
        raise MuflyError(
            "no section with any sensible change comes within 25 % of the measured thrust; check units, pitch, radius, "
            "number of blades and the direction of the twist"
        )
    return found


def _weights(found: Sequence[_Found]) -> Array:
    evidence = np.array([f.evidence for f in found])
    weights = np.exp(evidence - evidence.max())
    return np.asarray(weights / weights.sum(), dtype=np.float64)


def _scatter(best: _Found) -> tuple[float, float]:
    """What one point may be off while its neighbour is not, from what the fit leaves."""
    used = np.isfinite(best.errors).sum()
    grow = math.sqrt(used / max(best.freedom, 1.0)) if used > 5 else 1.0
    out = []
    for errors, least in zip(best.errors, (_SIGMA_THRUST, _SIGMA_TORQUE), strict=True):
        left = errors[np.isfinite(errors)]
        out.append(max(least, grow * float(np.sqrt(np.mean(left**2))) if left.size else least))
    return out[0], out[1]


def _undecided(shrunk: Array, correlation: Array, weights: Array, found: Sequence[_Found]) -> tuple[str, ...]:
    words = [
        f"the bench says little of {name}"
        for name, s in zip(CHANGES, shrunk.tolist(), strict=True)
        if s > _SAYS_LITTLE
    ]
    words += [
        f"{CHANGES[i]} and {CHANGES[j]} cannot be told apart (correlation {correlation[i, j]:+.2f})"
        for i in range(5)
        for j in range(i + 1, 5)
        if abs(correlation[i, j]) > _TOGETHER
    ]
    if weights[0] < 0.5:
        several = ", ".join("/".join(dict.fromkeys(f.airfoils)) for f in found[:4])
        words.append(f"sections that would do as well: {several}")
    return tuple(words)


# ----------------------------------------------------------------------------
# How sure is a prediction? A band from what is not known of the blade's sections, and of the method.
#
# Causes are varied one at a time about the nominal rotor, each by one standard deviation:
#
# * ``n_crit``: transition early or late, 4 and 9 beside the nominal value (the dissertation's Table 3.1);
# * ``engine``: 4 % of the lift coefficient, 8 % of the drag coefficient: network, boundary-layer code and wind tunnel
#   do not agree better below Re 1e5 (docs/polars.md);
# * ``camber``: 0.3 % of the chord for a known section, 1 % for a guess; zero-lift angle -2 f (thin airfoil,
# parabola);
# * ``thickness``: 0.5 % of the chord, 2 % for a guess; drag 1 + 2 t (Hoerner, Fluid-Dynamic Drag, 1965, ch. II);
# * ``pitch``: half a degree of setting and twist;
# * ``method``: 5 % of thrust, 8 % of torque, the size of what a lattice with a contracting wake changes
# (docs/bemt.md).
#
# They are taken as independent, variances add, and the 90 % interval is 1.645 standard deviations to either side.
# None of these numbers was fitted to the measurements that docs/validation.md checks them on.


@dataclass(frozen=True)
class Doubt:
    """Standard deviations of what is not known; the defaults belong to a known section."""

    n_crit: tuple[float, ...] = (4.0, 9.0)
    lift: float = 0.04
    drag: float = 0.08
    camber: float = 0.003
    thickness: float = 0.005
    pitch_rad: float = math.radians(0.5)
    method_thrust: float = 0.05
    method_torque: float = 0.08

    def __post_init__(self) -> None:
        for key in ("lift", "drag", "camber", "thickness", "pitch_rad", "method_thrust", "method_torque"):
            if not 0.0 <= getattr(self, key) < 1.0:
                raise InputError("uncertainty", key, f"is {getattr(self, key):g}", "give 0 or more, below 1")

    @classmethod
    def of_unknown_section(cls) -> Doubt:
        """Return the doubt about a blade whose airfoil was guessed."""
        return cls(camber=0.01, thickness=0.02)


@result(eq=False)
class Band:
    """A prediction with its interval.

    Attributes
    ----------
    thrust_N, torque_Nm : (n,) arrays
        Nominal prediction.
    thrust_low_N, thrust_high_N, torque_low_Nm, torque_high_Nm : (n,) arrays
        Interval.
    level : float
        Probability that it is meant to hold.
    thrust_share, torque_share : dict of str to (n,) arrays
        Relative standard deviation that each cause brings.
    """

    thrust_N: Array
    torque_Nm: Array
    thrust_low_N: Array
    thrust_high_N: Array
    torque_low_Nm: Array
    torque_high_Nm: Array
    level: float
    thrust_share: Mapping[str, Array]
    torque_share: Mapping[str, Array]


_SIGMAS = {0.5: 0.674, 0.68: 0.994, 0.8: 1.282, 0.9: 1.645, 0.95: 1.960, 0.99: 2.576}


def interval(
    rotor: Rotor,
    *,
    pitch_rad: ArrayLike,
    speed_rad_s: ArrayLike,
    climb_m_s: ArrayLike = 0.0,
    air: Air | None = None,
    corrections: Corrections | None = None,
    n_crit: float = 0.1,
    engine: Engine = "neuralfoil",
    doubt: Doubt | None = None,
    level: float = 0.9,
) -> Band:
    """Predict thrust and torque with an interval.

    For a rotor that was fitted to a bench (:func:`fit_rotor`) it is made of what that left open: the five numbers, the
    sections that would do as well, and the scatter; outside the range that was measured the method's own doubt comes
    back, wholly 5 degrees of pitch or a factor of two in speed away. Otherwise from the causes above.

    Parameters
    ----------
    rotor : Rotor
        The rotor.
    pitch_rad, speed_rad_s, climb_m_s : array_like
        Points, broadcast against each other.
    air, corrections, n_crit, engine
        As for :func:`mufly.rotor.blading.prepare` and :func:`mufly.rotor.bemt.hover`.
    doubt : Doubt, optional
        What is not known; :meth:`Doubt.of_unknown_section` where the airfoil is a guess.
    level : float
        0.5, 0.68, 0.8, 0.9, 0.95 or 0.99.

    Raises
    ------
    InputError
        If the level is none of these.
    """
    if level not in _SIGMAS:
        raise InputError(
            "uncertainty", "level", f"is {level:g}", f"choose one of {', '.join(map(str, _SIGMAS))}"
        )
    unsure = doubt or Doubt()
    fixes = corrections or Corrections()
    pitch, speed, climb = np.broadcast_arrays(*np.atleast_1d(pitch_rad, speed_rad_s, climb_m_s))
    if rotor.fit is not None:

        def at(one: Rotor) -> Array:
            blading = prepare(one, n_crit=n_crit, engine=engine, corrections=fixes)
            out = hover_batch(blading, pitch_rad=pitch, speed_rad_s=speed, climb_m_s=climb, air=air)
            return np.stack((out.thrust_N, out.torque_Nm))

        values, parts = _after_bench(rotor, rotor.fit, at, pitch, speed, unsure)
        return _band(values, parts, level)
    nominal = prepare(rotor, n_crit=n_crit, engine=engine, corrections=fixes)

    def solve(blading=nominal, turned: float = 0.0) -> tuple[Array, Array]:  # type: ignore[no-untyped-def]
        out = hover_batch(blading, pitch_rad=pitch + turned, speed_rad_s=speed, climb_m_s=climb, air=air)
        return out.thrust_N, out.torque_Nm

    def scaled(lift: float, drag: float) -> tuple[Array, Array]:
        changed = replace(fixes, lift_factor=fixes.lift_factor * lift, drag_factor=fixes.drag_factor * drag)
        return solve(replace(nominal, corrections=changed))

    thrust, torque = solve()

    def spread(*others: tuple[Array, Array]) -> tuple[Array, Array]:
        """Root mean square departure from the nominal point."""
        return (
            np.sqrt(np.mean([(t - thrust) ** 2 for t, _ in others], axis=0)),
            np.sqrt(np.mean([(q - torque) ** 2 for _, q in others], axis=0)),
        )

    shift = _ZERO_LIFT_PER_CAMBER * unsure.camber
    causes = {
        "n_crit": spread(
            *(solve(prepare(rotor, n_crit=n, engine=engine, corrections=fixes)) for n in unsure.n_crit),
            (thrust, torque),
        ),
        "engine": _added(
            spread(scaled(1 + unsure.lift, 1.0), scaled(1 - unsure.lift, 1.0)),
            spread(scaled(1.0, 1 + unsure.drag), scaled(1.0, 1 - unsure.drag)),
        ),
        "camber": spread(solve(turned=shift), solve(turned=-shift)),
        "thickness": spread(
            scaled(1.0, 1 + _DRAG_PER_THICKNESS * unsure.thickness),
            scaled(1.0, 1 - _DRAG_PER_THICKNESS * unsure.thickness),
        ),
        "pitch": spread(solve(turned=unsure.pitch_rad), solve(turned=-unsure.pitch_rad)),
        "method": (unsure.method_thrust * np.abs(thrust), unsure.method_torque * np.abs(torque)),
    }
    return _band(np.stack((thrust, torque)), {name: np.stack(pair) for name, pair in causes.items()}, level)


def _band(values: Array, causes: Mapping[str, Array], level: float) -> Band:
    """Thrust and torque (2, n), standard deviations of each cause likewise."""
    sigma = _SIGMAS[level] * np.sqrt(np.sum([np.square(c) for c in causes.values()], axis=0))
    size = np.where(values == 0.0, np.nan, np.abs(values))
    low, high = values - sigma, values + sigma
    return Band(
        values[0], values[1], low[0], high[0], low[1], high[1], level,
        {name: c[0] / size[0] for name, c in causes.items()}, {name: c[1] / size[1] for name, c in causes.items()},
    )  # fmt: skip


def _after_bench(
    rotor: Rotor, fit: SectionFit, at: Callable[[Rotor], Array], pitch: Array, speed: Array, unsure: Doubt
) -> tuple[Array, dict[str, Array]]:
    """Prediction of a fitted rotor and the standard deviation that each cause brings, (2, n) each."""
    weights = np.array([c.probability for c in fit.candidates])
    means, within = [], []
    for candidate in fit.candidates:
        one = replace_rotor(rotor, {"blade.airfoils": candidate.airfoils})

        def with_change(change: Array, one: Rotor = one, candidate: Candidate = candidate) -> Array:
            now = candidate.model_copy(update={"change": tuple(change.tolist())})
            return at(one.model_copy(update={"fit": fit.model_copy(update={"candidates": (now,)})}))

        change, covariance = np.array(candidate.change), np.array(candidate.covariance)
        # Along the principal axes, a standard deviation to either side
        size, axes = np.linalg.eigh(covariance)
        mean = with_change(change)
        spread = [
            0.5 * (with_change(change + step) - with_change(change - step))
            for step in (np.sqrt(np.maximum(size, 0.0)) * axes).T
        ]
        means.append(mean)
        within.append(np.sum(np.square(spread), axis=0))
    between = np.tensordot(weights, (np.array(means) - means[0]) ** 2, 1)
    off_pitch = np.maximum(
        np.maximum(fit.pitch_rad[0] - pitch, pitch - fit.pitch_rad[1]), 0.0
    ) / math.radians(5.0)
    off_speed = np.maximum(np.maximum(fit.speed_rad_s[0] / speed, speed / fit.speed_rad_s[1]), 1.0)
    away = np.minimum(np.hypot(off_pitch, np.log2(off_speed)), 1.0)
    value = means[0]
    method = np.array([[unsure.method_thrust], [unsure.method_torque]]) * away * np.abs(value)
    return value, {
        "fit": np.sqrt(np.tensordot(weights, np.array(within), 1)),
        "section": np.sqrt(between),
        "scatter": np.array(fit.scatter)[:, None] * np.abs(value),
        "method": method,
    }


def _added(*pairs: tuple[Array, Array]) -> tuple[Array, Array]:
    """Standard deviations of independent causes, together."""

    def root(parts: Sequence[Array]) -> Array:
        return np.sqrt(np.sum(np.square(parts), axis=0))

    return root([t for t, _ in pairs]), root([q for _, q in pairs])
