"""Commands of studies: ``mufly rotor sweep | rank | parameters``, ``mufly coax sweep | parameters`` and, for the
dissertation, ``mufly thesis``.
"""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from mufly.cli import coax
from mufly.cli.aero.rotor_theory_options import (
    DEFAULT_BEMT_OPTIONS,
    DEFAULT_FREE_WAKE_OPTIONS,
    DEFAULT_POLAR_OPTIONS,
    PolarOptions,
    TheoryOptions,
)
from mufly.cli.coax import THESIS_ROTOR_NAME, LowerArgument, UpperArgument, make_pair_setup
from mufly.cli.options import (
    PITCH_RANGE,
    ClusterOption,
    CommandGroup,
    DriveOption,
    JsonOption,
    RotorArgument,
    default_text,
    define_argument,
    define_option,
    load_drive_option,
)
from mufly.cli.output import (
    make_console,
    print_answer,
    print_files,
    print_json,
    print_lines,
    print_result_table,
    print_table,
    progress_bar,
    save_figure,
    write_text_file,
)
from mufly.cli.rotor import app as rotor_commands
from mufly.errors import InputError, suggest_name
from mufly.quantities.quantity_grammar import parse_values
from mufly.quantities.units import RPM
from mufly.results import ResultColumn, columns_to_rows

if TYPE_CHECKING:
    import xarray as xr

    from mufly.study.study_parameters import ParameterValue, StudyParameterSpec

_MAX_PRINTED_ROWS = 40  # rows of a sweep in the terminal

SetOption = Annotated[
    list[str] | None,
    define_option(
        "--set NAME=VALUE", "Parameter to fix, as thrust=0.4N, speed=5000rpm, gear=adapted. Repeat it for more."
    ),
]
AirfoilsOption = Annotated[
    list[str] | None,
    define_option(
        "--airfoils SET|DIR|NAMES",
        "Airfoils: 'thesis' (247, chosen by rule), 'database' (all), a folder of .dat files, or names "
        "separated by commas.",
    ),
]


def parse_set_options(
    texts: list[str] | None, table: dict[str, StudyParameterSpec], remedy: str
) -> dict[str, ParameterValue]:
    """Return the parameter values that ``--set`` gives, by name; raise InputError if a parameter has several."""
    from mufly.study import parse_parameter_settings

    settings = parse_parameter_settings(texts or [], table)
    for name, values in settings.items():
        if len(values) > 1:
            raise InputError("--set", name, "has several values", remedy)
    return {name: values[0] for name, values in settings.items()}


def _print_parameters(table: dict[str, StudyParameterSpec], as_json: bool) -> None:
    if as_json:
        return print_json(
            {k: {"unit": p.unit, "units": list(p.accepted_units), "meaning": p.meaning} for k, p in table.items()}
        )
    print_table(
        ("parameter", "units", "meaning"),
        [(name, ", ".join(u or "-" for u in p.accepted_units), p.meaning) for name, p in table.items()],
        text=(0, 1, 2),
    )


@rotor_commands.command()
def parameters(as_json: JsonOption = False) -> None:
    """List the parameters that can be varied or set, with their units."""
    from mufly.study import ROTOR_PARAMETERS

    _print_parameters(ROTOR_PARAMETERS, as_json)


@coax.app.command("parameters")
def list_pair_parameters(as_json: JsonOption = False) -> None:
    """List the parameters that `mufly coax sweep` can vary or set, with their units."""
    from mufly.study import PAIR_PARAMETERS

    _print_parameters(PAIR_PARAMETERS, as_json)
    if not as_json:
        text = "upper_rpm=5000:7000:500 is short for upper_speed=5000:7000:500rpm."
        make_console().print(text, style="dim", highlight=False)


def _print_failure_reasons(data: xr.Dataset) -> None:
    """Print the most frequent reasons of failed cases."""
    import numpy as np

    fault = data["fault"].values
    reasons, counts = np.unique(fault[fault != ""], return_counts=True)
    for reason, count in list(zip(reasons, counts, strict=True))[:5]:
        make_console().print(f"failed, {count}: {reason}", style="yellow", highlight=False)
    if len(reasons) > 5:
        text = f"and {len(reasons) - 5} other reasons, in the table's column 'fault'"
        make_console().print(text, style="yellow")


