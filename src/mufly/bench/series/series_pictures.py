"""Picture of a series: loads over speed with intervals, one colour per blade and pitch."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mufly.bench.series.series_analysis import SeriesResult, SettingResult
from mufly.results import draws
from mufly.results.result_figure import blank_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LOAD_AXES = (
    ("thrust", "Thrust (N)", 1.0),
    ("torque_upper", "Torque of the upper rotor (mN m)", 1e3),
    ("torque_lower", "Torque of the lower rotor (mN m)", 1e3),
)


@draws(SeriesResult)
def draw_series_result(series: SeriesResult) -> Figure:
    """Draw every setting with its 95 % intervals."""

    shown = [x for x in _LOAD_AXES if any(getattr(s, x[0]) is not None for s in series.settings)]
    figure = blank_figure(1.0 + 4.2 * len(shown), 4.0)
    for axes, (name, label, scale) in zip(figure.subplots(1, len(shown), squeeze=False).flat, shown, strict=True):
        for k, (blades, settings) in enumerate(_group_by_blades(series).items()):
            measured = [(s, load) for s in settings if (load := getattr(s, name)) is not None]
            if measured:
                axes.errorbar(
                    [s.speed_lower_rpm if s.axis == "lower" else s.speed_upper_rpm for s, _ in measured],
                    [scale * load.value for _, load in measured], [scale * load.expanded for _, load in measured],
                    fmt="o-", ms=4, lw=1.0, capsize=3, color=f"C{k % 10}", label=blades,
                )  # fmt: skip
        axes.set(xlabel="Speed (rpm)", ylabel=label)
        axes.grid(alpha=0.3)
    figure.axes[0].legend(fontsize="small")
    refused = "REFUSED, " if series.fatal_issues else ""
    figure.suptitle(f"{series.name}: {refused}95 % intervals", fontsize="medium")
    return figure


def _group_by_blades(series: SeriesResult) -> dict[str, list[SettingResult]]:
    """Return the settings grouped by mounted blades, in the order of speed."""
    out: dict[str, list[SettingResult]] = {}
    for s in sorted(series.settings, key=lambda s: (s.rotor, s.pitch_deg, s.speed_upper_rpm + s.speed_lower_rpm)):
        other = f" above {s.lower_rotor} {s.lower_pitch_deg:g}°" if s.lower_rotor else ""
        ratio = f", ratio {s.speed_lower_rpm / s.speed_upper_rpm:.2f}" if s.axis == "pair" else ""
        out.setdefault(f"{s.rotor} {s.pitch_deg:g}°{other}{ratio}", []).append(s)
    return out
