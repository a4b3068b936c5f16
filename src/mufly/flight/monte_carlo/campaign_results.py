"""Results of a campaign: success rate with its confidence interval, worst values and tables.

The interval of a share is Wilson's (J. Am. Stat. Assoc. 22, 1927): for ``k`` successes in ``n`` flights, with
``p = k / n`` and ``z = 1.96`` for 95 %,

    (p + z^2 / 2n +- z sqrt(p (1 - p) / n + z^2 / 4n^2)) / (1 + z^2 / n)

It is also valid at p = 1, where the usual ``p +- z sqrt(p (1 - p) / n)`` has no width: 1000 flights without a failure
mean that at most 0.4 % fail.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.flight.monte_carlo.campaign import Campaign, FlightResult
from mufly.flight.monte_carlo.flight_ending import ENDINGS, FlightEnding
from mufly.flight.monte_carlo.worker_pool import campaign_to_dict
from mufly.mission import HARD_TOUCHDOWN_M_S
from mufly.results import ShownBlock, make_lines_block, make_table_block, result
from mufly.vehicle import list_parameters
from mufly.version import __version__

_NORMAL_QUANTILE_95 = 1.959963984540054


class FlightMetric(NamedTuple):
    """A quantity by which flights are compared: its field, label, unit and limit.

    Attributes
    ----------
    field_name : str
        Field of :class:`FlightResult`.
    label : str
    unit : str
        Unit of display.
    factor : float
        Factor from the field's unit to ``unit``.
    high_is_bad : bool
    limit : float
        Largest allowed value (smallest if high is good), in the field's unit; NaN: no limit.
    """

    field_name: str
    label: str
    unit: str
    factor: float = 1.0
    high_is_bad: bool = True
    limit: float = math.nan


def list_metrics(tolerance_m: float) -> tuple[FlightMetric, ...]:
    """Return the metrics of tables and pictures, in their order; ``tolerance_m`` limits position errors (m)."""
    return (
        FlightMetric("overshoot_m", "overshoot, worst", "cm", 100.0),
        FlightMetric("waypoint_error_m", "off a waypoint, worst", "cm", 100.0, limit=tolerance_m),
        FlightMetric("tracking_peak_m", "tracking error, peak", "cm", 100.0),
        FlightMetric("tracking_rms_m", "tracking error, rms", "cm", 100.0),
        FlightMetric("touchdown_speed_m_s", "touchdown speed", "m/s", limit=HARD_TOUCHDOWN_M_S),
        FlightMetric("landing_error_m", "landed off its mark", "cm", 100.0, limit=tolerance_m),
        FlightMetric("tilt_peak_deg", "tilt, peak", "deg"),
        FlightMetric("railed_s", "input at its limit, longest", "s"),
        FlightMetric("oscillation_s", "oscillation, longest", "s"),
        FlightMetric("clearance_m", "distance to obstacles, least", "m", high_is_bad=False),
        FlightMetric("battery_left", "battery left", "%", 100.0, high_is_bad=False),
        FlightMetric("nees", "NEES / n of the estimate", "1"),
        FlightMetric("duration_s", "duration", "s"),
    )


def compute_wilson_interval(successes: int, flights: int, z: float = _NORMAL_QUANTILE_95) -> tuple[float, float]:
    """Return Wilson's interval of the success rate; ``z`` = 1.96 gives 95 %.

    Raises
    ------
    InputError
        If there are no flights, or more successes than flights.
    """
    if not 0 <= successes <= flights or flights < 1:
        raise InputError(
            "wilson",
            "",
            f"{successes} successes in {flights} flights",
            "give at least one flight, and at most as many successes as flights",
        )
    p, n = successes / flights, flights
    middle = p + z * z / (2 * n)
    half = z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    scale = 1 + z * z / n
    # At 0 and 1 the closed form has rounding errors.
    low = 0.0 if successes == 0 else (middle - half) / scale
    return low, 1.0 if successes == n else (middle + half) / scale


@result
class MetricSummary:
    """Statistics of one metric over all flights.

    Attributes
    ----------
    label : str
        Name of the metric.
    unit : str
        Unit of the values.
    count : int
        Number of flights with a value.
    median, percentile_95, worst : float
        Statistics of the values; ``percentile_95`` is on the bad side.
    flight : int
        Index of the worst flight.
    beyond_limit_count : int or None
        Number of flights beyond the limit; None without a limit.
    """

    label: str
    unit: str
    count: int
    median: float
    percentile_95: float
    worst: float
    flight: int
    beyond_limit_count: int | None


@result(
    json="flights successes low high reported_successes refused endings reasons failed worst=metric_summaries",
)
class CampaignOutcome:
    """The outcome of a campaign.

    Attributes
    ----------
    flights, successes : int
        Number of flights, and of successes confirmed by the truth.
    low, high : float
        95 % interval of the success rate (Wilson).
    reported_successes : int
        Number of successes reported by the state machine.
    refused : int
        Number of impossible vehicles that were drawn again.
    endings : tuple
        Class by true motion (:data:`mufly.flight.monte_carlo.flight_ending.ENDINGS`), number of flights, and the 95 %
            interval of its share (Wilson); tip-overs are always listed.
    reasons : tuple
        Reasons of failures without their numbers, each with its count; the commonest first.
    failed : tuple of int
        Indices of the failed flights.
    metric_summaries : tuple of MetricSummary
        Statistics of each metric.
    """

    flights: int
    successes: int
    low: float
    high: float
    reported_successes: int
    refused: int
    endings: tuple[tuple[FlightEnding, int, float, float], ...]
    reasons: tuple[tuple[str, int], ...]
    failed: tuple[int, ...]
    metric_summaries: tuple[MetricSummary, ...]

    def describe_success(self) -> str:
        """Return the success rate and its confidence interval as a sentence."""
        share = self.successes / self.flights
        return (
            f"{self.successes} of {self.flights} flights succeeded, {_format_percent(share)}; of all such "
            f"flights, with 95 % "
            f"confidence, between {_format_percent(self.low)} and {_format_percent(self.high)} do (Wilson's interval)"
        )

    def make_printed_blocks(self) -> list[ShownBlock]:
        """Return the success rate, the reasons of failures, and the worst values."""
        blocks = [
            make_lines_block(
                f"{self.describe_success()}.", style="green" if self.successes == self.flights else "yellow"
            )
        ]
        if self.reported_successes != self.successes:
            text = f"The state machine reports {self.reported_successes} successes."
            blocks.append(make_lines_block(text, style="yellow"))
        if self.refused:
            text = f"{self.refused} draws of impossible vehicles were repeated."
            blocks.append(make_lines_block(text))
        rows = [
            (w.label, f"{w.median:.3g}", f"{w.percentile_95:.3g}", f"{w.worst:.3g}", "" if w.unit == "1" else w.unit,
             f"{w.flight}", "" if w.beyond_limit_count is None else f"{w.beyond_limit_count}")
            for w in self.metric_summaries
        ]  # fmt: skip
        endings = [
            (
                name,
                f"{count}",
                _format_percent(count / self.flights),
                f"{_format_percent(low)} to {_format_percent(high)}",
            )
            for name, count, low, high in self.endings
        ]
        return [
            *blocks,
            make_table_block(("by the truth", "flights", "share", "95 % interval"), endings),
            make_lines_block(*(f"{count} x {reason}" for reason, count in self.reasons), mark="Failed"),
            make_table_block(("", "median", "95 %", "worst", "unit", "flight", "beyond limit"), rows),
        ]


def _format_percent(share: float) -> str:
    return f"{100 * share:.4g} %"


def summarise_outcome(flights: Sequence[FlightResult], tolerance_m: float) -> CampaignOutcome:
    """Return success rate, endings and worst values of a set of flights.

    Raises
    ------
    InputError
        If there are no flights.
    """
    good = [f for f in flights if f.success]
    low, high = compute_wilson_interval(len(good), len(flights))
    ended = Counter(f.ending for f in flights)
    reasons = Counter(_strip_numbers(f.reason) for f in flights if not f.success)
    return CampaignOutcome(
        len(flights), len(good), low, high,
        reported_successes=sum(f.reported_outcome.startswith("succeeded") for f in flights),
        refused=sum(f.refused for f in flights),
        endings=tuple(
            (name, ended[name], *compute_wilson_interval(ended[name], len(flights)))
            for name in ENDINGS
            if ended[name] or name in ("succeeded", "tipped over")
        ),
        reasons=tuple(sorted(reasons.items(), key=lambda r: (-r[1], r[0]))),
        failed=tuple(f.index for f in flights if not f.success),
        metric_summaries=tuple(
            w for m in list_metrics(tolerance_m) if (w := _summarise_metric(flights, m)) is not None
        ),
    )  # fmt: skip


def _strip_numbers(reason: str) -> str:
    return re.sub(r"\[[^]]*\]|[^ ,;:]*\d[^ ,;:]*", "...", reason)


def _summarise_metric(flights: Sequence[FlightResult], m: FlightMetric) -> MetricSummary | None:
    found = [(float(v), f.index) for f in flights if (v := getattr(f, m.field_name)) is not None]
    if not found:
        return None
    values = np.array([v for v, _ in found])
    most, flight = min(found, key=lambda one: (-one[0] if m.high_is_bad else one[0], one[1]))
    beyond = values > m.limit if m.high_is_bad else values < m.limit
    return MetricSummary(
        m.label, m.unit, len(found), m.factor * float(np.median(values)),
        m.factor * float(np.percentile(values, 95 if m.high_is_bad else 5)), m.factor * most, flight,
        None if math.isnan(m.limit) else int(beyond.sum()),
    )  # fmt: skip


def results_dataset(flights: Sequence[FlightResult], campaign: Campaign) -> xr.Dataset:
    """Return flights and their drawn parameters as labelled arrays over ``flight``; unknown values are NaN.

    The arrays do not depend on the workers.
    """

    def make_column(name: str, unit: str, meaning: str) -> tuple[str, NDArray[np.float64], dict[str, str]]:
        values = [math.nan if (v := getattr(f, name)) is None else float(v) for f in flights]
        return "flight", np.array(values), {"units": unit, "long_name": meaning}

    def make_text_column(name: str, meaning: str) -> tuple[str, NDArray[np.str_], dict[str, str]]:
        return "flight", np.array([str(getattr(f, name)) for f in flights], dtype=np.str_), {"long_name": meaning}

    succeeded = np.array([f.success for f in flights], dtype=np.int8)
    variables: dict[str, object] = {
        "success": ("flight", succeeded, {"long_name": "judged by the truth"}),
        "ending": make_text_column("ending", "class by the truth"),
        "reason": make_text_column("reason", "why it failed"),
        "reported_outcome": make_text_column("reported_outcome", "by the state machine"),
        # Text, because netCDF's classic format has no 64-bit integers.
        "seed": make_text_column("seed", "seed of gusts and sensors"),
        "refused": make_column("refused", "1", "impossible vehicles drawn before this one"),
    }
    for k, axis in enumerate("NED"):
        values = np.array([math.nan if f.wind is None else f.wind[k] for f in flights])
        variables[f"wind_{axis}"] = ("flight", values, {"units": "m/s", "long_name": f"steady wind, {axis}"})
    for m in list_metrics(campaign.tolerance_m):
        unit = {"cm": "m", "%": "1"}.get(m.unit, m.unit)
        variables[m.field_name] = make_column(m.field_name, unit, m.label)
    keys = [key for v in campaign.variations for key in v.keys]
    units = {p.key: (p.unit, p.description) for p in list_parameters(campaign.vehicle)}
    for key in keys:
        drawn = np.array([f.values.get(key, math.nan) for f in flights])
        unit, meaning = units[key]
        variables[key.replace(".", "_")] = (
            "flight",
            drawn,
            {"units": unit, "long_name": meaning, "key": key},
        )
    index = np.array([f.index for f in flights], dtype=np.int32)
    attributes = {k: str(v) for k, v in campaign_to_dict(campaign).items()} | {"mufly": __version__}
    return xr.Dataset(variables, {"flight": ("flight", index, {"long_name": "number of the flight"})}, attributes)
