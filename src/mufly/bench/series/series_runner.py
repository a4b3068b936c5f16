"""Run of a series: mount, settle, average, monitor limits and record; all motors stop at any failure.

    for every step of the plan that is not yet in the record
        request a change of blades if necessary
        zero:   stop, wait until the rotors are at rest, average
        point:  command the speed, wait until speed and loads have settled, average to the required precision
        write the reading to the disk

:class:`LimitGuard` checks every batch of samples. An exceeded limit, a request to stop (Ctrl-C, SIGTERM) or a silent
device ends the acquisition, and all motors stop before any other action. A failed device is reopened and the step
repeated, at most twice, after a new zero, because a reset microcontroller may have lost its scale.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.bench.bench_loads import CellCalibration
from mufly.bench.rig.bench_devices import BenchFacts, BenchRig, DeviceError, Samples
from mufly.bench.series.block_means import BlockMean, compute_block_mean, has_settled
from mufly.bench.series.series_plan import BenchLimits, BladeMounting, PlanStep, SeriesPlan
from mufly.bench.series.series_record import SeriesRecord
from mufly.errors import InputError, MuflyError
from mufly.quantities.units import RPM

Array = NDArray[np.float64]

MAX_STEP_TRIES = 3
_SETTLED_SPEED_TOLERANCE, _SETTLED_LOAD_TOLERANCE = (
    0.002,
    0.004,
)  # shares of the reading, and of the largest load so far
_REST_SPEED_rad_s = 1.0
_REQUIRED_THRUST_PRECISION = 0.002  # relative standard uncertainty of thrust that ends the averaging of a point
_SPEED_DEVIATION_LIMIT = 0.02  # relative speed error above which a point counts as not at speed
_MAX_WARM_PAUSE_s = 900.0  # longest pause without a new warm-up


class LimitError(MuflyError):
    """Error for an exceeded limit; the bench is stopped."""


class StopRequested(MuflyError):
    """Exception for a requested stop; the bench is stopped."""


@dataclass(frozen=True)
class SeriesProgress:
    """Number of completed steps of a series and its present activity.

    Attributes
    ----------
    done_steps, total_steps : int
        Number of completed steps and of all steps.
    activity : str
        Description of the present activity.
    record_line : dict, optional
        Line just written to the record.
    """

    done_steps: int
    total_steps: int
    activity: str
    record_line: dict[str, Any] | None = None


@dataclass(eq=False)
class LimitGuard:
    """Monitor of samples that raises an error at an exceeded limit or a requested stop.

    Attributes
    ----------
    limits : BenchLimits
    facts : BenchFacts
    stop_requested : callable
        Function that returns whether a stop is requested.
    saturated_channels : set of str
        Channels saturated since :meth:`clear_saturated_channels`.
    """

    limits: BenchLimits
    facts: BenchFacts
    stop_requested: Callable[[], bool]
    saturated_channels: set[str] = field(default_factory=set)
    zero_readings: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._cells: CellCalibration | None = self.facts.cell_calibration()

    def clear_saturated_channels(self) -> None:
        """Clear the set of channels that have reached the end of their range."""
        self.saturated_channels = set()

    def __call__(self, samples: Samples) -> None:
        if self.stop_requested():
            raise StopRequested("stopped on request; the same command resumes the series")
        most = {
            "speed": (self.limits.speed_rpm * RPM, 1 / RPM, "rpm"), "current": (self.limits.current_A, 1.0, "A"),
            "vibration": (self.limits.vibration_m_s2, 1.0, "m/s2"),
        }  # fmt: skip
        for name, values in samples.items():
            if not len(values):
                continue
            x = np.asarray(values, dtype=np.float64)
            quantity = name.split("_")[0]
            if quantity in most:
                limit, scale, unit = most[quantity]
                # The 75 % quantile is robust against noise in single samples of current or speed.
                worst = float(np.quantile(np.abs(x), 0.75))
                if worst > limit:
                    raise LimitError(f"{name} is {worst * scale:.4g} {unit}, beyond the limit of {limit * scale:g}")
            celsius = float(x[-1]) - 273.15
            if name.startswith("motor_temperature") and celsius > self.limits.motor_temperature_degC:
                raise LimitError(
                    f"{name} is {celsius:.0f} degC, beyond the limit of {self.limits.motor_temperature_degC:g}"
                )
            if name in self.facts.ranges:
                low, high = self.facts.ranges[name]
                if np.mean((x <= low) | (x >= high)) > 0.01:
                    self.saturated_channels.add(name)
        self._check_loads(samples)

    def estimate_display_loads(self, means: Mapping[str, BlockMean]) -> dict[str, float]:
        """Return display values of thrust and torque from the load cells, corrected by the last zero reading only."""
        if self._cells is None:
            return {n: means[n].value - self.zero_readings.get(n, 0.0) for n in ("thrust", "torque") if n in means}
        names = [f"{c}_raw" for c in self._cells.channels]
        if any(n not in means for n in names):
            return {}
        y, zero = [means[n].value for n in names], [self.zero_readings.get(n, math.nan) for n in names]
        return dict(
            zip(
                self._cells.channels,
                self._cells.readings_to_loads(np.array([y]), np.array(zero))[0].tolist(),
                strict=True,
            )
        )

    def _check_loads(self, samples: Samples) -> None:
        """Check approximate force and torque of a batch against their limits."""
        cells = self._cells
        found: dict[str, float] = {}
        if cells is not None:
            y = [
                np.median(samples[f"{c}_raw"]) if len(samples.get(f"{c}_raw", ())) else math.nan for c in cells.channels
            ]
            zero = [self.zero_readings.get(f"{c}_raw", b) for c, b in zip(cells.channels, cells.offset, strict=True)]
            if np.all(np.isfinite(y)):
                f = cells.readings_to_loads(np.array([y]), np.array(zero))[0]
                found = dict(zip(cells.channels, f.tolist(), strict=True))
        for name in ("thrust", "torque"):
            if len(samples.get(name, ())):
                found[name] = float(np.median(np.asarray(samples[name])))
        for name, limit, unit in (
            ("thrust", self.limits.thrust_N, "N"),
            ("torque", self.limits.torque_Nm, "N m"),
        ):
            if abs(found.get(name, 0.0)) > limit:
                raise LimitError(f"{name} is {found[name]:.4g} {unit}, beyond the limit of {limit:g}")


def run_series(
    plan: SeriesPlan, rig: BenchRig, record: SeriesRecord, *, asked: Callable[[], bool] = lambda: False,
    told: Callable[[SeriesProgress], None] = lambda _: None, mounted: Callable[[BladeMounting], None] = lambda _: None,
    keep_samples: bool = False, truth: Callable[[PlanStep], Mapping[str, float]] | None = None,
) -> SeriesRecord:  # fmt: skip
    """Measure the steps of a plan that are not yet in the record.

    Parameters
    ----------
    plan : SeriesPlan
    rig : BenchRig
        Bench, opened here and stopped in any case.
    record : SeriesRecord
        Empty record, or record of the same plan, which is continued.
    asked : callable
        Function that returns whether to stop, called several times a second.
    told : callable
        Called with the progress.
    mounted : callable
        Called before a change of blades; returns when the blades are mounted, or raises an error.
    keep_samples : bool
        Whether to record every sample, not only block means.
    truth : callable, optional
        Function that returns the true loads of a step on a simulated bench.

    Raises
    ------
    InputError
        If the record belongs to another plan, or the bench lacks an axis or channel of the plan.
    LimitError, StopRequested, DeviceError, StopError
        If the series is interrupted. The bench is stopped, and the record holds all completed readings.
    """
    _check_plan(plan, rig, record)
    guard = LimitGuard(plan.limits, rig.facts, asked)
    steps = plan.steps
    try:
        rig.open()
        if not record.lines:
            head = {
                "plan": plan.to_toml(),
                "digest": plan.compute_plan_hash(),
                "facts": rig.facts.to_dict(),
                "time": rig.now(),
            }
            record.append_line({"kind": "head", **head})
        else:
            record.append_line({"kind": "event", "what": "resumed", "time": rig.now()})
        runner = _SeriesRunner(plan, rig, record, guard, told, mounted, keep_samples, truth)
        for number, step in enumerate(steps):
            if (step.mounting_index, step.step_in_mounting) not in record.completed_steps:
                runner.run_step(number, step)
        told(SeriesProgress(len(steps), len(steps), "done"))
    except (LimitError, StopRequested, DeviceError) as error:
        rig.stop()
        record.append_line({"kind": "event", "what": type(error).__name__, "why": str(error), "time": rig.now()})
        raise
    finally:
        # The rotors stop before any error is reported, also for a program fault.
        rig.stop()
    return record


def _check_plan(plan: SeriesPlan, rig: BenchRig, record: SeriesRecord) -> None:
    missing = {a for m in plan.mounting for a in m.driven_rotors} - set(rig.driven_axes)
    if missing:
        raise InputError("plan", "mounting", f"needs the axis {', '.join(sorted(missing))}", "this bench "
        f"has {', '.join(rig.driven_axes) or 'none'}; change the plan")  # fmt: skip
    if record.lines and record.header_line.get("digest") != plan.compute_plan_hash():
        raise InputError("plan", "", "is not the plan of this record", "give another folder, or the plan of this one")
    if not record.lines:
        return
    then, now = (json.loads(json.dumps(f)) for f in (record.header_line["facts"], rig.facts.to_dict()))
    for facts in (then, now):
        facts.get("calibration", {}).pop("source", None)  # the path of the calibration file may change
    if other := [name for name in now if now[name] != then.get(name)]:
        raise InputError(
            "rig", ", ".join(other), "differs from the bench on which this series began",
            "resume with that bench (its file, calibration, seed), or give another folder",
        )  # fmt: skip


class _SeriesRunner:
    """State of :func:`run_series` between two steps."""

    def __init__(
        self,
        plan: SeriesPlan,
        rig: BenchRig,
        record: SeriesRecord,
        guard: LimitGuard,
        told: Callable[[SeriesProgress], None],
        mounted: Callable[[BladeMounting], None],
        keep: bool,
        truth: Callable[[PlanStep], Mapping[str, float]] | None,
    ) -> None:
        self.plan, self.rig, self.record, self.guard = plan, rig, record, guard
        self.on_progress, self.on_mount, self.keep_samples, self.true_loads = told, mounted, keep, truth
        self.mounted_index = -1  # mounting of the present blades
        self.step_count = len(plan.steps)
        self.largest_loads: dict[str, float] = {}
        self.needs_zero = bool(record.readings)  # a continued series needs a new zero
        last = record.lines[-2]["time"] if len(record.lines) > 1 else rig.now()
        self.is_cold = bool(record.readings) and rig.now() - float(last) > _MAX_WARM_PAUSE_s

    def run_step(self, number: int, step: PlanStep) -> None:
        """Run one step, and repeat it if a device fails."""
        mounting = self.plan.mounting[step.mounting_index]
        if self.mounted_index != step.mounting_index:
            self.rig.stop()
            self._wait_for_rest(number)
            self._report_progress(number, f"mount {mounting.describe_mounting()}")
            self.on_mount(mounting)
            self.rig.record_mounting(mounting)
            self.mounted_index = step.mounting_index
            self.record.append_line(
                {"kind": "event", "what": "mounted", "mounting": step.mounting_index, "time": self.rig.now()}
            )
        for tries in range(1, MAX_STEP_TRIES + 1):
            try:
                if self.is_cold and step.kind != "warm-up":
                    self._run_warm_up(number, mounting, float(np.median(mounting.speeds_rpm)), -1, step.mounting_index)
                if self.needs_zero and step.kind == "point":
                    self._take_reading(number, PlanStep(step.mounting_index, -1, "tare", 0.0), mounting)
                if step.kind == "warm-up":
                    self._run_warm_up(number, mounting, step.speed_rpm, step.step_in_mounting, step.mounting_index)
                else:
                    self._take_reading(number, step, mounting)
                return
            except DeviceError as error:
                self.rig.stop()
                self.record.append_line(
                    {
                        "kind": "event",
                        "what": "device",
                        "why": str(error),
                        "mounting": step.mounting_index,
                        "step": step.step_in_mounting,
                        "try": tries,
                        "time": self.rig.now(),
                    }
                )
                if tries == MAX_STEP_TRIES:
                    raise
                self._report_progress(number, f"{error}; trying again")
                self.rig.open()
                self.needs_zero = True

    def _report_progress(self, number: int, what: str, line: dict[str, Any] | None = None) -> None:
        self.on_progress(SeriesProgress(number, self.step_count, what, line))

    def _collect_samples(self, seconds: float) -> dict[str, Array]:
        return self.rig.collect_samples(seconds, self.guard)

    def _wait_for_rest(self, number: int) -> None:
        """Wait until all rotors are at rest, before a change of blades."""
        until = self.rig.now() + self.plan.times.settle_s
        while self.rig.now() < until:
            self._report_progress(number, "waiting for the rotors to stop")
            block = self._collect_samples(0.5)
            if all(len(v) and abs(float(v[-1])) < _REST_SPEED_rad_s for k, v in block.items() if k.startswith("speed")):
                return
        raise LimitError("a rotor still turns, after the command to stop; cut the power before going near it")

    def _run_warm_up(self, number: int, mounting: BladeMounting, speed_rpm: float, index: int, of: int) -> None:
        began, until = self.rig.now(), self.plan.times.warm_up_s
        self.rig.set_speeds(mounting.speeds_rad_s(speed_rpm))
        currents = []
        while (spent := self.rig.now() - began) < until - 0.1:
            self._report_progress(number, f"warming up, {spent / 60:.0f} of {until / 60:.0f} min at {speed_rpm:g} rpm")
            block = self._collect_samples(min(20.0, until - spent))
            currents.append(
                [float(np.mean(block[f"current_{a}"])) for a in mounting.driven_rotors if f"current_{a}" in block]
            )
        line = {
            "kind": "warmed",
            "mounting": of,
            "step": index,
            "time": self.rig.now(),
            "currents": currents[::3],
        }
        self.record.append_line(line)
        self.is_cold = False

    def _take_reading(self, number: int, step: PlanStep, mounting: BladeMounting) -> None:
        times, point = self.plan.times, step.kind == "point"
        wanted = mounting.speeds_rad_s(step.speed_rpm) if point else {}
        name = f"{step.speed_rpm:g} rpm" if point else "zero"
        self._report_progress(number, f"{name}: settling")
        self.rig.set_speeds(wanted)
        settled = self._wait_until_settled(wanted)
        self.guard.clear_saturated_channels()
        self._report_progress(number, f"{name}: averaging")
        began, blocks = self.rig.now(), [self._collect_samples(times.average_s if point else times.tare_s)]
        while True:
            block = {k: np.concatenate([b[k] for b in blocks if k in b]) for k in blocks[0]}
            means = {k: compute_block_mean(v) for k, v in block.items()}
            spent = self.rig.now() - began
            if not point or spent >= times.longest_s - 0.1 or self._is_precise_enough(means):
                break
            blocks.append(self._collect_samples(min(times.average_s, times.longest_s - spent)))
        at_speed = all(
            abs(means[f"speed_{a}"].value - w) <= _SPEED_DEVIATION_LIMIT * w
            for a, w in wanted.items()
            if f"speed_{a}" in means
        )
        for k, m in means.items():
            if not point and k.startswith(("thrust", "torque")):
                self.guard.zero_readings[k] = m.value
        line: dict[str, Any] = {
            "kind": "reading", "what": step.kind, "mounting": step.mounting_index, "step": step.step_in_mounting,
            "time": 0.5 * (began + self.rig.now()), "seconds": self.rig.now() - began, "speed_rpm": step.speed_rpm,
            "settled": settled, "at_speed": at_speed, "saturated": sorted(self.guard.saturated_channels),
            "channels": {k: list(m) for k, m in means.items()},
        }  # fmt: skip
        if point:
            line["quick"] = self.guard.estimate_display_loads(means)
        if self.keep_samples:
            line["samples"] = {k: [float(f"{x:.7g}") for x in v] for k, v in block.items()}
        if self.true_loads is not None and point:
            line["truth"] = dict(self.true_loads(step))
        self.record.append_line(line)
        self.needs_zero = False
        self._report_progress(number + 1, f"{name}: done" + ("" if settled else ", but it had not settled"), line)

    def _wait_until_settled(self, wanted: Mapping[str, float]) -> bool:
        """Wait until speeds and loads agree in two successive windows; return False if they do not within the plan's
        settling time.
        """
        times, before = self.plan.times, dict[str, BlockMean]()
        until = self.rig.now() + times.settle_s
        while self.rig.now() < until:
            now = {k: compute_block_mean(v) for k, v in self._collect_samples(times.window_s).items()
                   if k.startswith(("speed", "thrust", "torque"))}  # fmt: skip
            good = bool(before)
            for k, m in now.items():
                if k.startswith("speed"):
                    goal = wanted.get(k.removeprefix("speed_"), 0.0)
                    tolerance = max(_SETTLED_SPEED_TOLERANCE * abs(goal), _REST_SPEED_rad_s)
                    # A settled but wrong speed is detected later.
                    good = (
                        good
                        and abs(m.value - before.get(k, m).value) <= tolerance
                        and (goal > 0 or m.value < tolerance)
                    )
                else:
                    self.largest_loads[k] = max(
                        self.largest_loads.get(k, 0.0),
                        abs(m.value - self.guard.zero_readings.get(k, m.value)),
                    )
                    tolerance = max(_SETTLED_LOAD_TOLERANCE * self.largest_loads[k], m.std)
                    good = good and k in before and has_settled(before[k], m, tolerance)
            if good:
                return True
            before = now
        return False

    def _is_precise_enough(self, means: Mapping[str, BlockMean]) -> bool:
        """Return whether the loads of a point have the required precision."""
        for k in ("thrust_raw", "torque_raw", "thrust", "torque"):
            if k in means:
                load = abs(means[k].value - self.guard.zero_readings.get(k, 0.0))
                if means[k].std > _REQUIRED_THRUST_PRECISION * load:
                    return False
        return True
