"""Pictures of a campaign: distributions of the metrics of its flights, and their dependence on parameters.

Successes are blue, failures vermilion. The dashed line is the limit, the dotted line the value that 95 % of the flights
keep (the 95th percentile, or the 5th of a distance). Influence is Spearman's rank correlation of a parameter with a
metric over all flights (Kendall and Gibbons, Rank Correlation Methods); it assumes a monotonic relation, not a linear
one. The grey band is the 95 % range of the correlation of independent values.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from scipy.stats import rankdata

from mufly.flight.monte_carlo.campaign import Campaign, FlightResult
from mufly.flight.monte_carlo.campaign_results import CampaignOutcome, FlightMetric, list_metrics
from mufly.flight.record.flight_pictures import BLUE, GREY, PLOT_STYLE, VERMILION
from mufly.results import draws

_HISTOGRAM_BIN_COUNT = 40
_MAX_SHOWN_PARAMETERS = 12  # parameters shown
_INFLUENCED_METRICS = ("overshoot_m", "tracking_peak_m", "touchdown_speed_m_s", "battery_left")


def draw_distributions(flights: Sequence[FlightResult], tolerance_m: float, title: str = "") -> Figure:
    """Draw a histogram of every metric that differs between flights."""
    shown = [(m, v) for m in list_metrics(tolerance_m) if (v := _split_metric_by_success(flights, m)) is not None]
    columns = 3
    rows = max(1, math.ceil(len(shown) / columns))
    with mpl.rc_context(PLOT_STYLE):
        figure = Figure(figsize=(10.0, 2.3 * rows + 0.7), layout="constrained")
        for k, (m, (good, bad)) in enumerate(shown):
            axes = figure.add_subplot(rows, columns, k + 1)
            both = np.concatenate([good, bad])
            far = np.percentile(both, 95 if m.high_is_bad else 5)
            edges = np.linspace(
                both.min(), both.max(), min(_HISTOGRAM_BIN_COUNT, max(8, int(2 * math.sqrt(len(both)))) + 1)
            )
            axes.hist([good, bad], bins=edges.tolist(), stacked=True, color=[BLUE, VERMILION])
            axes.axvline(far, color=GREY, linestyle=":", linewidth=1.2)
            label = f"{m.label} ({m.unit})" if m.unit != "1" else m.label
            if not math.isnan(m.limit):
                limit = m.limit * m.factor
                label += f", allowed {limit:g}"
                if limit < both.max() + np.ptp(both):  # a distant limit would compress the histogram
                    axes.axvline(limit, color=VERMILION, linestyle="--", linewidth=1.2)
            axes.set_xlabel(label)
            axes.set_ylabel("flights" if k % columns == 0 else "")
            axes.yaxis.set_major_locator(MaxNLocator(integer=True))
        good_count = sum(f.success for f in flights)
        said = f"{good_count} successes (blue), {len(flights) - good_count} failures (red)"
        figure.suptitle(
            f"{title + ': ' if title else ''}{said}; dotted: 95th percentile, dashed: allowed", fontsize=10.0
        )
    return figure


@draws(CampaignOutcome)
def draw_outcome(outcome: CampaignOutcome) -> Figure:
    """Draw the success rate with its interval, and the reasons of failures."""
    with mpl.rc_context(PLOT_STYLE):
        figure = Figure(figsize=(8.0, 1.9 + 0.3 * len(outcome.reasons)), layout="constrained")
        heights = (1.0, max(0.6 * len(outcome.reasons), 0.01))
        upper, lower = figure.subplots(2, 1, height_ratios=heights)
        share = outcome.successes / outcome.flights
        upper.errorbar(
            100 * share, 0, xerr=[[100 * (share - outcome.low)], [100 * (outcome.high - share)]], fmt="o", color=BLUE,
            capsize=4,
        )  # fmt: skip
        upper.set(xlim=(0, 101), yticks=[], xlabel="flights that succeed (%), with the 95 % interval")
        others = ", ".join(f"{count} {name}" for name, count, _, _ in outcome.endings if name != "succeeded")
        upper.set_title(f"{outcome.successes} of {outcome.flights} flights succeeded; {others}")
        if outcome.reasons:
            names, counts = zip(*reversed(outcome.reasons), strict=True)
            lower.barh([n if len(n) < 70 else n[:67] + "..." for n in names], counts, color=VERMILION)
            lower.set_xlabel("flights that failed so")
            lower.xaxis.set_major_locator(MaxNLocator(integer=True))
        else:
            lower.set_axis_off()
    return figure


def _split_metric_by_success(flights: Sequence[FlightResult], m: FlightMetric) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the values of a metric in successes and in failures; None if all values are equal or unknown."""
    parts = [
        m.factor * np.array([v for f in flights if f.success is kind and (v := getattr(f, m.field_name)) is not None])
        for kind in (True, False)
    ]
    both = np.concatenate(parts)
    return (parts[0], parts[1]) if len(both) > 1 and np.ptp(both) > 1e-9 * max(1.0, np.abs(both).max()) else None


def draw_influences(flights: Sequence[FlightResult], campaign: Campaign) -> Figure | None:
    """Draw the influence of each varied parameter on the metrics; None for fewer than 2 parameters or 10 flights."""
    keys = [key for v in campaign.variations for key in v.keys]
    if len(keys) < 2 or len(flights) < 10:
        return None
    shown = [
        m
        for m in list_metrics(campaign.tolerance_m)
        if m.field_name in _INFLUENCED_METRICS and _split_metric_by_success(flights, m) is not None
    ]
    if not shown:
        return None
    with mpl.rc_context(PLOT_STYLE):
        figure = Figure(figsize=(5.0 * min(2, len(shown)), 3.2 * math.ceil(len(shown) / 2)), layout="constrained")
        for k, m in enumerate(shown):
            axes = figure.add_subplot(math.ceil(len(shown) / 2), min(2, len(shown)), k + 1)
            use = [f for f in flights if getattr(f, m.field_name) is not None]
            target = np.array([getattr(f, m.field_name) for f in use])
            rho = {key: _rank_correlation(np.array([f.values[key] for f in use]), target) for key in keys}
            names = sorted(keys, key=lambda key: -abs(rho[key]))[:_MAX_SHOWN_PARAMETERS][::-1]
            axes.barh(names, [rho[n] for n in names], color=[VERMILION if rho[n] > 0 else BLUE for n in names])
            chance = 1.96 / math.sqrt(max(len(use) - 1, 1))
            axes.axvspan(-chance, chance, color=GREY, alpha=0.25, linewidth=0, zorder=0)
            axes.set_xlim(-1.0, 1.0)
            axes.set_xlabel("rank correlation")
            axes.set_title(m.label)
            axes.tick_params(axis="y", labelsize=7.0)
        figure.suptitle(
            "Rank correlation with parameters (red: positive; grey: 95 % range of independent values)", fontsize=10.0
        )
    return figure


def _rank_correlation(a: np.ndarray, b: np.ndarray) -> float:
    if np.ptp(a) == 0.0 or np.ptp(b) == 0.0:
        return 0.0
    return float(np.corrcoef(rankdata(a), rankdata(b))[0, 1])
