"""``mufly coax map``: coefficients of a pair over both speeds and the climb velocity, for a vehicle to fly with."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, cast

import numpy as np
import typer
from numpy.typing import NDArray

from mufly.cli.options import (
    EngineOption,
    JsonOption,
    ModelOption,
    NCritOption,
    angle,
    console,
    corrections_of,
    engine_of,
    print_json,
    print_table,
    progress_bar,
    save_picture,
)
from mufly.errors import InputError

if TYPE_CHECKING:
    from mufly.vehicle import CoefficientMap

__all__ = ["add_to", "coax_map"]

_RPM = math.pi / 30.0
_POINTS = {"--rpm": 3, "--ratio": 11, "--climb": 9}
_WAKE_POINTS = {"--rpm": 1, "--ratio": 5, "--climb": 5}
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


def add_to(app: typer.Typer) -> None:
    """Add the command to ``mufly coax``."""
    app.command("map")(coax_map)


def coax_map(
    upper: Annotated[str, typer.Argument(metavar="UPPER", help="Upper rotor: built-in name or rotor file.")],
    lower: Annotated[
        str | None, typer.Argument(metavar="[LOWER]", help="Lower rotor; by default the upper one once more.")
    ] = None,
    spacing: Annotated[
        str, typer.Option(metavar="LENGTH", help="Distance between the discs: 20mm, 0.02m.")
    ] = "40mm",
    pitch: Annotated[
        str, typer.Option(metavar="ANGLE[,ANGLE]", help="Pitch of both rotors, or of upper and lower.")
    ] = "14",
    rpm: Annotated[
        str,
        typer.Option(
            metavar="FIRST:LAST[:STEP]",
            help="Mean of both speeds (it sets the Reynolds number); one value will do. 3 values by default, 1 for "
            "wakes: the middle.",
        ),
    ] = "2500:6000",
    ratio: Annotated[
        str,
        typer.Option(
            metavar="FIRST:LAST[:STEP]", help="Lower over upper speed. 11 values by default, 5 for wakes."
        ),
    ] = "0.6:1.6",
    climb: Annotated[
        str,
        typer.Option(
            metavar="FIRST:LAST[:STEP]", help="Climb velocity in m/s at the lowest of the mean speeds, scaled with "
            "speed above; 0 lies inside. 9 values by default, 5 for wakes.",
        ),
    ] = "-1:3",
    method: Annotated[str, typer.Option(metavar="bemt|wake", help="Blade elements, or vortex wakes.")] = "bemt",
    wake: Annotated[
        str, typer.Option("--wake", metavar="free|prescribed", help="Shape of the wakes of --method wake.")
    ] = "free",
    wake_step: Annotated[
        float, typer.Option("--wake-step", metavar="DEG", help="Azimuth step of --method wake.")
    ] = 30.0,
    wake_turns: Annotated[
        float, typer.Option("--wake-turns", metavar="N", help="Free turns of --method wake.")
    ] = 3.0,
    wake_tolerance: Annotated[
        float, typer.Option("--wake-tolerance", metavar="X", help="Settled when the loads change by less.")
    ] = 3e-3,
    wake_iterations: Annotated[
        int, typer.Option("--wake-iterations", metavar="N", help="At most, a point; what has not settled is marked.")
    ] = 150,
    density: Annotated[float, typer.Option(metavar="KG/M3", help="Density of the air.")] = 1.2,
    n_crit: NCritOption = 0.1,
    engine: EngineOption = "neuralfoil",
    model: ModelOption = "full",
    name: Annotated[str, typer.Option(metavar="NAME", help="Name of the map.")] = "",
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Map file (TOML); a picture of the same name (PNG) is drawn beside it."),
    ] = None,
    as_json: JsonOption = False,
) -> None:  # fmt: skip
    """Compute c_T and c_Q of both rotors over their speeds and the climb velocity, as a file that a vehicle can name.

    A line `coefficient_map = "pair.toml"` in the table `rotors` of a vehicle file makes the flight model use it in
    place of the constant coefficients (docs/coax-map.md). A run that is stopped goes on when the same command is given
    again. Blade elements take seconds, wakes minutes.
    Example: mufly coax map walkera-5g6 --spacing 40mm --pitch 14 --rpm 2500:6000 --climb -1:3 --out pair.toml
    """
    from mufly.rotor import Air, climb_ratios, load_rotor, prepare
    from mufly.rotor.coax_map import coax_map as compute
    from mufly.rotor.wake import WakeSettings
    from mufly.study import map_picture
    from mufly.vehicle import map_toml

    if method not in ("bemt", "wake"):
        raise InputError("--method", "", f"{method!r} is unknown", "use 'bemt' or 'wake'")
    counts = _WAKE_POINTS if method == "wake" else _POINTS
    speeds = _values("--rpm", rpm, counts, "rpm") * _RPM
    ratios, climbs = _values("--ratio", ratio, counts, ""), _values("--climb", climb, counts, "m/s")
    if speeds[0] <= 0:
        raise InputError("--rpm", "", f"{rpm!r} is not possible", "give speeds above 0")
    if out is not None and out.suffix != ".toml":
        raise InputError("--out", str(out), "is no name of a map file", "let it end in .toml")
    pitches = [angle("--pitch", part) for part in pitch.split(",")]
    if len(pitches) not in (1, 2):
        raise InputError("--pitch", "", f"{len(pitches)} angles", "give one, or one each for upper and lower")
    fixes, polars = corrections_of(model), engine_of(engine)
    blades = [
        prepare(load_rotor(r), n_crit=n_crit, engine=polars, corrections=fixes)
        for r in (upper, upper if lower is None else lower)
    ]
    settings = None
    if method == "wake":
        settings = WakeSettings(
            model=cast("Literal['free', 'prescribed']", wake), step_deg=wake_step, turns=wake_turns,
            tolerance=wake_tolerance, iterations=wake_iterations,
        )  # fmt: skip
    kept = out.with_suffix(".points") if out is not None else None
    try:
        with progress_bar("points", not as_json) as progress:
            made = compute(
                blades[0], blades[1], spacing_m=_length("--spacing", spacing), upper_pitch_rad=pitches[0],
                lower_pitch_rad=pitches[-1], mean_speed_rad_s=speeds.tolist(), ratio=ratios.tolist(),
                climb_ratio=climb_ratios(climbs.tolist(), speeds.tolist(), blades[0].rotors[0].radius_m).tolist(),
                method=cast("Literal['bemt', 'wake']", method), air=Air(density_kg_m3=density), settings=settings,
                name=name or (out.stem if out is not None else ""),
                note=f"polars {engine}, n_crit {n_crit:g}, corrections {model}", kept=kept, progress=progress,
            )  # fmt: skip
    except KeyboardInterrupt:
        if kept is not None:
            typer.echo(f"stopped; the points so far are in {kept}, and the same command goes on", err=True)
        raise
    files = []
    if out is not None:
        partial = out.with_suffix(".toml.part")
        partial.write_text(map_toml(made), encoding="utf-8")
        partial.replace(out)
        files = [out, save_picture(map_picture(made), out.parent, out.stem)]
    if as_json:
        tables = made.tables()._asdict()
        print_json({**made.model_dump(exclude={"table"}), **tables, "files": [str(f) for f in files]})
        return
    _print(made)
    for file in files:
        console().print(f"Written: {file}", highlight=False)


def _print(made: CoefficientMap) -> None:
    t = made.tables()
    c = console()
    c.print(f"[bold]{made.name}[/bold]  {made.description}", highlight=False)
    k, i = t.shape[0] // 2, int(np.argmin(np.abs(t.climb_ratio)))
    mean = float(t.mean_speed_rad_s[k])
    c.print(
        f"{t.shape[0]} mean speeds, {t.shape[1]} ratios, {t.shape[2]} climbs; below: {mean / _RPM:.0f} rpm, climb "
        f"{float(t.climb_ratio[i]) * mean * made.radius_m:.2f} m/s",
        highlight=False,
    )
    print_table(
        ("lower/upper speed", "cT upper", "cQ upper", "cT lower", "cQ lower", ""),
        [
            (f"{t.ratio[j]:.3g}", f"{t.cT_upper[k, j, i]:.5f}", f"{t.cQ_upper[k, j, i]:.6f}",
             f"{t.cT_lower[k, j, i]:.5f}", f"{t.cQ_lower[k, j, i]:.6f}", "" if t.solved[k, j, i] else "from neighbours")
            for j in range(t.shape[1])
        ],
        text=(0, 5),
    )  # fmt: skip
    if t.climb_ratio[0] == 0.0 or t.climb_ratio[-1] == 0.0:
        c.print(
            "Hover lies at the edge of the map, where it is held: damping in heave shows on one side only. Let --climb "
            "reach beyond 0 on both sides.",
            style="yellow",
        )
    missing = int(np.count_nonzero(~t.solved))
    if missing:
        c.print(
            f"{missing} of {t.solved.size} points have no solution and take the mean of their neighbours.",
            style="yellow",
        )


def _values(option: str, text: str, counts: dict[str, int], unit: str) -> NDArray[np.float64]:
    """Return the values of FIRST:LAST[:STEP], which may end in the unit."""
    body = text.strip().removesuffix(unit).strip() if unit else text.strip()
    match = re.fullmatch(rf"({_NUMBER})(?::({_NUMBER})(?::({_NUMBER}))?)?", body)
    if match is None:
        example = {"--rpm": "2500:6000", "--ratio": "0.6:1.6:0.1", "--climb": "-1:3m/s"}[option]
        raise InputError(
            option, "", f"{text!r} is no range", f"write first:last or first:last:step, as {example}"
        )
    first, last, step = (float(g) if g is not None else None for g in match.groups())
    assert first is not None
    if last is None:
        return np.array([first])
    if last <= first or (step is not None and not 0 < step <= (last - first) * (1 + 1e-9)):
        raise InputError(
            option, "", f"{text!r} holds no two values", "let it rise, by a step no longer than that"
        )
    if step is not None:
        n = math.floor((last - first) / step + 1e-9) + 1
        return np.array([round(first + k * step, 12) for k in range(n)])
    n = counts[option]
    return np.array([0.5 * (first + last)] if n == 1 else np.linspace(first, last, n).round(12).tolist())


def _length(option: str, text: str) -> float:
    match = re.fullmatch(rf"\s*({_NUMBER})\s*(mm|cm|m)\s*", text)
    if match is None:
        raise InputError(option, "", f"{text!r} is no length", "write a number and mm, cm or m, as 20mm")
    return float(match[1]) * {"mm": 1e-3, "cm": 1e-2, "m": 1.0}[match[2]]
