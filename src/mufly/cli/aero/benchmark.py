"""``mufly rotor benchmark``: measured rotors, predicted by mufly's methods and by anybody's code."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np

from mufly.cli.options import JsonOption, OutOption, option
from mufly.cli.present import (
    check_folder,
    console,
    print_json,
    print_table,
    progress_bar,
    save_picture,
    tell_files,
    write_csv,
)
from mufly.cli.rotor import app as rotor_commands
from mufly.errors import MuflyError

if TYPE_CHECKING:
    from mufly.study.benchmark import AdvancingRow, AdvancingScore, Code, Prediction, RotorCase, Row, Score


@rotor_commands.command()
def benchmark(
    data: Annotated[
        Path,
        option("--data DIR", "Measurements; which, and where they are to be had: docs/benchmark.md."),
    ],
    code: Annotated[
        list[str] | None,
        option(
            "[NAME=]WHAT",
            "bemt, wake, cfd:DIR (solved cases of `mufly cfd`), module:function, or a command with {folder} among its "
            "words. May be given several times.",
        ),
    ] = None,
    only: Annotated[str, option("NAMES", "Rotors or groups, with commas; a part of the name will do.")] = "",
    points: Annotated[int, option("N", "Points a rotor, at most; 0: all. Wakes: 3.", min=0)] = 0,
    held_out: Annotated[
        bool,
        option(
            "--held-out",
            "Also the 90 % intervals, fitted to the other families of rotors; a point and half of each sweep fitted, "
            "scored on the rest.",
        ),
    ] = False,
    n_crit: Annotated[
        float | None,
        option("--n-crit N", "Transition, for bemt and wake; default 0.1, and that of the air in tunnels."),
    ] = None,
    limit: Annotated[
        float, option("--limit", "Time that a command may take for one rotor.", unit="s", min=0.1)
    ] = 600.0,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Predict every public measurement that a folder holds, and score: table, picture, CSV.

    With --out, answers are kept there and a run that was stopped goes on. Nothing is fitted on what it is scored on.
    Examples: mufly rotor benchmark --data aero; mufly rotor benchmark --data aero --code bemt --code
    mine=my_code:predict --out scores; mufly rotor benchmark --data aero --code "qprop=python run.py {folder}"
    """
    from mufly.study import benchmark as room

    check_folder("--out", out)
    codes = [_code(text, n_crit, limit) for text in code or ["bemt"]]
    cases, missing = room.load_cases(data, only)
    with progress_bar("rotors", not as_json) as progress:
        scores = room.run(cases, codes, points=points, slow_points=points or 3, folder=out, progress=progress)
    if held_out:
        with progress_bar("intervals", not as_json) as progress:
            scores += room.cross_validated(cases, progress)
    for share in ("one", "half") if held_out else ():
        with progress_bar(f"fitted to {share}", not as_json) as progress:
            scores += room.held_out(cases, share, progress)
    with progress_bar("tunnel", not as_json) as progress:
        advancing = room.run_advancing(cases, codes, progress)
    tunnel = room.advancing_table(advancing)
    rows, by_family = room.table(scores), room.families(scores)
    files = []
    if out is not None:
        files = [save_picture(room.picture(scores), out, "errors"), _points_csv(scores, out / "points.csv")]
        files.append(write_csv(out / "scores.csv", _HEADS, [_cells(r) for r in rows]))
        files.append(write_csv(out / "families.csv", _HEADS, [_cells(r) for r in by_family]))
        if advancing:
            files.append(
                write_csv(out / "advancing.csv", _TUNNEL_HEADS, [_tunnel_cells(s) for s in advancing])
            )
    if as_json:
        print_json(
            {"scores": rows, "families": by_family, "missing": missing, "rotors": [_rotor(s) for s in scores],
             "advancing": tunnel,
             "advancing_runs": [dict(zip(_TUNNEL_HEADS, _tunnel_cells(s), strict=True)) for s in advancing],
             "files": [str(f) for f in files]}
        )  # fmt: skip
        return
    _show(rows, "mean size of the error, of rotors in a group")
    if len(by_family) > len(rows):
        _show(by_family, "by family")
    if tunnel:
        _show_tunnel(tunnel + room.advancing_table(advancing, by_family=True))
    c = console()
    faults = [f"{s.code}, {s.case.name}: {s.fault}" for s in scores if s.fault]
    faults += [f"{a.code}, {a.case.name}: {a.fault}" for a in advancing if a.fault]
    for text in dict.fromkeys(faults):
        c.print(text, style="yellow", highlight=False)
    for text in missing:
        c.print(f"not in {data}: {text}", style="dim", highlight=False)
    tell_files(files)
    silent = sorted({r.code for r in rows} - {r.code for r in rows if r.without < r.points})
    if silent:
        raise MuflyError(f"{', '.join(silent)}: has no answer for any point; see the lines above")


_HEADS = (
    "code", "group", "rotors", "points", "thrust_error", "thrust_bias", "torque_error", "torque_bias",
    "thrust_inside_90", "torque_inside_90", "without_answer",
)  # fmt: skip