def _write_sweep(
    data: xr.Dataset, folder: Path, variable: str, x: str | None = None, *, quiet: bool = False
) -> list[Path]:
    from mufly.study import draw_parameter_sweep, write_study_results

    files = write_study_results(data, folder)
    try:
        picture = draw_parameter_sweep(data, variable, x=x, title=data.attrs["rotor"])
        files.append(save_figure(picture, folder, variable))
    except InputError as error:  # too many lines for a picture: the tables are written
        if not quiet:
            make_console().print(f"No picture: {error}", style="yellow")
    return files


# ----------------------------------------------------------------------------
# Single rotors.


@rotor_commands.command(epilog="Parameters and their units: mufly rotor parameters.")
def sweep(
    rotor: RotorArgument = "naca4412-r60-c20",
    vary: Annotated[
        list[str] | None,
        define_option(
            "NAME=VALUES",
            "Parameter to vary and its values, as chord=10:30:5mm or airfoil=goe394,naca4412. Repeat it for more.",
        ),
    ] = None,
    set_: SetOption = None,
    drive: DriveOption = None,
    show: Annotated[str | None, define_option("--plot VARIABLE", "Result to draw over the pitch.")] = None,
    out: Annotated[
        Path | None,
        define_option("--out DIR", "Folder for tables and a picture; a stopped sweep resumes there."),
    ] = None,
    cluster: ClusterOption = None,
    theory: TheoryOptions = DEFAULT_BEMT_OPTIONS,
    as_json: JsonOption = False,
) -> None:
    """Evaluate every combination of some parameters' values: geometry, drive, air.

    The pitch has to be varied or set, and one of thrust (the speed is found), speed, or duty (the speed at
    which rotor and motor settle). With a thrust, gear=adapted finds the gear ratio that gives this thrust at full
    voltage, as in the dissertation's studies. A case that fails has its reason in 'fault' and does not stop the others.
    With --method wake a case takes seconds (several wakes where a speed is found); each result is stored at once.

    Example: mufly rotor sweep naca4412-r60-c20 --vary chord=10:30:5mm --vary pitch=6:20:1deg --set thrust=0.4N
    --set gear=adapted --drive mufly --out chords
    """
    from mufly.study import ROTOR_PARAMETERS, parse_parameter_settings
    from mufly.study import sweep_parameters as run

    setup = theory.make_study_setup(
        rotor,
        parse_set_options(set_, ROTOR_PARAMETERS, "vary it with --vary"),
        drive=load_drive_option(drive),
        with_outside_share=True,
    )
    varied = parse_parameter_settings(vary or [])
    if not varied:
        raise InputError("--vary", "", "nothing is varied", "give for example --vary pitch=6:20:1deg")
    sought = {k: v[0] for k, v in varied.items() if v in (("adapted",), ("best",))}
    if sought:
        raise InputError("--vary", "gear", f"{sought['gear']!r} is one value", "fix it: --set gear=adapted")
    both = [name for name in varied if name in setup.fixed_parameters and name != "n_crit"]
    if both:
        raise InputError("--set", both[0], "is varied too", "leave one of the two out")
    with progress_bar("sweep", not as_json) as progress:
        data = run(setup, varied, folder=out, progress=progress, cluster=cluster)
    files = _write_sweep(data, out, _select_plotted_result(data, show)) if out is not None else []
    print_answer(
        as_json, data.to_dict(), lambda: _print_best_pitch_cases(data, _select_plotted_result(data, show)), files
    )


def _select_plotted_result(data: xr.Dataset, asked: str | None) -> str:
    if asked is not None and asked not in data.data_vars:
        raise InputError("--plot", "", f"{asked!r} is not a result", suggest_name(asked, map(str, data.data_vars)))
    return asked or ("thrust_per_power_N_W" if "thrust_per_power_N_W" in data else "figure_of_merit")


