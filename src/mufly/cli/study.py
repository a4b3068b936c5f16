"""Many rotors or pairs at once: ``mufly rotor sweep | rank | optimise``, ``mufly coax sweep | optimise``."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mufly.cli import coax
from mufly.cli.coax import DENSITY, SPACING, THESIS, LowerArgument, UpperArgument, angles, length, pair_of
from mufly.cli.options import (
    DriveOption,
    EngineOption,
    JsonOption,
    MethodOption,
    ModelOption,
    NCritOption,
    OutOption,
    RotorArgument,
    WakeOption,
    WakeSetOption,
    corrections_of,
    drive_or_none,
    wake_of,
    wake_progress,
)
from mufly.cli.present import (
    answer,
    console,
    print_json,
    print_table,
    progress_bar,
    save_picture,
    tell_files,
    writing,
)
from mufly.errors import InputError
from mufly.units import RPM

if TYPE_CHECKING:
    import xarray as xr

    from mufly.rotor import Result, Rotor
    from mufly.rotor.wake import WakeSettings
    from mufly.study import Optimum, PairOptimum, Setup
    from mufly.study.parameters import Parameter, Value

_SHOWN = 40  # rows of a sweep in the terminal

SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="NAME=VALUE", help="Fix a parameter, as thrust=0.4N, speed=5000rpm, gear=adapted."
    ),
]
_Cluster = Annotated[
    str | None,
    typer.Option("--cluster", metavar="ADDRESS", help="Scheduler of a dask cluster, as tcp://host:8786."),
]
_Airfoils = Annotated[
    list[str] | None,
    typer.Option(
        "--airfoils", metavar="SET|DIR|NAMES",
        help="'thesis' (247 by rule), 'database' (all), a folder of .dat files, or names separated by commas.",
    ),
]  # fmt: skip


def _given(texts: list[str] | None, table: dict[str, Parameter], remedy: str) -> dict[str, Value]:
    """Settings of ``--set``, each with one value."""
    from mufly.study import parse_settings

    settings = parse_settings(texts or [], table)
    for name, values in settings.items():
        if len(values) > 1:
            raise InputError("--set", name, "has several values", remedy)
    return {name: values[0] for name, values in settings.items()}


def _list_parameters(table: dict[str, Parameter], as_json: bool) -> None:
    if as_json:
        print_json(
            {k: {"unit": p.unit, "units": list(p.units), "meaning": p.meaning} for k, p in table.items()}
        )
        return
    print_table(
        ("parameter", "units", "meaning"),
        [(name, ", ".join(u or "-" for u in p.units), p.meaning) for name, p in table.items()],
        text=(0, 1, 2),
    )


def parameters(as_json: JsonOption = False) -> None:
    """List everything that can be varied or set, with its units."""
    from mufly.study import PARAMETERS

    _list_parameters(PARAMETERS, as_json)


def pair_parameters(as_json: JsonOption = False) -> None:
    """List everything that `mufly coax sweep` can vary or set, with its units."""
    from mufly.study import PAIR

    _list_parameters(PAIR, as_json)
    if not as_json:
        text = "upper_rpm=5000:7000:500 is short for upper_speed=5000:7000:500rpm."
        console().print(text, style="dim", highlight=False)


def _shown(name: str, value: Value, form: str = "g") -> str:
    """A value of a parameter for reading, with its unit."""
    from mufly.study.parameters import in_unit

    values, unit = in_unit(name, [value])
    return f"{values[0]:{form}} {unit}".strip() if values.dtype.kind == "f" else str(values[0])


def _print_faults(data: xr.Dataset) -> None:
    """Print the commonest reasons of cases that failed."""
    import numpy as np

    fault = data["fault"].values
    reasons, counts = np.unique(fault[fault != ""], return_counts=True)
    for reason, count in list(zip(reasons, counts, strict=True))[:5]:
        console().print(f"failed, {count}: {reason}", style="yellow", highlight=False)
    if len(reasons) > 5:
        text = f"and {len(reasons) - 5} other reasons, in the table's column 'fault'"
        console().print(text, style="yellow")


def _write_sweep(
    data: xr.Dataset, folder: Path, variable: str, x: str | None = None, *, quiet: bool = False
) -> list[Path]:
    from mufly.study import lines_picture, write_results

    files = write_results(data, folder)
    try:
        picture = lines_picture(data, variable, x=x, title=data.attrs["rotor"])
        files.append(save_picture(picture, folder, variable))
    except InputError as error:  # too many lines for a picture: the tables are there all the same
        if not quiet:
            console().print(f"No picture: {error}", style="yellow")
    return files


def _write_rotor(rotor: Rotor, path: Path) -> Path:
    from mufly.rotor import rotor_toml

    with writing(path, "give another place"):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(rotor_toml(rotor), encoding="utf-8")
    return path


def _setup(
    rotor: str, drive: str | None, fixed: dict[str, Value], model: str, engine: str, *, flags: bool,
    method: str = "bemt", wake: tuple[WakeSettings, int] | None = None,
) -> Setup:  # fmt: skip
    """Return what the options about a single rotor say."""
    from mufly.rotor import load_rotor
    from mufly.study import Setup

    more = {} if wake is None else {"wake": wake[0], "stations": wake[1]}
    return Setup(
        load_rotor(rotor), drive_or_none(drive), fixed, corrections_of(model), engine, flags=flags, method=method,
        **more,  # type: ignore[arg-type]
    )  # fmt: skip


# ----------------------------------------------------------------------------
# Single rotors.


def sweep(
    rotor: RotorArgument = "naca4412-r60-c20",
    vary: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUES", help="As chord=10:30:5mm or airfoil=goe394,naca4412. Repeat it."),
    ] = None,
    set_: SetOption = None,
    drive: DriveOption = None,
    show: Annotated[str | None, typer.Option("--plot", metavar="VARIABLE", help="What to draw over the pitch.")] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Write tables and a picture there; a stopped sweep resumes."),
    ] = None,
    cluster: _Cluster = None,
    n_crit: NCritOption = 0.1,
    engine: EngineOption = "neuralfoil",
    model: ModelOption = "full",
    method: MethodOption = "bemt",
    wake: WakeOption = "free",
    wake_set: WakeSetOption = None,
    as_json: JsonOption = False,
) -> None:  # fmt: skip
    """Evaluate every combination of some parameters' values: geometry, drive, air.

    The pitch has to be varied or set, and one of thrust (the speed is found), speed, or duty (the speed at
    which rotor and motor settle). With a thrust, gear=adapted finds the gear ratio that just gives it at full
    voltage, as the dissertation's studies do. A case that fails is marked with its reason and the others go on.
    With --method wake a case takes seconds (a few wakes where a speed is found); each is kept as soon as it is there.

    Example: mufly rotor sweep naca4412-r60-c20 --vary chord=10:30:5mm --vary pitch=6:20:1deg --set thrust=0.4N
    --set gear=adapted --drive mufly --out chords
    """
    from mufly.study import PARAMETERS, parse_settings
    from mufly.study import sweep as run

    wakes = wake_of(method, wake, wake_set)
    fixed = {"n_crit": n_crit, **_given(set_, PARAMETERS, "vary it with --vary")}
    setup = _setup(rotor, drive, fixed, model, engine, flags=True, method=method, wake=wakes)
    varied = parse_settings(vary or [])
    if not varied:
        raise InputError("--vary", "", "nothing is varied", "give for example --vary pitch=6:20:1deg")
    sought = {k: v[0] for k, v in varied.items() if v in (("adapted",), ("best",))}
    if sought:
        raise InputError("--vary", "gear", f"{sought['gear']!r} is one value", "fix it: --set gear=adapted")
    both = [name for name in varied if name in setup.fixed and name != "n_crit"]
    if both:
        raise InputError("--set", both[0], "is varied too", "leave one of the two out")
    with progress_bar("sweep", not as_json) as progress:
        data = run(setup, varied, folder=out, progress=progress, cluster=cluster)
    files = _write_sweep(data, out, _plotted(data, show)) if out is not None else []
    answer(as_json, data.to_dict, lambda: _print_best(data, _plotted(data, show)), files)


def _plotted(data: xr.Dataset, asked: str | None) -> str:
    if asked is not None and asked not in data.data_vars:
        raise InputError(
            "--plot", "", f"{asked!r} is no result", f"use one of: {', '.join(map(str, data.data_vars))}"
        )
    return asked or ("thrust_per_power_N_W" if "thrust_per_power_N_W" in data else "figure_of_merit")


def _print_best(data: xr.Dataset, variable: str) -> None:
    """Print the best case over the pitch for every combination of the rest, best first, at most 40."""
    import numpy as np

    c = console()
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
    order = np.argsort(-flat[np.arange(flat.shape[0]), best], kind="stable")[:_SHOWN]
    rows = []
    for k in order:
        index = np.unravel_index(k, tuple(data.sizes[d] for d in others)) if others else ()
        row = [_shown(d, data[d].values[int(i)].item()) for d, i in zip(others, index, strict=True)]
        if "pitch" in data.dims:
            row.append(_shown("pitch", data["pitch"].values[int(best[k])].item()))
        top = flat[k, best[k]]
        rows.append([*row, f"{top:.5g}" if np.isfinite(top) else "-"])
    heads = [*others, *(["best pitch"] if "pitch" in data.dims else []), f"{variable}"]
    print_table(heads, rows)
    _print_faults(data)


def rank(
    rotor: RotorArgument = "naca4412-r60-c20",
    airfoils: _Airfoils = None,
    pitch: Annotated[str, typer.Option(metavar="RANGE", help="Pitch settings to try.")] = "6:20:1deg",
    set_: SetOption = None,
    drive: DriveOption = "mufly",
    by: Annotated[
        str | None, typer.Option(metavar="VARIABLE", help="What to rank by, the greatest first.")
    ] = None,
    top: Annotated[int, typer.Option(metavar="N", help="How many of each end to print.")] = 10,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Write ranking.nc, ranking.csv and a picture.")
    ] = None,
    cluster: _Cluster = None,
    n_crit: NCritOption = 0.1,
    engine: EngineOption = "neuralfoil",
    model: ModelOption = "full",
    as_json: JsonOption = False,
) -> None:
    """Rank airfoils by what the rotor makes of them, each at its best pitch.

    Without --set: thrust=0.4N gear=adapted, as in the dissertation's Table 3.3.

    Examples: mufly rotor rank; mufly rotor rank --airfoils my_airfoils/ --set thrust=0.3N --set gear=1.5
    """
    import numpy as np

    from mufly.study import (
        PARAMETERS,
        choose_airfoils,
        parse_values,
        rank_airfoils,
        rank_picture,
        write_results,
    )

    standard = ["thrust=0.4N", "gear=adapted"] if drive not in (None, "none") else ["thrust=0.4N"]
    given = _given(set_ or standard, PARAMETERS, "give one value of something else")
    setup = _setup(rotor, drive, {"n_crit": n_crit, **given}, model, engine, flags=False)
    if "pitch" in given or "airfoil" in given:
        raise InputError("--set", "", "holds what a ranking varies", "give one value of something else")
    _, pitches = parse_values(f"pitch={pitch}")
    names = choose_airfoils(airfoils or ["thesis"])
    with progress_bar("rank", not as_json) as progress:
        ranking = rank_airfoils(
            setup, names, [float(p) for p in pitches], by=by, folder=out, progress=progress, cluster=cluster
        )
    files = []
    if out is not None:
        files = [*write_results(ranking, out, "ranking"), save_picture(rank_picture(ranking), out, "ranking")]
    key = ranking.attrs["by"]
    if as_json:
        columns = {str(v): ranking[v].values for v in ranking.data_vars}
        rows = [
            {"airfoil": str(name), **{k: v[i] for k, v in columns.items()}}
            for i, name in enumerate(ranking["airfoil"].values)
        ]
        print_json({**ranking.attrs, "ranking": rows, "files": [str(f) for f in files]})
        return
    n = ranking.sizes["airfoil"]
    shown = range(n) if n <= 2 * top else [*range(top), *range(n - top, n)]
    print_table(
        ("airfoil", "rank", str(key), "best pitch", "thickness", "camber"),
        [
            (
                str(ranking["airfoil"].values[k]),
                str(ranking["rank"].values[k]),
                f"{ranking[key].values[k]:.5g}".replace("nan", "-"),
                f"{np.degrees(ranking['pitch'].values[k]):.1f}°".replace("nan°", "-"),
                f"{ranking['thickness_ratio'].values[k]:.1%}",
                f"{ranking['camber'].values[k]:.1%}",
            )
            for k in shown
        ],
    )
    failed = [k for k in range(n) if ranking["fault"].values[k]]
    for k in failed[:5]:
        reason = f"{ranking['airfoil'].values[k]}: {ranking['fault'].values[k]}"
        console().print(reason, style="yellow", highlight=False)
    tell_files(files)


def optimise(
    rotor: RotorArgument = "naca4412-r60-c20",
    goal: Annotated[
        str, typer.Option("--for", metavar="GOAL", help="'endurance' or 'thrust-per-power'.")
    ] = "thrust-per-power",
    free: Annotated[
        str, typer.Option(metavar="NAMES", help="chord, twist, taper, radius, hub_cutout, blades, airfoil, gear.")
    ] = "chord,twist,taper,airfoil,gear",
    limit: Annotated[
        list[str] | None,
        typer.Option(metavar="LIMIT", help="As thickness_mm>=0.8, radius<=60mm, speed_rpm<=7000. Repeat it; quote it."),
    ] = None,
    airfoils: Annotated[
        list[str] | None,
        typer.Option("--airfoils", metavar="SET|DIR|NAMES", help="Candidates: 'thesis', 'database', a folder, names."),
    ] = None,
    set_: Annotated[
        list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="Fix a parameter; thrust=0.4N if not given.")
    ] = None,
    drive: DriveOption = "mufly",
    seed: Annotated[int, typer.Option(metavar="K", help="Same seed, same answer.")] = 0,
    generations: Annotated[int, typer.Option(metavar="N", help="How long to search.")] = 60,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="Write the rotor as a rotor file (TOML).")
    ] = None,
    n_crit: NCritOption = 0.1,
    engine: EngineOption = "neuralfoil",
    model: ModelOption = "full",
    as_json: JsonOption = False,
) -> None:  # fmt: skip
    """Search for a better rotor at a given thrust, within limits, and tell what each change brought.

    Changes are listed from the start, the one that gains most first, each with the pitch set anew; a negative gain is
    the price of a limit. What can be limited: the parameters that are searched, and thickness_mm (the least along the
    blade), tip_chord_mm, solidity, speed_rpm, motor_current_A, gear.

    Example: mufly rotor optimise --for endurance --free chord,twist,taper,radius,airfoil,gear --limit
    'thickness_mm>=0.8' --limit 'radius<=60mm' --out better.toml
    """
    from mufly.study import PARAMETERS, choose_airfoils, parse_limit
    from mufly.study import optimise as search

    given = set_ or []
    if not any(text.strip().startswith("thrust") for text in given):
        given = [*given, "thrust=0.4N"]
    fixed = {"n_crit": n_crit, **_given(given, PARAMETERS, "give one")}
    setup = _setup(rotor, drive, fixed, model, engine, flags=False)
    names = [name.strip() for name in free.split(",") if name.strip()]
    candidates = choose_airfoils(airfoils or ["thesis"]) if "airfoil" in names else []
    limits = [parse_limit(text) for text in limit or []]
    with progress_bar("generations", not as_json) as progress:
        best = search(
            setup, goal, names,  # type: ignore[arg-type]
            limits=limits, airfoils=candidates, seed=seed, generations=generations, progress=progress,
        )  # fmt: skip
    files = [_write_rotor(best.rotor, out)] if out is not None else []
    if as_json:
        print_json(_json(best))
        return
    _print(best)
    tell_files(files)


def _json(best: Optimum) -> dict[str, Any]:
    return {
        "rotor": best.rotor.toml_tables(),
        "pitch_rad": best.pitch_rad,
        "changes": best.changes,
        "goal": best.goal,
        "unit": _unit(best.goal),
        "before": best.before,
        "after": best.after,
        "steps": [vars(step) for step in best.steps],
        "results": best.results,
    }


def _unit(goal: str) -> str:
    return "s" if goal == "endurance" else "N/W"


def _print(best: Optimum) -> None:
    rows = [("start", "", f"{best.before:.5g}", "", "")]
    for step in best.steps:
        rows.append(
            (
                step.parameter,
                _shown(step.parameter, step.value, ".4g"),
                f"{step.goal:.5g}",
                f"{step.gain:+.1%}",
                f"{math.degrees(step.pitch_rad):.2f}°",
            )
        )
    print_table(("change", "to", f"{best.goal} ({_unit(best.goal)})", "gain", "pitch"), rows, text=(0, 1))
    r = best.results
    c = console()
    c.print(
        f"[bold]{best.after / best.before - 1:+.1%}[/bold]: {r['electrical_power_W']:.3f} W for {r['thrust_N']:.3g} N, "
        f"{r['thrust_per_power_N_W']:.4f} N/W, {r['endurance_s'] / 60:.1f} min; "
        f"{r['speed_rad_s'] / RPM:.0f} rpm at {math.degrees(best.pitch_rad):.2f}°, gear "
        f"{r['gear_ratio']:.3g}, duty {r['duty']:.2f}, least thickness {1e3 * r['least_thickness_m']:.2f} mm",
        highlight=False,
    )


# ----------------------------------------------------------------------------
# Coaxial pairs.


_STANDARD: dict[str, Value] = {"spacing": 0.02, "pitch": math.radians(14.0)}


def _pair_settings(texts: list[str]) -> dict[str, tuple[Value, ...]]:
    """Settings of a pair; ``upper_rpm=6000`` is ``upper_speed=6000rpm``."""
    from mufly.study import PAIR, parse_settings

    full = [re.sub(r"^\s*(upper|lower)_rpm\s*=\s*(.*?)\s*(rpm)?\s*$", r"\1_speed=\2rpm", t) for t in texts]
    return parse_settings(full, PAIR)


def sweep_pairs(
    upper: UpperArgument = THESIS,
    lower: LowerArgument = None,
    vary: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUES", help="As spacing=10:40:10mm or lower_rpm=5000:7000:500. Repeat it."),
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="Fix a parameter: upper_rpm=6000, thrust=0.9N. Repeat it."),
    ] = None,
    free: Annotated[
        str, typer.Option(metavar="NAME", help="What balances the torques where they are: lower-speed, lower-pitch.")
    ] = "lower-speed",
    show: Annotated[
        str, typer.Option("--plot", metavar="VARIABLE", help="What to draw and to print.")
    ] = "thrust_ratio",
    over: Annotated[
        str | None, typer.Option(metavar="NAME", help="What is on the horizontal axis; else the first that is varied.")
    ] = None,
    method: MethodOption = "wake",
    wake: WakeOption = "free",
    wake_set: WakeSetOption = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Tables and a picture; a stopped sweep resumes there.")
    ] = None,
    cluster: Annotated[
        str | None, typer.Option("--cluster", metavar="ADDRESS", help="Scheduler of a dask cluster, as tcp://host:8786.")
    ] = None,
    n_crit: NCritOption = 0.1,
    engine: EngineOption = "neuralfoil",
    model: ModelOption = "full",
    as_json: JsonOption = False,
) -> None:  # fmt: skip
    """Evaluate a pair for every combination of some parameters' values.

    Parameters: `mufly coax parameters`. Spacing is 20mm and pitch 14deg unless varied or set. With upper_speed (or
    upper_rpm) and lower_speed or speed_ratio the pair is evaluated there; with upper_speed alone, or with thrust, the
    torques are balanced. A case that fails is marked with its reason, in 'fault'; the others go on. A wake takes
    seconds a case; with --out each is kept as soon as it is there.

    Examples: mufly coax sweep --vary spacing=10:40:10mm --set upper_rpm=6000 --set speed_ratio=1 --out spacing;
    mufly coax sweep --vary upper_rpm=5000:7000:500 --vary lower_rpm=4000:8000:500 --method bemt --plot lower_thrust_N
    """
    from mufly.study import PAIR
    from mufly.study import sweep as run
    from mufly.study.setup import PAIR_OUTPUTS

    if show not in PAIR_OUTPUTS:
        raise InputError("--plot", "", f"{show!r} is no result", f"use one of: {', '.join(PAIR_OUTPUTS)}")
    varied, given = _pair_settings(vary or []), _pair_settings(set_ or [])
    if not varied:
        raise InputError("--vary", "", "nothing is varied", "give for example --vary spacing=10:40:10mm")
    if over is not None and over not in varied:
        where = "is not varied" if over in PAIR else "is unknown"
        raise InputError("--over", "", f"{over!r} {where}", f"use one of: {', '.join(varied)}")
    for name, values in given.items():
        if len(values) > 1:
            raise InputError("--set", name, "has several values", "vary it with --vary")
        if name in varied:
            raise InputError("--set", name, "is varied too", "leave one of the two out")
    named = {*varied, *given}
    fixed: dict[str, Value] = {"n_crit": n_crit, **{k: v[0] for k, v in given.items()}}
    for name, value in _STANDARD.items():
        if name not in named and not (name == "pitch" and "upper_pitch" in named):
            fixed[name] = value
    if "upper_pitch" in fixed or "upper_pitch" in varied:
        fixed.pop("pitch", None)
    if not named & {"thrust", "upper_speed"}:
        fixed["upper_speed"] = 6000.0 * RPM
    setup = pair_of(
        upper,
        lower,
        fixed,
        method=method,
        wake=wake,
        wake_set=wake_set,
        model=model,
        engine=engine,
        balance=free,
    )
    with progress_bar("pairs", not as_json) as progress:
        data = run(setup, varied, folder=out, progress=progress, cluster=cluster)
    files = (
        _write_sweep(data, out, show, over or next(iter(varied)), quiet=as_json) if out is not None else []
    )
    answer(as_json, data.to_dict, lambda: _print_pairs(data, show), files)


def _print_pairs(data: xr.Dataset, variable: str) -> None:
    import numpy as np

    c = console()
    names = [str(d) for d in data.dims]
    fault = data["fault"].values.ravel()
    c.print(f"{fault.size} cases, {int((fault != '').sum())} failed.", highlight=False)
    columns = [
        "upper_speed_rad_s",
        "lower_speed_rad_s",
        "upper_thrust_N",
        "lower_thrust_N",
        "yaw_torque_Nm",
        "power_W",
    ]
    heads = ["upper rpm", "lower rpm", "upper (N)", "lower (N)", "yaw (mN m)", "power (W)"]
    scales = [1.0 / RPM, 1.0 / RPM, 1.0, 1.0, 1e3, 1.0]
    if variable not in columns:
        columns, heads, scales = [*columns, variable], [*heads, variable], [*scales, 1.0]
    values = [scale * data[v].values.ravel() for v, scale in zip(columns, scales, strict=True)]
    rows = []
    for k, index in enumerate(np.ndindex(*(data.sizes[n] for n in names))):
        if k == _SHOWN:
            break
        row = [_shown(name, data[name].values[i].item()) for name, i in zip(names, index, strict=True)]
        rows.append([*row, *(f"{v[k]:.4g}" if np.isfinite(v[k]) else "-" for v in values)])
    print_table([*names, *heads], rows, text=())
    if fault.size > _SHOWN:
        c.print(f"and {fault.size - _SHOWN} more; --out writes them all", style="dim")
    _print_faults(data)


_DEFAULT = "upper_twist,lower_twist,upper_chord,lower_chord,upper_pitch,lower_pitch"


def optimise_pairs(
    upper: UpperArgument = THESIS,
    lower: LowerArgument = None,
    spacing: Annotated[str, SPACING] = "20mm",
    thrust: Annotated[float, typer.Option(metavar="N", help="Thrust of the pair.")] = 0.9,
    pitch: Annotated[
        str, typer.Option(metavar="ANGLE[,ANGLE]", help="Pitch of upper and lower rotor at the start.")
    ] = "14",
    vary: Annotated[
        str,
        typer.Option(metavar="NAMES", help="What is free: upper_ and lower_ before twist, chord, pitch, taper."),
    ] = _DEFAULT,
    limit: Annotated[
        list[str] | None,
        typer.Option(metavar="LIMIT", help="As upper_chord<=25mm or lower_pitch>=8deg. Repeat it; quote it."),
    ] = None,
    climb: Annotated[float, typer.Option(metavar="M/S", help="Axial speed, positive in climb.")] = 0.0,
    density: Annotated[float, DENSITY] = 1.2,
    seed: Annotated[int, typer.Option(metavar="K", help="Same seed, same answer.")] = 0,
    generations: Annotated[int, typer.Option(metavar="N", help="How long to search.")] = 30,
    check: Annotated[
        bool, typer.Option("--check/--no-check", help="Whether start and optimum are computed by the wake method too.")
    ] = True,
    wake: WakeOption = "free",
    wake_set: WakeSetOption = None,
    n_crit: NCritOption = 0.1,
    engine: EngineOption = "neuralfoil",
    model: ModelOption = "full",
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:  # fmt: skip
    """Search for the blades and pitches of both rotors that need the least power at a thrust, torques balanced.

    Blade elements search; the wake method, which the search does not see, computes start and optimum at the end, and
    both gains are printed. With --out both rotors are written as rotor files, upper.toml and lower.toml.

    Examples: mufly coax optimise --thrust 0.9 --out better; mufly coax optimise --vary upper_pitch,lower_pitch
    --limit 'upper_pitch<=20deg'
    """
    from mufly.study import PAIR_FREE, check_by_wake, optimise_pair, pair_limit, rotor_loads_picture

    if not 0.0 < thrust < math.inf:
        raise InputError("--thrust", "", f"{thrust:g} N is not possible", "give a number above 0")
    if generations < 1:
        raise InputError("--generations", "", f"{generations} is not possible", "give 1 or more")
    names = [n.strip() for n in vary.split(",") if n.strip()]
    for name in names:
        if name not in PAIR_FREE:
            raise InputError("--vary", "", f"{name!r} cannot be free", f"use some of: {', '.join(PAIR_FREE)}")
    limits = [pair_limit(text) for text in limit or []]
    above, below = angles(pitch)
    setup = pair_of(
        upper, lower,
        {"spacing": length(spacing), "upper_pitch": above, "lower_pitch": below, "thrust": thrust, "climb": climb,
         "density": density, "n_crit": n_crit},
        method="wake", wake=wake, wake_set=wake_set, model=model, engine=engine,
    )  # fmt: skip
    with progress_bar("generations", not as_json) as progress:
        best = optimise_pair(
            setup, names, limits=limits, seed=seed, generations=generations, progress=progress
        )
    files = (
        []
        if out is None
        else [_write_rotor(best.upper, out / "upper.toml"), _write_rotor(best.lower, out / "lower.toml")]
    )
    checked: tuple[Result | str, Result | str] | None = None
    if check:
        with wake_progress("start and optimum", not as_json, out) as told:
            checked = check_by_wake(setup, best, told)
    if out is not None:
        after = checked[1] if checked is not None and not isinstance(checked[1], str) else best.after
        files.append(save_picture(rotor_loads_picture(after.upper, after.lower), out, "loads"))
    answer(as_json, lambda: _pair_json(best, checked), lambda: _print_pair_optimum(best, checked), files)


def _short(point: Result | str | None) -> dict[str, Any] | None:
    if point is None:
        return None
    if isinstance(point, str):
        return {"fault": point}
    return {
        "power_W": point.power_W,
        "thrust_N": point.thrust_N,
        "figure_of_merit": point.figure_of_merit,
        **{
            side: {
                "pitch_rad": r.pitch_rad, "speed_rad_s": r.speed_rad_s, "thrust_N": r.thrust_N,
                "torque_Nm": r.torque_Nm, "power_W": r.power_W, "outside_share": r.outside_share,
            }
            for side, r in (("upper", point.upper), ("lower", point.lower))
        },
    }  # fmt: skip


def _pair_json(best: PairOptimum, checked: tuple[Result | str, Result | str] | None) -> dict[str, Any]:
    return {
        "upper": best.upper.toml_tables(),
        "lower": best.lower.toml_tables(),
        "changes": best.changes,
        "at_limit": best.at_limit,
        "evaluations": best.evaluations,
        "bemt": {
            "start": _short(best.before),
            "pitch_only": _short(best.pitched),
            "optimum": _short(best.after),
        },
        "wake": None if checked is None else {"start": _short(checked[0]), "optimum": _short(checked[1])},
    }


def _print_pair_optimum(best: PairOptimum, checked: tuple[Result | str, Result | str] | None) -> None:
    c = console()
    shown = [
        (name, _shown(name, value, ".4g"), "at the end of its range" if name in best.at_limit else "")
        for name, value in best.changes.items()
    ]
    print_table(("free", "found", ""), shown, text=(0, 2))
    heads = ("", "method", "power (W)", "change", "upper rpm", "lower rpm", "upper (N)", "lower (N)", "merit")
    rows: list[tuple[str, ...]] = []

    def add(label: str, method: str, point: Result | str | None, first: Result | str | None) -> None:
        if point is None:
            return
        if isinstance(point, str):
            rows.append((label, method, "-", "", "", "", "", "", ""))
            return
        change = (
            "" if first is None or isinstance(first, str) else f"{point.power_W / first.power_W - 1:+.1%}"
        )
        rows.append(
            (label, method, f"{point.power_W:.4g}", change, f"{point.upper.speed_rad_s / RPM:.0f}",
             f"{point.lower.speed_rad_s / RPM:.0f}", f"{point.upper.thrust_N:.4g}", f"{point.lower.thrust_N:.4g}",
             f"{point.figure_of_merit:.3f}")
        )  # fmt: skip

    add("start", "bemt", best.before, None)
    add("start's blades, best pitch", "bemt", best.pitched, best.before)
    add("optimum", "bemt", best.after, best.before)
    if checked is not None:
        add("start", "wake", checked[0], None)
        add("optimum", "wake", checked[1], checked[0])
    print_table(heads, rows, text=(0, 1))
    for point in checked or ():
        if isinstance(point, str):
            c.print(f"Not confirmed by the wake: {point}", style="yellow", highlight=False)
    share = max(best.after.upper.outside_share, best.after.lower.outside_share)
    if share > 0.0:
        c.print(
            f"At the optimum sections beyond what the polars' engine computed carry up to {share:.0%} of a thrust",
            style="yellow", highlight=False,
        )  # fmt: skip
    c.print(f"{best.evaluations} pairs computed.", style="dim", highlight=False)


coax.app.command("sweep")(sweep_pairs)
coax.app.command("parameters")(pair_parameters)
coax.app.command("optimise")(optimise_pairs)
coax.app.command("map")(coax.coax_map)


def add_to(app: typer.Typer) -> None:
    """Add the commands to ``mufly rotor``."""
    app.command(epilog="Parameters and their units: mufly rotor parameters.")(sweep)
    app.command()(parameters)
    app.command()(rank)
    app.command()(optimise)
