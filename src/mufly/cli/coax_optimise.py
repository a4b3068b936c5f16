"""``mufly coax optimise``: blades and pitches of both rotors for the least power at a thrust, torques balanced."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mufly.cli.coax_shared import (
    DENSITY,
    SPACING,
    THESIS,
    LowerArgument,
    UpperArgument,
    angles,
    length,
    pair_of,
)
from mufly.cli.options import (
    EngineOption,
    JsonOption,
    ModelOption,
    NCritOption,
    OutOption,
    console,
    print_json,
    print_table,
    progress_bar,
    save_picture,
)
from mufly.cli.wake_options import WakeOption, WakeSetOption, wake_progress
from mufly.errors import InputError

if TYPE_CHECKING:
    from mufly.study import PairOptimum, PairPoint

__all__ = ["add_to"]

_DEFAULT = "upper_twist,lower_twist,upper_chord,lower_chord,upper_pitch,lower_pitch"


def add_to(app: typer.Typer) -> None:
    """Add the command to ``mufly coax``."""
    app.command()(optimise)


def optimise(
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
    files = _write(best, out) if out is not None else []
    checked: tuple[PairPoint | str, PairPoint | str] | None = None
    if check:
        with wake_progress("start and optimum", not as_json, out) as told:
            checked = check_by_wake(setup, best, told)
    if out is not None:
        from mufly.study import PairPoint

        after = checked[1] if checked is not None and isinstance(checked[1], PairPoint) else best.after
        files.append(save_picture(rotor_loads_picture(after.upper, after.lower), out, "loads"))
    if as_json:
        print_json(_json(best, checked, files))
        return
    _print(best, checked)
    for file in files:
        console().print(f"Written: {file}", highlight=False)


def _write(best: PairOptimum, folder: Path) -> list[Path]:
    from mufly.rotor import rotor_toml

    files = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for side, rotor in (("upper", best.upper), ("lower", best.lower)):
            path = folder / f"{side}.toml"
            path.write_text(rotor_toml(rotor), encoding="utf-8")
            files.append(path)
    except OSError as error:
        raise InputError(
            "--out", str(folder), f"cannot be written ({error})", "give another folder"
        ) from error
    return files


def _short(point: PairPoint | str | None) -> dict[str, Any] | None:
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


def _json(
    best: PairOptimum, checked: tuple[PairPoint | str, PairPoint | str] | None, files: list[Path]
) -> dict[str, Any]:
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
        "files": [str(f) for f in files],
    }


def _print(best: PairOptimum, checked: tuple[PairPoint | str, PairPoint | str] | None) -> None:
    from mufly.study.parameters import in_unit

    c = console()
    shown = []
    for name, value in best.changes.items():
        number, unit = in_unit(name, [value])
        shown.append(
            (name, f"{number[0]:.4g} {unit}", "at the end of its range" if name in best.at_limit else "")
        )
    print_table(("free", "found", ""), shown, text=(0, 2))
    heads = ("", "method", "power (W)", "change", "upper rpm", "lower rpm", "upper (N)", "lower (N)", "merit")
    rows: list[tuple[str, ...]] = []

    def add(label: str, method: str, point: PairPoint | str | None, first: PairPoint | str | None) -> None:
        if point is None:
            return
        if isinstance(point, str):
            rows.append((label, method, "-", "", "", "", "", "", ""))
            return
        change = (
            "" if first is None or isinstance(first, str) else f"{point.power_W / first.power_W - 1:+.1%}"
        )
        rpm = 30.0 / math.pi
        rows.append(
            (label, method, f"{point.power_W:.4g}", change, f"{point.upper.speed_rad_s * rpm:.0f}",
             f"{point.lower.speed_rad_s * rpm:.0f}", f"{point.upper.thrust_N:.4g}", f"{point.lower.thrust_N:.4g}",
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