def _print_best_pitch_cases(data: xr.Dataset, variable: str) -> None:
    """Print the best case over all pitches for every combination of the other parameters, best first, at most 40."""
    import numpy as np

    from mufly.study.study_parameters import format_parameter_value

    c = make_console()
    values = data[variable]
    solved = np.isfinite(values.values)
    c.print(
        f"{values.size} cases, {int((~solved).sum())} failed. Best {variable} over the pitch:"
        if "pitch" in data.dims else f"{values.size} cases, {int((~solved).sum())} failed. {variable}, best first:",
        highlight=False,
    )  # fmt: skip
    others = [str(d) for d in data.dims if d != "pitch"]
    table = data.transpose(*others, *(["pitch"] if "pitch" in data.dims else []))
    flat = np.where(np.isfinite(table[variable].values), table[variable].values, -np.inf)
    flat = flat.reshape(int(np.prod([data.sizes[d] for d in others], dtype=int)), -1)
    best = flat.argmax(axis=1)
    order = np.argsort(-flat[np.arange(flat.shape[0]), best], kind="stable")[:_MAX_PRINTED_ROWS]
    rows = []
    for k in order:
        index = np.unravel_index(k, tuple(data.sizes[d] for d in others)) if others else ()
        row = [format_parameter_value(d, data[d].values[int(i)].item()) for d, i in zip(others, index, strict=True)]
        if "pitch" in data.dims:
            row.append(format_parameter_value("pitch", data["pitch"].values[int(best[k])].item()))
        top = flat[k, best[k]]
        rows.append([*row, f"{top:.5g}" if np.isfinite(top) else "-"])
    heads = [*others, *(["best pitch"] if "pitch" in data.dims else []), f"{variable}"]
    print_table(heads, rows)
    _print_failure_reasons(data)


@rotor_commands.command()
def rank(
    rotor: RotorArgument = "naca4412-r60-c20",
    airfoils: AirfoilsOption = None,
    pitch: Annotated[
        tuple[float, ...],
        define_option("--pitch", "Pitch settings to try, as 6:20:1.", unit="deg", form="values", within=PITCH_RANGE),
    ] = default_text("6:20:1deg"),
    set_: SetOption = None,
    drive: DriveOption = "mufly",
    by: Annotated[str | None, define_option("VARIABLE", "Result to rank by, the greatest first.")] = None,
    top: Annotated[int, define_option("N", "Number of airfoils to print from each end.")] = 10,
    out: Annotated[Path | None, define_option("--out DIR", "Folder for ranking.nc, ranking.csv and a picture.")] = None,
    cluster: ClusterOption = None,
    polars: PolarOptions = DEFAULT_POLAR_OPTIONS,
    as_json: JsonOption = False,
) -> None:
    """Rank airfoils by the performance of a rotor, with each airfoil at its best pitch.

    Without --set, thrust=0.4N and gear=adapted apply, as in the dissertation's Table 3.3.

    Examples: mufly rotor rank; mufly rotor rank --airfoils my_airfoils/ --set thrust=0.3N --set gear=1.5
    """
    from mufly.study import (
        ROTOR_PARAMETERS,
        draw_ranking_extremes,
        expand_airfoil_names,
        rank_airfoils,
        write_study_results,
    )

    standard = ["thrust=0.4N", "gear=adapted"] if drive not in (None, "none") else ["thrust=0.4N"]
    given = parse_set_options(set_ or standard, ROTOR_PARAMETERS, "give one value of something else")
    setup = polars.make_study_setup(rotor, given, drive=load_drive_option(drive), with_outside_share=False)
    if "pitch" in given or "airfoil" in given:
        raise InputError("--set", "", "a ranking varies pitch and airfoil", "fix other parameters")
    pitches = [math.radians(p) for p in pitch]
    names = expand_airfoil_names(airfoils or ["thesis"])
    with progress_bar("rank", not as_json) as progress:
        ranking = rank_airfoils(setup, names, pitches, by=by, folder=out, progress=progress, cluster=cluster)
    files = []
    if out is not None:
        files = [
            *write_study_results(ranking, out, "ranking"),
            save_figure(draw_ranking_extremes(ranking), out, "ranking"),
        ]
    rows = columns_to_rows({str(v): ranking[v].values.tolist() for v in ("airfoil", *ranking.data_vars)})
    if as_json:
        return print_answer(as_json, {**ranking.attrs, "ranking": rows}, None, files)
    columns = (
        "airfoil", "rank", ResultColumn(ranking.attrs["by"], form=".5g"),
        ResultColumn("pitch", "deg", ".1f", "best pitch", own_unit="rad"), ResultColumn("thickness_ratio", form=".1%"),
        ResultColumn("camber", form=".1%"),
    )  # fmt: skip
    print_result_table(rows if len(rows) <= 2 * top else rows[:top] + rows[-top:], columns)
    failed = [f"{row['airfoil']}: {row['fault']}" for row in rows if row["fault"]]
    print_lines(*failed[:5], style="yellow")
    print_files(files)