def _cells(row: Row) -> list[float | str]:
    return [
        row.code, row.group, float(row.rotors), float(row.points), row.thrust, row.thrust_bias, row.torque,
        row.torque_bias, row.thrust_inside, row.torque_inside, float(row.without),
    ]  # fmt: skip


def _show(rows: list[Row], title: str) -> None:
    def share(value: float) -> str:
        return f"{100 * value:.0f}" if np.isfinite(value) else "-"

    console().print(title, style="bold")
    print_table(
        ("code", "of", "rotors", "points", "thrust (bias)", "torque (bias)", "held by 90 %"),
        [
            (
                r.code, r.group, f"{r.rotors}", f"{r.points}" + (f" ({r.without} without answer)" if r.without else ""),
                _pair(r.thrust, r.thrust_bias), _pair(r.torque, r.torque_bias),
                f"{share(r.thrust_inside)}, {share(r.torque_inside)}",
            )
            for r in rows
        ],
        text=(0, 1),
    )  # fmt: skip


def _pair(size: float, bias: float) -> str:
    return f"{100 * size:.1f} % ({100 * bias:+.1f})" if np.isfinite(size) else "-"


_TUNNEL_HEADS = (
    "code", "rotor", "family", "speed_rad_s", "efficiency", "best_advance_ratio", "zero_thrust_advance_ratio",
    "efficiency_error", "best_advance_ratio_error", "zero_thrust_advance_ratio_error",
)  # fmt: skip


def _tunnel_cells(s: AdvancingScore) -> list[float | str]:
    m = s.measured
    return [
        s.code, s.case.name, s.case.family, s.speed_rad_s, m.efficiency, m.best_advance, m.zero_thrust, *s.errors
    ]  # fmt: skip


def _show_tunnel(rows: list[AdvancingRow]) -> None:
    console().print("runs in a tunnel: mean size of the error, of rotors in a group", style="bold")
    print_table(
        ("code", "of", "rotors", "runs", "greatest efficiency (bias)", "its advance ratio", "that without thrust"),
        [
            (r.code, r.group, f"{r.rotors}", f"{r.runs}", *(_pair(s, b) for s, b in zip(r.size, r.bias, strict=True)))
            for r in rows
        ],
        text=(0, 1),
    )  # fmt: skip


def _rotor(s: Score) -> dict[str, object]:
    return {
        "code": s.code, "rotor": s.case.name, "group": s.case.group, "family": s.case.family,
        "section_known": s.case.known, "thrust_error": s.thrust_error, "torque_error": s.torque_error, "fault": s.fault,
    }  # fmt: skip


def _points_csv(scores: list[Score], path: Path) -> Path:
    rows: list[list[float | str]] = []
    for s in scores:
        m = s.case.measured
        for k in range(m.thrust_N.size):
            rows.append(
                [s.code, s.case.name, s.case.group, s.case.family, float(np.degrees(m.pitch_rad[k])),
                 float(m.speed_rad_s[k]), float(m.thrust_N[k]), float(m.torque_Nm[k]), float(s.thrust_error[k]),
                 float(s.torque_error[k])]
            )  # fmt: skip
    heads = ("code", "rotor", "group", "family", "pitch_deg", "speed_rad_s", "thrust_N", "torque_Nm", "thrust_error",
             "torque_error")  # fmt: skip
    return write_csv(path, heads, rows)


def _code(text: str, n_crit: float | None, limit_s: float) -> Code:
    from mufly.study.benchmark import Code, code_of

    name, _, what = text.rpartition("=")
    kind, colon, folder = what.partition(":")
    if kind == "cfd" and colon:
        return Code(name or "cfd", lambda case: _solved(Path(folder), case))
    return code_of(text, n_crit=n_crit, limit_s=limit_s)


def _solved(folder: Path, case: RotorCase) -> Prediction:
    """What solved OpenFOAM cases below a folder say of a rotor's points; those within half a per cent are the same."""
    from mufly.cfd import read_point, read_solution
    from mufly.errors import InputError, MuflyError
    from mufly.study.benchmark import Prediction

    if not folder.is_dir():
        raise InputError(
            "--code", f"cfd:{folder}", "is no folder", "name one that holds cases of `mufly cfd run`"
        )
    m = case.measured
    thrust, torque = (np.full(m.thrust_N.size, np.nan) for _ in range(2))
    faults = []
    for mesh in sorted(folder.rglob("constant/polyMesh")):
        at = mesh.parent.parent
        try:
            point = read_point(at)
            same = np.flatnonzero(
                (point.rotor == case.rotor.name)
                & (np.abs(m.speed_rad_s / point.speed_rad_s - 1.0) < 5e-3)
                & (np.abs(m.pitch_rad - point.pitch_rad) < 1e-3)
            )
            if same.size:
                found = read_solution(at)
                thrust[same], torque[same] = found.thrust_N, found.torque_Nm
        except MuflyError as error:
            faults.append(f"{at.name}: {error}")
    return Prediction(thrust, torque, "; ".join(faults))
