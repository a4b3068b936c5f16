"""A known vehicle flown, forgotten and found again.

**The demonstration: fly a known vehicle, forget half of what is known of it, identify it, and compare.**

Twelve numbers are free: the eleven that act on flight and that benches do not give well (torque coefficients with the
stabiliser bar, inertias, linkages, the bar's following time), and the radio's delay. Each starts 50 % off, up or down
at random. Thrust coefficients and motor constants are taken from the benches, as the dissertation does (Table 5.2).

**Flights to identify from, made under the dissertation's conditions (Sec. 5.3.2), with a known truth.**

A pilot cannot hold the helicopter in open loop, so a PID controller helps: the pilot moves its set-points, slowly
and at random here, and a chirp is added to them or to a motor. The controller sits on the ground: it sees noisy
measurements, and what it commands is logged and reaches the vehicle a radio delay later. Four flights as in Sec. 5.3.3
(upper motor, heave, roll, pitch), and one in which everything moves, with other signals, that no fit sees.

The vehicle is integrated with :func:`mufly.dynamics.integrate_state` in steps of 1 ms, not with the simulator of the
fits. Its battery sags, and the voltage is logged. Gains and noise are those of an ordinary small helicopter: own
choice.
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
    battery_state,
    find_trim,
    integrate_state,
    model_parameters,
)
from mufly.dynamics.model_state import ATTITUDE, MOTORS, RS_POS, RS_RATES
from mufly.identify.fit_result import FitResult, RecordPrediction
from mufly.identify.flight.flight_fit import fit_flight_records
from mufly.identify.flight.free_parameters import choose_free_parameters
from mufly.identify.flight.staged_search import FitMethod, FitProgress
from mufly.identify.flight_record import FlightRecord
from mufly.results import result, select_fields
from mufly.rotations import euler_from_quaternion
from mufly.vehicle import Vehicle, list_parameters, load_vehicle, replace_parameters

_Array = NDArray[np.float64]

SAMPLE_S = 0.01
RADIO_DELAY_S = 0.025
# Standard deviations: ultrasonic height (m), attitude and yaw of the IMU (rad), gyros (rad/s), voltage (V).
SENSOR_NOISE_STD = {
    "height": 0.01, "roll": 0.01, "pitch": 0.01, "yaw": 0.02, "p": 0.03, "q": 0.03, "r": 0.03, "voltage": 0.02
}  # fmt: skip
_LOGGED_OUTPUTS = ("height", "roll", "pitch", "yaw", "p", "q", "r", "voltage")
_FLIGHT_HEIGHT_M = 1.5  # m
_INITIAL_CHARGE = 0.7
_UNRECORDED_LEAD_S = 2.0  # before the recorder of a flight that begins in motion


@dataclass(frozen=True)
class DemoExcitation:
    """Added to the set-points (height m, roll, pitch, yaw rad) and to the motors, (n, 4) and (n, 2)."""

    set_point: _Array
    motor_input: _Array


def linear_chirp(time_s: _Array, low_hz: float, high_hz: float) -> _Array:
    """Return a sine whose frequency rises linearly from ``low_hz`` to ``high_hz``, faded in and out over 0.5 s."""
    length = time_s[-1]
    phase = 2 * np.pi * (low_hz * time_s + 0.5 * (high_hz - low_hz) / length * time_s**2)
    fade = np.clip(np.minimum(time_s, length - time_s) / 0.5, 0.0, 1.0)
    return np.sin(phase) * fade


def _make_excitations(n: int, rng: np.random.Generator) -> dict[str, DemoExcitation]:
    t = np.arange(n) * SAMPLE_S
    pilot_b, pilot_a = butter(2, 2 * 0.3 * SAMPLE_S)

    def pilot_noise(size: float) -> _Array:
        """Slow wandering of a set-point."""
        noise = lfilter(pilot_b, pilot_a, rng.standard_normal(n + 500))[500:]
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
    # Steps and faster wandering on everything at once: nothing that the fits have seen.
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
    """Fly one record.

    Parameters
    ----------
    vehicle : Vehicle
        The truth.
    excitation : Excitation
    rng : numpy.random.Generator
        For the sensors.
    name : str
    air : DrydenWind, optional
        With steps of ``SAMPLE_S``; calm by default.
    """
    p, n = model_parameters(vehicle), len(excitation.motor_input)
    hover = find_trim(vehicle, charge=_INITIAL_CHARGE)
    x, wind = hover.state.copy(), np.zeros((n, 3)) if air is None else air.next_samples(n)
    x[RS_POS + 2] = -_FLIGHT_HEIGHT_M
    std = np.array([SENSOR_NOISE_STD[o] for o in _LOGGED_OUTPUTS])
    inputs, measured = np.empty((n, 4)), np.empty((n, len(_LOGGED_OUTPUTS)))
    controller = _PilotPid(hover.input)
    steps = round(SAMPLE_S / 1e-3)
    late = round(RADIO_DELAY_S / 1e-3)
    whole, part = divmod(late, steps)
    yaw = 0.0
    for k in range(n):
        before = inputs[max(k - whole - 1, 0)] if k > whole else hover.input
        roll, pitch, heading = euler_from_quaternion(x[ATTITUDE])
        yaw += math.remainder(heading - yaw, 2 * math.pi)
        duty = np.clip(before[:2], 0.0, 1.0)
        volts = battery_state(x, duty[0], duty[1], p)[0]
        truth = np.array([-x[RS_POS + 2], roll, pitch, yaw, x[RS_RATES], x[RS_RATES + 1], x[RS_RATES + 2], volts])
        measured[k] = truth + std * rng.standard_normal(len(std))
        set_point = excitation.set_point[k] + [_FLIGHT_HEIGHT_M, 0.0, 0.0, 0.0]
        inputs[k] = controller.step(measured[k], set_point, excitation.motor_input[k])
        now = inputs[max(k - whole, 0)] if k >= whole else hover.input
        integrate_state(x, before, wind[k], p, 1e-3, part)
        integrate_state(x, now, wind[k], p, 1e-3, steps - part)
    time_s = np.arange(n, dtype=np.float64) * SAMPLE_S
    return FlightRecord(name, time_s, inputs, _LOGGED_OUTPUTS, measured, measured[:, -1].copy())


class _PilotPid:
    """Pilot support: PID on height, roll, pitch and yaw at the rate of the log."""

    def __init__(self, hover: _Array) -> None:
        self._hover = hover
        self._height_estimate = self._climb_estimate = 0.0
        self._error_integral = np.zeros(4)
        self._is_first_step = True

    def step(self, y: _Array, set_point: _Array, motor: _Array) -> _Array:
        if self._is_first_step:
            self._height_estimate, self._is_first_step = set_point[0], False
        # Height and climb from a second-order observer with poles at -6 1/s.
        error = y[0] - self._height_estimate
        self._height_estimate += SAMPLE_S * (self._climb_estimate + 12.0 * error)
        self._climb_estimate += SAMPLE_S * 36.0 * error
        off = set_point - [self._height_estimate, *y[1:4]]
        self._error_integral = np.clip(self._error_integral + SAMPLE_S * off, -1.0, 1.0)
        (height, roll, pitch, yaw), (_, p, q, r) = off, y[3:7]
        i_height, i_roll, i_pitch, i_yaw = self._error_integral
        heave = 0.05 * height - 0.10 * self._climb_estimate + 0.01 * i_height
        turn = 0.04 * yaw - 0.02 * r + 0.01 * i_yaw
        roll = 0.6 * roll - 0.05 * p + 0.5 * i_roll
        pitch = 0.6 * pitch - 0.05 * q + 0.5 * i_pitch
        u = self._hover + np.array([heave + turn, heave - turn, -pitch, roll])
        u[MOTORS] += motor
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
    """Fly the records of the demonstration.

    Parameters
    ----------
    vehicle : Vehicle
        The truth.
    seed : int
        Of pilot and sensor noise.
    seconds : float
        Length of a flight.
    moving : bool
        Switch the recorder on in mid-flight, when rotors, bar and vehicle move already, instead of in a steady hover.
    wind, gust : float
        Mean wind, from south to north, and standard deviation of a gust's components (m/s).

    Returns
    -------
    fit, held_out : list of Record
        Yaw, heave, roll, pitch; mixed.
    """
    rng = np.random.default_rng(seed)
    before = round(_UNRECORDED_LEAD_S / SAMPLE_S) if moving else 0
    n = round(seconds / SAMPLE_S) + 1 + before
    signals = _make_excitations(n, rng)
    flown = {}
    for k, (name, signal) in enumerate(signals.items()):
        air = DrydenWind((wind, 0.0, 0.0), gust, step_s=SAMPLE_S, seed=5 * seed + k) if wind or gust else None
        flown[name] = fly_demo_record(vehicle, signal, rng, name=f"demo-{name}", air=air).slice_samples(before, n)
    return [flown[k] for k in ("yaw", "heave", "roll", "pitch")], [flown["mixed"]]


DEMO_FREE_SYMBOLS = (
    "cQ_up", "cQ_dw", "Jdrive_up", "Jdrive_dw", "Jrot_up", "Jrot_dw", "Izz", "Iyy", "l_up", "l_dw", "Tf_up", "delay",
)  # fmt: skip
_START_ERROR = 0.5


@result(eq=False, picture="mufly.identify.fit_pictures:fit_picture")
class IdentificationDemo:
    """A fit beside the truth.

    Attributes
    ----------
    seed : int
    truth : dict of str to float
        SI values by symbol.
    start : Vehicle
        What the fit started from.
    fit : Fit
    held_out_over_noise : float
        Root mean square of the held-out record's prediction error over the sensors' true noise, all outputs.
    """

    seed: int
    truth: dict[str, float]
    start: Vehicle
    fit: FitResult
    held_out_over_noise: float

    def truth_inside_interval(self) -> dict[str, bool]:
        """Return, by symbol, whether the interval holds the truth."""
        return {e.symbol: e.low <= self.truth[e.symbol] <= e.high for e in self.fit.estimates}

    def as_record(self) -> dict[str, Any]:
        """Return what ``mufly identify demo --json`` prints."""
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
            "unseen": list(fit.unseen), "held_out_error_over_noise_floor": self.held_out_over_noise,
            **select_fields(fit, "cost simulations seconds"),
        }  # fmt: skip


def run_identification_demo(
    *, vehicle: str | Vehicle = "mufly-1.1", seed: int = 0, method: FitMethod = "lm", moving: bool = False,
    on_progress: Callable[[FitProgress], None] | None = None,
) -> IdentificationDemo:  # fmt: skip
    """Fly, identify, compare.

    Parameters
    ----------
    vehicle : str or Vehicle
        The truth.
    seed : int
        Of pilot, sensor noise and starts.
    method : {"lm", "cma"}
    moving : bool
        Records begin in mid-flight; see :func:`fly_demo_flights`.
    on_progress : callable, optional
        As in :func:`mufly.identify.fit_flight_records`.

    Thesis: Figs 5.3 to 5.6.
    """
    truth = load_vehicle(vehicle) if isinstance(vehicle, str) else vehicle
    flights, held_out = fly_demo_flights(truth, seed=seed, moving=moving)
    rows = {r.symbol: r for r in list_parameters(truth)}
    true = {s: RADIO_DELAY_S if s == "delay" else float(rows[s].value) for s in DEMO_FREE_SYMBOLS}
    random = np.random.default_rng([seed, 1])
    factors = np.where(random.random(len(DEMO_FREE_SYMBOLS)) < 0.5, 1 - _START_ERROR, 1 + _START_ERROR)
    factor = dict(zip(DEMO_FREE_SYMBOLS, factors, strict=True))
    values = {rows[s].key: true[s] * float(factor[s]) for s in DEMO_FREE_SYMBOLS if s != "delay"}
    start = replace_parameters(truth, values, source="estimated")
    free = choose_free_parameters(
        start, DEMO_FREE_SYMBOLS, flights[0].outputs, delay_s=true["delay"] * float(factor["delay"])
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
    """Return the root mean square prediction error over the true noise of the demonstration's sensors."""
    std: NDArray[np.float64] = np.array([SENSOR_NOISE_STD[o] for o in record.output_names])
    return float(np.sqrt(np.nanmean((record.residual / std) ** 2)))
