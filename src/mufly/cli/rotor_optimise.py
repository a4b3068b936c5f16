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
    ModelOption,
    NCritOption,
    RotorArgument,
    console,
    print_json,
    print_table,
    progress_bar,
)

if TYPE_CHECKING:
    from mufly.study import Optimum

__all__ = ["optimise"]


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
    from mufly.cli.rotor_study import setup_of
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
