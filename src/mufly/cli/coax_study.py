"""``mufly coax map``: coefficients of a pair over both speeds and the climb velocity, for a vehicle to fly with."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

import numpy as np
import typer
from numpy.typing import NDArray

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
    MethodOption,
    ModelOption,
    NCritOption,
    OutOption,
    WakeOption,
    WakeSetOption,
    angle,
    corrections_of,
    engine_of,
    wake_progress,
)
from mufly.cli.present import console, print_json, print_table, progress_bar, save_picture
from mufly.errors import InputError
from mufly.units import RPM

if TYPE_CHECKING:
    import xarray as xr

    from mufly.study import PairOptimum, PairPoint
    from mufly.study.parameters import Value
    from mufly.vehicle import CoefficientMap

_POINTS = {"--rpm": 3, "--ratio": 11, "--climb": 9}
_WAKE_POINTS = {"--rpm": 1, "--ratio": 5, "--climb": 5}
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


def add_map(app: typer.Typer) -> None:
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
    from mufly.rotor.maps import coax_map as compute
    from mufly.rotor.wake import WakeSettings
    from mufly.study import map_picture
    from mufly.vehicle import map_toml

    if method not in ("bemt", "wake"):
        raise InputError("--method", "", f"{method!r} is unknown", "use 'bemt' or 'wake'")
    counts = _WAKE_POINTS if method == "wake" else _POINTS
    speeds = _values("--rpm", rpm, counts, "rpm") * RPM
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
        f"{t.shape[0]} mean speeds, {t.shape[1]} ratios, {t.shape[2]} climbs; below: {mean / RPM:.0f} rpm, climb "
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


# ----------------------------------------------------------------------------
# ``mufly coax optimise``: blades and pitches of both rotors for the least power at a thrust, torques balanced.


_DEFAULT = "upper_twist,lower_twist,upper_chord,lower_chord,upper_pitch,lower_pitch"


def add_optimise(app: typer.Typer) -> None:
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
    _coax_optimise_print(best, checked)
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


def _coax_optimise_print(best: PairOptimum, checked: tuple[PairPoint | str, PairPoint | str] | None) -> None:
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


# ----------------------------------------------------------------------------
# ``mufly coax sweep``: a pair over spacing, speeds, pitches and blades.


# Where nothing else is said: the dissertation's pair.
_STANDARD: dict[str, Value] = {"spacing": 0.02, "pitch": math.radians(14.0)}
_SHOWN = 40


def add_sweep(app: typer.Typer) -> None:
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
    from mufly.study.sweeps import PAIR_OUTPUTS

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
    _coax_sweep_print(data, show)
    for file in files:
        console().print(f"Written: {file}", highlight=False)


def _coax_sweep_print(data: xr.Dataset, variable: str) -> None:
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
