"""``mufly coax sweep``: a pair over spacing, speeds, pitches and blades."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mufly.cli.coax_shared import THESIS, LowerArgument, UpperArgument, pair_of
from mufly.cli.options import (
    EngineOption,
    JsonOption,
    ModelOption,
    NCritOption,
    console,
    print_json,
    print_table,
    progress_bar,
    save_picture,
)
from mufly.cli.wake_options import MethodOption, WakeOption, WakeSetOption
from mufly.errors import InputError

if TYPE_CHECKING:
    import xarray as xr

    from mufly.study.parameters import Value

__all__ = ["add_to", "settings_of"]

# Where nothing else is said: the dissertation's pair.
_STANDARD: dict[str, Value] = {"spacing": 0.02, "pitch": math.radians(14.0)}
_SHOWN = 40


def add_to(app: typer.Typer) -> None:
    """Add the command to ``mufly coax``."""
    app.command()(sweep)
    app.command()(parameters)


def parameters(as_json: JsonOption = False) -> None:
    """List everything that `mufly coax sweep` can vary or set, with its units."""
    from mufly.study import PAIR

    if as_json:
        print_json(
            {k: {"unit": p.unit, "units": list(p.units), "meaning": p.meaning} for k, p in PAIR.items()}
        )
        return
    print_table(
        ("parameter", "units", "meaning"),
        [(name, ", ".join(u or "-" for u in p.units), p.meaning) for name, p in PAIR.items()],
        text=(0, 1, 2),
    )
    console().print(
        "upper_rpm=5000:7000:500 is short for upper_speed=5000:7000:500rpm.", style="dim", highlight=False
    )


def settings_of(texts: list[str]) -> dict[str, tuple[Value, ...]]:
    """Settings of a pair; ``upper_rpm=6000`` is ``upper_speed=6000rpm``."""
    from mufly.study import PAIR, parse_settings

    full = [re.sub(r"^\s*(upper|lower)_rpm\s*=\s*(.*?)\s*(rpm)?\s*$", r"\1_speed=\2rpm", t) for t in texts]
    return parse_settings(full, PAIR)


def sweep(
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
    from mufly.study import PAIR, lines_picture, sweep_pairs, write_results
    from mufly.study.pair_sweep import PAIR_OUTPUTS

    if show not in PAIR_OUTPUTS:
        raise InputError("--plot", "", f"{show!r} is no result", f"use one of: {', '.join(PAIR_OUTPUTS)}")
    varied, given = settings_of(vary or []), settings_of(set_ or [])
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
        fixed["upper_speed"] = 6000.0 * math.pi / 30.0
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
        data = sweep_pairs(setup, varied, folder=out, progress=progress, cluster=cluster)
    files: list[Path] = []
    if out is not None:
        files = write_results(data, out)
        try:
            picture = lines_picture(data, show, x=over or next(iter(varied)), title=data.attrs["rotor"])
            files.append(save_picture(picture, out, show))
        except InputError as error:  # too many lines for a picture: the tables are there all the same
            if not as_json:
                console().print(f"No picture: {error}", style="yellow")
    if as_json:
        print_json({**data.to_dict(), "files": [str(f) for f in files]})
        return
    _print(data, show)
    for file in files:
        console().print(f"Written: {file}", highlight=False)


def _print(data: xr.Dataset, variable: str) -> None:
    import numpy as np

    from mufly.study.parameters import in_unit

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
    scales = [30.0 / np.pi, 30.0 / np.pi, 1.0, 1.0, 1e3, 1.0]
    if variable not in columns:
        columns, heads, scales = [*columns, variable], [*heads, variable], [*scales, 1.0]
    values = [scale * data[v].values.ravel() for v, scale in zip(columns, scales, strict=True)]
    rows = []
    for k, index in enumerate(np.ndindex(*(data.sizes[n] for n in names))):
        if k == _SHOWN:
            break
        row = []
        for name, i in zip(names, index, strict=True):
            shown, unit = in_unit(name, [data[name].values[i].item()])
            row.append(f"{shown[0]:g} {unit}".strip())
        rows.append([*row, *(f"{v[k]:.4g}" if np.isfinite(v[k]) else "-" for v in values)])
    print_table([*names, *heads], rows, text=())
    if fault.size > _SHOWN:
        c.print(f"and {fault.size - _SHOWN} more; --out writes them all", style="dim")
    reasons, counts = np.unique(fault[fault != ""], return_counts=True)
    for reason, count in list(zip(reasons, counts, strict=True))[:5]:
        c.print(f"failed, {count}: {reason}", style="yellow", highlight=False)