# ----------------------------------------------------------------------------
# Coaxial pairs.


_DEFAULT_PAIR_SETTINGS: dict[str, ParameterValue] = {"spacing": 0.02, "pitch": math.radians(14.0)}


def _parse_pair_settings(texts: list[str]) -> dict[str, tuple[ParameterValue, ...]]:
    """Return the settings of a pair; ``upper_rpm=6000`` stands for ``upper_speed=6000rpm``."""
    from mufly.study import PAIR_PARAMETERS, parse_parameter_settings

    full = []
    for text in texts:
        name, _, listed = (part.strip() for part in text.partition("="))
        if name in ("upper_rpm", "lower_rpm"):
            speeds = ",".join(map(repr, parse_values(text, listed, "rpm")))
            text = f"{name.removesuffix('rpm')}speed={speeds}rpm"
        full.append(text)
    return parse_parameter_settings(full, PAIR_PARAMETERS)


@coax.app.command("sweep")
def sweep_pairs(
    upper: UpperArgument = THESIS_ROTOR_NAME,
    lower: LowerArgument = None,
    vary: Annotated[
        list[str] | None,
        define_option(
            "NAME=VALUES",
            "Parameter to vary and its values, as spacing=10:40:10mm or lower_rpm=5000:7000:500. Repeat it for more.",
        ),
    ] = None,
    set_: Annotated[
        list[str] | None,
        define_option("--set NAME=VALUE", "Parameter to fix, as upper_rpm=6000 or thrust=0.9N. Repeat it for more."),
    ] = None,
    free: Annotated[
        str, define_option("NAME", "Quantity that balances the torques: lower-speed or lower-pitch.")
    ] = "lower-speed",
    show: Annotated[str, define_option("--plot VARIABLE", "Result to draw and to print.")] = "thrust_ratio",
    over: Annotated[
        str | None, define_option("NAME", "Parameter on the horizontal axis. Default: the first that varies.")
    ] = None,
    theory: TheoryOptions = DEFAULT_FREE_WAKE_OPTIONS,
    out: Annotated[
        Path | None, define_option("--out DIR", "Folder for tables and a picture; a stopped sweep resumes there.")
    ] = None,
    cluster: ClusterOption = None,
    as_json: JsonOption = False,
) -> None:
    """Evaluate a pair for every combination of some parameters' values.

    Parameters: `mufly coax parameters`. Spacing is 20mm and pitch 14deg unless varied or set. With upper_speed (or
    upper_rpm) and lower_speed or speed_ratio the pair is evaluated at these speeds; with upper_speed
    alone, or with thrust, the
    torques are balanced. A case that fails has its reason in 'fault' and does not stop the others. A wake takes
    seconds; with --out each result is stored at once.

    Examples: mufly coax sweep --vary spacing=10:40:10mm --set upper_rpm=6000 --set speed_ratio=1 --out spacing;
    mufly coax sweep --vary upper_rpm=5000:7000:500 --vary lower_rpm=4000:8000:500 --method bemt --plot lower_thrust_N
    """
    from mufly.study import PAIR_PARAMETERS
    from mufly.study import sweep_parameters as run
    from mufly.study.study_setup import PAIR_OUTPUTS

    if show not in PAIR_OUTPUTS:
        raise InputError("--plot", "", f"{show!r} is not a result", suggest_name(show, PAIR_OUTPUTS))
    varied, given = _parse_pair_settings(vary or []), _parse_pair_settings(set_ or [])
    if not varied:
        raise InputError("--vary", "", "nothing is varied", "give for example --vary spacing=10:40:10mm")
    if over is not None and over not in varied:
        where = "is not varied" if over in PAIR_PARAMETERS else "is unknown"
        raise InputError("--over", "", f"{over!r} {where}", suggest_name(over, varied))
    for name, values in given.items():
        if len(values) > 1:
            raise InputError("--set", name, "has several values", "vary it with --vary")
        if name in varied:
            raise InputError("--set", name, "is varied too", "leave one of the two out")
    named = {*varied, *given}
    fixed: dict[str, ParameterValue] = {k: v[0] for k, v in given.items()}
    for name, value in _DEFAULT_PAIR_SETTINGS.items():
        if name not in named and not (name == "pitch" and "upper_pitch" in named):
            fixed[name] = value
    if "upper_pitch" in fixed or "upper_pitch" in varied:
        fixed.pop("pitch", None)
    if not named & {"thrust", "upper_speed"}:
        fixed["upper_speed"] = 6000.0 * RPM
    setup = make_pair_setup(upper, lower, fixed, theory, balance=free)
    with progress_bar("pairs", not as_json) as progress:
        data = run(setup, varied, folder=out, progress=progress, cluster=cluster)
    files = _write_sweep(data, out, show, over or next(iter(varied)), quiet=as_json) if out is not None else []
    print_answer(as_json, data.to_dict(), lambda: _print_pair_sweep(data, show), files)


