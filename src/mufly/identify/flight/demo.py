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

The vehicle is integrated with :func:`mufly.dynamics.advance` in steps of 1 ms, not with the simulator of the fits.
Its battery sags, and the voltage is logged. Gains and noise are those of an ordinary small helicopter: own choice.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, lfilter

from mufly.dynamics import DrydenWind, advance, battery_state, euler_from_quaternion, model_parameters, trim
from mufly.dynamics.state import ATTITUDE, MOTORS, RS_POS, RS_RATES
from mufly.identify.flight.fit import fit_flights
from mufly.identify.flight.free import choose_free
from mufly.identify.flight.search import Method, Progress
from mufly.identify.record import Record
from mufly.identify.result import Fit, RecordFit
from mufly.results import result
from mufly.vehicle import Vehicle, load_vehicle, parameters, replace

_Array = NDArray[np.float64]

SAMPLE_S = 0.01
RADIO_DELAY_S = 0.025
# Standard deviations: ultrasonic height (m), attitude and yaw of the IMU (rad), gyros (rad/s), voltage (V).
NOISE = {
    "height": 0.01, "roll": 0.01, "pitch": 0.01, "yaw": 0.02, "p": 0.03, "q": 0.03, "r": 0.03, "voltage": 0.02
}  # fmt: skip
_OUTPUTS = ("height", "roll", "pitch", "yaw", "p", "q", "r", "voltage")
_HEIGHT = 1.5  # m
_CHARGE = 0.7
_LEAD_S = 2.0  # before the recorder of a flight that begins in motion


@dataclass(frozen=True)
class Excitation:
    """Added to the set-points (height m, roll, pitch, yaw rad) and to the motors, (n, 4) and (n, 2)."""

    set_point: _Array
    motor: _Array


def chirp(time_s: _Array, low_hz: float, high_hz: float) -> _Array:
    """Return a sine whose frequency rises linearly from ``low_hz`` to ``high_hz``, faded in and out over 0.5 s."""
    length = time_s[-1]
    phase = 2 * np.pi * (low_hz * time_s + 0.5 * (high_hz - low_hz) / length * time_s**2)
    fade = np.clip(np.minimum(time_s, length - time_s) / 0.5, 0.0, 1.0)
    return np.sin(phase) * fade


def _excitations(n: int, rng: np.random.Generator) -> dict[str, Excitation]:
    t = np.arange(n) * SAMPLE_S
    pilot_b, pilot_a = butter(2, 2 * 0.3 * SAMPLE_S)

    def pilot(size: float) -> _Array:
        """Slow wandering of a set-point."""
        noise = lfilter(pilot_b, pilot_a, rng.standard_normal(n + 500))[500:]
        return size * noise / np.std(noise) * np.clip((t - 0.5) / 1.0, 0.0, 1.0)

    late = np.clip(t - 0.5, 0.0, None)

    def steps(size: float, hz: float) -> _Array:
        return size * np.sign(np.sin(2 * np.pi * hz * late))

    out = {}
    for name in ("yaw", "heave", "roll", "pitch", "mixed"):
        set_point = np.column_stack([pilot(0.05), pilot(0.02), pilot(0.02), pilot(0.1)])
        out[name] = Excitation(set_point, np.zeros((n, 2)))
    out["yaw"].motor[:, 0] = 0.08 * chirp(late, 0.2, 3.0)
    out["heave"].motor[:] = 0.06 * chirp(late, 0.2, 3.0)[:, None]
    out["roll"].set_point[:, 1] += 0.25 * chirp(late, 0.3, 4.0)
    out["pitch"].set_point[:, 2] += 0.25 * chirp(late, 0.3, 4.0)
    # Steps and faster wandering on everything at once: nothing that the fits have seen.
    out["mixed"].set_point[:, :3] += np.column_stack([steps(0.2, 0.23), steps(0.12, 0.61), steps(0.12, 0.47)])
    out["mixed"].motor[:] = np.column_stack([steps(0.05, 0.9), steps(0.05, 0.37)])
    return out


def fly_record(
    vehicle: Vehicle,
    excitation: Excitation,
    rng: np.random.Generator,
    *,
    name: str,
    air: DrydenWind | None = None,
) -> Record:
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
    p, n = model_parameters(vehicle), len(excitation.motor)
    hover = trim(vehicle, charge=_CHARGE)
    x, wind = hover.state.copy(), np.zeros((n, 3)) if air is None else air.block(n)
    x[RS_POS + 2] = -_HEIGHT
    std = np.array([NOISE[o] for o in _OUTPUTS])
    inputs, measured = np.empty((n, 4)), np.empty((n, len(_OUTPUTS)))
    controller = _Pid(hover.input)
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
        truth = np.array(
            [-x[RS_POS + 2], roll, pitch, yaw, x[RS_RATES], x[RS_RATES + 1], x[RS_RATES + 2], volts]
        )
        measured[k] = truth + std * rng.standard_normal(len(std))
        set_point = excitation.set_point[k] + [_HEIGHT, 0.0, 0.0, 0.0]
        inputs[k] = controller.step(measured[k], set_point, excitation.motor[k])
        now = inputs[max(k - whole, 0)] if k >= whole else hover.input
        advance(x, before, wind[k], p, 1e-3, part)
        advance(x, now, wind[k], p, 1e-3, steps - part)
    time_s = np.arange(n, dtype=np.float64) * SAMPLE_S
    return Record(name, time_s, inputs, _OUTPUTS, measured, measured[:, -1].copy())


