"""Rotor methods beside measurements, terms of the theory and other codes, as Markdown tables.

    python benchmarks/validate_rotors.py PART [--data DIR] [--keep DIR] [--method bemt,tubes,wake] [--record]

``mufly rotor benchmark`` scores any code on single rotors; this script holds what needs more than its scores:

=================  ================================================================================ ==============
part               table                                                                            time, two cores
=================  ================================================================================ ==============
table-3.2          four points: methods, the dissertation's CFD, open choices                       10 s; wake 5 min
singles            all other single rotors, one by one; wakes at three or five points               10 s; wake 15 min
held-out           sections fitted to a part of each sweep, scored on the rest                      1 min
variants           each correction, transition and assumed section: mean errors, blade elements     20 s
intervals          share of measurements inside 90 % intervals                                      10 s
stations           Caradonna and Tung: thrust from five stations beside that of the whole blade     1 min
momentum           thrust from momentum through planes below the disc, by the wake                  2 min
pair               the dissertation's pair: equal speeds, torque balance, spacing                   5 s; wake 5 min
pair-28            the measured 28 inch pair, each rotor                                            10 s; wake 4 min
pair-ratios        blade elements against the wake over speed ratio and spacing                     5 min
pair-spacing       share of the lower rotor over the spacing by three methods                       2 min
pair-blades        share of the lower rotor over planform and pitch, beside a rig of unknown blades 2 min
inner-inflow       wide blades by blade elements and by the wake: errors, angles, inflow                20 s
sections           unknown sections: each fitted to half a sweep, scored on the other half          2 min
scatter            bounds by the scatter of measurements on fits to a part of a sweep               5 s
turned             blades turned until thrust fits: the error of torque that is left                5 s
polars [NAME ...]  NeuralFoil beside XFOIL (Debian: apt install xfoil)                              2 min
inplane-drag       drag of the rotors in their planes: `rotors.inplane_drag` of a vehicle file      5 s
caradonna-cfd DIR  Caradonna and Tung by OpenFOAM: lift of five stations, pressures of one          10 CPU min
=================  ================================================================================ ==============

The measurements (default ../shared/data/aero) stay outside the project; docs/how-to/score-a-rotor-code.md lists them.
Assumptions on unrecorded sections stand in ``mufly.study.benchmark.rotor_cases``. With ``--keep``, solved wakes are
written to a folder, and a stopped run resumes; empty it after a change of the wake method. Wakes are solved by default
where a part needs them. ``--record`` writes the figures to ``docs/figures.json``. (*): not converged; (c):
converged with a thicker core of old wakes than the first tried.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from figure_record import RECORD_HELP, make_recorder
from rotor_checks import (
    C_T,
    report_caradonna_cfd,
    report_inner_inflow,
    report_inplane_drag,
    report_pair_blades,
    report_polars,
    report_scatter,
    report_sections,
    report_turned,
)
from rotor_tables import LIFT, bootstrap_share, percent, show_table, sizes

from mufly.errors import MuflyError
from mufly.files.answer_store import hash_inputs, read_stored_result, write_stored_result
from mufly.files.text_table import read_text_table
from mufly.quantities.units import RPM
from mufly.rotor import (
    TEXTBOOK_CORRECTIONS,
    Air,
    Blading,
    Corrections,
    OperatingCondition,
    RotorSystem,
    SystemSolution,
    calibrate_blading,
    compare_measurements,
    compute_airfoil_polars,
    prepare_blading,
    replace_rotor,
    solve_system,
)
from mufly.rotor.measured.uncertainty import THRUST_TORQUE_ERROR_SCALES, fit_student_scale
from mufly.rotor.wake import WakeSettings, compute_momentum_flux_thrust
from mufly.study.benchmark import (
    PredictionCode,
    RotorCase,
    RotorPrediction,
    score_codes,
    score_held_out_points,
    score_prediction_intervals,
    tabulate_by_group,
)
from mufly.study.benchmark.benchmark_scores import select_points
from mufly.study.benchmark.rotor_cases import (
    BENCHMARK_AIR,
    T_MOTOR_AIR,
    load_caradonna_tung,
    load_dji_9443,
    load_t_motor_28,
    load_table_3_2,
    load_uiuc_propellers,
)

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "aero"
PITCH = float(np.radians(14))
SPACINGS_M = (0.01, 0.02, 0.03, 0.04)
DISSERTATION_TRIM = {14: "6650, 0.1949, 2.053", 16: "5750, 0.1820, 1.741", 18: "5025, 0.1709, 1.529"}


def make_blading(
    case: RotorCase,
    *,
    n_crit: float = 0.1,
    corrections: Corrections | None = None,
    section: str = "",
    cutout: float | None = None,
) -> Blading:
    """Lay a case out with another transition, corrections, section or hub cut-out."""
    rotor = case.rotor if cutout is None else replace_rotor(case.rotor, {"hub_cutout": cutout})
    names = list(rotor.airfoil_names())
    tables = compute_airfoil_polars(names, n_crit=n_crit)
    if section:
        tables = dict.fromkeys(names, compute_airfoil_polars([section], n_crit=n_crit)[section])
    return prepare_blading(rotor, tables, corrections=corrections)


def make_code(
    name: str,
    method: str = "bemt",
    *,
    settings: WakeSettings | None = None,
    offset_deg: float = 0.0,
    calibrated: bool = False,
    **how: Any,
) -> PredictionCode:
    """Return a method with its choices as a code; ``how`` as in :func:`make_blading`."""

    def predict(case: RotorCase) -> RotorPrediction:
        blading = make_blading(case, **how)
        if calibrated:
            blading = calibrate_blading(blading, case.measured)
        points = replace(case.measured, pitch_rad=case.measured.pitch_rad + math.radians(offset_deg))
        found = compare_measurements(blading, points, air=case.air, method=method, settings=settings)
        return RotorPrediction(found.thrust_N, found.torque_Nm, "; ".join(f for f in found.prediction_faults if f))

    return PredictionCode(name, predict, method == "wake", repr((method, settings, offset_deg, calibrated, how)))


def report_table_3_2(asked: argparse.Namespace) -> None:
    """Four points: methods, calibration on the first point, the dissertation's CFD, and what open choices do."""
    case = load_table_3_2(asked.data)
    printed = read_text_table(asked.data / "thesis_table_3_2.csv").read_matrix()[:, 4:]

    def cfd(k: int) -> PredictionCode:
        return PredictionCode(
            ("CFD laminar", "CFD k-epsilon", "CFD k-omega", "CFD BSL")[k],
            lambda _: RotorPrediction(printed[:, 2 * k], printed[:, 2 * k + 1]),
        )

    codes = [make_code("bemt"), make_code("bemt, calibrated on the first", calibrated=True), *map(cfd, range(4))]
    if "wake" in asked.method:
        codes += [
            make_code("wake", "wake"),
            *(make_code(f"wake, n_crit {x:g}", "wake", n_crit=x) for x in (1.0, 4.0, 9.0)),
            *(make_code(f"wake, hub cut-out {x:g} R", "wake", cutout=x) for x in (0.1, 0.2)),
            make_code("wake, inviscid", "wake", settings=WakeSettings(inviscid=True)),
            make_code("wake, prescribed", "wake", settings=WakeSettings(model="prescribed")),
            make_code("wake, pitch +0.8 deg (not applied)", "wake", offset_deg=0.8),
        ]
    scores = score_codes([case], codes, slow_points=0, folder=asked.keep)
    rows = [[s.code, sizes(s.thrust_error), sizes(s.torque_error), s.fault] for s in scores]
    show_table("Table 3.2: error of four points, mean size (bias), %", ["", "thrust", "torque", "fault"], rows)
    by_code = {s.code: np.stack((s.thrust_error, s.torque_error)) + 1 for s in scores}
    mean_cfd = np.mean([by_code[f"CFD {n}"] for n in ("laminar", "k-epsilon", "k-omega")], axis=0)
    for name in ("bemt", "wake"):
        if name in by_code:
            thrust, torque = (sizes(v) for v in by_code[name] / mean_cfd - 1)
            print(f"{name} over the mean of the first three CFD models, %: thrust {thrust}; torque {torque}\n")
            size = 100 * np.abs(by_code[name] - 1)
            if name == "bemt":
                asked.record("bemt_table_mean", *size.mean(axis=1))
            asked.record(f"{name}_table" + ("_worst" if name == "bemt" else ""), *size.max(axis=1))


