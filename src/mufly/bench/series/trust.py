"""Reasons not to believe a series, as far as its record shows them; each names what was seen and what to do.

==============  =======  ==============================================================================================
kind            refuses  seen
==============  =======  ==============================================================================================
saturated       yes      a cell met the end of its range at a point
zero            yes      a zero jumped between two readings by more than 5 % of the largest load of that cell
reference       yes      the reference's loads changed by more than 2 % and four standard uncertainties between visits
polarity        yes      thrust is negative
speed           yes      more than a fifth of the points did not reach their speed, or did not settle
nonsense        yes      more than a fifth of the points had to leave out more than 2 % of their samples
split           yes      currents and torque cell do not agree about a pair (no: the currents were never calibrated)
outlier         no       a point is off the line of its mounting's other speeds by 2.5 % and five standard uncertainties
incomplete      no       steps of the plan are not in the record
interrupted     no       the series was stopped, a limit was passed, or a device failed, and it went on
broken          no       lines of the record are damaged
==============  =======  ==============================================================================================
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mufly.bench.rig.devices import Facts
from mufly.bench.series.plan import Plan
from mufly.bench.series.readings import Readings
from mufly.bench.series.record import Record

ZERO_LIMIT, SHARE = 0.05, 0.2


class Doubt(NamedTuple):
    """A reason not to believe a series: kind (table above), in words, and whether it refuses the series."""

    kind: str
    text: str
    fatal: bool


def doubts_of(plan: Plan, facts: Facts, record: Record, points: Readings, zeros: Readings) -> list[Doubt]:
    """Return what the record itself shows; fatal ones first."""
    out: list[Doubt] = []

    def named(which: Readings) -> str:
        some = [f"{plan.mounting[k].rotor} {plan.mounting[k].pitch_deg:g} deg at {r:g} rpm" for k, r in
                zip(which.mounting[:3], which.nominal_rpm[:3], strict=True)]  # fmt: skip
        return "; ".join(some) + (f" and {len(which) - 3} more" if len(which) > 3 else "")

    full = points.where(points.saturated)
    if len(full) or zeros.saturated.any():
        where = named(full) if len(full) else "a zero"
        out.append(
            Doubt(
                "saturated",
                f"a cell met the end of its range at {where}: lower the amplification or the load",
                True,
            )
        )
    out += _jumps(points, zeros)
    n = max(len(points), 1)
    slow = points.where(~points.at_speed | ~points.settled)
    if len(slow):
        text = f"{len(slow)} of {n} points did not reach their speed or did not settle ({named(slow)})"
        out.append(Doubt("speed", f"{text}: they are left out", len(slow) > SHARE * n))
    wild = points.where(points.wild >= 0.02)
    if len(wild):
        text = f"more than 2 % of a cell's samples were nonsense at {len(wild)} of {n} points ({named(wild)})"
        out.append(Doubt("nonsense", f"{text}: look at the wiring; they are left out", len(wild) > SHARE * n))
    done = record.done
    left = [s for s in plan.steps if s.kind != "warm-up" and (s.mounting, s.index) not in done]
    if left:
        out.append(
            Doubt(
                "incomplete",
                f"{len(left)} of {len(plan.steps)} steps are not measured yet; run the plan again",
                False,
            )
        )
    events = [x for x in record.lines if x["kind"] == "event"]
    for x in events:
        if x["what"] not in ("mounted", "resumed"):
            out.append(Doubt("interrupted", f"{x['what']}: {x.get('why', '')}", False))
    if record.broken:
        out.append(Doubt("broken", f"{record.broken} lines of the record are damaged and passed over", False))
    return sorted(out, key=lambda d: not d.fatal)


def _jumps(points: Readings, zeros: Readings) -> list[Doubt]:
    out = []
    for name in ("thrust_raw", "torque_raw", "thrust", "torque"):
        if name not in zeros.mean or name not in points.mean or len(zeros) < 2 or not len(points):
            continue
        zero = zeros.mean[name]
        largest = float(np.nanmax(np.abs(points.mean[name] - np.interp(points.time, zeros.time, zero))))
        step = np.abs(np.diff(zero))
        k = int(np.argmax(step))
        if step[k] > ZERO_LIMIT * largest:
            out.append(
                Doubt(
                    "zero",
                    f"the zero of {name} jumped by {100 * step[k] / largest:.0f} % of the largest load at "
                    f"{(zeros.time[k] - zeros.time[0]) / 60:.0f} min: something touched the bench",
                    True,
                )
            )
    return out
