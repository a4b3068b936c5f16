"""Results of a campaign: success rate with its confidence interval, worst values, tables and files.

The interval of a share is Wilson's (J. Am. Stat. Assoc. 22, 1927): of ``k`` successes in ``n`` flights, with
``p = k / n`` and ``z = 1.96`` for 95 %,

    (p + z^2 / 2n +- z sqrt(p (1 - p) / n + z^2 / 4n^2)) / (1 + z^2 / n)

It holds at p = 1 too, where the usual ``p +- z sqrt(p (1 - p) / n)`` claims to be certain: none of 1000 failed means
that at most 0.4 % fail.
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
from mufly.flight.monte_carlo.worker_pool import describe_campaign
from mufly.mission import HARD_TOUCHDOWN_M_S
from mufly.results import ShownBlock, result, show_lines, show_table
from mufly.vehicle import list_parameters
from mufly.version import __version__

_Z95 = 1.959963984540054


class FlightMetric(NamedTuple):
    """A metric of every flight.

    Attributes
    ----------
    name : str
        Field of :class:`FlightResult`.
    label : str
    unit : str
        To be read in.
    factor : float
        From the field's unit to that.
    high_is_bad : bool
    limit : float
        What is allowed of it, in the field's unit; NaN: nothing is said.
    """

    name: str
    label: str
    unit: str
    factor: float = 1.0
    high_is_bad: bool = True
    limit: float = math.nan


def list_metrics(tolerance_m: float) -> tuple[FlightMetric, ...]:
    """Return the numbers that tables and pictures show, in their order."""
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


def wilson_interval(successes: int, flights: int, z: float = _Z95) -> tuple[float, float]:
    """Return the interval of a share, 95 % by default.

    Raises
    ------
    InputError
        If there are no flights, or more successes than flights.
    """
    if not 0 <= successes <= flights or flights < 1:
        raise InputError("wilson", "", f"{successes} of {flights}", "give at least one flight, and no more successes")
    p, n = successes / flights, flights
    middle = p + z * z / (2 * n)
    half = z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    scale = 1 + z * z / n
    # At the ends the closed form leaves the last bit.
    low = 0.0 if successes == 0 else (middle - half) / scale
    return low, 1.0 if successes == n else (middle + half) / scale


@result
class MetricSummary:
    """Statistics of one metric over all flights.

    Attributes
    ----------
    label : str
        What it is.
    unit : str
        Of the numbers.
    count : int
        Flights that have it.
    median, percentile_95, worst : float
        ``percentile_95`` is on the bad side.
    flight : int
        Which has the worst.
    beyond : int or None
        Flights beyond what is allowed; None where nothing is said.
    """

    label: str
    unit: str
    count: int
    median: float
    percentile_95: float
    worst: float
    flight: int
    beyond: int | None


@result(picture="mufly.flight.monte_carlo.campaign_pictures:draw_outcome")
class CampaignOutcome:
    """The outcome of a campaign.

    Attributes
    ----------
    flights, successes : int
        Judged by the truth.
    low, high : float
        95 % interval of the share of successes (Wilson).
    claimed : int
        Successes by what the state machine says.
    refused : int
        Vehicles drawn that cannot be, and were drawn again.
    endings : tuple
        Class by the truth (:data:`mufly.flight.monte_carlo.flight_ending.ENDINGS`), number of flights, and the 95 %
        interval of its share (Wilson); always with tip-overs.
    reasons : tuple
        Why flights failed, with their number, the commonest first; numbers in a reason are left out.
    failed : tuple of int
        Which.
    worst : tuple of Worst
    """

    flights: int
    successes: int
    low: float
    high: float
    claimed: int
    refused: int
    endings: tuple[tuple[FlightEnding, int, float, float], ...]
    reasons: tuple[tuple[str, int], ...]
    failed: tuple[int, ...]
    worst: tuple[MetricSummary, ...]

    def describe_success(self) -> str:
        """Return the share of successes and how sure it is, as a sentence."""
        share = self.successes / self.flights
        return (
            f"{self.successes} of {self.flights} flights succeeded, {_format_percent(share)}; of all such "
            f"flights, with 95 % "
            f"confidence, between {_format_percent(self.low)} and {_format_percent(self.high)} do (Wilson's interval)"
        )

    def shown_blocks(self) -> list[ShownBlock]:
        """Return the share of successes, why flights failed, and the worst numbers."""
        blocks = [
            show_lines(f"{self.describe_success()}.", style="green" if self.successes == self.flights else "yellow")
        ]
        if self.claimed != self.successes:
            text = f"The state machine reports {self.claimed} successes."
            blocks.append(show_lines(text, style="yellow"))
        if self.refused:
            text = f"{self.refused} draws gave impossible vehicles and were repeated."
            blocks.append(show_lines(text))
        rows = [
            (w.label, f"{w.median:.3g}", f"{w.percentile_95:.3g}", f"{w.worst:.3g}", "" if w.unit == "1" else w.unit,
             f"{w.flight}", "" if w.beyond is None else f"{w.beyond}")
            for w in self.worst
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
            show_table(("by the truth", "flights", "share", "95 % interval"), endings),
            show_lines(*(f"{count} x {reason}" for reason, count in self.reasons), mark="Failed"),
            show_table(("", "median", "95 %", "worst", "unit", "flight", "beyond limit"), rows),
        ]


def _format_percent(share: float) -> str:
    return f"{100 * share:.4g} %"


def summarise_outcome(flights: Sequence[FlightResult], tolerance_m: float) -> CampaignOutcome:
    """Return the outcome of a set of flights.

    Raises
    ------
    InputError
        If there are none.
    """
    good = [f for f in flights if f.success]
    low, high = wilson_interval(len(good), len(flights))
    ended = Counter(f.ending for f in flights)
    reasons = Counter(_without_numbers(f.reason) for f in flights if not f.success)
    return CampaignOutcome(
        len(flights), len(good), low, high,
        claimed=sum(f.told.startswith("succeeded") for f in flights), refused=sum(f.refused for f in flights),
        endings=tuple(
            (name, ended[name], *wilson_interval(ended[name], len(flights)))
            for name in ENDINGS
            if ended[name] or name in ("succeeded", "tipped over")
        ),
        reasons=tuple(sorted(reasons.items(), key=lambda r: (-r[1], r[0]))),
        failed=tuple(f.index for f in flights if not f.success),
        worst=tuple(w for m in list_metrics(tolerance_m) if (w := _summarise_metric(flights, m)) is not None),
    )  # fmt: skip


def _without_numbers(reason: str) -> str:
    return re.sub(r"\[[^]]*\]|[^ ,;:]*\d[^ ,;:]*", "...", reason)


def _summarise_metric(flights: Sequence[FlightResult], m: FlightMetric) -> MetricSummary | None:
    found = [(float(v), f.index) for f in flights if (v := getattr(f, m.name)) is not None]
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
    """Return flights as labelled arrays over ``flight``, with every parameter that was drawn; unknown is NaN.

    It depends on the flights alone, not on who flew them.
    """

    def make_column(name: str, unit: str, meaning: str) -> tuple[str, NDArray[np.float64], dict[str, str]]:
        values = [math.nan if (v := getattr(f, name)) is None else float(v) for f in flights]
        return "flight", np.array(values), {"units": unit, "long_name": meaning}

    variables: dict[str, object] = {
        "success": (
            "flight",
            np.array([f.success for f in flights], dtype=np.int8),
            {"long_name": "judged by the truth"},
        ),
        "ending": (
            "flight",
            np.array([f.ending for f in flights], dtype=np.str_),
            {"long_name": "class by the truth"},
        ),
        "reason": (
            "flight",
            np.array([f.reason for f in flights], dtype=np.str_),
            {"long_name": "why it failed"},
        ),
        "told": (
            "flight",
            np.array([f.told for f in flights], dtype=np.str_),
            {"long_name": "by the state machine"},
        ),
        # As text: netCDF's classic format has no integers of 64 bits.
        "seed": (
            "flight",
            np.array([str(f.seed) for f in flights]),
            {"long_name": "seed of gusts and sensors"},
        ),
        "refused": make_column("refused", "1", "impossible vehicles drawn before it"),
    }
    for k, axis in enumerate("NED"):
        values = np.array([math.nan if f.wind is None else f.wind[k] for f in flights])
        variables[f"wind_{axis}"] = ("flight", values, {"units": "m/s", "long_name": f"steady wind, {axis}"})
    for m in list_metrics(campaign.tolerance_m):
        unit = {"cm": "m", "%": "1"}.get(m.unit, m.unit)
        variables[m.name] = make_column(m.name, unit, m.label)
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
    attributes = {k: str(v) for k, v in describe_campaign(campaign).items()} | {"mufly": __version__}
    return xr.Dataset(variables, {"flight": ("flight", index, {"long_name": "number of the flight"})}, attributes)
