"""Operating points: of one rotor with its drive and prediction interval, and of a pair beside its rotors alone."""

from __future__ import annotations

import math
from typing import Any

from mufly.drive import DriveTrain, find_operating_point, make_blade_load, scale_load_to_reference
from mufly.drive import OperatingPoint as DrivePoint
from mufly.quantities.units import RPM
from mufly.results import (
    ResultColumn,
    ShownBlock,
    make_lines_block,
    result,
    select_fields,
    tabulate_fields,
    tabulate_results,
)
from mufly.rotor import (
    Blading,
    OperatingCondition,
    PredictionInterval,
    Rotor,
    RotorResult,
    RotorSystem,
    SolverMethod,
    SystemSolution,
    solve_system,
)
from mufly.rotor.wake import WakeSettings
from mufly.study.case_evaluation import WakeProgress, solve_case, solve_isolated_rotors
from mufly.study.study_setup import StudySetup

_WAKE_FIELDS = "converged message iterations residual settings"
_METHOD_NAMES = {
    "bemt": "blade element momentum theory",
    "tubes": "blade elements in the mean wakes as vortex tubes",
}
_ROTOR_COLUMNS = (
    ResultColumn("speed_rad_s", "rpm", ".0f"),
    ResultColumn("pitch_rad", "deg", ".2f"),
    ResultColumn("thrust_N"),
    ResultColumn("torque_Nm", "mN m"),
    ResultColumn("power_W"),
    ResultColumn("c_T", form=".5f", head="c_T"),
    ResultColumn("c_Q", form=".6f", head="c_Q"),
    ResultColumn("figure_of_merit", form=".3f"),
)
_DRIVE_COLUMNS = (
    ResultColumn("input_power_W", head="electrical power"),
    ResultColumn("thrust_per_power_N_W", head="thrust per electrical power"),
    ResultColumn("efficiency", "%", ".1f"),
    ResultColumn("duty", form=".2f"),
    ResultColumn("voltage_V"),
    ResultColumn("motor_current_A", form=".2f"),
)


@result(eq=False)
class RotorPoint:
    """Operating point of one rotor.

    Attributes
    ----------
    rotor : Rotor
    model : str
        Corrections of blade element theory.
    n_crit : float
        Amplification exponent of transition.
    solution : SystemSolution
    drive : DriveTrain, optional
    drive_point : OperatingPoint, optional
        State of the drive at the thrust; None without a drive or thrust.
    interval : PredictionInterval, optional
    """

    rotor: Rotor
    model: str
    n_crit: float
    solution: SystemSolution
    drive: DriveTrain | None = None
    drive_point: DrivePoint | None = None
    interval: PredictionInterval | None = None

    @property
    def loads(self) -> RotorResult:
        """Loads of the rotor."""
        return self.solution.rotors[0]

    def as_record(self) -> dict[str, Any]:
        """Return the loads with method, drive, interval and wake."""
        wake = {"wake": select_fields(self.solution, _WAKE_FIELDS)} if self.solution.wakes else {}
        return {
            "rotor": self.rotor.name, "model": self.model, "n_crit": self.n_crit, **self.loads.as_record(),
            "drive": self.drive_point, "band": self.interval, **wake, "method": self.solution.method,
        }  # fmt: skip

    def make_printed_blocks(self) -> tuple[ShownBlock, ...]:
        """Return loads, interval, drive and stations as printed text."""
        s, r = self.solution, self.loads
        wake = f"; {s.settings.model} wake, {s.message}" if s.wakes and s.settings is not None else ""
        where = f" at {math.degrees(r.pitch_rad):.2f}° and {r.speed_rad_s / RPM:.0f} rpm{wake}"
        loads, *stations = r.load_blocks(self.rotor.radius_m)
        blocks: list[ShownBlock] = [make_lines_block(where, head=self.rotor.name), loads]
        if self.interval is not None:
            blocks += self.interval.make_printed_blocks()
        if self.drive is not None and self.drive_point is not None:
            blocks.append(tabulate_fields(self.drive_point, _DRIVE_COLUMNS, title=f"drive {self.drive.name}"))
        return (*blocks, *stations)


