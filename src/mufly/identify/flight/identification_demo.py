"""Demonstration: identify a known vehicle from simulated flights and compare the estimates with the truth.

**Free parameters.** Twelve parameters are free. Eleven act on flight and are hard to measure on benches: torque
coefficients with the stabiliser bar, inertias, linkages, and the bar's following time. The twelfth is the radio delay.
Each starts 50 % too high or too low, at random. Thrust coefficients and motor constants come from benches, as in the
dissertation (Table 5.2).

**Simulated flights under the conditions of the dissertation (Sec. 5.3.2).**
A pilot cannot stabilise the helicopter in open loop, so a PID controller supports the pilot. Its set-points vary
slowly and at random, and a chirp is added to the set-points or to a motor. The controller runs on the ground with
noisy measurements; its commands are logged and reach the vehicle after the radio delay. Four flights as in Sec. 5.3.3
(upper motor, heave, roll, pitch) are fitted. A fifth flight with other signals on all channels is held out.

The vehicle is integrated with :func:`mufly.dynamics.integrate_state` in steps of 1 ms, not with the simulator of the
fits. The battery voltage sags and is logged. Gains and noise are own choices, typical of a small helicopter.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, lfilter

from mufly.dynamics import (
    DrydenWind,
    compute_battery_supply,
    find_trim,
    integrate_state,
    model_parameters,
)
from mufly.dynamics.model_state import ATTITUDE_SLICE, MODEL_POSITION, MODEL_RATES, MOTOR_INPUT_SLICE
from mufly.identify.fit_result import FitResult, RecordPrediction, tabulate_estimates
from mufly.identify.flight.flight_fit import fit_flight_records
from mufly.identify.flight.free_parameters import choose_free_parameters
from mufly.identify.flight.staged_search import FitMethod, FitProgress
from mufly.identify.flight_record import FlightRecord
from mufly.results import ShownBlock, make_lines_block, result, select_fields
from mufly.rotations import euler_from_quaternion
from mufly.vehicle import Vehicle, list_parameters, load_vehicle, replace_parameters

_Array = NDArray[np.float64]

DEMO_SAMPLE_S = 0.01
_DEMO_SETTLING_SAMPLES = 500
RADIO_DELAY_S = 0.025
# Standard deviations: ultrasonic height (m), attitude and yaw of the IMU (rad), gyros (rad/s), voltage (V).
SENSOR_NOISE_STD = {
    "height": 0.01, "roll": 0.01, "pitch": 0.01, "yaw": 0.02, "p": 0.03, "q": 0.03, "r": 0.03, "voltage": 0.02
}  # fmt: skip
_LOGGED_OUTPUTS = ("height", "roll", "pitch", "yaw", "p", "q", "r", "voltage")
_FLIGHT_HEIGHT_M = 1.5  # m
_INITIAL_CHARGE_FRACTION = 0.7
_UNRECORDED_LEAD_S = 2.0  # flight time before the record begins, for records that begin in motion


@dataclass(frozen=True)
class DemoExcitation:
    """Excitation of a demonstration flight: signals (n, 4) added to the set-points, and (n, 2) to the motor inputs.

    The set-points are height (m), roll, pitch and yaw (rad).
    """

    set_point: _Array
    motor_input: _Array


def linear_chirp(time_s: _Array, low_hz: float, high_hz: float) -> _Array:
    """Return a sine whose frequency rises linearly from ``low_hz`` to ``high_hz``, faded in and out over 0.5 s."""
    length = time_s[-1]
    phase = 2 * np.pi * (low_hz * time_s + 0.5 * (high_hz - low_hz) / length * time_s**2)
    fade = np.clip(np.minimum(time_s, length - time_s) / 0.5, 0.0, 1.0)
    return np.sin(phase) * fade


def _make_excitations(n: int, rng: np.random.Generator) -> dict[str, DemoExcitation]:
    t = np.arange(n) * DEMO_SAMPLE_S
    pilot_b, pilot_a = butter(2, 2 * 0.3 * DEMO_SAMPLE_S)

    def pilot_noise(size: float) -> _Array:
        """Return a slow random variation (n,) of a set-point, of RMS ``size``, which fades in at the start."""
        noise = lfilter(pilot_b, pilot_a, rng.standard_normal(n + _DEMO_SETTLING_SAMPLES))[_DEMO_SETTLING_SAMPLES:]
        return size * noise / np.std(noise) * np.clip((t - 0.5) / 1.0, 0.0, 1.0)

    late = np.clip(t - 0.5, 0.0, None)

    def square_wave(size: float, hz: float) -> _Array:
        return size * np.sign(np.sin(2 * np.pi * hz * late))

    out = {}
    for name in ("yaw", "heave", "roll", "pitch", "mixed"):
        set_point = np.column_stack([pilot_noise(0.05), pilot_noise(0.02), pilot_noise(0.02), pilot_noise(0.1)])
        out[name] = DemoExcitation(set_point, np.zeros((n, 2)))
    out["yaw"].motor_input[:, 0] = 0.08 * linear_chirp(late, 0.2, 3.0)
    out["heave"].motor_input[:] = 0.06 * linear_chirp(late, 0.2, 3.0)[:, None]
    out["roll"].set_point[:, 1] += 0.25 * linear_chirp(late, 0.3, 4.0)
    out["pitch"].set_point[:, 2] += 0.25 * linear_chirp(late, 0.3, 4.0)
    # Steps and faster random variation on all channels, which no fitted record contains.
    out["mixed"].set_point[:, :3] += np.column_stack(
        [square_wave(0.2, 0.23), square_wave(0.12, 0.61), square_wave(0.12, 0.47)]
    )
    out["mixed"].motor_input[:] = np.column_stack([square_wave(0.05, 0.9), square_wave(0.05, 0.37)])
    return out


def fly_demo_record(
    vehicle: Vehicle,
    excitation: DemoExcitation,
    rng: np.random.Generator,
    *,
    name: str,
    air: DrydenWind | None = None,
) -> FlightRecord:
    """Simulate one flight in closed loop and return its record.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with the true parameters.
    excitation : DemoExcitation
    rng : numpy.random.Generator
        Generator of the sensor noise.
    name : str
    air : DrydenWind, optional
        Wind with steps of ``DEMO_SAMPLE_S``; calm air by default.
    """
    p, n = model_parameters(vehicle), len(excitation.motor_input)
    hover = find_trim(vehicle, charge=_INITIAL_CHARGE_FRACTION)
    x, wind = hover.state.copy(), np.zeros((n, 3)) if air is None else air.draw_wind_samples(n)
    x[MODEL_POSITION + 2] = -_FLIGHT_HEIGHT_M
    std = np.array([SENSOR_NOISE_STD[o] for o in _LOGGED_OUTPUTS])
    inputs, measured = np.empty((n, 4)), np.empty((n, len(_LOGGED_OUTPUTS)))
    controller = _PilotPid(hover.input)
    steps = round(DEMO_SAMPLE_S / 1e-3)
    late = round(RADIO_DELAY_S / 1e-3)
    whole, part = divmod(late, steps)
    yaw = 0.0
    for k in range(n):
        before = inputs[max(k - whole - 1, 0)] if k > whole else hover.input
        roll, pitch, heading = euler_from_quaternion(x[ATTITUDE_SLICE])
        yaw += math.remainder(heading - yaw, 2 * math.pi)
        duty = np.clip(before[:2], 0.0, 1.0)
        volts = compute_battery_supply(x, duty[0], duty[1], p)[0]
        truth = np.array(
            [-x[MODEL_POSITION + 2], roll, pitch, yaw, x[MODEL_RATES], x[MODEL_RATES + 1], x[MODEL_RATES + 2], volts]
        )
        measured[k] = truth + std * rng.standard_normal(len(std))
        set_point = excitation.set_point[k] + [_FLIGHT_HEIGHT_M, 0.0, 0.0, 0.0]
        inputs[k] = controller.step(measured[k], set_point, excitation.motor_input[k])
        now = inputs[max(k - whole, 0)] if k >= whole else hover.input
        integrate_state(x, before, wind[k], p, 1e-3, part)
        integrate_state(x, now, wind[k], p, 1e-3, steps - part)
    time_s = np.arange(n, dtype=np.float64) * DEMO_SAMPLE_S
    return FlightRecord(name, time_s, inputs, _LOGGED_OUTPUTS, measured, measured[:, -1].copy())


_ANGLE_COLUMNS, _YAW_AND_RATE_COLUMNS = slice(1, 4), slice(3, 7)


class _PilotPid:
    """PID controller of height, roll, pitch and yaw that stands for the pilot, at the sample rate of the log."""

    def __init__(self, hover: _Array) -> None:
        self._hover = hover
        self._height_estimate = self._climb_estimate = 0.0
        self._error_integral = np.zeros(4)
        self._is_first_step = True

    def step(self, y: _Array, set_point: _Array, motor: _Array) -> _Array:
        if self._is_first_step:
            self._height_estimate, self._is_first_step = set_point[0], False
        y_height, y_angles, (_, p, q, r) = y[0], y[_ANGLE_COLUMNS], y[_YAW_AND_RATE_COLUMNS]
        # Height and climb from a second-order observer with poles at -6 1/s.
        error = y_height - self._height_estimate
        self._height_estimate += DEMO_SAMPLE_S * (self._climb_estimate + 12.0 * error)
        self._climb_estimate += DEMO_SAMPLE_S * 36.0 * error
        off = set_point - [self._height_estimate, *y_angles]
        self._error_integral = np.clip(self._error_integral + DEMO_SAMPLE_S * off, -1.0, 1.0)
        height, roll, pitch, yaw = off
        i_height, i_roll, i_pitch, i_yaw = self._error_integral
        heave = 0.05 * height - 0.10 * self._climb_estimate + 0.01 * i_height
        turn = 0.04 * yaw - 0.02 * r + 0.01 * i_yaw
        roll = 0.6 * roll - 0.05 * p + 0.5 * i_roll
        pitch = 0.6 * pitch - 0.05 * q + 0.5 * i_pitch
        u = self._hover + np.array([heave + turn, heave - turn, -pitch, roll])
        u[MOTOR_INPUT_SLICE] += motor
        return np.clip(u, [0.0, 0.0, -1.0, -1.0], 1.0)


def fly_demo_flights(
    vehicle: Vehicle,
    *,
    seed: int = 0,
    seconds: float = 12.0,
    moving: bool = False,
    wind: float = 0.0,
    gust: float = 0.0,
) -> tuple[list[FlightRecord], list[FlightRecord]]:
    """Simulate the flights of the demonstration.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with the true parameters.
    seed : int
        Random seed of pilot and sensor noise.
    seconds : float
        Duration of a flight (s).
    moving : bool
        Begin the records in mid-flight, with rotors, bar and vehicle in motion, instead of in a steady hover.
    wind, gust : float
        Mean wind, from south to north, and standard deviation of the gust components (m/s).

    Returns
    -------
    fit, held_out : list of FlightRecord
        Records to fit (yaw, heave, roll, pitch), and the held-out record (mixed).
    """
    rng = np.random.default_rng(seed)
    before = round(_UNRECORDED_LEAD_S / DEMO_SAMPLE_S) if moving else 0
    n = round(seconds / DEMO_SAMPLE_S) + 1 + before
    signals = _make_excitations(n, rng)
    flown = {}
    for k, (name, signal) in enumerate(signals.items()):
        air = DrydenWind((wind, 0.0, 0.0), gust, step_s=DEMO_SAMPLE_S, seed=5 * seed + k) if wind or gust else None
        flown[name] = fly_demo_record(vehicle, signal, rng, name=f"demo-{name}", air=air).slice_samples(before, n)
    return [flown[k] for k in ("yaw", "heave", "roll", "pitch")], [flown["mixed"]]


DEMO_FREE_SYMBOLS = (
    "cQ_up", "cQ_dw", "Jdrive_up", "Jdrive_dw", "Jrot_up", "Jrot_dw", "Izz", "Iyy", "l_up", "l_dw", "Tf_up", "delay",
)  # fmt: skip
_START_VALUE_ERROR_FRACTION = 0.5


@result(eq=False)
class IdentificationDemo:
    """Fit of the demonstration's records, and the true parameters to compare with.

    Attributes
    ----------
    seed : int
    truth : dict of str to float
        True SI values by symbol.
    start : Vehicle
        Vehicle with the start values of the fit.
    fit : FitResult
    held_out_over_noise : float
        RMS prediction error of the held-out record over the true sensor noise, all outputs.
    """

    seed: int
    truth: dict[str, float]
    start: Vehicle
    fit: FitResult
    held_out_over_noise: float

    def truth_inside_interval(self) -> dict[str, bool]:
        """Return, by symbol, whether the interval contains the true value."""
        return {e.symbol: e.low <= self.truth[e.symbol] <= e.high for e in self.fit.estimates}

    def as_record(self) -> dict[str, Any]:
        """Return the output of ``mufly identify demo --json`` as a dictionary."""
        fit, inside = self.fit, self.truth_inside_interval()
        return {
            "seed": self.seed, **select_fields(fit, "vehicle method converged message"),
            "parameters": [
                {
                    "symbol": e.symbol, "unit": e.unit, "truth": self.truth[e.symbol], "start": e.start,
                    "estimate": e.value, "std": e.std, "interval": [e.low, e.high],
                    "inside": inside[e.symbol],
                }
                for e in fit.estimates
            ],
            "undetermined": list(fit.undetermined), "held_out_error_over_noise_floor": self.held_out_over_noise,
            **select_fields(fit, "cost simulations seconds=computing_time_s"),
        }  # fmt: skip

    def make_printed_blocks(self) -> tuple[ShownBlock, ...]:
        """Return the estimates beside the true values, and the notes on the fit, as printed text."""
        inside, truth = self.truth_inside_interval(), self.truth
        beside = {
            "truth": {k: f"{v:.5g}" for k, v in truth.items()},
            "off": {e.symbol: f"{100 * (e.value / truth[e.symbol] - 1):+.2f} %" for e in self.fit.estimates},
            "": {k: "" if held else "outside" for k, held in inside.items()},
        }
        return (
            tabulate_estimates(self.fit.estimates, f"Demonstration, seed {self.seed}", beside),
            *self.fit.show_notes(),
            make_lines_block(
                f"{sum(inside.values())} of {len(inside)} intervals hold the truth; prediction error of the flight "
                f"that was not fitted is {self.held_out_over_noise:.3f} of the sensors' noise."
            ),
        )


def run_identification_demo(
    *, vehicle: str | Vehicle = "mufly-1.1", seed: int = 0, method: FitMethod = "lm", moving: bool = False,
    on_progress: Callable[[FitProgress], None] | None = None,
) -> IdentificationDemo:  # fmt: skip
    """Simulate the flights, identify the vehicle and compare the estimates with the truth.

    Parameters
    ----------
    vehicle : str or Vehicle
        Vehicle with the true parameters.
    seed : int
        Random seed of pilot, sensor noise and start values.
    method : {"lm", "cma"}
    moving : bool
        Whether records begin in mid-flight; see :func:`fly_demo_flights`.
    on_progress : callable, optional
        As in :func:`mufly.identify.fit_flight_records`.

    Thesis: Figs 5.3 to 5.6.
    """
    truth = load_vehicle(vehicle) if isinstance(vehicle, str) else vehicle
    flights, held_out = fly_demo_flights(truth, seed=seed, moving=moving)
    rows = {r.symbol: r for r in list_parameters(truth)}
    true = {s: RADIO_DELAY_S if s == "delay" else float(rows[s].value) for s in DEMO_FREE_SYMBOLS}
    random = np.random.default_rng([seed, 1])
    factors = np.where(
        random.random(len(DEMO_FREE_SYMBOLS)) < 0.5, 1 - _START_VALUE_ERROR_FRACTION, 1 + _START_VALUE_ERROR_FRACTION
    )
    factor = dict(zip(DEMO_FREE_SYMBOLS, factors, strict=True))
    values = {rows[s].key: true[s] * float(factor[s]) for s in DEMO_FREE_SYMBOLS if s != "delay"}
    start = replace_parameters(truth, values, source="estimated")
    free = choose_free_parameters(
        start, DEMO_FREE_SYMBOLS, flights[0].output_names, delay_s=true["delay"] * float(factor["delay"])
    )
    options = {
        "held_out": held_out,
        "method": method,
        "seed": seed,
        "on_progress": on_progress,
        "held_exact": True,
    }
    fit = fit_flight_records(start, free, flights, **options)  # type: ignore[arg-type]
    return IdentificationDemo(seed, true, start, fit, rms_over_true_noise(fit.records[-1]))


def rms_over_true_noise(record: RecordPrediction) -> float:
    """Return the RMS prediction error, divided by the true sensor noise of the demonstration."""
    std: NDArray[np.float64] = np.array([SENSOR_NOISE_STD[o] for o in record.output_names])
    return float(np.sqrt(np.nanmean((record.residual / std) ** 2)))
