"""``mufly rotor optimise``: a better rotor within limits, and what each change brought."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mufly.cli.options import (
    DriveOption,
    EngineOption,
    JsonOption,
    MethodOption,
    ModelOption,
    NCritOption,
    RotorArgument,
    WakeOption,
    WakeSetOption,
    corrections_of,
    drive_or_none,
    wake_of,
)
from mufly.cli.present import console, print_json, print_table, progress_bar, save_picture

if TYPE_CHECKING:
    import xarray as xr

    from mufly.rotor.wake import WakeSettings
    from mufly.study import Optimum, Setup
    from mufly.study.parameters import Value


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
    from mufly.errors import InputError
    from mufly.rotor import rotor_toml
    from mufly.study import choose_airfoils, parse_limit
    from mufly.study import optimise as search

    given = set_ or []
    if not any(text.strip().startswith("thrust") for text in given):
        given = [*given, "thrust=0.4N"]
    setup, several = setup_of(rotor, drive, given, model, n_crit, engine, flags=False)
    if several:
        raise InputError("--set", next(iter(several)), "has several values", "give one")
    names = [name.strip() for name in free.split(",") if name.strip()]
    candidates = choose_airfoils(airfoils or ["thesis"]) if "airfoil" in names else []
    limits = [parse_limit(text) for text in limit or []]
    with progress_bar("generations", not as_json) as progress:
        best = search(
            setup, goal, names,  # type: ignore[arg-type]
            limits=limits, airfoils=candidates, seed=seed, generations=generations, progress=progress,
        )  # fmt: skip
    if out is not None:
        try:
            out.write_text(rotor_toml(best.rotor), encoding="utf-8")
        except OSError as error:
            raise InputError(
                "--out", str(out), f"cannot be written ({error})", "give another file"
            ) from error
    if as_json:
        print_json(_json(best))
        return
    _print(best)
    if out is not None:
        console().print(f"Written: {out}")


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
    from mufly.study.parameters import in_unit

    rows = [("start", "", f"{best.before:.5g}", "", "")]
    for step in best.steps:
        values, unit = in_unit(step.parameter, [step.value])
        value = str(values[0]) if values.dtype.kind == "U" else f"{values[0]:.4g} {unit}".strip()
        rows.append(
            (
                step.parameter,
                value,
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
        f"{r['speed_rad_s'] * 30 / math.pi:.0f} rpm at {math.degrees(best.pitch_rad):.2f}°, gear "
        f"{r['gear_ratio']:.3g}, duty {r['duty']:.2f}, least thickness {1e3 * r['least_thickness_m']:.2f} mm",
        highlight=False,
    )


# ----------------------------------------------------------------------------
# ``mufly rotor sweep`` and ``rank``: many rotors at once.


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


def add_to(app: typer.Typer) -> None:
    """Add the commands to ``mufly rotor``."""
    app.command(epilog="Parameters and their units: mufly rotor parameters.")(sweep)
    app.command()(parameters)
    app.command()(rank)
    app.command()(optimise)


def setup_of(
    rotor: str,
    drive: str | None,
    settings: list[str],
    model: str,
    n_crit: float,
    engine: str,
    *,
    flags: bool,
    method: str = "bemt",
    wake: WakeSettings | None = None,
    stations: int | None = None,
) -> tuple[Setup, dict[str, tuple[Value, ...]]]:
    """Return what the options say, and the settings that hold more than one value."""
    from mufly.rotor import load_rotor
    from mufly.rotor.blading import STATIONS
    from mufly.rotor.wake import WakeSettings
    from mufly.study import Setup, parse_settings

    given = parse_settings(settings)
    fixed: dict[str, Any] = {"n_crit": n_crit, **{k: v[0] for k, v in given.items() if len(v) == 1}}
    several = {k: v for k, v in given.items() if len(v) > 1}
    return (
        Setup(
            load_rotor(rotor),
            drive_or_none(drive),
            fixed,
            corrections=corrections_of(model),
            engine=engine,
            flags=flags,
            method=method,
            wake=wake or WakeSettings(),
            stations=stations or STATIONS,
        ),
        several,
    )


def parameters(as_json: JsonOption = False) -> None:
    """List everything that can be varied or set, with its units."""
    from mufly.study import PARAMETERS

    if as_json:
        print_json(
            {k: {"unit": p.unit, "units": list(p.units), "meaning": p.meaning} for k, p in PARAMETERS.items()}
        )
        return
    print_table(
        ("parameter", "units", "meaning"),
        [(name, ", ".join(u or "-" for u in p.units), p.meaning) for name, p in PARAMETERS.items()],
        text=(0, 1, 2),
    )


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
    from mufly.errors import InputError
    from mufly.study import parse_settings
    from mufly.study import sweep as run

    settings, stations = wake_of(method, wake, wake_set)
    setup, several = setup_of(
        rotor,
        drive,
        set_ or [],
        model,
        n_crit,
        engine,
        flags=True,
        method=method,
        wake=settings,
        stations=stations,
    )
    if several:
        raise InputError("--set", next(iter(several)), "has several values", "vary it with --vary")
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
    files = _write(data, out, _plotted(data, show)) if out is not None else []
    if as_json:
        print_json({**data.to_dict(), "files": [str(f) for f in files]})
        return
    _print_best(data, _plotted(data, show))
    for file in files:
        console().print(f"Written: {file}")


def _plotted(data: xr.Dataset, asked: str | None) -> str:
    from mufly.errors import InputError

    if asked is not None and asked not in data.data_vars:
        raise InputError(
            "--plot", "", f"{asked!r} is no result", f"use one of: {', '.join(map(str, data.data_vars))}"
        )
    return asked or ("thrust_per_power_N_W" if "thrust_per_power_N_W" in data else "figure_of_merit")


def _write(data: xr.Dataset, folder: Path, variable: str) -> list[Path]:
    from mufly.errors import InputError
    from mufly.study import lines_picture, write_results

    files = write_results(data, folder)
    try:
        files.append(save_picture(lines_picture(data, variable, title=data.attrs["rotor"]), folder, variable))
    except InputError as error:  # too many lines for a picture: the tables are there all the same
        console().print(f"No picture: {error}", style="yellow")
    return files


def _print_best(data: xr.Dataset, variable: str) -> None:
    """Print the best case over the pitch for every combination of the rest, best first, at most 40."""
    import numpy as np

    from mufly.study.parameters import in_unit

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
    order = np.argsort(-flat[np.arange(flat.shape[0]), best], kind="stable")[:40]
    rows = []
    for k in order:
        index = np.unravel_index(k, tuple(data.sizes[d] for d in others)) if others else ()
        row = [_value(data, d, int(i), in_unit) for d, i in zip(others, index, strict=True)]
        if "pitch" in data.dims:
            row.append(_value(data, "pitch", int(best[k]), in_unit))
        top = flat[k, best[k]]
        rows.append([*row, f"{top:.5g}" if np.isfinite(top) else "-"])
    heads = [*others, *(["best pitch"] if "pitch" in data.dims else []), f"{variable}"]
    print_table(heads, rows)
    reasons, counts = np.unique(data["fault"].values[data["fault"].values != ""], return_counts=True)
    for reason, count in list(zip(reasons, counts, strict=True))[:5]:
        c.print(f"failed, {count}: {reason}", style="yellow", highlight=False)
    if len(reasons) > 5:
        c.print(f"and {len(reasons) - 5} other reasons, in the table's column 'fault'", style="yellow")


def _value(data: xr.Dataset, name: str, index: int, in_unit: Any) -> str:
    shown, unit = in_unit(name, [data[name].values[index].item()])
    return f"{shown[0]:g} {unit}".strip() if shown.dtype.kind == "f" else str(shown[0])


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

    from mufly.errors import InputError
    from mufly.study import choose_airfoils, parse_values, rank_airfoils, rank_picture, write_results

    standard = ["thrust=0.4N", "gear=adapted"] if drive not in (None, "none") else ["thrust=0.4N"]
    setup, several = setup_of(rotor, drive, set_ or standard, model, n_crit, engine, flags=False)
    if several or "pitch" in setup.fixed or "airfoil" in setup.fixed:
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
    for file in files:
        console().print(f"Written: {file}")
