"""``mufly rotor benchmark``: measured rotors, predicted by this package's methods and by external codes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from mufly.cli.options import JsonOption, OutOption, define_option
from mufly.cli.output import (
    check_output_place,
    print_answer,
    print_files,
    print_lines,
    print_result_table,
    progress_bar,
    save_figure,
    write_records,
)
from mufly.cli.rotor import app as rotor_commands
from mufly.errors import MuflyError
from mufly.results import columns_to_rows, select_fields

if TYPE_CHECKING:
    from mufly.study.benchmark import RotorScore


@rotor_commands.command()
def benchmark(
    data: Annotated[
        Path,
        define_option(
            "--data DIR",
            "Folder with the measurements; docs/how-to/score-a-rotor-code.md lists them and their sources.",
        ),
    ],
    code: Annotated[
        list[str] | None,
        define_option(
            "[NAME=]WHAT",
            "Method to score: bemt, wake, cfd:DIR (solved cases of `mufly cfd`), module:function, or a "
            "command with {folder} among its words. Repeat it for more. Default: bemt.",
        ),
    ] = None,
    only: Annotated[
        str,
        define_option("NAMES", "Rotors or groups to include, separated by commas; parts of names match. Default: all."),
    ] = "",
    points: Annotated[
        int, define_option("N", "Largest number of points of each rotor; 0: all, for wakes 3.", min=0)
    ] = 0,
    held_out: Annotated[
        bool,
        define_option(
            "--held-out",
            "Also fit each rotor to one point and to half of its sweep, and score the other points; "
            "score 90 % intervals that are fitted to other families of rotors.",
        ),
    ] = False,
    n_crit: Annotated[
        float | None,
        define_option(
            "--n-crit N",
            "Amplification exponent of transition (e^N) for bemt and wake. Default: 0.1, for tunnel data "
            "that of the tunnel.",
        ),
    ] = None,
    limit: Annotated[
        float, define_option("--limit", "Time limit of a command for each rotor.", unit="s", min=0.1)
    ] = 600.0,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Score prediction methods on the public measurements in a folder: table, picture, CSV.

    With --out, predictions are stored and a stopped run resumes. No method is scored on data to which it is fitted.
    Examples: mufly rotor benchmark --data aero; mufly rotor benchmark --data aero --code bemt --code
    mine=my_code:predict --out scores; mufly rotor benchmark --data aero --code "qprop=python run.py {folder}"
    """
    from mufly.study import benchmark as room

    check_output_place("--out", out)
    codes = [room.parse_code(text, n_crit=n_crit, limit_s=limit) for text in code or ["bemt"]]
    cases, missing = room.load_cases(data, only)
    with progress_bar("rotors", not as_json) as progress:
        scores = room.score_codes(cases, codes, points=points, slow_points=points or 3, folder=out, progress=progress)
    if held_out:
        with progress_bar("intervals", not as_json) as progress:
            scores += room.score_prediction_intervals(cases, progress)
    for share in ("one", "half") if held_out else ():
        with progress_bar(f"fitted to {share}", not as_json) as progress:
            scores += room.score_held_out_points(cases, share, progress)
    with progress_bar("tunnel", not as_json) as progress:
        advancing = room.score_propellers(cases, codes, progress)
    tunnel = room.tabulate_propeller_scores(advancing)
    rows, by_family = room.tabulate_by_group(scores), room.tabulate_by_family(scores)
    files = []
    if out is not None:
        files = [save_figure(room.draw_scores(scores), out, "errors"), _write_points_csv(scores, out / "points.csv")]
        files += [write_records(out / "scores.csv", [select_fields(r, _GROUP_SCORE_FIELDS) for r in rows])]
        files += [write_records(out / "families.csv", [select_fields(r, _GROUP_SCORE_FIELDS) for r in by_family])]
        if advancing:
            files.append(
                write_records(out / "advancing.csv", [select_fields(s, _TUNNEL_SCORE_FIELDS) for s in advancing])
            )
    if as_json:
        content = {
            "scores": rows, "families": by_family, "missing": missing,
            "rotors": [select_fields(s, _ROTOR_SCORE_FIELDS) for s in scores], "advancing": tunnel,
            "advancing_runs": [select_fields(s, _TUNNEL_SCORE_FIELDS) for s in advancing],
        }  # fmt: skip
        return print_answer(as_json, content, None, files)
    print_result_table(rows, room.SCORE_COLUMNS, title="mean absolute error over the rotors of a group")
    if len(by_family) > len(rows):
        print_result_table(by_family, room.SCORE_COLUMNS, title="by family")
    tunnel += room.tabulate_propeller_scores(advancing, by_family=True)
    print_result_table(tunnel, room.PROPELLER_SCORE_COLUMNS, title="wind tunnel runs, mean over the rotors of a group")
    faults = [f"{s.code}, {s.case.name}: {s.fault}" for s in scores if s.fault]
    faults += [f"{a.code}, {a.case.name}: {a.fault}" for a in advancing if a.fault]
    print_lines(*dict.fromkeys(faults), style="yellow")
    print_lines(*missing, mark="not scored or with an assumption", style="dim")
    print_files(files)
    silent = sorted({r.code for r in rows} - {r.code for r in rows if r.unpredicted < r.points})
    if silent:
        raise MuflyError(f"{', '.join(silent)}: has no prediction for any point; see the lines above")


_GROUP_SCORE_FIELDS = (
    "code group rotors points thrust_error=thrust thrust_bias torque_error=torque torque_bias "
    "thrust_inside_90=thrust_inside torque_inside_90=torque_inside without_answer=unpredicted"
)
_ROTOR_SCORE_FIELDS = (
    "code rotor=case.name group=case.group family=case.family section_known=case.section_known "
    "thrust_error torque_error fault"
)
_TUNNEL_SCORE_FIELDS = (
    "code rotor=case.name family=case.family speed_rad_s efficiency=measured.max_efficiency "
    "best_advance_ratio=measured.best_advance_ratio zero_thrust_advance_ratio=measured.zero_thrust_advance_ratio "
    "efficiency_error=relative_errors.0 best_advance_ratio_error=relative_errors.1 "
    "zero_thrust_advance_ratio_error=relative_errors.2"
)


def _write_points_csv(scores: list[RotorScore], path: Path) -> Path:
    rows: list[dict[str, Any]] = []
    for s in scores:
        m = s.case.measured
        points = columns_to_rows(
            {
                "pitch_deg": np.degrees(m.pitch_rad), **select_fields(m, "speed_rad_s thrust_N torque_Nm"),
                **select_fields(s, "thrust_error torque_error"),
            }
        )  # fmt: skip
        about = select_fields(s, "code rotor=case.name group=case.group family=case.family")
        rows += [{**about, **point} for point in points]
    return write_records(path, rows)
