"""Prediction beside measurement, and the calibration of a rotor on one measured point.

Errors are prediction over measurement less one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from mufly.errors import InputError, MuflyError
from mufly.results import result
from mufly.rotor.bemt import hover_batch
from mufly.rotor.blading import Blading, Corrections, as_blading, prepare
from mufly.rotor.engines import Engine
from mufly.rotor.geometry import Rotor
from mufly.rotor.solution import solve
from mufly.rotor.system import Air, Condition, Method, Result, System, WakeSettings
from mufly.units import RPM

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Measurements:
    """Points of a test bench; :func:`mufly.bench.read_measurements` reads them from a file.

    Attributes
    ----------
    pitch_rad, speed_rad_s, thrust_N, torque_Nm : (n,) arrays
        Setting and result; torque is nan where it was not measured.
    source : str
        File or paper.
    """

    pitch_rad: Array
    speed_rad_s: Array
    thrust_N: Array
    torque_Nm: Array
    source: str


@result(eq=False)
class Comparison:
    """A prediction beside a measurement.

    Attributes
    ----------
    measured : Measurements
        The bench.
    thrust_N, torque_Nm : (n,) arrays
        Prediction.
    thrust_error, torque_error : (n,) arrays
        Prediction / measurement - 1; nan without a measurement.
    calibrated : bool
        True if the prediction was scaled to a measurement.
    faults : tuple of str
        Why a point has no prediction, for each point; empty where it has.
    """

    measured: Measurements
    thrust_N: Array
    torque_Nm: Array
    thrust_error: Array
    torque_error: Array
    calibrated: bool
    faults: tuple[str, ...] = ()

    @property
    def mean_thrust_error(self) -> float:
        """Mean absolute error of thrust, over the points that have a prediction; nan if none has."""
        known = np.isfinite(self.thrust_error)
        return float(np.mean(np.abs(self.thrust_error[known]))) if known.any() else math.nan

    @property
    def mean_torque_error(self) -> float:
        """Mean absolute error of torque; nan if none was measured."""
        known = np.isfinite(self.torque_error)
        return float(np.mean(np.abs(self.torque_error[known]))) if known.any() else math.nan

    def __str__(self) -> str:
        head = "calibrated on measurements" if self.calibrated else "not calibrated"
        lines = [
            f"{self.measured.source}: {head}",
            "pitch_deg speed_rpm  thrust_N measured  error   torque_Nm measured  error",
        ]
        m = self.measured
        for i in range(m.thrust_N.size):
            torque = f"{self.torque_Nm[i]:9.5f}"
            if np.isfinite(m.torque_Nm[i]):
                torque += f" {m.torque_Nm[i]:8.5f} {100 * self.torque_error[i]:+5.1f}%"
            lines.append(
                f"{math.degrees(m.pitch_rad[i]):9.2f} {m.speed_rad_s[i] / RPM:9.0f} {self.thrust_N[i]:9.4f} "
                f"{m.thrust_N[i]:8.4f} {100 * self.thrust_error[i]:+5.1f}% {torque}"
            )
        mean = f"mean absolute error: thrust {100 * self.mean_thrust_error:.1f} %"
        if math.isfinite(self.mean_torque_error):
            mean += f", torque {100 * self.mean_torque_error:.1f} %"
        return "\n".join([*lines, mean])


def compare(
    blading: Blading | Rotor,
    measurements: Measurements,
    *,
    air: Air | None = None,
    method: Method = "bemt",
    settings: WakeSettings | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Comparison:
    """Predict every measured point.

    Parameters
    ----------
    blading : Blading or Rotor
        The rotor, the first of a batch.
    measurements : Measurements
        Points.
    air : Air, optional
        Density and viscosity at the bench.
    method : 'bemt' or 'wake'
        Blade elements, or a wake a point (seconds each).
    settings : WakeSettings, optional
        Of the wakes.
    progress : callable, optional
        Of the wakes: points done, and points in all.

    Thesis: Table 3.2; Fig. 3.15.
    """
    case, gas = as_blading(blading), air or Air()
    bench = measurements
    faults = [""] * bench.thrust_N.size
    if method == "bemt":
        out = hover_batch(case, pitch_rad=bench.pitch_rad, speed_rad_s=bench.speed_rad_s, air=gas)
        thrust, torque = out.thrust_N, out.torque_Nm
    else:
        thrust, torque = _by_wake(case, bench, gas, settings, faults, progress)
    return Comparison(
        bench,
        thrust,
        torque,
        thrust / bench.thrust_N - 1.0,
        torque / bench.torque_Nm - 1.0,
        case.corrections.calibrated,
        tuple(faults),
    )


def _by_wake(
    case: Blading, bench: Measurements, air: Air, settings: WakeSettings | None, faults: list[str],
    progress: Callable[[int, int], None] | None,
) -> tuple[Array, Array]:  # fmt: skip
    """Thrust and torque of every point, nan where its wake does not converge; why not goes into ``faults``."""
    system, n = System.single(case), bench.thrust_N.size
    thrust, torque = np.full(n, np.nan), np.full(n, np.nan)
    known: Result | None = None
    # Neighbours in pitch and speed one after the other: each wake starts from the one before.
    for done, k in enumerate(np.lexsort((bench.speed_rad_s, bench.pitch_rad)).tolist()):
        if progress is not None:
            progress(done, n)
        point = Condition(float(bench.pitch_rad[k]), float(bench.speed_rad_s[k]), air=air)
        now = solve(system, point, "wake", settings=settings, start=known)
        if not now.converged and known is not None:
            now = solve(system, point, "wake", settings=settings)
        if now.converged:
            known = now
            thrust[k], torque[k] = now.rotors[0].thrust_N, now.rotors[0].torque_Nm
        else:
            faults[k] = now.message
    if progress is not None:
        progress(n, n)
    return thrust, torque


def calibrate(
    blading: Blading, measurements: Measurements, point: int = 0, *, air: Air | None = None
) -> Blading:
    """Scale lift and drag of all sections so that one measured point is met, as the dissertation did (sec. 3.3.1).

    Two numbers are found: a factor on the lift coefficient that gives the thrust, then one on the drag
    coefficient that gives the torque; the pair is repeated until both hold to 1e-6. Results of the blading
    returned say ``calibrated``.

    Parameters
    ----------
    blading : Blading
        The rotor.
    measurements : Measurements
        The bench.
    point : int
        Which of its points.

    Raises
    ------
    MuflyError
        If no factors between 0.2 and 5 meet the point.
    """
    pitch, speed = measurements.pitch_rad[point], measurements.speed_rad_s[point]
    wanted = measurements.thrust_N[point], measurements.torque_Nm[point]
    lift, drag = 1.0, 1.0

    def scaled(lift: float, drag: float) -> Blading:
        return replace(blading, corrections=replace(blading.corrections, lift_factor=lift, drag_factor=drag))

    def error(lift: float, drag: float) -> tuple[float, float]:
        out = hover_batch(scaled(lift, drag), pitch_rad=pitch, speed_rad_s=speed, air=air)
        return float(out.thrust_N / wanted[0] - 1.0), float(out.torque_Nm / wanted[1] - 1.0)

    try:
        for _ in range(30):
            lift = brentq(lambda x, d=drag: error(x, d)[0], 0.2, 5.0, xtol=1e-10)
            if math.isfinite(wanted[1]):
                drag = brentq(lambda x, c=lift: error(c, x)[1], 0.2, 5.0, xtol=1e-10)
            thrust_error, torque_error = error(lift, drag)
            if abs(thrust_error) < 1e-6 and not abs(torque_error) > 1e-6:
                return scaled(lift, drag)
    except ValueError:
        pass
    raise MuflyError(
        f"{measurements.source}: no factors on lift and drag between 0.2 and 5 meet point {point + 1} "
        f"({math.degrees(pitch):g} deg, {speed / RPM:.0f} rpm); check the rotor and the units"
    )


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
_ZERO_LIFT_PER_CAMBER = 2.0  # rad per chord: thin-airfoil theory, parabolic camber line
_DRAG_PER_THICKNESS = 2.0  # skin friction of a section of thickness t: 1 + 2 t


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
    sigma_t, sigma_q = _added(*causes.values())
    k = _SIGMAS[level]
    size_t, size_q = (np.where(v == 0.0, np.nan, np.abs(v)) for v in (thrust, torque))
    return Band(
        thrust, torque, thrust - k * sigma_t, thrust + k * sigma_t, torque - k * sigma_q, torque + k * sigma_q, level,
        {name: t / size_t for name, (t, _) in causes.items()}, {name: q / size_q for name, (_, q) in causes.items()},
    )  # fmt: skip


def _added(*pairs: tuple[Array, Array]) -> tuple[Array, Array]:
    """Standard deviations of independent causes, together."""

    def root(parts: Sequence[Array]) -> Array:
        return np.sqrt(np.sum(np.square(parts), axis=0))

    return root([t for t, _ in pairs]), root([q for _, q in pairs])
