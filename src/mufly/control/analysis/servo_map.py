"""Servos and control rate that a vehicle needs: roll-pitch over servo lag, servo frame and control rate.

A servo has a lag (first order, ``swash_plate.time_constant``) and a frame, the interval at which it accepts commands. A
command waits for up to one frame; the map assumes a whole frame. Analogue servos have a frame of 20 ms (50 Hz). The
frame 0 describes a servo that follows every command. Commands are delayed by one period plus the frame, in whole
periods.

For every cell several bandwidths of the H-infinity design are tried: the frequencies of the weights are multiplied by
:data:`BANDWIDTH_FACTORS`. Among the sampled loops with a disk margin of :data:`SAFE_DISK_MARGIN` or more, the loop with
the least tilt in gusts is used; without such a loop, the loop with the largest margin. The designs do not know the
delay, and orders differ from cell to cell, so the figures are not smooth over lag. The speed of the swash plate is
three standard deviations, in gusts of 0.5 m/s and with the sensors' noise; a slower servo cannot follow.

Sec. 6.1.9 of the dissertation doubts that servos are fast enough without the stabiliser bar.

Thesis: Sec. 6.1.9.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from mufly.control.analysis.comparison import compute_output_noise_std
from mufly.control.analysis.gust_response import GUST_m_s, compute_lateral_gust_response
from mufly.control.analysis.loop_margins import disk_margin
from mufly.control.designs import POSITION_LOOP_RATE_DIVIDER, design_roll_pitch, design_velocity
from mufly.control.linear_systems import analyse_loop, sample_plant
from mufly.control.synthesis.weighting_schemes import DesignSettings, TransferFunction, fill_missing_weights
from mufly.dynamics import linearise_vehicle
from mufly.errors import MuflyError
from mufly.results import ShownBlock, make_lines_block, make_table_block, result
from mufly.vehicle import Vehicle, replace_parameters

LAGS_s = (0.001, 0.01, 0.03, 0.05, 0.08, 0.12)
RATES_Hz = (50.0, 100.0, 200.0, 400.0)
FRAMES_s = (0.0, 0.02)
BANDWIDTH_FACTORS = (0.35, 0.7, 1.4)
"""Factors on the frequencies of the roll-pitch weights."""
SAFE_DISK_MARGIN = 0.6
"""Least disk margin that counts as enough: gains within 5.4 dB and phases within 33 degrees, in both servos."""
_FIGURE_LABELS_AND_UNITS = {
    "disk_margin": ("disk margin", "1"), "sensitivity_peak_dB": ("peak of S_u", "dB"),
    "crossover_rad_s": ("highest crossover of the loop gain", "rad/s"),
    "gust_tilt_rad": (f"tilt in gusts of {GUST_m_s:g} m/s", "rad"),
    "swash_plate_rate_rad_s": ("speed of the swash plate, three deviations", "rad/s"),
}  # fmt: skip


@result
class ServoTimingMap:
    """Margins, tilt in gusts and swash-plate rate of roll-pitch over servo frame, control rate and servo lag.

    Attributes
    ----------
    vehicle_name : str
    bar : bool
        Whether the vehicle has a stabiliser bar.
    table : xarray.Dataset
        Over ``frame_s``, ``rate_Hz``, ``lag_s``: ``disk_margin``, ``sensitivity_peak_dB``, ``crossover_rad_s``,
        ``gust_tilt_rad``, ``swash_plate_rate_rad_s``; nan where no design is stable.
    """

    vehicle_name: str
    bar: bool
    table: xr.Dataset

    def longest_safe_servo_lag_s(self, frame_s: float, rate_Hz: float) -> float:
        """Return the longest servo lag (s) up to which every disk margin is sufficient; nan if none is sufficient."""
        margins = self.table.disk_margin.sel(frame_s=frame_s, rate_Hz=rate_Hz)
        enough = np.cumprod(np.nan_to_num(margins.values) >= SAFE_DISK_MARGIN).astype(bool)
        return float(self.table.lag_s.values[enough][-1]) if enough.any() else float("nan")

    def as_record(self) -> dict[str, Any]:
        """Return all values of the map as JSON data, None where no design is stable."""
        values = {
            name: [[[float(v) if np.isfinite(v) else None for v in row] for row in plane] for plane in array.values]
            for name, array in self.table.data_vars.items()
        }
        axes = {str(name): axis.values.tolist() for name, axis in self.table.coords.items()}
        return {"vehicle": self.vehicle_name, "bar": self.bar, **axes, **{str(k): v for k, v in values.items()}}

    def make_printed_blocks(self) -> list[ShownBlock]:
        """Return a table for each frame, and the slowest servo at each rate."""
        blocks: list[ShownBlock] = []
        t = self.table
        for frame in t.frame_s.values:
            rows = []
            for rate in t.rate_Hz.values:
                for name, factor, form in (
                    ("disk_margin", 1.0, ".2f"),
                    ("gust_tilt_rad", np.degrees(1.0), ".2f"),
                    ("swash_plate_rate_rad_s", np.degrees(1.0), ".0f"),
                ):
                    label = {"disk_margin": "disk margin", "gust_tilt_rad": "tilt (deg)"}.get(name, "plate (deg/s)")
                    cells = [
                        f"{factor * v:{form}}" if np.isfinite(v) else "-"
                        for v in t[name].sel(frame_s=frame, rate_Hz=rate).values
                    ]
                    rows.append((f"{rate:g} Hz" if name == "disk_margin" else "", label, *cells))
            heads = ("control rate", "", *(f"{1e3 * lag:g} ms" for lag in t.lag_s.values))
            servo = "servos without a frame" if frame == 0.0 else f"servo frame {1e3 * frame:g} ms"
            with_bar = "with" if self.bar else "without"
            blocks.append(
                make_table_block(heads, rows, title=f"{self.vehicle_name} {with_bar} bar, {servo}, by servo lag")
            )
        said = []
        for frame in t.frame_s.values:
            for rate in t.rate_Hz.values:
                slowest = self.longest_safe_servo_lag_s(frame, rate)
                up_to = "no servo" if np.isnan(slowest) else f"servo lags up to {1e3 * slowest:g} ms"
                cell = f"Frame {1e3 * frame:g} ms, {rate:g} Hz"
                said.append(f"{cell}: {up_to} with a disk margin of {SAFE_DISK_MARGIN:g}")
        blocks.append(make_lines_block(*said))
        return blocks


def compute_servo_map(
    vehicle: Vehicle,
    *,
    lags_s: Sequence[float] = LAGS_s,
    rates_Hz: Sequence[float] = RATES_Hz,
    frames_s: Sequence[float] = FRAMES_s,
    progress: Callable[[int, int], None] | None = None,
) -> ServoTimingMap:
    """Design roll-pitch for every combination of servo lag, servo frame and control rate, and compute its margins.

    Parameters
    ----------
    vehicle : Vehicle
    lags_s, rates_Hz, frames_s : sequence of float
        Servo lags, control rates and servo frames.
    progress : callable, optional
        Called with (lags done, all lags).

    Raises
    ------
    MuflyError
        If the vehicle cannot hover.
    """
    s = fill_missing_weights(DesignSettings(), vehicle)
    shape = len(frames_s), len(rates_Hz), len(lags_s)
    values = {name: np.full(shape, np.nan) for name in _FIGURE_LABELS_AND_UNITS}
    best = dict.fromkeys(np.ndindex(shape), (0.0, 0.0))
    velocities = [design_velocity(s, POSITION_LOOP_RATE_DIVIDER / rate) for rate in rates_Hz]
    for j, lag in enumerate(lags_s):
        slow = replace_parameters(vehicle, {"swash_plate.time_constant": lag})
        linear = linearise_vehicle(slow)
        for i, rate in enumerate(rates_Hz):
            for factor in BANDWIDTH_FACTORS:
                try:
                    design = design_roll_pitch(linear.roll_pitch, scale_roll_pitch_bandwidth(s, factor), 1.0 / rate)
                except MuflyError:
                    continue
                noise = compute_output_noise_std(vehicle, design.plant.output_labels)
                K = design.discrete.to_state_space()
                for f, frame in enumerate(frames_s):
                    delay = 1 + int(np.ceil(frame * rate - 1e-9))
                    plant = sample_plant(design.plant, 1.0 / rate, delay)
                    loop = analyse_loop(plant, design.feedback_controller(K))
                    if not loop.stable:
                        continue
                    margin = disk_margin(plant, design.feedback_controller(K)).margin
                    gust = compute_lateral_gust_response(
                        linear, design, velocities[i], s.position_gain, delay_samples=delay, noise=noise
                    )
                    rank = min(margin, SAFE_DISK_MARGIN), -gust.tilt_std_rad
                    if not np.isfinite(gust.tilt_std_rad) or rank <= best[f, i, j]:
                        continue
                    best[f, i, j] = rank
                    new = (margin, loop.sensitivity_peak_dB, max(loop.crossovers, default=np.nan), gust.tilt_std_rad,
                           3.0 * gust.swash_plate_rate_std_rad_s)  # fmt: skip
                    for name, value in zip(values, new, strict=True):
                        values[name][f, i, j] = value
        if progress is not None:
            progress(j + 1, len(lags_s))
    table = xr.Dataset(
        {
            name: (
                ("frame_s", "rate_Hz", "lag_s"),
                array,
                {"long_name": _FIGURE_LABELS_AND_UNITS[name][0], "units": _FIGURE_LABELS_AND_UNITS[name][1]},
            )
            for name, array in values.items()
        },
        {"frame_s": list(frames_s), "rate_Hz": list(rates_Hz), "lag_s": list(lags_s)},
        {"vehicle": vehicle.name},
    )
    return ServoTimingMap(vehicle.name, vehicle.stabiliser_bar.fitted, table)


def scale_roll_pitch_bandwidth(settings: DesignSettings, factor: float) -> DesignSettings:
    """Return the settings with roll-pitch weights of scaled bandwidth.

    Both corner frequencies of W_r and the zero of W_v are multiplied by ``factor``.
    """
    w = settings.roll_pitch_weights
    assert w is not None  # fill_missing_weights
    r, v = w.output_noise, w.input_disturbance
    moved = replace(
        w,
        output_noise=TransferFunction(
            (r.numerator[0], factor * r.numerator[1]), (r.denominator[0], factor * r.denominator[1])
        ),
        input_disturbance=TransferFunction((v.numerator[0], factor * v.numerator[1]), v.denominator),
    )
    return replace(settings, roll_pitch_weights=moved)
