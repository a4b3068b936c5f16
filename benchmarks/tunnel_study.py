"""Propellers in UIUC's tunnel: where the errors of efficiency and of the advance ratio without thrust come from.

    python benchmarks/tunnel_study.py DIR    # DIR as for `mufly rotor benchmark --data`; two minutes

First, for each run: the turn of the blade that puts the advance ratio without thrust right (there is next to no induced
velocity there, so it is an error of geometry, zero-lift angle or of what hangs on the shaft); how steep the thrust then
falls, and how much power is left without thrust, predicted over measured; and what the same turn does to hover, which
it has not seen. Then what a fit to the runs says: its error at tunnel points that it has not seen, and in hover, of
which it saw nothing. Then the scores of `mufly rotor benchmark`, each choice by itself.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from mufly.rotor import (
    Blading,
    RotorMeasurements,
    compare_measurements,
    fit_rotor,
    prepare_blading,
    solve_rotor_batch,
)
from mufly.study.benchmark import PredictionCode, RotorCase, RotorPrediction, load_cases
from mufly.study.benchmark.benchmark_scores import select_points
from mufly.study.benchmark.propeller_efficiency import score_propellers, tabulate_propellers

Array = NDArray[np.float64]

_TURN = 0.15  # rad, most that is sought
_HUB, _HUB_DRAG = 0.1, 0.9
"""Hub over R, and drag coefficient of a blunt cylinder along the flow (Hoerner, Fluid-Dynamic Drag, 1965, ch. III)."""


def _loads(blading: Blading, case: RotorCase, run: RotorMeasurements, turn: float) -> tuple[Array, Array]:
    out = solve_rotor_batch(blading, pitch_rad=turn, speed_rad_s=run.speed_rad_s, climb_m_s=run.climb_m_s, air=case.air)
    return out.thrust_N, out.power_W


def _turn(blading: Blading, case: RotorCase, run: RotorMeasurements, airspeed: float) -> float:
    """Turn of the blade (rad) that leaves no thrust at an airspeed (m/s)."""

    def thrust(turn: float) -> float:
        out = solve_rotor_batch(
            blading, pitch_rad=turn, speed_rad_s=run.speed_rad_s[0], climb_m_s=airspeed, air=case.air
        )
        return float(out.thrust_N)

    return float(brentq(thrust, -_TURN, _TURN))


def report_runs(cases: list[RotorCase], n_crit: float) -> None:
    """What each run says."""
    print(
        f"\n| n_crit {n_crit:g} | turn, degrees | slope of thrust | power without thrust | hover: c_T, c_P | turned |"
    )
    print("|---|---|---|---|---|---|")
    for case in cases:
        blading, rows = prepare_blading(case.rotor, n_crit=n_crit), []
        for run in case.tunnel_runs:
            speed = float(run.speed_rad_s[0])
            j = run.climb_m_s / (2.0 * case.rotor.radius_m * speed / (2.0 * np.pi))
            fast = j > 0.6 * j[-1]
            slope, level = np.polyfit(j[fast], run.thrust_N[fast], 1)
            free = -level / slope
            airspeed = free * run.climb_m_s[-1] / j[-1]
            turn = _turn(blading, case, run, airspeed)
            thrust, power = _loads(blading, case, run, turn)
            mine = np.polyfit(j[fast], thrust[fast], 1)[0]
            measured = np.interp(free, j, run.torque_Nm * speed)
            rows.append((np.degrees(turn), mine / slope, np.interp(free, j, power) / measured))
        turn, steep, left = np.mean(rows, axis=0)
        turned = replace(case.measured, pitch_rad=case.measured.pitch_rad + np.radians(turn))
        hover = []
        for bench in (case.measured, turned):
            found = compare_measurements(blading, bench, air=case.air)
            hover.append(f"{100 * found.thrust_error.mean():+.0f}, {100 * found.torque_error.mean():+.0f} %")
        print(f"| {case.name} | {turn:+.1f} | {steep:.2f} | {left:.2f} | {hover[0]} | {hover[1]} |")


def _code(name: str, made: Callable[[RotorCase], Blading], *, hub: bool = False) -> PredictionCode:
    """Blade elements on a rotor as ``made`` lays it out, with or without the drag of its hub."""

    def predict(case: RotorCase) -> RotorPrediction:
        thrust, power = _loads(made(case), case, case.measured, 0.0)
        if hub:
            area = np.pi * (_HUB * case.rotor.radius_m) ** 2
            thrust = thrust - 0.5 * case.air.density_kg_m3 * case.measured.climb_m_s**2 * _HUB_DRAG * area
        return RotorPrediction(thrust, power / case.measured.speed_rad_s)

    return PredictionCode(name, predict)


def _fitted(cases: list[RotorCase], whole: bool) -> dict[str, Blading]:
    out = {}
    for case in cases:
        n = case.measured.thrust_N.size
        seen = np.arange(n) if whole else np.array([n // 2])
        section = "known" if case.section_known else "guessed"
        fit = fit_rotor(case.rotor, select_points(case, seen).measured, section=section, air=case.air)
        out[case.name] = prepare_blading(fit.rotor)
    return out


def report_fits(cases: list[RotorCase], n_crit: float) -> None:
    """Sections fitted to runs in the tunnel."""
    print("\n| fitted to the tunnel | turn, degrees | held out: thrust, torque | hover: c_T, c_P before | after |")
    print("|---|---|---|---|---|")
    rows = []
    for case in cases:
        runs = [np.stack((r.pitch_rad, r.speed_rad_s, r.thrust_N, r.torque_Nm, r.climb_m_s)) for r in case.tunnel_runs]
        pitch, speed, thrust, torque, climb = np.concatenate(runs, axis=1)
        tunnel = RotorMeasurements(pitch, speed, thrust, torque, "tunnel", climb)
        section = "known" if case.section_known else "guessed"
        found = fit_rotor(case.rotor, tunnel, section=section, air=case.air, n_crit=n_crit)
        errors = []
        for blading in (prepare_blading(case.rotor), prepare_blading(found.rotor, n_crit=n_crit)):
            hover = compare_measurements(blading, case.measured, air=case.air)
            errors += [np.abs(hover.thrust_error).mean(), np.abs(hover.torque_error).mean()]
        rows.append([np.degrees(found.change[0]), *(100 * found.held_out), *(100 * np.array(errors))])
        t, *e = rows[-1]
        cells = (f"{a:.1f}, {b:.1f} %" for a, b in zip(e[::2], e[1::2], strict=True))
        print(f"| {case.name} | {t:+.1f} | " + " | ".join(cells) + " |", flush=True)
    m = np.mean(np.array(rows)[:, 1:], axis=0)
    print(f"| all | | {m[0]:.1f}, {m[1]:.1f} % | {m[2]:.1f}, {m[3]:.1f} % | {m[4]:.1f}, {m[5]:.1f} % |")


def main() -> None:
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    cases = [case for case in load_cases(Path(sys.argv[1]))[0] if case.tunnel_runs]
    for n_crit in (0.1, 8.15):
        report_runs(cases, n_crit)
    report_fits(cases, 8.15)
    one, whole = _fitted(cases, whole=False), _fitted(cases, whole=True)
    choices = [
        _code("default", lambda c: prepare_blading(c.rotor)),
        _code("hub", lambda c: prepare_blading(c.rotor), hub=True),
        _code("n_crit 4", lambda c: prepare_blading(c.rotor, n_crit=4.0)),
        _code("n_crit 4, hub", lambda c: prepare_blading(c.rotor, n_crit=4.0), hub=True),
        _code("n_crit 8.15", lambda c: prepare_blading(c.rotor, n_crit=8.15)),
        _code("n_crit 8.15, hub", lambda c: prepare_blading(c.rotor, n_crit=8.15), hub=True),
        _code("one static point", lambda c: one[c.name]),
        _code("one static point, hub", lambda c: one[c.name], hub=True),
        _code("whole static run", lambda c: whole[c.name]),
    ]
    scores = score_propellers(cases, choices)
    print("\n| | efficiency | its J | J without thrust |\n|---|---|---|---|")
    for row in tabulate_propellers(scores):
        cells = (f"{100 * s:.1f} % ({100 * b:+.1f})" for s, b in zip(row.size, row.bias, strict=True))
        print(f"| {row.code} | " + " | ".join(cells) + " |")
    print("\n| J without thrust, bias | " + " | ".join(c.name for c in choices) + " |\n|" + "---|" * (len(choices) + 1))
    families = tabulate_propellers(scores, by_family=True)
    for family in dict.fromkeys(row.group for row in families):
        cells = (f"{100 * row.bias[2]:+.1f} %" for row in families if row.group == family)
        print(f"| {family} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