def _print_pair_sweep(data: xr.Dataset, variable: str) -> None:
    import numpy as np

    from mufly.study.study_parameters import format_parameter_value

    c = make_console()
    names = [str(d) for d in data.dims]
    fault = data["fault"].values.ravel()
    c.print(f"{fault.size} cases, {int((fault != '').sum())} failed.", highlight=False)
    columns: list[ResultColumn | str] = [
        ResultColumn("upper_speed_rad_s", "rpm"), ResultColumn("lower_speed_rad_s", "rpm"), "upper_thrust_N",
        "lower_thrust_N", ResultColumn("yaw_torque_Nm", "mN m"), "power_W",
    ]  # fmt: skip
    if variable not in ("upper_thrust_N", "lower_thrust_N", "power_W"):
        columns.append(ResultColumn(variable))
    rows = []
    for index in itertools.islice(np.ndindex(*(data.sizes[n] for n in names)), _MAX_PRINTED_ROWS):
        row = {
            name: format_parameter_value(name, data[name].values[i].item())
            for name, i in zip(names, index, strict=True)
        }
        rows.append({**{str(v): data[v].values[index].item() for v in data.data_vars}, **row})
    print_result_table(rows, [*names, *columns])
    if fault.size > _MAX_PRINTED_ROWS:
        c.print(f"and {fault.size - _MAX_PRINTED_ROWS} more; --out writes them all", style="dim")
    _print_failure_reasons(data)


# ----------------------------------------------------------------------------
# The dissertation's studies, with its results beside those of this package.


thesis_commands = CommandGroup(
    help=("Repeat the studies of the dissertation and compare the results. Assumptions: docs/explanation/studies.md."),
    no_args_is_help=True,
)


_NameArgument = Annotated[
    str, define_argument("NAME", "Name of a figure or table, as fig-3.26 or table-5.3; `mufly thesis list` has all.")
]
_KeepOption = Annotated[
    Path | None,
    define_option("--out DIR", "Folder for picture, tables and verdicts; a stopped run resumes there."),
]


@thesis_commands.command("list")
def list_thesis_items(as_json: JsonOption = False) -> None:
    """List the dissertation's 91 figures and 7 tables, with the verdicts of those that have run."""
    from mufly.thesis import THESIS_ITEMS, count_verdicts, load_cached_answer

    answers = [load_cached_answer(name) for name in THESIS_ITEMS]
    if as_json:
        return print_json(answers)
    print_table(
        ("name", "kind", "section", "verdict", "agree", "title"),
        [
            (a.item.name, a.item.kind, a.item.section, a.verdict_word, a.agreement_count_text, a.item.title)
            for a in answers
        ],
        text=(0, 1, 2, 3, 4, 5),
    )
    make_console().print(", ".join(f"{n} {word}" for word, n in count_verdicts(answers).items()) + ".", highlight=False)


