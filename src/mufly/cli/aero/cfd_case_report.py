"""Reports of solved cases: tables on the screen, files and pictures in the case."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mufly.cli.output import (
    make_console,
    print_answer,
    print_lines,
    print_result_table,
    print_table,
    save_figure,
    write_csv,
    write_records,
)
from mufly.results import ResultColumn, select_fields, to_records

if TYPE_CHECKING:
    from mufly.cfd import CfdSolution, OperatingPoint, PairSolution, SpanLoads
    from mufly.rotor import Rotor
    from mufly.rotor.structure.coupled_rounds import AeroelasticSolution


def report_case(folder: Path, rotor: Rotor | None, as_json: bool, rounds: AeroelasticSolution | None = None) -> bool:
    """Print a solution, and write its tables and pictures into the case; return whether the solution has settled.

    ``rounds`` are the rounds of solver and beam of an elastic blade; None for a rigid blade.
    """
    content, show, files, _ = _write_solution_report(folder, rotor)
    if rounds is not None:
        content = {**content, "rounds": rounds}
        told = ", ".join(f"{math.degrees(v):+.2f}" for v in rounds.tip_twist_by_round_rad)
        if not as_json:
            print_lines(
                f"elastic blade, twist of the tip: {told} degrees (blade elements, then after each round); tip up "
                f"{1e3 * rounds.deflection_m[-1]:.2f} mm"
            )
    print_answer(as_json, content, show, files)
    return all(found["verdict"].settled for found in (content, content.get("lower", content)))


def report_pair(folder: Path, rotor: Rotor | None, pair: PairSolution, as_json: bool) -> bool:
    """Print both rotors of a pair and their ratios, by CFD and by other methods; return whether the solution has
    settled.
    """
    from mufly.cfd import draw_pair_span_loads

    upper, show_upper, upper_files, upper_loads = _write_solution_report(folder / "upper", rotor)
    lower, show_lower, lower_files, lower_loads = _write_solution_report(folder / "lower", rotor)
    files = [save_figure(draw_pair_span_loads(pair), folder, "pair"), *upper_files, *lower_files]
    ratios = [("cfd", pair.upper.verdict, pair.lower.verdict), *_pair_by_method(upper_loads, lower_loads)]

    def print_pair() -> None:
        show_upper()
        show_lower()
        _print_pair_ratios(ratios)
        up, low = pair.midway_downwash_m_s
        make_console().print(
            f"Half way between the discs the mean downward velocity is {up:.2f} m/s under the upper rotor's blades and "
            f"{low:.2f} m/s in the lower one's case.",
            highlight=False,
        )
        if not pair.settled:
            make_console().print("Not settled: do not rely on these numbers.", style="yellow", highlight=False)

    ratios_of = select_fields(pair, "settled thrust_ratio torque_ratio midway_downwash_m_s")
    print_answer(as_json, {**ratios_of, "upper": upper, "lower": lower}, print_pair, files)
    return pair.settled


def report_climb_thrust(folder: Path, rotor: Rotor | None, solutions: list[CfdSolution], as_json: bool) -> None:
    """Print, write and draw the thrust over the climb velocity."""
    from mufly.cfd import compare_climbs, draw_climb_comparison
    from mufly.vehicle import load_coefficient_map

    found = compare_climbs(solutions, rotor, load_coefficient_map("walkera-5g6-bemt"))
    columns = {"cfd": found.c_T, **found.other_methods, "map_over_hover": found.map_thrust_ratio}
    coefficients = {name if "map" in name else f"c_T_{name}": values for name, values in columns.items()}
    rows = to_records(
        {
            "climb_m_s": found.climb_m_s, **coefficients,
            "torque_Nm": [s.verdict.torque_Nm for s in found.solutions],
            "verdict": [s.verdict.outcome for s in found.solutions],
        }
    )  # fmt: skip
    files = [write_records(folder / "inflow.csv", rows), save_figure(draw_climb_comparison(found), folder, "inflow")]
    slopes = {
        name: {f"{reach:g}": found.thrust_slope(values, reach) for reach in (0.5, 1.0)}
        for name, values in columns.items()
    }

    def print_climb_thrust() -> None:
        names = (name.replace("_over_", ", of ") for name in columns)
        heads = (ResultColumn(key, head=name) for key, name in zip(list(rows[0])[1:-2], names, strict=True))
        title = "c_T by each method, and thrust of the flight model's map over its thrust in hover"
        print_result_table(rows, [ResultColumn("climb_m_s", form="g"), *heads, "torque_Nm", "verdict"], title=title)
        lines = [(n, *(f"{100 * x:+.1f} %" for x in of.values())) for n, of in slopes.items()]
        print_table(("thrust for 1 m/s of climb", "from -0.5 to 0.5", "from -1 to 1 m/s"), lines)

    print_answer(as_json, {"points": rows, "thrust_for_1_m_s": slopes}, print_climb_thrust, files)


def _pair_by_method(upper: list[SpanLoads], lower: list[SpanLoads]) -> list[tuple[str, Any, Any]]:
    return [(a.method, a, b) for a, b in zip(upper, lower, strict=False)]


def _write_solution_report(
    folder: Path, rotor: Rotor | None
) -> tuple[dict[str, Any], Callable[[], None], list[Path], list[SpanLoads]]:
    """Write a solution's tables and pictures; return the data, the printing function, the files, and other methods'
    loads."""
    import numpy as np

    from mufly import cfd
    from mufly.cfd.rotor_pair import read_actuator_disc

    poly = cfd.read_poly_mesh(folder)
    found = cfd.read_solution(folder, poly)
    below = found.point.other_m > 0.0
    other = read_actuator_disc(folder)
    others = [] if rotor is None else cfd.predict_span_loads(rotor, found, other, int(below))
    low = cfd.read_solution(folder, poly, patch="blade_lower") if found.point.gap_m else None
    others_low = [] if rotor is None or low is None else cfd.predict_span_loads(rotor, found, None, 1)
    place = folder / "results"
    past = cfd.read_load_history(folder)
    points, faces, data = cfd.extract_blade_surface(poly, found)
    files = [
        write_csv(place / "history.csv", ("iteration", "thrust_N", "torque_Nm"), past),
        write_csv(
            place / "loads.csv", ("r_m", "dr_m", "thrust_N_m", "torque_Nm_m", "reversed_flow_fraction"),
            zip(found.r_m, found.dr_m, found.thrust_N_m, found.torque_Nm_m, found.reversed_flow_fraction, strict=True),
        ),
        save_figure(cfd.draw_span_loads(found, others), place, "loads"),
        save_figure(cfd.draw_surface_pressure(poly, found), place, "pressure"),
        save_figure(cfd.draw_iteration_history(past), place, "history"),
        cfd.write_vtp(place / "blades.vtp", points, faces, data),
        cfd.write_glb(place / "blades.glb", points, faces, cfd.map_colours(data["pressure_Pa"]), found.point.rotor),
    ]  # fmt: skip
    flow = cfd.read_flow(folder, poly)
    second = low or other
    wake = cfd.compute_wake_profile(poly, flow, found.point, found.thrust_N + (second.thrust_N if second else 0.0))
    vortices = cfd.extract_vortex_surface(poly, flow, found.point)
    files += [
        save_figure(cfd.draw_skin_friction(poly, found), place, "friction"),
        save_figure(cfd.draw_vorticity(poly, flow, found.point), place, "vorticity"),
        save_figure(cfd.draw_vortices(vortices, poly, found.point), place, "vortices"),
        save_figure(cfd.draw_wake_profile(wake), place, "wake"),
        cfd.write_vtp(place / "vortices.vtp", *vortices),
        cfd.write_glb(
            place / "vortices.glb",
            *vortices[:2],
            cfd.map_colours(cfd.average_faces_at_points(*vortices[:2], vortices[2]["down_m_s"])),
            found.point.rotor,
            shared=True,
        ),
        write_csv(
            place / "wake.csv",
            ("below_m", "r_m", "down_m_s", "swirl_m_s"),
            (
                (h, *row)
                for h, down, swirl in zip(wake.below_m, wake.down_m_s, wake.swirl_m_s, strict=True)
                for row in zip(wake.r_m, down, swirl, strict=True)
            ),
        ),
    ]

    kept = (
        "verdict thrust_N torque_Nm power_W c_T c_Q figure_of_merit friction_torque_fraction r_m dr_m thrust_N_m "
        "torque_Nm_m reversed_flow_fraction"
    )
    content = {
        "point": found.point,
        **select_fields(found, f"{kept} max_eddy_viscosity_ratio wake_torque_ratio wake_thrust_ratio"),
        "yplus_largest": float(found.yplus.max()), "yplus_median": float(np.median(found.yplus)),
        "beside": {o.method: select_fields(o, "thrust_N torque_Nm") for o in others},
        **({} if low is None else {"lower": select_fields(low, kept)}),
    }  # fmt: skip

    def print_solution() -> None:
        side = found.point.other_m
        _print_solution(
            found, others, found.point, "lower rotor: " if side > 0 else "upper rotor: " if side < 0 else ""
        )
        if low is not None:
            under = replace(low.point, pitch_rad=low.point.lower_pitch_rad, speed_rad_s=low.point.lower_rad_s)
            _print_solution(low, others_low, under, "lower rotor: ")
            _print_pair_ratios([("cfd", found.verdict, low.verdict), *_pair_by_method(others, others_low)])

    return content, print_solution, files, others


def _print_pair_ratios(pairs: list[tuple[str, Any, Any]]) -> None:
    """Print the lower rotor of a pair relative to the upper one, by every method."""
    rows = [
        (name, f"{low.thrust_N / up.thrust_N:.3f}", f"{low.torque_Nm / up.torque_Nm:.3f}") for name, up, low in pairs
    ]
    print_table(("lower over upper rotor", "thrust", "torque"), rows)


def _print_solution(found: CfdSolution, others: list[SpanLoads], p: OperatingPoint, what: str) -> None:
    import numpy as np

    from mufly.quantities.units import RPM

    v = found.verdict
    c = make_console()
    c.print(
        f"{what}[bold]{p.rotor}[/bold]  {math.degrees(p.pitch_rad):.4g}°, "
        f"{p.speed_rad_s / RPM:.0f} rpm, {p.model}, "
        f"{p.level} mesh, {v.iterations} iterations: {v.outcome}",
        highlight=False,
    )
    if p.geometry_note:
        c.print(f"With {p.geometry_note}; blade elements and wake are computed for the plain blade.", highlight=False)
    rows = [("cfd", f"{v.thrust_N:.4f}", f"{1e3 * v.torque_Nm:.4f}", "", "")]
    rows += [
        (o.method, f"{o.thrust_N:.4f}", f"{1e3 * o.torque_Nm:.4f}", f"{100 * (v.thrust_N / o.thrust_N - 1):+.1f} %",
         f"{100 * (v.torque_Nm / o.torque_Nm - 1):+.1f} %")
        for o in others
    ]  # fmt: skip
    print_table(("", "thrust (N)", "torque (mN m)", "cfd, difference in thrust", "in torque"), rows)
    c.print(
        f"Drift {100 * v.drift:.2g} % and swing {100 * v.swing:.2g} % in the last 400 iterations, outflow "
        f"{1e3 * v.outflow_m3_s:.3g} l/s at the bottom, continuity {v.leak:.1e}; friction is "
        f"{100 * found.friction_torque_fraction:.0f} % of the torque; y+ up to {found.yplus.max():.2g}, median "
        f"{np.median(found.yplus):.2g}; figure of merit {found.figure_of_merit:.3f}"
        + (
            f"; the air below carries {100 * found.wake_torque_ratio:.0f} % of the torque, "
            f"{100 * found.wake_thrust_ratio:.0f} % of the thrust"
            if np.isfinite(found.wake_torque_ratio)
            else ""
        )
        + (
            f"; turbulent over molecular viscosity up to {found.max_eddy_viscosity_ratio:.3g}"
            if found.max_eddy_viscosity_ratio
            else ""
        ),
        highlight=False,
    )
    left = 100 * float(np.average(found.reversed_flow_fraction, weights=found.dr_m))
    c.print(
        f"The flow is separated on {left:.0f} % of the upper side (friction towards the leading edge).", highlight=False
    )
    if not v.settled:
        c.print(f"Not settled ({v.outcome}): do not rely on these numbers.", style="yellow", highlight=False)
