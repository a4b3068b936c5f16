"""Roll-pitch over forward speed: the benefit of gains that are scheduled over speed.

Roll-pitch is designed at every speed and closed around the linear model at every speed, sampled with one sample of
delay. A schedule that knows the speed exactly has the margins of the diagonal: each design at its own speed. The gain
of scheduling is the largest excess of a disk margin on the diagonal over that of the hover design at the same speed.
``rotors.flight_map`` of the vehicle file adds translational lift, blow-back and rate damping; without it only the
drags change with speed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from mufly.control.analysis.loop_margins import disk_margin
from mufly.control.designs import DEFAULT_CONTROL_RATE_HZ, design_roll_pitch
from mufly.control.linear_systems import Array, analyse_loop, sample_plant
from mufly.control.synthesis.synthesis_methods import SYNTHESIS_METHOD_NAMES, SynthesisMethod
from mufly.control.synthesis.weighting_schemes import DesignSettings, fill_missing_weights
from mufly.dynamics import find_trim, linearise_vehicle
from mufly.results import ShownBlock, make_lines_block, make_table_block, result
from mufly.vehicle import Vehicle

SPEEDS_m_s = (0.0, 1.0, 2.0)
FAST_SYNTHESIS_METHODS: tuple[SynthesisMethod, ...] = ("hinf", "h2", "lqg", "ltr", "indi")
"""Methods that design in a fraction of a second."""
MIN_WORTHWHILE_MARGIN_GAIN = 0.1
"""Gain of the disk margin from which a schedule is worth its effort."""


@result
class ScheduleMargins:
    """Margins of one method's roll-pitch designs over forward speed.

    Attributes
    ----------
    method : str
    speeds_m_s : tuple of float
        Speeds of designs (rows) and of flight (columns).
    disk_margin, sensitivity_peak_dB : array, shape (speeds, speeds)
        Zero and ``inf`` for an unstable loop.
    """

    method: SynthesisMethod
    speeds_m_s: tuple[float, ...]
    disk_margin: Array
    sensitivity_peak_dB: Array

    @property
    def largest_disk_margin_increase(self) -> float:
        """Largest increase of the disk margin, over all speeds, by the design for that speed instead of the design for
        the first speed.
        """
        return float(np.max(np.diag(self.disk_margin) - self.disk_margin[0]))


@result
class ScheduleComparison:
    """Margins over forward speed of the roll-pitch designs of several methods.

    Attributes
    ----------
    vehicle_name : str
    has_flight_map : bool
    schedules : tuple of ScheduleMargins
    """

    vehicle_name: str
    has_flight_map: bool
    schedules: tuple[ScheduleMargins, ...]

    @property
    def verdict_sentence(self) -> str:
        """Sentence on whether scheduling over speed is worthwhile."""
        most = max(self.schedules, key=lambda s: s.largest_disk_margin_increase)
        said = (
            f"Scheduling over speed gains at most {most.largest_disk_margin_increase:.2f} of disk margin "
            f"({SYNTHESIS_METHOD_NAMES[most.method]}): "
            + (
                "worthwhile."
                if most.largest_disk_margin_increase >= MIN_WORTHWHILE_MARGIN_GAIN
                else "one design at the first speed is sufficient for all."
            )
        )
        if not self.has_flight_map:
            said += " The vehicle has no flight map, so only its drag changes with speed."
        return said

    def make_printed_blocks(self) -> list[ShownBlock]:
        """Return a table of disk margin and peak of S_u, and the verdict."""
        speeds = self.schedules[0].speeds_m_s
        heads = ("method", "designed at", *(f"at {v:g} m/s" for v in speeds))
        rows = [
            (
                SYNTHESIS_METHOD_NAMES[s.method] if i == 0 else "", f"{v:g} m/s",
                *(f"{d:.2f}, {p:.2f} dB" for d, p in zip(s.disk_margin[i], s.sensitivity_peak_dB[i], strict=True)),
            )
            for s in self.schedules for i, v in enumerate(speeds)
        ]  # fmt: skip
        title = f"{self.vehicle_name}, roll-pitch: disk margin, peak of S_u"
        return [make_table_block(heads, rows, title=title), make_lines_block(self.verdict_sentence)]


def compare_designs_over_speed(
    vehicle: Vehicle,
    methods: Sequence[SynthesisMethod] = FAST_SYNTHESIS_METHODS,
    *,
    speeds_m_s: Sequence[float] = SPEEDS_m_s,
    progress: Callable[[int, int], None] | None = None,
) -> ScheduleComparison:
    """Design roll-pitch at forward speeds by several methods, and assess every design at every speed.

    Parameters
    ----------
    vehicle : Vehicle
    methods : sequence of str
    speeds_m_s : sequence of float
        Forward speeds, rising; the first is that of the single design.
    progress : callable, optional
        Called with (methods done, all methods).

    Raises
    ------
    MuflyError
        If there is no steady flight at a speed, or a design fails.
    """
    base = fill_missing_weights(DesignSettings(), vehicle)
    period, n = 1.0 / DEFAULT_CONTROL_RATE_HZ, len(speeds_m_s)
    plants = [linearise_vehicle(vehicle, find_trim(vehicle, velocity=(v, 0.0, 0.0))).roll_pitch for v in speeds_m_s]
    held = [sample_plant(plant, period, 1) for plant in plants]
    found = []
    for done, method in enumerate(methods):
        disk, peak = np.zeros((n, n)), np.full((n, n), np.inf)
        for i, plant in enumerate(plants):
            design = design_roll_pitch(plant, replace(base, method=method), period)
            K = design.feedback_controller(design.discrete.to_state_space())
            for j, flown in enumerate(held):
                loop = analyse_loop(flown, K)
                if loop.stable:
                    disk[i, j], peak[i, j] = disk_margin(flown, K).margin, loop.sensitivity_peak_dB
        found.append(ScheduleMargins(method, tuple(speeds_m_s), disk, peak))
        if progress is not None:
            progress(done + 1, len(methods))
    return ScheduleComparison(vehicle.name, vehicle.rotors.flight_map is not None, tuple(found))
