"""Tables and text lines for plans and results of series."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from mufly.bench.series.series_analysis import LOAD_NAMES, LoadInterval, SeriesResult, SettingResult
from mufly.bench.series.series_files import LoadDifference
from mufly.bench.series.series_plan import SeriesPlan
from mufly.bench.series.series_runner import SeriesProgress
from mufly.results import ShownBlock, make_lines_block, make_table_block


def tabulate_series_plan(plan: SeriesPlan) -> list[ShownBlock]:
    """Return a table of the mountings of a plan, and the number of points and duration."""
    rows = [
        (f"{k}", m.use, m.describe_mounting(), ", ".join(f"{s:g}" for s in m.speeds_rpm))
        for k, m in enumerate(plan.mounting, 1)
    ]
    pairs = [m for m in plan.mounting if m.axis == "pair"]
    blocks: list[ShownBlock] = [
        make_table_block(("", "use", "blades", "speeds (rpm)"), rows, text=(1, 2, 3)),
        make_lines_block(
            f"{plan.point_count} points, {len(plan.steps)} steps; about {plan.estimate_duration_s() / 60:.0f} min and "
            f"{len(plan.mounting)} changes of blades"
        ),
    ]
    if pairs and len({m.speed_ratio for m in pairs}) < 2:
        text = "One speed ratio determines the total thrust only; --ratio 0.9,1,1.1 separates the two rotors."
        blocks.append(make_lines_block(text))
    return blocks


def format_measured_point(line: dict[str, Any], plan: SeriesPlan, p: SeriesProgress) -> str:
    """Return a text line for a measured point: blades, speed, loads, and a fault if there is one."""
    m, quick = plan.mounting[line["mounting"]], line.get("quick", {})
    loads = []
    if "thrust" in quick:
        loads.append(f"thrust {quick['thrust']:.4g} N")
    if "torque" in quick:
        loads.append(f"torque {1e3 * quick['torque']:.4g} mN m")
    faults = {
        "saturated": line["saturated"],
        "not at its speed": not line["at_speed"],
        "did not settle": not line["settled"],
    }
    fault = next((f"  NOT USABLE: {name}" for name, there in faults.items() if there), "")
    blades = f"{m.rotor} {m.pitch_deg:g} deg {m.axis:5s}"
    return f"{p.done_steps:4d}/{p.total_steps}  {blades} {line['speed_rpm']:6.0f} rpm  {', '.join(loads)}{fault}"


def tabulate_series_result(found: SeriesResult) -> list[ShownBlock]:
    """Return as printed text a table of the settings with their intervals, the corrections, and the issues."""
    pair = any(s.axis == "pair" for s in found.settings)
    heads = ["rotor", "axis", "pitch (deg)", "speed (rpm)", "mounted", "thrust (N)"]
    heads += ["torque upper (mN m)", "torque lower (mN m)"] if pair else ["torque (mN m)"]
    rows = [_setting_row(s)[: len(heads)] for s in found.settings]
    repeat = [
        f"{load}: mountings of the same setting differ by {100 * tau:.2f} % (one standard deviation)"
        for load, tau in found.relative_repeatability.items()
        if math.isfinite(tau)
    ]
    blocks: list[ShownBlock] = [
        make_table_block(heads, rows, text=(0, 1, 3), title=f"{found.name}, 95 % intervals"),
        make_lines_block(*found.notes, *repeat),
    ]
    if all(s.mountings < 2 for s in found.settings):
        text = (
            "no setting was mounted twice: intervals are valid for the blades as mounted, without the error "
            "of their pitch"
        )
        blocks.append(make_lines_block(text))
    inside = [
        abs(load.value - s.truth[f"nominal_{name}"]) <= load.expanded
        for s in found.settings
        for name in LOAD_NAMES
        if (load := getattr(s, name)) is not None and f"nominal_{name}" in s.truth
    ]
    if inside:
        blocks.append(make_lines_block(f"simulated bench: {sum(inside)} of {len(inside)} intervals contain the truth"))
    for d in found.doubts:
        mark, style = ("REFUSED", "red") if d.is_fatal else ("note", "yellow")
        blocks.append(make_lines_block(d.text, mark=mark, style=style))
    return blocks


def _setting_row(s: SettingResult) -> tuple[str, ...]:
    speeds = {"upper": [s.speed_upper_rpm], "lower": [s.speed_lower_rpm]}.get(
        s.axis, [s.speed_upper_rpm, s.speed_lower_rpm]
    )
    torques = (s.torque_upper, s.torque_lower) if s.axis == "pair" else (s.single_rotor_torque, None)
    cells = [_format_load(load, 1e3) for load in torques]
    return (
        s.rotor, s.axis, f"{s.pitch_deg:g}", ", ".join(f"{x:.0f}" for x in speeds), f"{s.mountings}",
        _format_load(s.thrust), cells[0], cells[1] if s.axis == "pair" else "",
    )  # fmt: skip


def _format_load(load: LoadInterval | None, scale: float = 1.0) -> str:
    return "-" if load is None else f"{scale * load.value:.4g} ± {scale * load.expanded:.2g}"


def tabulate_load_differences(found: Sequence[LoadDifference], first: str, second: str) -> list[ShownBlock]:
    """Return a table of the differences between two series, or a series and theory; ``first`` and ``second`` name its
    columns.
    """
    rows = [
        (d.point_description, f"{d.first:.4g}", f"{d.second:.4g}", f"{100 * d.relative:+.1f} %", f"{d.En_score:+.2f}")
        for d in found
    ]
    beyond = sum(abs(d.En_score) > 1 for d in found)
    mean = sum(abs(d.relative) for d in found) / len(found)
    return [
        make_table_block(("setting", first, second, "off", "E_n"), rows),
        make_lines_block(
            f"{beyond} of {len(found)} differ by more than their uncertainty; "
            f"mean absolute difference {100 * mean:.1f} %"
        ),
    ]