class _Pid:
    """Pilot support: PID on height, roll, pitch and yaw at the rate of the log."""

    def __init__(self, hover: _Array) -> None:
        self._hover = hover
        self._height = self._climb = 0.0
        self._sum = np.zeros(4)
        self._first = True

    def step(self, y: _Array, set_point: _Array, motor: _Array) -> _Array:
        if self._first:
            self._height, self._first = set_point[0], False
        # Height and climb from a second-order observer with poles at -6 1/s.
        error = y[0] - self._height
        self._height += SAMPLE_S * (self._climb + 12.0 * error)
        self._climb += SAMPLE_S * 36.0 * error
        off = np.array(
            [set_point[0] - self._height, set_point[1] - y[1], set_point[2] - y[2], set_point[3] - y[3]]
        )
        self._sum = np.clip(self._sum + SAMPLE_S * off, -1.0, 1.0)
        heave = 0.05 * off[0] - 0.10 * self._climb + 0.01 * self._sum[0]
        turn = 0.04 * off[3] - 0.02 * y[6] + 0.01 * self._sum[3]
        roll = 0.6 * off[1] - 0.05 * y[4] + 0.5 * self._sum[1]
        pitch = 0.6 * off[2] - 0.05 * y[5] + 0.5 * self._sum[2]
        u = self._hover + np.array([heave + turn, heave - turn, -pitch, roll])
        u[MOTORS] += motor
        return np.clip(u, [0.0, 0.0, -1.0, -1.0], 1.0)


def demo_flights(
    vehicle: Vehicle,
    *,
    seed: int = 0,
    seconds: float = 12.0,
    moving: bool = False,
    wind: float = 0.0,
    gust: float = 0.0,
) -> tuple[list[Record], list[Record]]:
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
    before = round(_LEAD_S / SAMPLE_S) if moving else 0
    n = round(seconds / SAMPLE_S) + 1 + before
    signals = _excitations(n, rng)
    flown = {}
    for k, (name, signal) in enumerate(signals.items()):
        air = DrydenWind((wind, 0.0, 0.0), gust, step_s=SAMPLE_S, seed=5 * seed + k) if wind or gust else None
        flown[name] = fly_record(vehicle, signal, rng, name=f"demo-{name}", air=air).part(before, n)
    return [flown[k] for k in ("yaw", "heave", "roll", "pitch")], [flown["mixed"]]


DEMO_FREE = (
    "cQ_up", "cQ_dw", "Jdrive_up", "Jdrive_dw", "Jrot_up", "Jrot_dw", "Izz", "Iyy", "l_up", "l_dw", "Tf_up", "delay",
)  # fmt: skip
_OFF = 0.5


@result(eq=False, picture="mufly.identify.pictures:fit_picture")
class Demo:
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
    fit: Fit
    held_out_over_noise: float

    def inside(self) -> dict[str, bool]:
        """Return, by symbol, whether the interval holds the truth."""
        return {e.symbol: e.low <= self.truth[e.symbol] <= e.high for e in self.fit.estimates}

    def as_dict(self) -> dict[str, Any]:
        """Return what ``mufly identify demo --json`` prints."""
        fit, inside = self.fit, self.inside()
        return {
            "seed": self.seed, "vehicle": fit.vehicle, "method": fit.method, "converged": fit.converged,
            "message": fit.message,
            "parameters": [
                {
                    "symbol": e.symbol, "unit": e.unit, "truth": self.truth[e.symbol], "start": e.start,
                    "estimate": e.value, "std": e.std, "interval": [e.low, e.high],
                    "inside": inside[e.symbol],
                }
                for e in fit.estimates
            ],
            "unseen": list(fit.unseen), "held_out_error_over_noise_floor": self.held_out_over_noise,
            "cost": fit.cost, "simulations": fit.simulations, "seconds": fit.seconds,
        }  # fmt: skip


def run_demo(
    *, vehicle: str | Vehicle = "mufly-1.1", seed: int = 0, method: Method = "lm", moving: bool = False,
    on_progress: Callable[[Progress], None] | None = None,
) -> Demo:  # fmt: skip
    """Fly, identify, compare.

    Parameters
    ----------
    vehicle : str or Vehicle
        The truth.
    seed : int
        Of pilot, sensor noise and starts.
    method : {"lm", "cma"}
    moving : bool
        Records begin in mid-flight; see :func:`demo_flights`.
    on_progress : callable, optional
        As in :func:`mufly.identify.fit_flights`.

    Thesis: Figs 5.3 to 5.6.
    """
    truth = load_vehicle(vehicle) if isinstance(vehicle, str) else vehicle
    flights, held_out = demo_flights(truth, seed=seed, moving=moving)
    rows = {r.symbol: r for r in parameters(truth)}
    true = {s: RADIO_DELAY_S if s == "delay" else float(rows[s].value) for s in DEMO_FREE}
    random = np.random.default_rng([seed, 1])
    factors = np.where(random.random(len(DEMO_FREE)) < 0.5, 1 - _OFF, 1 + _OFF)
    factor = dict(zip(DEMO_FREE, factors, strict=True))
    values = {rows[s].key: true[s] * float(factor[s]) for s in DEMO_FREE if s != "delay"}
    start = replace(truth, values, source="estimated")
    free = choose_free(start, DEMO_FREE, flights[0].outputs, delay_s=true["delay"] * float(factor["delay"]))
    options = {
        "held_out": held_out,
        "method": method,
        "seed": seed,
        "on_progress": on_progress,
        "held_exact": True,
    }
    fit = fit_flights(start, free, flights, **options)  # type: ignore[arg-type]
    return Demo(seed, true, start, fit, over_true_noise(fit.records[-1]))


def over_true_noise(record: RecordFit) -> float:
    """Return the root mean square prediction error over the true noise of the demonstration's sensors."""
    std: NDArray[np.float64] = np.array([NOISE[o] for o in record.outputs])
    return float(np.sqrt(np.nanmean((record.residual / std) ** 2)))
