"""Comparison of predictions with bench measurements, and calibration of a rotor on one measured point.

Relative errors are prediction / measurement - 1.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from mufly.errors import InputError, MuflyError
from mufly.quantities.units import RPM
from mufly.results import ResultColumn, ShownBlock, columns_to_rows, make_lines_block, result, tabulate_results
from mufly.rotor.bemt import solve_rotor_batch, warn_reynolds_range
from mufly.rotor.blading import Blading, ensure_blading
from mufly.rotor.geometry import Rotor
from mufly.rotor.measured.uncertainty import PredictionInterval
from mufly.rotor.rotor_solver import solve_system
from mufly.rotor.rotor_system import Air, OperatingCondition, RotorSystem, SolverMethod, SystemSolution, WakeSettings
from mufly.rotor.validity_checks import SUPERSONIC_TIP_REMEDY, describe_supersonic_tips

Array = NDArray[np.float64]


@result(eq=False)
class RotorMeasurements:
    """Points of a test bench; :func:`mufly.bench.read_measurements` reads them from a file.

    Attributes
    ----------
    pitch_rad, speed_rad_s, thrust_N, torque_Nm : (n,) arrays
        Pitch setting, rotor speed and measured loads; torque is nan where it was not measured.
    source : str
        File or paper.
    climb_m_s : (n,) array
        Axial speed of the rotor through the air (m/s), as of a propeller in a wind tunnel; 0 for all points is hover.
    density_kg_m3 : float
        Air density at the bench (kg/m^3), for which the loads are given; nan if unknown.
    notes : tuple of str
        Remarks on rows of the file that were skipped and values that were assumed.
    """

    pitch_rad: Array
    speed_rad_s: Array
    thrust_N: Array
    torque_Nm: Array
    source: str
    climb_m_s: Array = field(default_factory=lambda: np.zeros(1))
    density_kg_m3: float = math.nan
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "climb_m_s", np.broadcast_to(self.climb_m_s, self.thrust_N.shape).copy())

    @property
    def has_axial_flow(self) -> bool:
        """True if any point has axial flow."""
        return bool(np.any(self.climb_m_s != 0.0))

    @property
    def air(self) -> Air:
        """Air at the bench; density 1.2 kg/m^3 if unknown."""
        return Air(density_kg_m3=self.density_kg_m3) if math.isfinite(self.density_kg_m3) else Air()

    def select_points(self, index: NDArray[np.intp]) -> RotorMeasurements:
        """Return the measurements of the points with these indices."""
        return RotorMeasurements(
            self.pitch_rad[index], self.speed_rad_s[index], self.thrust_N[index], self.torque_Nm[index], self.source,
            self.climb_m_s[index], self.density_kg_m3, self.notes,
        )  # fmt: skip


@result(eq=False)
class MeasurementComparison:
    """Predicted and measured loads of the points of a bench run.

    Attributes
    ----------
    measured : RotorMeasurements
        Measured points.
    thrust_N, torque_Nm : (n,) arrays
        Predicted loads.
    thrust_error, torque_error : (n,) arrays
        Prediction / measurement - 1; nan without a measurement.
    calibrated : bool
        True if the prediction was calibrated on a measurement.
    prediction_faults : tuple of str
        Reason why a point has no prediction, for each point; empty if it has one.
    interval : PredictionInterval, optional
        Of the loads of each point.
    """

    measured: RotorMeasurements
    thrust_N: Array
    torque_Nm: Array
    thrust_error: Array
    torque_error: Array
    calibrated: bool
    prediction_faults: tuple[str, ...] = ()
    interval: PredictionInterval | None = None

    def count_inside_interval(self) -> dict[str, tuple[int, int]]:
        """Return for thrust and torque how many measured values lie inside the interval, and how many there are."""
        i, m = self.interval, self.measured
        if i is None:
            return {}
        loads = {
            "thrust": (m.thrust_N, i.thrust_low_N, i.thrust_high_N),
            "torque": (m.torque_Nm, i.torque_low_Nm, i.torque_high_Nm),
        }
        return {
            name: (int(np.sum((low <= value) & (value <= high))), int(np.isfinite(value).sum()))
            for name, (value, low, high) in loads.items()
        }

    @property
    def mean_thrust_error(self) -> float:
        """Mean absolute relative error of thrust over the points with a prediction; nan if there is none."""
        known = np.isfinite(self.thrust_error)
        return float(np.mean(np.abs(self.thrust_error[known]))) if known.any() else math.nan

    @property
    def mean_torque_error(self) -> float:
        """Mean absolute relative error of torque; nan if no torque was measured."""
        known = np.isfinite(self.torque_error)
        return float(np.mean(np.abs(self.torque_error[known]))) if known.any() else math.nan

    def make_printed_blocks(self) -> tuple[ShownBlock, ...]:
        """Return the loads of each point and the mean errors as printed text."""
        m = self.measured
        table = {
            "pitch_rad": m.pitch_rad, "speed_rad_s": m.speed_rad_s, "axial_m_s": m.climb_m_s,
            "thrust_N": self.thrust_N, "measured_thrust_N": m.thrust_N, "thrust_error": self.thrust_error,
            "torque_Nm": self.torque_Nm, "measured_torque_Nm": m.torque_Nm, "torque_error": self.torque_error,
        }  # fmt: skip
        torque = _TORQUE_COLUMNS if np.isfinite(m.torque_Nm).any() else _TORQUE_COLUMNS[:1]
        axial = (ResultColumn("axial_m_s", form=".2f"),) if m.has_axial_flow else ()
        known = {"thrust": self.mean_thrust_error, "torque": self.mean_torque_error}
        means = ", ".join(f"{name} {100 * error:.1f} %" for name, error in known.items() if math.isfinite(error))
        return (
            make_lines_block(f"{m.source}: {'calibrated on measurements' if self.calibrated else 'not calibrated'}"),
            tabulate_results(columns_to_rows(table), (*_LOAD_COLUMNS, *torque, *axial)),
            make_lines_block(f"mean absolute error: {means or 'not known'}"),
            *(
                make_lines_block(
                    f"{name}: {inside} of {count} measured values inside the {self.interval.level:.0%} interval"
                )
                for name, (inside, count) in self.count_inside_interval().items()
                if count and self.interval is not None
            ),
            *(
                make_lines_block(f"point {k + 1}: {fault}", style="yellow")
                for k, fault in enumerate(self.prediction_faults)
                if fault
            ),
        )


_LOAD_COLUMNS = (
    ResultColumn("pitch_rad", "deg", ".2f"),
    ResultColumn("speed_rad_s", "rpm", ".0f"),
    ResultColumn("thrust_N", form=".4f"),
    ResultColumn("measured_thrust_N", form=".4f", head="measured"),
    ResultColumn("thrust_error", "%", "+.1f", head="error"),
)
_TORQUE_COLUMNS = (
    ResultColumn("torque_Nm", form=".5f"),
    ResultColumn("measured_torque_Nm", form=".5f", head="measured"),
    ResultColumn("torque_error", "%", "+.1f", head="error"),
)


def compare_measurements(
    blading: Blading | Rotor,
    measurements: RotorMeasurements,
    *,
    air: Air | None = None,
    method: SolverMethod = "bemt",
    settings: WakeSettings | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> MeasurementComparison:
    """Predict the loads at every measured point, and compare them with the measurement.

    Parameters
    ----------
    blading : Blading or Rotor
        Rotor; of a batch the first rotor is used.
    measurements : RotorMeasurements
        Measured points.
    air : Air, optional
        Density and viscosity at the bench; default: the air of ``measurements``.
    method : 'bemt' or 'wake'
        Blade elements, or a vortex wake for each point (seconds per point).
    settings : WakeSettings, optional
        Settings of the wake method.
    progress : callable, optional
        ``progress(done, total)`` after each point of the wake method.

    Thesis: Table 3.2; Fig. 3.15.
    """
    bench = measurements
    case, gas = ensure_blading(blading), air or bench.air
    reject_supersonic_points(float(case.radius_m[0]), bench, gas)
    faults = [""] * bench.thrust_N.size
    warn_reynolds_range(case, np.zeros(bench.thrust_N.size, dtype=np.int64), bench.speed_rad_s, gas)
    if method == "bemt":
        out = solve_rotor_batch(
            case, pitch_rad=bench.pitch_rad, speed_rad_s=bench.speed_rad_s, climb_m_s=bench.climb_m_s, air=gas
        )
        thrust, torque = out.thrust_N, out.torque_Nm
    else:
        thrust, torque = _predict_by_wake(case, bench, gas, settings, faults, progress)
    return MeasurementComparison(
        bench,
        thrust,
        torque,
        _relative_error(thrust, bench.thrust_N),
        _relative_error(torque, bench.torque_Nm),
        case.is_calibrated,
        tuple(faults),
    )


def reject_supersonic_points(radius_m: float, bench: RotorMeasurements, air: Air, only: int | None = None) -> None:
    """Raise an error that names the first measured point, or the point ``only``, with tips at Mach 1 or faster.

    Raises
    ------
    InputError
        If there is such a point, as where a speed has the wrong unit.
    """
    for k, (speed, climb) in enumerate(zip(bench.speed_rad_s.tolist(), bench.climb_m_s.tolist(), strict=True)):
        fault = describe_supersonic_tips(radius_m, speed, air, climb)
        if fault and only in (None, k):
            raise InputError(
                bench.source, f"point {k + 1}, speed", fault, f"check its unit; {SUPERSONIC_TIP_REMEDY}"
            )  # fmt: skip


def _relative_error(value: Array, measured: Array) -> Array:
    """Return the relative error; nan where the measured value is nan or 0, as thrust in a fast climb may be."""
    return value / np.where(measured == 0.0, math.nan, measured) - 1.0


def _predict_by_wake(
    case: Blading, bench: RotorMeasurements, air: Air, settings: WakeSettings | None, faults: list[str],
    progress: Callable[[int, int], None] | None,
) -> tuple[Array, Array]:  # fmt: skip
    """Compute thrust and torque of every point by the wake method.

    A point whose wake does not converge is nan; the reason goes into ``faults``.
    """
    system, n = RotorSystem.from_single_rotor(case), bench.thrust_N.size
    thrust, torque = np.full(n, np.nan), np.full(n, np.nan)
    known: SystemSolution | None = None
    # Neighbours in pitch and speed follow each other: each wake starts from the previous one.
    for done, k in enumerate(np.lexsort((bench.climb_m_s, bench.speed_rad_s, bench.pitch_rad)).tolist()):
        if progress is not None:
            progress(done, n)
        point = OperatingCondition(
            float(bench.pitch_rad[k]),
            float(bench.speed_rad_s[k]),
            climb_m_s=float(bench.climb_m_s[k]),
            air=air,
        )
        now = solve_system(system, point, "wake", settings=settings, start=known)
        if not now.converged and known is not None:
            now = solve_system(system, point, "wake", settings=settings)
        if now.converged:
            known = now
            thrust[k], torque[k] = now.rotors[0].thrust_N, now.rotors[0].torque_Nm
        else:
            faults[k] = now.message
    if progress is not None:
        progress(n, n)
    return thrust, torque


def calibrate_blading(
    blading: Blading, measurements: RotorMeasurements, point: int = 0, *, air: Air | None = None
) -> Blading:
    """Scale lift and drag of all sections to match one measured point, as in the dissertation (sec. 3.3.1).

    A factor on the lift coefficient matches the thrust, then a factor on the drag coefficient matches the torque. Both
    steps repeat until thrust and torque agree to 1e-6. Results of the returned blading are marked ``calibrated``.

    Parameters
    ----------
    blading : Blading
        Rotor to calibrate.
    measurements : RotorMeasurements
        Measured points.
    point : int
        Index of the point to match.

    Raises
    ------
    MuflyError
        If no factors between 0.2 and 5 match the point.
    """
    air = air or measurements.air
    reject_supersonic_points(float(blading.radius_m[0]), measurements, air, point)
    pitch, speed = measurements.pitch_rad[point], measurements.speed_rad_s[point]
    wanted = (measurements.thrust_N[point], measurements.torque_Nm[point])
    climb = measurements.climb_m_s[point]
    lift, drag = 1.0, 1.0

    def scale_blading(lift: float, drag: float) -> Blading:
        return replace(blading, corrections=replace(blading.corrections, lift_factor=lift, drag_factor=drag))

    def relative_load_errors(lift: float, drag: float) -> tuple[float, float]:
        out = solve_rotor_batch(scale_blading(lift, drag), pitch_rad=pitch, speed_rad_s=speed, climb_m_s=climb, air=air)
        return float(out.thrust_N / wanted[0] - 1.0), float(out.torque_Nm / wanted[1] - 1.0)

    try:
        for _ in range(30):
            lift = brentq(lambda x, d=drag: relative_load_errors(x, d)[0], 0.2, 5.0, xtol=1e-10)
            if math.isfinite(wanted[1]):
                drag = brentq(lambda x, c=lift: relative_load_errors(c, x)[1], 0.2, 5.0, xtol=1e-10)
            thrust_error, torque_error = relative_load_errors(lift, drag)
            if abs(thrust_error) < 1e-6 and not abs(torque_error) > 1e-6:
                return scale_blading(lift, drag)
    except ValueError:
        pass
    raise MuflyError(
        f"{measurements.source}: no factors on lift and drag between 0.2 and 5 meet point {point + 1} "
        f"({math.degrees(pitch):g} deg, {speed / RPM:.0f} rpm); check the rotor and the units"
    )
