"""Comparison of CFD solutions with tables of measured or published loads, and with other methods over climb."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.cfd.case_studies import SpanLoads, convert_to_span_loads
from mufly.cfd.cfd_solution import CfdSolution
from mufly.cfd.openfoam_case import OperatingPoint, read_operating_point
from mufly.cfd.rotor_pair import ActuatorDisc
from mufly.cfd.solver_process import ConvergenceAssessment, judge_case_convergence
from mufly.errors import InputError, MuflyError
from mufly.files.text_table import read_text_table
from mufly.quantities.units import RPM
from mufly.results import ResultColumn, ShownBlock, columns_to_rows, result, tabulate_results
from mufly.rotor import OperatingCondition, Rotor, RotorSystem, SolverMethod, prepare_blading, solve_system
from mufly.rotor.coax_maps import interpolate_map
from mufly.vehicle import CoefficientMap

Array = NDArray[np.float64]


@result
class CaseComparison:
    """Thrust and torque of a CFD case beside those of the same point in a table.

    Attributes
    ----------
    case : str
    point : OperatingPoint
    verdict : Verdict
    thrust_deviations, torque_deviations : dict of str to float
        Relative deviation from the table, by the column's name without ``T_`` or ``Q_`` and unit.
    """

    case: str
    point: OperatingPoint
    verdict: ConvergenceAssessment
    thrust_deviations: dict[str, float]
    torque_deviations: dict[str, float]


def compare_cases_with_table(table: Path, cases: Sequence[Path]) -> list[CaseComparison]:
    """Compare cases with the rows of a table with the same pitch (to 0.05 degrees) and speed (to 0.5 %).

    Parameters
    ----------
    table : Path
        CSV with ``pitch_deg``, ``rpm`` and columns ``T_...`` (N) and ``Q_...`` (N m); # begins a comment.
    cases : sequence of Path

    Raises
    ------
    InputError
        If the table cannot be read or lacks a column, a folder is no case, or no row matches a case.
    """
    written = read_text_table(table)
    needed = [
        written.find_column_index(name, "give columns pitch_deg, rpm, T_... and Q_...") for name in ("pitch_deg", "rpm")
    ]
    pitches, speeds = (written.read_numbers(k) for k in needed)
    loads = {k: written.read_numbers(i, optional=True) for i, k in enumerate(written.header) if k[:2] in ("T_", "Q_")}
    out = []
    for case in cases:
        point = read_operating_point(case)
        pitch, rpm = math.degrees(point.pitch_rad), point.speed_rad_s / RPM
        verdict = judge_case_convergence(case)
        if verdict.outcome == "not begun":
            raise InputError(str(case), "", "has not been run", "run it first: `mufly cfd run --out` its folder")
        at = np.flatnonzero((np.abs(pitches - pitch) < 0.05) & (np.abs(speeds / rpm - 1.0) < 5e-3))
        if not at.size:
            raise InputError(
                str(table), "", f"has no row at {pitch:.3g} degrees and {rpm:.0f} rpm", f"leave {case} out"
            )
        beside = [
            {
                k.removeprefix(letter).removesuffix(unit): ours / float(v[at[0]]) - 1.0
                for k, v in loads.items()
                if k.startswith(letter) and np.isfinite(v[at[0]])
            }
            for letter, unit, ours in (("T_", "_N", verdict.thrust_N), ("Q_", "_Nm", verdict.torque_Nm))
        ]
        out.append(CaseComparison(str(case), point, verdict, beside[0], beside[1]))
    return out


@result(eq=False)
class ClimbComparison:
    """Thrust over the climb velocity, relative to the thrust of the same method in hover.

    Attributes
    ----------
    solutions : tuple of CfdSolution
        Solutions in order of climb, including those that did not converge.
    climb_m_s : (points,) array
        Climb velocity of each solution.
    c_T : (points,) array
        Thrust coefficients of the solutions: means of the last iterations.
    other_methods : dict of (points,) arrays
        Coefficient by blade elements (``bemt``) and vortex wake (``wake``) at the same climbs; nan without a solution.
    map_name : str
        Name of the flight model's coefficient map.
    map_thrust_ratio : (points,) array
        Thrust of the map's upper rotor over that in hover, at the same climb over tip speed and equal rotor speeds; nan
        beyond the edges of the map.
    """

    solutions: tuple[CfdSolution, ...]
    climb_m_s: Array
    c_T: Array
    other_methods: dict[str, Array]
    map_name: str
    map_thrust_ratio: Array

    def thrust_slope(self, values: Array, reach_m_s: float) -> float:
        """Return the change of thrust per 1 m/s of climb, between climbs of -reach and +reach (m/s), divided by the
        thrust in hover; NaN if unknown.
        """
        at_zero = np.flatnonzero(self.climb_m_s == 0.0)
        ends = [np.flatnonzero(np.abs(self.climb_m_s - climb) < 1e-9) for climb in (-reach_m_s, reach_m_s)]
        if not (at_zero.size and ends[0].size and ends[1].size):
            return math.nan
        return float((values[ends[1][0]] - values[ends[0][0]]) / values[at_zero[0]] / (2.0 * reach_m_s))

    @property
    def thrust_slopes(self) -> dict[str, dict[str, float]]:
        """Change of thrust per 1 m/s of climb by method, and by the reach of the climbs (m/s)."""
        methods = {"cfd": self.c_T, **self.other_methods, "map_over_hover": self.map_thrust_ratio}
        return {
            name: {f"{reach:g}": self.thrust_slope(values, reach) for reach in (0.5, 1.0)}
            for name, values in methods.items()
        }

    def tabulate_points(self) -> list[dict[str, Any]]:
        """Return a row for each climb: thrust by every method, torque and verdict of the solution."""
        return columns_to_rows({
            "climb_m_s": self.climb_m_s, "c_T_cfd": self.c_T,
            **{f"c_T_{name}": values for name, values in self.other_methods.items()},
            "map_over_hover": self.map_thrust_ratio,
            "torque_Nm": [s.verdict.torque_Nm for s in self.solutions],
            "verdict": [s.verdict.outcome for s in self.solutions],
        })  # fmt: skip

    def as_record(self) -> dict[str, Any]:
        """Return the points over the climb, and the slopes of the thrust."""
        return {"points": self.tabulate_points(), "thrust_for_1_m_s": self.thrust_slopes}

    def make_printed_blocks(self) -> tuple[ShownBlock, ...]:
        """Return thrust over climb by every method, and its slopes."""
        methods = [ResultColumn(f"c_T_{name}", head=f"c_T {name}") for name in ("cfd", *self.other_methods)]
        loads = [ResultColumn(name) for name in ("map_over_hover", "torque_Nm", "verdict")]
        columns = (ResultColumn("climb_m_s", form="g"), *methods, *loads)
        title = "c_T by each method, and thrust of the flight model's map over its thrust in hover"
        reach = {name: tuple(of.values()) for name, of in self.thrust_slopes.items()}
        slopes = [
            ResultColumn("0", "%", "+.1f", head="thrust for 1 m/s, -0.5 to 0.5 m/s"),
            ResultColumn("1", "%", "+.1f", head="-1 to 1 m/s"),
        ]
        return (
            tabulate_results(self.tabulate_points(), columns, title=title),
            tabulate_results([*reach.values()], slopes, names=[*reach]),
        )


def compare_climbs(solutions: Sequence[CfdSolution], rotor: Rotor | None, flight: CoefficientMap) -> ClimbComparison:
    """Compare CFD solutions of a rotor at several climb velocities with blade elements, the wake method and the flight
    model's map.

    Parameters
    ----------
    solutions : sequence of CfdSolution
        Solutions that differ only in climb.
    rotor : Rotor, optional
        Rotor for blade elements and the wake method; without it both methods are skipped.
    flight : CoefficientMap

    Raises
    ------
    InputError
        If the solutions differ in more than the climb.
    """
    found = sorted(solutions, key=lambda s: s.point.climb_m_s)
    first = found[0].point
    for name in ("rotor", "pitch_rad", "speed_rad_s", "model", "level", "geometry_note"):
        for s in found[1:]:
            if getattr(s.point, name) != getattr(first, name):
                raise InputError("climb", name, "differs between the cases", "give cases that differ in the climb only")
    climb = np.array([s.point.climb_m_s for s in found])
    scale = first.density_kg_m3 * math.pi * first.radius_m**4 * first.speed_rad_s**2
    others: dict[str, Array] = {}
    if rotor is not None:
        system = RotorSystem.from_single_rotor(prepare_blading(rotor))
        methods: tuple[SolverMethod, ...] = ("bemt", "wake")
        for method in methods:
            values = others.setdefault(method, np.full(len(climb), math.nan))
            for i, w in enumerate(climb):
                at_point = OperatingCondition(first.pitch_rad, first.speed_rad_s, None, float(w), first.air)
                try:
                    told = solve_system(system, at_point, method)
                except MuflyError:
                    continue
                if told.converged:
                    values[i] = told.rotors[0].thrust_N / scale
    tip = abs(first.speed_rad_s) * first.radius_m
    mean = float(np.mean(flight.decode_map_tables().mean_speed_rad_s))
    thrust, outside = interpolate_map(flight, mean, 1.0, climb / tip)
    hover = interpolate_map(flight, mean, 1.0, 0.0)[0][..., 0]
    part = np.where(outside, math.nan, thrust[:, 0] / hover)
    return ClimbComparison(
        tuple(found), climb, np.array([s.verdict.thrust_N for s in found]) / scale, others, flight.name, part
    )


def predict_span_loads(
    rotor: Rotor, found: CfdSolution, other: ActuatorDisc | None = None, which: int = 0
) -> list[SpanLoads]:
    """Return the loads along the blade by blade elements and by the wake method, at the operating point of a CFD
    solution; a method that fails is left out.

    Parameters
    ----------
    rotor : Rotor
    found : CfdSolution
    other : ActuatorDisc, optional
        The other rotor of a pair that is solved alternately.
    which : int
        Rotor of a pair: 0 for the upper, 1 for the lower.
    """
    p = found.point
    system, pitch, speed = RotorSystem.from_single_rotor(prepare_blading(rotor)), p.pitch_rad, p.speed_rad_s
    condition = OperatingCondition(pitch, speed, None, p.climb_m_s, p.air)
    if p.gap_m:
        system = RotorSystem.from_coaxial_pair(prepare_blading(rotor), prepare_blading(rotor), spacing_m=p.gap_m)
        condition = OperatingCondition((pitch, p.lower_pitch_rad), (speed, p.lower_rad_s), None, p.climb_m_s, p.air)
    elif other is not None:
        system = RotorSystem.from_coaxial_pair(prepare_blading(rotor), prepare_blading(rotor), spacing_m=abs(p.other_m))
        both = [(pitch, speed), (other.pitch_rad, other.speed_rad_s)]
        pitches, speeds = zip(*(both[::-1] if which else both), strict=True)
        condition = OperatingCondition(pitches, speeds, None, p.climb_m_s, p.air)
    out = []
    methods: tuple[SolverMethod, ...] = ("bemt", "wake")
    for method in methods:
        try:
            solution = solve_system(system, condition, method)
        except MuflyError:
            continue
        if solution.converged:
            out.append(convert_to_span_loads(solution.rotors[which], method))
    return out