def load_singles(data: Path) -> list[RotorCase]:
    """Return all single rotors."""
    others = [load_dji_9443(data), load_caradonna_tung(data), load_t_motor_28(data)]
    return [load_table_3_2(data), *load_uiuc_propellers(data), *others]


def report_singles(asked: argparse.Namespace) -> None:
    """Propellers, DJI 9443, Caradonna and Tung, T-motor 28: all points by blade elements, some by the wake."""
    cases, scores = load_singles(asked.data)[1:], []
    if "bemt" in asked.method:
        scores += score_codes(cases, [make_code("bemt")])
    if "wake" in asked.method:
        for case in cases:
            n, propeller = case.measured.thrust_N.size, case.group == "UIUC micro"
            few = np.array([0, n // 2, n - 1]) if propeller else np.unique(np.linspace(0, n - 1, 5).round().astype(int))
            wanted = [
                make_code(f"{m}, {'3' if propeller else '5'} points, n_crit {x:g}", m, n_crit=x)
                for x in ((0.1,) if propeller else (0.1, 4.0, 9.0))
                for m in ("wake", "bemt")
            ]
            scores += score_codes([select_points(case, few)], wanted, slow_points=0, folder=asked.keep)
    rows = [
        [s.case.name, Path(s.case.rotor.airfoil_names()[0]).stem + ("" if s.case.section_known else " (guess)"), s.code,
         sizes(s.thrust_error), sizes(s.torque_error), s.fault]
        for s in scores
    ]  # fmt: skip
    show_table("Single rotors: error, mean size (bias), %", ["rotor", "section", "", "thrust", "torque", "fault"], rows)
    for label, pick in (("all", (True, False)), ("known", (True,)), ("guessed", (False,))):
        part = [s for s in scores if s.case.group == "UIUC micro" and s.case.section_known in pick]
        for r in tabulate_by_group(part):
            print(f"{r.rotors} propellers, section {label}, {r.code}: {100 * r.thrust:.1f} / {100 * r.torque:.1f} %")
            key = {"all": ("bemt", "bemt_uiuc"), "known": ("bemt", "bemt_known")}.get(label, ("", ""))
            if r.code == key[0]:
                asked.record(key[1], 100 * r.thrust, 100 * r.torque)
            if label == "all" and r.code.startswith("wake"):
                asked.record("wake_uiuc", 100 * r.thrust, 100 * r.torque)
    short = {"dji9443": "dji", "caradonna-tung": "caradonna", "tmotor28": "tmotor"}
    for s in scores:
        thrust, torque, name = 100 * np.abs(s.thrust_error), 100 * np.abs(s.torque_error), short.get(s.case.name)
        if name and s.code == "bemt":
            asked.record(f"bemt_{name}", thrust.mean(), *([torque.mean()] if name == "tmotor" else []))
        elif name and s.code == "wake, 5 points, n_crit 0.1":
            middle = thrust.size // 2
            asked.record(f"wake_{name}", *((thrust[middle], torque[middle]) if name == "tmotor" else (thrust.max(),)))


def report_held_out(asked: argparse.Namespace) -> None:
    """Sections of propellers fitted to the middle point, and to every other point, scored on the rest of the sweep."""
    rows, cases = [], load_uiuc_propellers(asked.data)
    for share, key in (("one", "bemt_one_point"), ("half", "bemt_half")):
        (r,) = tabulate_by_group(score_held_out_points(cases, share))
        rows.append([r.code, *(f"{100 * v:.1f}" for v in (r.thrust, r.torque, r.thrust_inside, r.torque_inside))])
        asked.record(key, 100 * r.thrust, 100 * r.torque)
    show_table("Fitted propellers, %", ["", "thrust", "torque", "inside 90 % intervals: thrust", "torque"], rows)


def report_variants(asked: argparse.Namespace) -> None:
    """Mean errors with each correction left out or replaced, other transitions, and one section for guessed ones."""
    cases = load_singles(asked.data)
    changes = {
        "all corrections (default)": Corrections(),
        "plain: no finite chord, no rotation": TEXTBOOK_CORRECTIONS,
        "without finite chord": Corrections(lifting_surface=False),
        "without rotation": Corrections(stall_delay="none"),
        "rotation after Snel": Corrections(stall_delay="snel"),
        "rotation after Chaviaropoulos, Hansen": Corrections(stall_delay="chaviaropoulos-hansen"),
        "without swirl": Corrections(swirl=False),
        "without hub loss": Corrections(hub_loss=False),
        "without tip loss": Corrections(tip_loss="none"),
        "effective radius (eq. 3.13)": Corrections(tip_loss="effective_radius"),
    }
    codes = [make_code(name, corrections=c) for name, c in changes.items()]
    codes += [make_code(f"n_crit {n:g}", n_crit=n) for n in (1.0, 4.0, 9.0)]
    rows = tabulate_by_group(score_codes(cases, codes))
    groups = list(dict.fromkeys(r.group for r in rows))
    found = {(r.code, r.group): f"{100 * r.thrust:.1f} / {100 * r.torque:.1f}".replace(" / nan", "") for r in rows}
    lines = [[c.name, *(found[c.name, g] for g in groups)] for c in codes]
    show_table("Mean error of thrust / torque, %", ["", *groups], lines)
    part = [c for c in cases if c.group == "UIUC micro" and not c.section_known]
    sections = ("naca2408", "clarky", "naca4412", "naca4503", "naca5503", "naca6503", "goe417a")
    rows = tabulate_by_group(score_codes(part, [make_code(s, section=s) for s in sections]))
    lines = [[r.code, f"{100 * r.thrust:.1f} / {100 * r.torque:.1f}"] for r in rows]
    show_table("Propellers of guessed section, one section for all: c_T / c_P error, %", ["section", ""], lines)


def report_intervals(asked: argparse.Namespace) -> None:
    """Share of measurements inside 90 % intervals whose scales are fitted to the other families of rotors.

    The two ranges are 90 % of bootstrap samples of the share of points, over rotors and over families.
    """
    rows, scores = [], score_prediction_intervals(load_singles(asked.data))
    for section in ("known", "guessed"):
        part, shares = [s for s in scores if s.code.endswith(section)], []
        for k, quantity in enumerate(("thrust", "torque")):
            held = [
                (s.case, s.inside_interval[k][known], s.relative_half_width[k])
                for s in part
                if s.inside_interval is not None
                and s.relative_half_width is not None
                and (known := np.isfinite(s.inside_interval[k])).any()
            ]
            inside = [i for _, i, _ in held]
            points = np.concatenate(inside)
            means, widths = np.mean([i.mean() for i in inside]), np.mean([h.mean() for _, _, h in held])
            shares.append(100 * points.mean())
            cells = [f"{shares[-1]:.0f} % of {points.size}", f"{100 * means:.0f} % of {len(held)}"]
            for groups in ([c.name for c, _, _ in held], [c.family for c, _, _ in held]):
                low, high = bootstrap_share(inside, groups)
                cells.append(f"{100 * low:.0f} to {100 * high:.0f} % ({len(set(groups))})")
            rows.append([f"{section}, {quantity}", *cells, f"{100 * widths:.0f} %"])
        asked.record(f"bemt_intervals_{section}", *shares)
    head = ["section", "points inside", "mean of rotors", "range over rotors", "over families", "half width"]
    show_table("90 % intervals, scales fitted to the other families", head, rows)
    errors = [s.standardised_error for s in scores if s.standardised_error is not None]
    fitted, shipped = [fit_student_scale([e[k] for e in errors]) for k in (0, 1)], THRUST_TORQUE_ERROR_SCALES
    print(f"scales fitted to all rotors: {fitted[0]:.3f}, {fitted[1]:.3f}; in mufly: {shipped[0]:g}, {shipped[1]:g}")


def report_stations(asked: argparse.Namespace) -> None:
    """Caradonna and Tung: thrust as the report can have had it, from five stations, beside the whole blade's."""
    case = load_caradonna_tung(asked.data)
    at, m, air, radius = np.array(list(LIFT[5.0])), case.measured, case.air, case.rotor.radius_m

    def from_stations(cl: np.ndarray) -> float:
        """c_T over solidity / 2: straight lines in c_l r^2, 0 at 0.2 R and at the tip."""
        return float(np.trapezoid([0, *(cl * at**2), 0], [0.2, *at, 1.0]))

    rows = []
    for pitch, speed, thrust in zip(m.pitch_rad, m.speed_rad_s, m.thrust_N, strict=True):
        point = OperatingCondition(float(pitch), float(speed), air=air)
        r = solve_system(RotorSystem.from_single_rotor(make_blading(case)), point, "wake").rotors[0]
        pressure = 0.5 * air.density_kg_m3 * (speed * r.r_m) ** 2 * r.chord_m
        cl = np.interp(at, r.r_m / radius, r.dT_N / r.dr_m / pressure / case.rotor.blades)
        ct = thrust / (air.density_kg_m3 * np.pi * radius**4 * speed**2)
        half = case.rotor.blades * float(r.chord_m[0]) / (2 * np.pi * radius)
        measured = LIFT.get(round(math.degrees(pitch)))
        rows.append([
            f"{np.degrees(pitch):.0f}", percent(r.thrust_N, thrust), percent(half * from_stations(cl), ct),
            percent(half * from_stations(np.array(list(measured.values()))), ct) if measured else "",
            *(f"{v:.3f}" for v in cl),
        ])  # fmt: skip
    head = ["pitch", "whole blade", "five stations", "the measured five", *(f"{x:g} R" for x in at)]
    show_table("Caradonna and Tung: deviation from the published c_T, %; lift coefficients by the wake", head, rows)


def report_momentum(asked: argparse.Namespace) -> None:
    """Thrust from the momentum through planes below the disc, over the loads' without profile drag's share."""
    rows, heights = [], (0.3, 0.5, 0.75, 1.0)
    first, dji, slender = load_table_3_2(asked.data), load_dji_9443(asked.data), load_caradonna_tung(asked.data)
    for case, i in ((first, 0), (first, 3), (slender, 1), (slender, 2), (dji, 0)):
        m, air = case.measured, case.air
        point = OperatingCondition(float(m.pitch_rad[i]), float(m.speed_rad_s[i]), air=air)
        found = solve_system(RotorSystem.from_single_rotor(make_blading(case)), point, "wake")
        r = found.rotors[0]
        wind = r.reynolds * air.viscosity_Pa_s / air.density_kg_m3 / r.chord_m
        drag = 0.5 * air.density_kg_m3 * wind**2 * r.chord_m * r.cd * np.sin(r.phi_rad) * r.dr_m
        lift = r.thrust_N + case.rotor.blades * drag.sum()
        through = [compute_momentum_flux_thrust(found, -h * case.rotor.radius_m, reach=10.0) for h in heights]
        label = f"{case.name}, {np.degrees(m.pitch_rad[i]):.0f} deg, {m.speed_rad_s[i] / RPM:.0f} rpm"
        rows.append([label, *(percent(v, lift) for v in through), f"{found.settings.core_limit:g} R"])
    head = ["rotor", *(f"{h:g} R below" for h in heights), "old cores"]
    show_table("Momentum through a plane below the disc, over the thrust: deviation, %", head, rows)


@dataclass(frozen=True)
class Loads:
    """Thrust (N), torque (N m), speed (rad/s) of the upper and lower rotor (or of one), and a mark; see above."""

    thrust: tuple[float, ...]
    torque: tuple[float, ...]
    speed: tuple[float, ...]
    mark: str = ""

    def lower_over_upper(self, of: str) -> float:
        """Ratio of ``"thrust"``, ``"torque"`` or ``"power"``."""
        if of == "power":
            return self.torque[1] * self.speed[1] / (self.torque[0] * self.speed[0])
        upper, lower = getattr(self, of)
        return float(lower / upper)


class PairSolver:
    """Solves two rotors alike, each wake from the last one of its family; keeps the wakes' answers in a folder."""

    def __init__(self, keep: Path | None) -> None:
        self.keep = keep
        self.last: dict[str, SystemSolution] = {}

    def solve(
        self,
        rotor: Blading,
        speeds: tuple[float | None, ...],
        pitch: tuple[float, ...] = (PITCH, PITCH),
        *,
        method: str,
        spacing_m: float = 0.02,
        air: Air = BENCHMARK_AIR,
        settings: WakeSettings | None = None,
        family: str = "",
        label: str = "",
    ) -> Loads:
        """Return the loads; speeds in rad/s, None for the one that balances the torques; one speed: one rotor."""
        key = hash_inputs(label, rotor.r_m, rotor.chord_m, speeds, pitch, spacing_m, asdict(air), repr(settings))
        file = self.keep and method == "wake" and self.keep / f"pair-{key[:24]}.json"
        kept = read_stored_result(file, key) if file else None
        if kept is not None:
            return Loads(*(tuple(kept[n]) for n in ("thrust", "torque", "speed")), kept["mark"])
        alone = len(speeds) == 1
        system = (
            RotorSystem.from_single_rotor(rotor)
            if alone
            else RotorSystem.from_coaxial_pair(rotor, rotor, spacing_m=spacing_m)
        )
        point = OperatingCondition(pitch[: len(speeds)], speeds, air=air)
        more = {"settings": settings, "start": self.last.get(family)} if method == "wake" else {}
        try:
            found = solve_system(system, point, method, **more)
        except MuflyError as error:
            print(f"{label} {speeds}: {error}", file=sys.stderr)
            return Loads(*[(math.nan,) * len(speeds)] * 3, " (*)")
        if family and found.converged:
            self.last[family] = found
        mark = "" if found.converged else " (*)"
        if found.settings and found.converged and (found.settings.core_limit or 0.0) > (0.15 if alone else 0.2):
            mark = "" if settings else " (c)"
        loads = Loads(
            *(tuple(getattr(r, n) for r in found.rotors) for n in ("thrust_N", "torque_Nm", "speed_rad_s")), mark
        )
        if file:
            write_stored_result(file, key, asdict(loads))
        return loads


def report_pair(asked: argparse.Namespace) -> None:
    """The dissertation's pair (Sec. 3.4.7): equal speeds, torque balance, spacing; NACA 0012, 14 degrees, R 60 mm."""
    rotor, solver = make_blading(load_table_3_2(asked.data)), PairSolver(asked.keep)
    for method in asked.method:
        rows = []
        for rpm in (3000, 6000, 7000):
            alone = solver.solve(rotor, (rpm * RPM,), method="bemt" if method == "tubes" else method)
            both = solver.solve(rotor, (rpm * RPM,) * 2, method=method, family="equal")
            if (method, rpm) == ("wake", 6000):
                asked.record("wake_pair_ratio", both.lower_over_upper("thrust"), both.lower_over_upper("torque"))
            rows.append([
                f"{rpm}", f"{alone.thrust[0]:.4f}", f"{both.thrust[0]:.4f}{both.mark}", f"{both.thrust[1]:.4f}",
                percent(both.thrust[0], alone.thrust[0]), percent(both.torque[0], alone.torque[0]),
                f"{both.lower_over_upper('thrust'):.3f}", f"{both.lower_over_upper('torque'):.3f}",
            ])  # fmt: skip
        rows.append(["dissertation", "", "", "", "slightly above 0", "slightly above 0", "0.55", "0.80"])
        head = ["rpm", "alone N", "upper N", "lower N", "upper / alone: thrust %", "torque %", "lower / upper: thrust",
                "torque"]  # fmt: skip
        show_table(f"{method}: equal speeds, spacing 20 mm", head, rows)
        rows = []
        for h in SPACINGS_M:
            equal = solver.solve(rotor, (6000 * RPM,) * 2, method=method, spacing_m=h, family="equal")
            for deg in DISSERTATION_TRIM:
                if method == "wake" and deg != 14 and h != 0.02:
                    continue
                a = solver.solve(
                    rotor, (6000 * RPM, None), (PITCH, math.radians(deg)), method=method, spacing_m=h, family="trim"
                )
                rows.append([
                    f"{1e3 * h:.0f}, {deg}", f"{equal.lower_over_upper('thrust'):.3f}{equal.mark}",
                    f"{a.speed[1] / RPM:.0f}, {a.thrust[1]:.4f}, {a.torque[1] * a.speed[1]:.3f}{a.mark}",
                    DISSERTATION_TRIM[deg] if h == 0.02 else "",
                    f"{100 * (1 - a.lower_over_upper('thrust')):.1f}", f"{100 * (a.lower_over_upper('power') - 1):.1f}",
                    f"{sum(a.thrust):.4f}", f"{np.dot(a.torque, a.speed):.3f}",
                ])  # fmt: skip
        head = ["spacing mm, lower pitch deg", "equal speeds: lower / upper thrust", "balanced: rpm, N, W of the lower",
                "dissertation (23, 10 %)", "thrust deficit %", "power excess %", "both N", "both W"]  # fmt: skip
        show_table(f"{method}: upper rotor at 6000 rpm", head, rows)


def report_pair_28(asked: argparse.Namespace) -> None:
    """The measured 28 inch pair: all speeds by blade elements and tubes, four speeds by the wake."""
    case, solver = load_t_motor_28(asked.data), PairSolver(asked.keep)
    points = read_text_table(asked.data / "tmotor28_coaxial.csv").read_matrix()
    four, rows = points[np.linspace(0, len(points) - 1, 4).round().astype(int)], []
    for method in asked.method:
        for n_crit in (0.1, 4.0, 9.0):
            rotor, errors, marks = make_blading(case, n_crit=n_crit), [], []
            for rpm_l, t_l, q_l, _, t_u, q_u, _, rpm_u in four if method == "wake" else points:
                a = solver.solve(
                    rotor, (rpm_u * RPM, rpm_l * RPM), (0.0, 0.0), method=method, spacing_m=0.115, air=T_MOTOR_AIR,
                    family="28 inch", label=f"28 inch, n_crit {n_crit:g}",
                )  # fmt: skip
                marks.append(a.mark)
                ours = [a.thrust[0], a.torque[0], a.thrust[1], a.torque[1], sum(a.thrust), sum(a.torque)]
                errors.append(np.array(ours) / [t_u, q_u, t_l, q_l, t_u + t_l, q_u + q_l] - 1)
            rows.append([f"{method}, n_crit {n_crit:g}{max(marks)}", *(sizes(v) for v in np.transpose(errors))])
            mean = 100 * np.abs(errors).mean(axis=0)
            if n_crit == 0.1 and method != "bemt":
                name = "wake_big" if method == "wake" else method
                asked.record(f"{name}_upper", *mean[:2])
                asked.record(f"{name}_lower", *mean[2:4])
    head = ["", "upper thrust", "torque", "lower thrust", "torque", "both: thrust", "torque"]
    show_table("28 inch pair: error, mean size (bias), %", head, rows)


def report_pair_ratios(asked: argparse.Namespace) -> None:
    """Blade elements against the wake over speed ratio and spacing, upper rotor at 6000 rpm, both at 14 degrees."""
    rotor, solver, upper = make_blading(load_table_3_2(asked.data)), PairSolver(asked.keep), 6000 * RPM
    ratios = (1.4, 1.2, 1.0, 0.85, 0.7)  # falling: a slow lower rotor hardly lifts, and its wake stays near
    alone = solver.solve(rotor, (upper,), method="wake")
    scale = np.array([alone.thrust[0], alone.torque[0]] * 2)
    found, rows = np.full((len(SPACINGS_M), len(ratios), 4), np.nan), []
    for i, h in enumerate(SPACINGS_M):
        cells = []
        for j, ratio in enumerate(ratios):
            a, b = (
                solver.solve(rotor, (upper, upper * ratio), method=m, spacing_m=h, family="ratios")
                for m in ("wake", "bemt")
            )
            ours, quick = ([x.thrust[0], x.torque[0], x.thrust[1], x.torque[1]] for x in (a, b))
            # The lower rotor may carry next to nothing: deviations are over what a rotor does alone at its speed.
            found[i, j] = 100 * np.subtract(quick, ours) / (scale * np.array([1, 1, ratio**2, ratio**2]))
            cells.append(" / ".join(f"{v:+.0f}" for v in found[i, j]) + a.mark)
        rows.append([f"{1e3 * h:.0f} mm", *cells])
    title = "Blade elements less wake, % of a rotor alone at that speed: upper thrust / torque, lower thrust / torque"
    show_table(title, ["spacing", *(f"speed ratio {r:g}" for r in ratios)], rows)
    size = np.abs(found)
    rows = [["mean", *(f"{v:.1f}" for v in np.nanmean(size, axis=(0, 1)))],
            ["largest", *(f"{v:.1f}" for v in np.nanmax(size, axis=(0, 1)))],
            ["mean at 20 mm", *(f"{v:.1f}" for v in np.nanmean(size[1], axis=0))]]  # fmt: skip
    show_table("The same in sum", ["", "upper thrust", "upper torque", "lower thrust", "lower torque"], rows)


def report_pair_spacing(asked: argparse.Namespace) -> None:
    """Equal speeds, 14 degrees, 6000 rpm: how the thrust is shared over the spacing; old cores held at 0.3 R."""
    rotor, solver, how = make_blading(load_table_3_2(asked.data)), PairSolver(asked.keep), WakeSettings(core_limit=0.3)
    methods, speed, rows = ("wake", "tubes", "bemt"), 6000 * RPM, []
    alone = {m: solver.solve(rotor, (speed,), method=m, settings=how).thrust[0] for m in ("wake", "bemt")}
    for over in (0.1, 1 / 6, 0.25, 0.5, 1.0):
        cells = [f"{over:.3g}"]
        for method in methods:
            a = solver.solve(rotor, (speed,) * 2, method=method, spacing_m=0.12 * over, settings=how)
            cells += [
                f"{a.thrust[0] / alone['wake' if method == 'wake' else 'bemt']:.3f}",
                f"{a.lower_over_upper('thrust'):.3f}{a.mark}",
            ]
        rows.append(cells)
    head = ["z/D", *(f"{m}: {w}" for m in methods for w in ("upper / alone", "lower / upper"))]
    show_table("Thrust over the spacing", head, rows)


PARTS: dict[str, tuple[Callable[[argparse.Namespace], None], tuple[str, ...]]] = {
    "table-3.2": (report_table_3_2, ("bemt", "wake")),
    "singles": (report_singles, ("bemt", "wake")),
    "held-out": (report_held_out, ()),
    "variants": (report_variants, ()),
    "intervals": (report_intervals, ()),
    "stations": (report_stations, ()),
    "momentum": (report_momentum, ()),
    "pair": (report_pair, ("bemt", "tubes", "wake")),
    "pair-28": (report_pair_28, ("bemt", "tubes", "wake")),
    "pair-ratios": (report_pair_ratios, ()),
    "pair-spacing": (report_pair_spacing, ()),
    "pair-blades": (report_pair_blades, ()),
    "inner-inflow": (report_inner_inflow, ()),
    "sections": (report_sections, ()),
    "scatter": (report_scatter, ()),
    "turned": (report_turned, ()),
    "polars": (report_polars, ()),
    "inplane-drag": (report_inplane_drag, ()),
    "caradonna-cfd": (report_caradonna_cfd, ()),
}
"""Part, its function, and the methods that ``--method`` chooses from."""


def main() -> int:
    """Print the tables of a part."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parts = parser.add_subparsers(dest="part", required=True, metavar="PART")
    for name, (report, methods) in PARTS.items():
        part = parts.add_parser(
            name, help=(report.__doc__ or "").split("\n")[0].replace("%", "%%"), description=report.__doc__
        )
        if name not in ("polars", "inplane-drag"):
            part.add_argument("--data", type=Path, default=DATA, metavar="DIR", help="measurements")
            part.add_argument("--keep", type=Path, metavar="DIR", help="keep solved wakes there, and read them again")
        part.add_argument("--record", action="store_true", help=RECORD_HELP)
        if methods:
            part.add_argument("--method", default=",".join(methods), help=f"of {', '.join(methods)}, with commas")
        if name == "polars":
            part.add_argument("names", nargs="*", metavar="NAME", help="sections; default: eight")
        if name == "inplane-drag":
            part.add_argument("--vehicle", default="mufly-1.1", help="vehicle file, or a built-in vehicle")
            part.add_argument("--rotor", default="walkera-5g6", help="rotor file, or a built-in rotor")
        if name == "caradonna-cfd":
            part.add_argument("folder", type=Path, metavar="DIR", help="folder of the case")
            part.add_argument("--model", default="k-epsilon")
            part.add_argument("--mesh", default="coarse")
            part.add_argument("--hub", type=float, default=0.1, help="radius of the hub over R; 0: none")
            part.add_argument("--most", type=int, default=2800, help="iterations, at most")
            part.add_argument("--pitch", type=float, default=8.0, choices=tuple(C_T), help="degrees")
    asked = parser.parse_args()
    asked.record = make_recorder(asked.record)
    report, methods = PARTS[asked.part]
    if methods:
        asked.method = [m for m in asked.method.split(",") if m in methods or parser.error(f"--method {m}: no method")]
    if "data" in asked and not asked.data.is_dir():
        parser.error(f"--data {asked.data}: is no folder; docs/how-to/score-a-rotor-code.md lists the measurements")
    try:
        report(asked)
    except MuflyError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
