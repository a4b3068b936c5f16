"""What the commands about coaxial pairs share: options, the pair they describe, tables and JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mufly.cli.options import angle, corrections_of, engine_of, wake_of
from mufly.cli.present import console, print_table, save_picture, write_csv
from mufly.errors import InputError
from mufly.units import RPM

if TYPE_CHECKING:
    from mufly.rotor import RotorResult
    from mufly.study import PairPoint, PairSetup
    from mufly.study.parameters import Value

THESIS = "naca0012-r60-c20"  # the dissertation's pair: this rotor twice at 14 degrees, 20 mm apart

UpperArgument = Annotated[
    str, typer.Argument(metavar="UPPER", help="Upper rotor: built-in name or rotor file (TOML).")
]
LowerArgument = Annotated[
    str | None, typer.Argument(metavar="LOWER", help="Lower rotor; if not given, the upper one again.")
]
SPACING = typer.Option("--spacing", metavar="LENGTH", help="Distance between the discs: 20mm, 2cm, 0.02m.")
DENSITY = typer.Option("--density", metavar="KG/M3", help="Density of the air.")


def _both(option: str, text: str) -> list[str]:
    parts = [p.strip() for p in text.split(",")]
    if len(parts) not in (1, 2) or not all(parts):
        raise InputError(
            option, "", f"{text!r} is neither one value nor two", "write one, or UPPER,LOWER as 14,12"
        )
    return parts if len(parts) == 2 else parts * 2


def speeds(text: str) -> tuple[float, float]:
    """Upper and lower speed (rad/s) of ``"6000,6650"`` or ``"6000"`` rpm."""
    out = []
    for part in _both("--rpm", text):
        try:
            value = float(part.removesuffix("rpm"))
        except ValueError:
            raise InputError("--rpm", "", f"{part!r} is no number", "write for example 6000,6650") from None
        if not 0.0 < value < math.inf:
            raise InputError("--rpm", "", f"{part} is not possible", "give a number above 0")
        out.append(value * RPM)
    return out[0], out[1]


def angles(text: str) -> tuple[float, float]:
    """Upper and lower pitch (rad) of ``"14,12"``, ``"14"`` degrees."""
    upper, lower = (angle("--pitch", part) for part in _both("--pitch", text))
    return upper, lower


def length(text: str) -> float:
    """Distance (m) of ``"20mm"``."""
    from mufly.study.parameters import PAIR, parse_quantity

    try:
        return float(parse_quantity("spacing", text, PAIR))
    except InputError as error:
        raise InputError("--spacing", "", error.problem, error.remedy) from None


def pair_of(
    upper: str, lower: str | None, fixed: dict[str, Value], *, method: str, wake: str, wake_set: list[str] | None,
    model: str, engine: str, balance: str = "lower-speed",
) -> PairSetup:  # fmt: skip
    """The pair that the options describe.

    Raises
    ------
    InputError
        If one of them is wrong.
    """
    from mufly.rotor import load_rotor
    from mufly.study import PairSetup

    settings, stations = wake_of(method, wake, wake_set)
    above = load_rotor(upper)
    below = above if lower is None else load_rotor(lower)
    return PairSetup(
        above, below, fixed, method, settings, corrections_of(model), engine_of(engine), stations=stations,
        free=balance,  # type: ignore[arg-type]
    )  # fmt: skip


def _plain(result: RotorResult) -> dict[str, Any]:
    values = {f.name: getattr(result, f.name) for f in fields(result)}
    stations = {k: v for k, v in values.items() if getattr(v, "ndim", 0) == 1}
    return {**{k: v for k, v in values.items() if k not in stations}, "stations": stations}


def losses(point: PairPoint, alone: tuple[RotorResult, RotorResult]) -> dict[str, float]:
    """What the pair does compared with its rotors alone at the same pitch and speed: ratios less one."""
    thrust = sum(r.thrust_N for r in alone)
    power = sum(r.power_W for r in alone)
    each = zip(("upper", "lower"), (point.upper, point.lower), alone, strict=True)
    return {
        **{
            f"{side}_{key}": getattr(r, name) / getattr(a, name) - 1.0
            for side, r, a in each
            for key, name in (("thrust", "thrust_N"), ("torque", "torque_Nm"))
        },
        "thrust": point.thrust_N / thrust - 1.0,
        "power": point.power_W / power - 1.0,
        "thrust_per_power": (point.thrust_N / point.power_W) / (thrust / power) - 1.0,
    }


def pair_json(
    setup: PairSetup, point: PairPoint, alone: tuple[RotorResult, RotorResult] | None, files: Sequence[Path]
) -> dict[str, Any]:
    """A point as JSON; SI units."""
    s = point.solution
    return {
        "upper": {"rotor": setup.upper.name, **_plain(point.upper)},
        "lower": {"rotor": setup.lower.name, **_plain(point.lower)},
        "spacing_m": point.spacing_m,
        "thrust_N": point.thrust_N,
        "power_W": point.power_W,
        "yaw_torque_Nm": point.yaw_torque_Nm,
        "figure_of_merit": point.figure_of_merit,
        "lower_over_upper": {
            "speed": point.lower.speed_rad_s / point.upper.speed_rad_s,
            "thrust": point.lower.thrust_N / point.upper.thrust_N,
            "torque": point.lower.torque_Nm / point.upper.torque_Nm,
            "power": point.lower.power_W / point.upper.power_W,
        },
        "isolated": None if alone is None else dict(zip(("upper", "lower"), map(_plain, alone), strict=True)),
        "change_from_isolated": None if alone is None else losses(point, alone),
        "method": setup.method,
        "wake": None
        if s is None
        else {
            "converged": s.converged, "message": s.message, "iterations": s.iterations, "residual": s.residual,
            "settings": vars(s.settings),
        },
        "files": [str(f) for f in files],
    }  # fmt: skip


def print_pair(setup: PairSetup, point: PairPoint, alone: tuple[RotorResult, RotorResult] | None) -> None:
    """Print a point as tables."""
    c = console()
    how = (
        "blade element momentum theory"
        if point.solution is None
        else f"{setup.wake.model} wake, {point.message}"
    )
    c.print(
        f"[bold]{setup.upper.name} over {setup.lower.name}[/bold], {1e3 * point.spacing_m:g} mm apart; {how}",
        highlight=False,
    )

    def row(name: str, r: RotorResult) -> tuple[str, ...]:
        merit = f"{r.figure_of_merit:.3f}" if math.isfinite(r.figure_of_merit) else "-"
        return (
            name, f"{r.speed_rad_s / RPM:.0f}", f"{math.degrees(r.pitch_rad):.2f}°", f"{r.thrust_N:.4g}",
            f"{1e3 * r.torque_Nm:.4g}", f"{r.power_W:.4g}", f"{r.c_T:.5f}", f"{r.c_Q:.6f}", merit,
        )  # fmt: skip

    rows = [row("upper", point.upper), row("lower", point.lower)]
    merit = f"{point.figure_of_merit:.3f}" if math.isfinite(point.figure_of_merit) else "-"
    balanced = abs(point.yaw_torque_Nm) < 1e-6 * abs(point.upper.torque_Nm)
    yaw, power = "0" if balanced else f"{1e3 * point.yaw_torque_Nm:+.3g}", f"{point.power_W:.4g}"
    rows.append(("pair", "", "", f"{point.thrust_N:.4g}", yaw, power, "", "", merit))
    if alone is not None:
        rows += [row("upper alone", alone[0]), row("lower alone", alone[1])]
    print_table(("", "rpm", "pitch", "thrust (N)", "torque (mN m)", "power (W)", "c_T", "c_Q", "merit"), rows)
    up, low = point.upper, point.lower
    lines = [
        f"lower over upper: thrust {low.thrust_N / up.thrust_N:.3f}, torque {low.torque_Nm / up.torque_Nm:.3f}, power "
        f"{low.power_W / up.power_W:.3f}, speed {low.speed_rad_s / up.speed_rad_s:.3f}; "
        f"{point.thrust_N / point.power_W:.4g} N/W"
    ]
    if alone is not None:
        x = losses(point, alone)
        lines.append(
            f"against the rotors alone at these speeds: upper thrust {x['upper_thrust']:+.1%}, torque "
            f"{x['upper_torque']:+.1%}; lower thrust {x['lower_thrust']:+.1%}, torque {x['lower_torque']:+.1%}; the "
            f"pair's thrust {x['thrust']:+.1%}, power {x['power']:+.1%}, thrust per power {x['thrust_per_power']:+.1%}"
        )
    for line in lines:
        c.print(line, highlight=False)
    share = max(up.outside_share, low.outside_share)
    if share > 0.0:
        c.print(
            f"sections beyond what the polars' engine computed carry up to {share:.0%} of a rotor's thrust",
            style="yellow", highlight=False,
        )  # fmt: skip


def write_pair(point: PairPoint, alone: tuple[RotorResult, RotorResult] | None, folder: Path) -> list[Path]:
    """Write stations and pictures of a point; of a wake, its geometry, the air around it and its history too."""
    from mufly.study import (
        field_picture,
        history_picture,
        rotor_loads_picture,
        wake_picture,
        write_stations,
    )

    files = [
        write_stations(point.upper, folder, "stations-upper"),
        write_stations(point.lower, folder, "stations-lower"),
        save_picture(rotor_loads_picture(point.upper, point.lower, alone), folder, "loads"),
    ]
    s = point.solution
    if s is not None:
        heads = ("residual", "upper_thrust_N", "upper_torque_Nm", "lower_thrust_N", "lower_torque_Nm")
        files.append(write_csv(folder / "history.csv", heads, s.history))
        history = history_picture(s.history, residual=s.settings.residual, note=s.message)
        files.append(save_picture(history, folder, "history"))
        if s.converged:
            files.append(save_picture(wake_picture(s), folder, "wake"))
            files.append(save_picture(field_picture(s), folder, "air"))
            files.append(save_picture(field_picture(s, mean=False), folder, "air-instant"))
    return files