@thesis_commands.command("run")
def run_thesis_study(
    name: Annotated[str, define_argument("NAME|all", "Name of a figure or table (`mufly thesis list`), or all.")],
    out: _KeepOption = None,
    case: Annotated[
        Path | None,
        define_option("--case DIR", "Folder of a solved CFD case, or of several, for fig-3.22, fig-3.23 and fig-3.24."),
    ] = None,
    again: Annotated[bool, define_option("--again", "Compute stored answers again.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Repeat a figure or table; print each claim of the dissertation with mufly's numbers and the criterion.

    Answers are stored (MUFLY_CACHE, or the user's cache folder) until their sources change, so a `run all` that was
    stopped resumes; quick studies run first. Rotor studies are computed with mufly's corrections and with the theory
    of the dissertation, so that a difference can be traced to either.

    Examples: mufly thesis run fig-3.26; mufly thesis run all --out thesis; mufly thesis run fig-3.23 --case DIR
    """
    from mufly.thesis import (
        THESIS_ITEMS,
        count_verdicts,
        find_item,
        list_studies_by_cost,
        load_cached_answer,
        load_or_run_study,
    )

    if name == "all" and case is not None:
        raise InputError("thesis", "--case", "goes with one figure", "mufly thesis run fig-3.23 --case DIR")
    names = list_studies_by_cost() if name == "all" else [find_item(name).name]
    answers: list[dict[str, Any]] = []
    for k, one in enumerate(names):
        count = f"{k + 1} of {len(names)}: " if len(names) > 1 else ""
        with progress_bar(f"{count}{one}", not as_json) as progress:
            found = load_or_run_study(one, out, progress, case=case, again=again)
        answers.append(found.as_record())
        if not as_json:
            print_answer(as_json, found)
    if as_json:
        print_json(answers if name == "all" else answers[0])
    elif name == "all":
        agree, every = sum(a["agree"] for a in answers), sum(len(a["verdicts"]) for a in answers)
        words = ", ".join(
            f"{n} {w}" for w, n in count_verdicts([load_cached_answer(i, out) for i in THESIS_ITEMS]).items()
        )
        make_console().print(f"[bold]{words}. {agree} of {every} verdicts agree.[/bold]")


@thesis_commands.command("show")
def show_thesis_item(name: _NameArgument, as_json: JsonOption = False) -> None:
    """Show a figure or table: the printed and the computed values, the verdict, and the picture; compute it if missing.

    Example: mufly thesis show fig-6.11
    """
    from mufly.thesis import load_cached_answer, load_or_run_study

    found = load_cached_answer(name)
    if not found.is_answered:
        with progress_bar(found.item.name, not as_json) as progress:
            found = load_or_run_study(name, None, progress)
    print_answer(as_json, found, files=None)


@thesis_commands.command("outlook")
def show_outlook(as_json: JsonOption = False) -> None:
    """Show the dissertation's outlook (Sec. 7.2) sentence by sentence, with mufly's result beside each.

    docs/thesis/outlook.md has the same table with the commands.
    """
    from dataclasses import asdict

    from mufly.thesis import OUTLOOK_SENTENCES, count_outlook_states

    if as_json:
        return print_json([asdict(s) for s in OUTLOOK_SENTENCES])
    print_table(
        ("", "section", "sentence", "state", "answer"),
        [(f"{s.number}", s.section, s.text, s.state, s.answer) for s in OUTLOOK_SENTENCES],
        text=(1, 2, 3, 4),
    )
    make_console().print(
        ", ".join(f"{n} {state}" for state, n in count_outlook_states().items()) + ".", highlight=False
    )


@thesis_commands.command("report")
def write_thesis_report(
    out: Annotated[Path, define_option("--out FILE", "Page to write, as thesis.html.")],
    from_folder: Annotated[
        Path | None,
        define_option("--from DIR", "Folder that `mufly thesis run all --out` wrote. Default: the cache."),
    ] = None,
) -> None:
    """Write one self-contained page of HTML with every figure and table, their verdicts and mufly's pictures.

    Run `mufly thesis run all` first; studies that have not run are marked.

    Example: mufly thesis report --out thesis.html
    """
    from mufly.thesis import THESIS_ITEMS, count_verdicts, load_cached_answer, render_html_page

    answers = [load_cached_answer(name, from_folder) for name in THESIS_ITEMS]
    write_text_file(out, render_html_page(answers), "give another file")
    print_files([out])
    make_console().print(", ".join(f"{n} {word}" for word, n in count_verdicts(answers).items()) + ".", highlight=False)
