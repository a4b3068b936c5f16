"""Validity checks of a series from its record; each issue states the observation and the remedy.

==============  =======  ==============================================================================================
kind            fatal    observation
==============  =======  ==============================================================================================
saturated       yes      a cell met the end of its range at a point
zero            yes      a zero jumped between two readings by more than 5 % of the largest load of that cell
reference       yes      the reference's loads changed by more than 2 % and four standard uncertainties between visits
polarity        yes      thrust is negative
speed           yes      more than a fifth of the points did not reach their speed, or did not settle
nonsense        yes      more than a fifth of the points had more than 2 % outliers among their samples
split           yes      currents and torque cell disagree for a pair (no: the currents were never calibrated)
outlier         no       a point is off the line of its mounting's other speeds by 2.5 % and five standard uncertainties
incomplete      no       steps of the plan are not in the record
interrupted     no       the series was stopped, a limit was passed, or a device failed, and it went on
broken          no       lines of the record are damaged
==============  =======  ==============================================================================================
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from mufly.bench.rig.bench_devices import BenchFacts
from mufly.bench.series.series_plan import SeriesPlan
from mufly.bench.series.series_readings import SeriesReadings
from mufly.bench.series.series_record import SeriesRecord

MAX_ZERO_JUMP, MAX_BAD_POINT_FRACTION = 0.05, 0.2


class SeriesIssue(NamedTuple):
    """Issue of a series: kind (see the table of this module), description, and whether it invalidates the series."""

    kind: str
    text: str
    is_fatal: bool


def find_series_issues(
    plan: SeriesPlan, facts: BenchFacts, record: SeriesRecord, points: SeriesReadings, zeros: SeriesReadings
) -> Iterator[SeriesIssue]:
    """Yield the issues visible in the record."""

    def describe_points(which: SeriesReadings) -> str:
        some = [f"{plan.mounting[k].rotor} {plan.mounting[k].pitch_deg:g} deg at {r:g} rpm" for k, r in
                zip(which.mounting_index[:3], which.nominal_rpm[:3], strict=True)]  # fmt: skip
        return "; ".join(some) + (f" and {len(which) - 3} more" if len(which) > 3 else "")

    full = points.select_readings(points.saturated)
    if len(full) or zeros.saturated.any():
        where = describe_points(full) if len(full) else "a zero"
        yield SeriesIssue(
            "saturated",
            f"a cell met the end of its range at {where}: lower the amplification or the load",
            True,
        )
    yield from _check_zero_jumps(points, zeros)
    n = max(len(points), 1)
    slow = points.select_readings(~points.at_speed | ~points.settled)
    if len(slow):
        text = f"{len(slow)} of {n} points did not reach their speed or did not settle ({describe_points(slow)})"
        yield SeriesIssue("speed", f"{text}: these points are omitted", len(slow) > MAX_BAD_POINT_FRACTION * n)
    wild = points.select_readings(points.spike_share >= 0.02)
    if len(wild):
        text = f"more than 2 % of a cell's samples were invalid at {len(wild)} of {n} points ({describe_points(wild)})"
        yield SeriesIssue(
            "nonsense",
            f"{text}: check the wiring; these points are omitted",
            len(wild) > MAX_BAD_POINT_FRACTION * n,
        )
    done = record.completed_steps
    left = [s for s in plan.steps if s.kind != "warm-up" and (s.mounting_index, s.step_in_mounting) not in done]
    if left:
        yield SeriesIssue(
            "incomplete",
            f"{len(left)} of {len(plan.steps)} steps are not measured yet; run the plan again",
            False,
        )
    events = [x for x in record.lines if x["kind"] == "event"]
    for x in events:
        if x["what"] not in ("mounted", "resumed"):
            yield SeriesIssue("interrupted", f"{x['what']}: {x.get('why', '')}", False)
    if record.broken_lines:
        yield SeriesIssue("broken", f"{record.broken_lines} lines of the record are damaged and skipped", False)


def _check_zero_jumps(points: SeriesReadings, zeros: SeriesReadings) -> Iterator[SeriesIssue]:
    for name in ("thrust_raw", "torque_raw", "thrust", "torque"):
        if name not in zeros.mean or name not in points.mean or len(zeros) < 2 or not len(points):
            continue
        zero = zeros.mean[name]
        largest = float(np.nanmax(np.abs(points.mean[name] - np.interp(points.time_s, zeros.time_s, zero))))
        step = np.abs(np.diff(zero))
        k = int(np.argmax(step))
        if step[k] > MAX_ZERO_JUMP * largest:
            yield SeriesIssue(
                "zero",
                f"the zero of {name} jumped by {100 * step[k] / largest:.0f} % of the largest load at "
                f"{(zeros.time_s[k] - zeros.time_s[0]) / 60:.0f} min: the bench was touched or moved",
                True,
            )