def solve_rotor_point(
    blading: Blading, condition: OperatingCondition, *, method: SolverMethod = "bemt", model: str = "default",
    n_crit: float = 0.1, settings: WakeSettings | None = None, drive: DriveTrain | None = None,
    progress: WakeProgress | None = None,
) -> RotorPoint:  # fmt: skip
    """Solve a rotor and, with its thrust and torque, the drive.

    Parameters
    ----------
    blading : Blading
    condition : OperatingCondition
        Two of pitch, speed and thrust; the third is found.
    method : 'bemt', 'tubes' or 'wake'
    model, n_crit : str, float
        Names of the corrections and transition of the blading, for the record.
    settings : WakeSettings, optional
    drive : DriveTrain, optional
    progress : callable, optional
        Called after each iteration of a wake.
    """
    system = RotorSystem.from_single_rotor(blading)
    found = solve_system(system, condition, method, settings=settings, progress=progress)
    r, point = found.rotors[0], None
    if drive is not None and found.converged and r.thrust_N > 0:
        load = make_blade_load(blading, pitch_rad=r.pitch_rad, climb_m_s=condition.climb_m_s, air=condition.air)
        if found.wakes:
            load = scale_load_to_reference(load, r.speed_rad_s, r.thrust_N, r.torque_Nm)
        point = find_operating_point(drive, load, thrust_N=r.thrust_N)
    return RotorPoint(blading.rotors[0], model, n_crit, found, drive, point)


@result(eq=False)
class PairPoint:
    """Operating point of a coaxial pair, beside its rotors alone.

    Attributes
    ----------
    setup : StudySetup
    solution : SystemSolution
    alone : tuple of RotorResult, optional
        Both rotors alone, at the same pitch and speed.
    interval : PredictionInterval, optional
        Of the loads of both rotors.
    """

    setup: StudySetup
    solution: SystemSolution
    alone: tuple[RotorResult, ...] | None = None
    interval: PredictionInterval | None = None

    def as_record(self) -> dict[str, Any]:
        """Return the loads of both rotors and of the pair, with the rotors alone."""
        sides, s, alone = ("upper", "lower"), self.solution, self.alone
        both = zip(sides, self.setup.rotors, (s.upper, s.lower), strict=True)
        return {
            **{side: {"rotor": rotor.name, **found.as_record()} for side, rotor, found in both},
            **select_fields(s, "spacing_m thrust_N power_W yaw_torque_Nm figure_of_merit lower_over_upper"),
            "isolated": alone and dict(zip(sides, alone, strict=True)),
            "change_from_isolated": alone and s.compute_interference_changes(alone),
            "method": self.setup.method,
            "wake": select_fields(s, _WAKE_FIELDS) if s.wakes else None,
            **({"band": {side: self.interval.as_record(k) for k, side in enumerate(sides)}} if self.interval else {}),
        }

    def make_printed_blocks(self) -> tuple[ShownBlock, ...]:
        """Return both rotors, the pair, and its changes against the rotors alone as printed text."""
        s, setup, ratio = self.solution, self.setup, self.solution.lower_over_upper
        how = _METHOD_NAMES.get(setup.method) or f"{setup.wake_settings.model} wake, {s.message}"
        each = (s.upper, s.lower, *(self.alone or ()))
        balanced = abs(s.yaw_torque_Nm) < 1e-6 * abs(s.upper.torque_Nm)
        yaw = "balanced" if balanced else f"{1e3 * s.yaw_torque_Nm:+.3g} mN m left over"
        pair = tabulate_fields(s, [
            "thrust_N", "power_W", ResultColumn("figure_of_merit", form=".3f"), ("torques", yaw),
            ("thrust per power", f"{s.thrust_N / s.power_W:.4g} N/W"),
            *((f"{name}, lower over upper", f"{value:.3f}") for name, value in ratio.items()),
        ], title="pair")  # fmt: skip
        blocks = [
            make_lines_block(
                f", {1e3 * s.spacing_m:g} mm apart; {how}", head=f"{setup.rotors[0].name} over {setup.rotors[1].name}"
            ),
            tabulate_results(each, _ROTOR_COLUMNS, names=("upper", "lower", "upper alone", "lower alone")[: len(each)]),
            pair,
            *(self.interval.make_printed_blocks() if self.interval is not None else ()),
        ]
        if self.alone is not None:
            change = s.compute_interference_changes(self.alone)
            columns = [ResultColumn(name, "%", "+.1f", head=name.replace("_", " ")) for name in change]
            title = "against the rotors alone at these speeds, change"
            blocks.append(tabulate_results([change], columns, title=title))
        share = max(s.upper.outside_share, s.lower.outside_share)
        outside = f"sections outside the range of the polars carry up to {share:.0%} of a rotor's thrust"
        return (*blocks, *((make_lines_block(outside, style="yellow"),) if share > 0.0 else ()))


def solve_pair_point(setup: StudySetup, *, isolated: bool, progress: WakeProgress | None = None) -> PairPoint:
    """Solve a pair and, if it converges and ``isolated`` is true, each of its rotors alone.

    Raises
    ------
    MuflyError
        If the wake of a rotor alone does not converge.
    """
    point = solve_case(setup, progress=progress)
    alone = solve_isolated_rotors(setup, point, progress) if isolated and point.converged else None
    return PairPoint(setup, point, alone)
