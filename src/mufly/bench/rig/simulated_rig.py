"""Simulated test bench: rotor loads from blade element momentum theory, with realistic errors.

Blade element momentum theory gives the loads of each rotor or pair as a map over speed
(:func:`make_rotor_load_splines`, :func:`make_pair_load_splines`), scaled by the air density of the room. The readings
have these errors:

* a random pitch error of each mounting;
* load cells with gain, offset and cross-talk, which the program knows only from an inexact calibration; zeros with
  warm-up drift and random walk; gains with temperature drift; correlated noise; quantisation; and saturation;
* vibration at the rotor frequencies on both cells, proportional to speed squared; ripple of torque and speed;
* motors whose resistance, torque constant and friction change as they warm up:

      k I = Q + c_0 + c_1 W,    R = R_0 (1 + 0.00393 dT_w),    k = k_0 (1 - 0.0011 dT_m),    c = c_00 (1 - 0.004 dT_m)

  with a time constant for winding and magnet (textbook values of copper and neodymium; friction is a guess);
* random walk of room temperature, pressure and humidity, measured by sensors with errors within tolerance.

The clock is simulated, so that a series runs faster than real time. The numbers of the default bench are guesses for
the bench of the dissertation, Sec. 3.2.1 (Maxon EC 45 flat, a 20 mN m torque cell). ``true_loads`` returns the truth.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline
from scipy.signal import lfilter

from mufly.bench.bench_loads import fit_cell_calibration
from mufly.bench.bench_table import BenchTable
from mufly.bench.rig.bench_devices import BenchFacts, DeviceError, SampleCallback, calibration_to_dict
from mufly.bench.series.moist_air import compute_moist_air_density
from mufly.bench.series.series_plan import BladeMounting, PlanStep, SeriesPlan
from mufly.quantities.units import RPM
from mufly.rotor import (
    Air,
    Blading,
    OperatingCondition,
    RotorSystem,
    load_rotor,
    prepare_blading,
    solve_rotor_batch,
    solve_system,
)

Array = NDArray[np.float64]

ROTOR_MAP_AIR = Air()
SAMPLE_RATE_Hz = 100.0
_MAP_SPEEDS_rad_s = np.geomspace(800.0, 12000.0, 12) * RPM
_MAP_PITCH_OFFSETS_rad = np.radians([-0.6, 0.0, 0.6])  # offsets from the nominal pitch
_MAP_SPEED_RATIOS = np.array([0.6, 0.8, 1.0, 1.25, 1.6])
ROTOR_SIDE_NAMES = ("upper", "lower")


@lru_cache(maxsize=32)
def _load_blading(rotor: str) -> Blading:
    return prepare_blading(load_rotor(rotor))


@lru_cache(maxsize=256)
def make_rotor_load_splines(rotor: str, pitch_deg: float) -> tuple[RectBivariateSpline, RectBivariateSpline]:
    """Return splines of T / Omega^2 and Q / Omega^2 as functions of pitch offset (rad) and ln(Omega), in the air
    ROTOR_MAP_AIR.
    """
    at = solve_rotor_batch(
        _load_blading(rotor),
        pitch_rad=np.radians(pitch_deg) + _MAP_PITCH_OFFSETS_rad[:, None],
        speed_rad_s=_MAP_SPEEDS_rad_s[None, :],
        air=ROTOR_MAP_AIR,
    )
    x, y = _MAP_PITCH_OFFSETS_rad, np.log(_MAP_SPEEDS_rad_s)
    thrust, torque = (
        RectBivariateSpline(x, y, v / _MAP_SPEEDS_rad_s**2, kx=2, ky=3) for v in (at.thrust_N, at.torque_Nm)
    )
    return thrust, torque


@lru_cache(maxsize=64)
def make_pair_load_splines(
    upper: str, lower: str, upper_pitch_deg: float, lower_pitch_deg: float, spacing_m: float
) -> tuple[RectBivariateSpline, ...]:
    """Return splines of T_up, Q_up, T_dw, Q_dw, each divided by its rotor's speed squared, in the air ROTOR_MAP_AIR.

    The splines are functions of ln(mean speed) and ln(lower speed / upper speed).
    """
    system = RotorSystem.from_coaxial_pair(_load_blading(upper), _load_blading(lower), spacing_m=spacing_m)
    speeds = np.geomspace(1500.0, 9000.0, 5) * RPM
    pitch = (np.radians(upper_pitch_deg), np.radians(lower_pitch_deg))
    found = np.empty((4, speeds.size, _MAP_SPEED_RATIOS.size))
    for i, s in enumerate(speeds):
        for j, r in enumerate(_MAP_SPEED_RATIOS):
            up = 2.0 * s / (1.0 + r)
            a, b = solve_system(system, OperatingCondition(pitch, (up, r * up), air=ROTOR_MAP_AIR)).rotors
            found[:, i, j] = (
                a.thrust_N / up**2, a.torque_Nm / up**2, b.thrust_N / (r * up) ** 2, b.torque_Nm / (r * up) ** 2,
            )  # fmt: skip
    return tuple(RectBivariateSpline(np.log(speeds), np.log(_MAP_SPEED_RATIOS), v, kx=2, ky=2) for v in found)


@dataclass(frozen=True)
class SimulatedMotor:
    """Motor of the simulated bench: torque constant, resistance and friction when cold, and thermal parameters."""

    torque_Nm_A: float = 0.0255
    resistance_ohm: float = 1.2
    friction_Nm: float = 1.2e-3
    friction_Nm_s: float = 3.0e-6
    winding_resistance_K_W: float = 4.0
    winding_time_constant_s: float = 40.0
    magnet_heating_fraction: float = 0.6
    magnet_time_constant_s: float = 500.0


@dataclass(frozen=True)
class SimulatedFaults:
    """Deliberate faults of the simulated bench.

    Attributes
    ----------
    reference_moved_deg : float
        Pitch slip of the reference blades.
    reference_moved_after : int
        Number of reference mountings before the slip.
    force_cell_saturates : bool
        Whether high loads saturate the amplifier of the force cell.
    silent_from_s : float
        Time from which the bench does not answer.
    spike_share : float
        Share of invalid samples of the cells.
    speed_shortfall_fraction : float
        Share by which a motor fails to reach its commanded speed.
    """

    reference_moved_deg: float = 0.0
    reference_moved_after: int = 2
    force_cell_saturates: bool = False
    silent_from_s: float = np.inf
    spike_share: float = 0.0
    speed_shortfall_fraction: float = 0.0


SIMULATED_FAULTS: dict[str, SimulatedFaults] = {
    "reference": SimulatedFaults(reference_moved_deg=0.5, reference_moved_after=1),
    "saturated": SimulatedFaults(force_cell_saturates=True),
    "silent": SimulatedFaults(silent_from_s=1500.0),
    "spikes": SimulatedFaults(spike_share=0.05),
    "speed": SimulatedFaults(speed_shortfall_fraction=0.04),
}
"""Faults by their names in ``mufly bench run --fault``."""


@dataclass
class _MotorHeat:
    winding_rise_K: float = 0.0
    magnet_rise_K: float = 0.0


@dataclass(frozen=True)
class BenchImperfections:
    """Parameters of the simulated bench's errors: drift, noise, mounting, temperatures; :meth:`ideal_bench` sets nearly
    all to zero.
    """

    zero_warm_up_V: tuple[float, float] = (
        0.012,
        0.0,
    )  # V, zero drift of each cell during warm-up
    zero_walk_V_per_sqrt_h: tuple[float, float] = (0.004, 0.003)  # V per sqrt(hour)
    white_noise_V: tuple[float, float] = (0.010, 0.010)  # V, white
    coloured_noise_V: tuple[float, float] = (0.004, 0.004)  # V, correlation time 0.3 s
    vibration_V: tuple[float, float] = (0.06, 0.06)  # V at 7000 rpm
    gain_per_K: tuple[float, float] = (4e-4, 6e-4)
    current_noise_A: float = 0.008
    mounting_pitch_std_deg: float = 0.03  # standard deviation per mounting
    reference_pitch_std_deg: float = 0.02
    calibration_noise_V: float = 0.003  # V, noise of a calibration reading
    room_temperature_std_K: float = 0.8
    speed_ripple: float = 0.002
    motor_warms_up: bool = True

    @classmethod
    def ideal_bench(cls) -> BenchImperfections:
        """Return parameters without errors except negligible noise."""
        z = (0.0, 0.0)
        return cls(z, z, (1e-5, 1e-5), z, z, z, 1e-5, 0.0, 0.0, 1e-6, 0.0, 0.0, False)


@dataclass(eq=False)
class SimulatedRig:
    """Simulated bench; a :class:`mufly.bench.rig.bench_devices.BenchRig`.

    Parameters
    ----------
    seed : int
        Random seed of all errors.
    imperfections : BenchImperfections, optional
    faults : SimulatedFaults, optional
    spacing_m : float
        Distance between the discs of a pair (m).
    """

    seed: int = 0
    imperfections: BenchImperfections = field(default_factory=BenchImperfections)
    faults: SimulatedFaults = field(default_factory=SimulatedFaults)
    spacing_m: float = 0.04
    time_s: float = 0.0

    def __post_init__(self) -> None:
        rng = self._rng = np.random.default_rng([self.seed, 7])
        self.driven_axes = ROTOR_SIDE_NAMES
        self._sensitivity = np.array([[2.0, 5.0], [0.01, 150.0]]) * (1 + 0.02 * rng.standard_normal((2, 2)))
        self._zero_offset_V = np.array([0.12, -0.4])
        if self.faults.force_cell_saturates:
            self._sensitivity[0] *= 12.0
        self.facts = self._calibrate_cells()
        self._motors = {s: SimulatedMotor(0.0255 * (1 + 0.03 * rng.standard_normal())) for s in ROTOR_SIDE_NAMES}
        self._motor_heat = {s: _MotorHeat() for s in ROTOR_SIDE_NAMES}
        self.speed = dict.fromkeys(ROTOR_SIDE_NAMES, 0.0)
        self.commanded_speed = dict.fromkeys(ROTOR_SIDE_NAMES, 0.0)
        self._zero_walk_V, self._correlated_noise_V = np.zeros(2), np.zeros(2)
        self._room_state = np.array([295.0 + rng.standard_normal(), 96500.0 + 800 * rng.standard_normal(), 0.45])
        self._room_temperature_offset = np.zeros(1)
        self._sensor_error = rng.standard_normal(3) * (
            self.facts.temperature_std_K, self.facts.pressure_std_Pa, self.facts.humidity_std
        )  # fmt: skip
        self._warm_up_signs = rng.choice([-1.0, 1.0], 2)
        self._gain_drift_signs = rng.choice([-1.0, 1.0], 2)
        self.mounting: BladeMounting | None = None
        self._pitch_error_rad, self._reference_mountings, self.open_count = 0.0, 0, 0

    def _calibrate_cells(self) -> BenchFacts:
        """Simulate a calibration of the load cells with known weights; return it within the bench's properties."""
        thrust, torque = np.meshgrid([0.0, 0.2, 0.5, 1.0], [0.0, 2e-3, 5e-3, 10e-3])
        loads = np.column_stack([thrust.ravel(), torque.ravel()])
        y = loads @ self._sensitivity.T + self._zero_offset_V
        y += self.imperfections.calibration_noise_V * self._rng.standard_normal(y.shape)
        columns = {"thrust": loads[:, 0], "torque": loads[:, 1], "thrust_raw": y[:, 0], "torque_raw": y[:, 1]}
        table = BenchTable("simulated", columns, {k: k for k in columns}, np.arange(2, 2 + len(y)))
        return BenchFacts(
            "simulated", calibration_to_dict(fit_cell_calibration(table)),
            dict.fromkeys(("thrust_raw", "torque_raw"), (-5.0, 5.0)), manual=False,
        )  # fmt: skip

    # --- interface of BenchRig ---------------------------------------------------------------------------------------

    def now(self) -> float:
        return self.time_s

    def open(self) -> None:
        self.open_count += 1
        if self.time_s >= self.faults.silent_from_s:
            raise DeviceError("simulated bench: does not answer")

    def record_mounting(self, mounting: BladeMounting) -> None:
        is_reference = mounting.use == "reference"
        b = self.imperfections
        self.mounting = mounting
        self._pitch_error_rad = float(
            np.radians(
                (b.reference_pitch_std_deg if is_reference else b.mounting_pitch_std_deg) * self._rng.standard_normal()
            )
        )
        if is_reference:
            self._reference_mountings += 1
            if self._reference_mountings > self.faults.reference_moved_after:
                self._pitch_error_rad += np.radians(self.faults.reference_moved_deg)
        self.time_s += 90.0  # time for a change of blades
        self._cool_motors(90.0)

    def set_speeds(self, speeds_rad_s: Mapping[str, float]) -> None:
        for side in ROTOR_SIDE_NAMES:
            self.commanded_speed[side] = float(speeds_rad_s.get(side, 0.0)) * (
                1.0 - self.faults.speed_shortfall_fraction
            )

    def stop(self) -> None:
        self.commanded_speed = dict.fromkeys(ROTOR_SIDE_NAMES, 0.0)

    def close(self) -> None:
        self.stop()

    def collect_samples(self, duration_s: float, watch: SampleCallback) -> dict[str, Array]:
        parts: list[dict[str, Array]] = []
        for _ in range(count := max(1, round(duration_s / 2.0))):
            parts.append(self.advance_time(duration_s / count))
            watch(parts[-1])
        return {name: np.concatenate([p[name] for p in parts]) for name in parts[0]}

    # --- simulation --------------------------------------------------------------------------------------------------

    def true_density(self) -> float:
        """Return the true density of the air (kg/m3)."""
        t, p, h = self._room_state
        return float(compute_moist_air_density(p, t + self._room_temperature_offset[0], h))

    def find_loads_at_map_density(self, speed: Mapping[str, Any], pitch_off: float = 0.0) -> tuple[Any, dict[str, Any]]:
        """Return the true thrust of all rotors (N) and torque of each (N m), at 1.2 kg/m3, for speeds (rad/s)."""
        m = self.mounting
        zero = np.zeros(np.shape(next(iter(speed.values()))))
        torque: dict[str, Any] = dict.fromkeys(ROTOR_SIDE_NAMES, zero)
        if m is None:
            return zero, torque
        if m.axis != "pair":
            w = np.maximum(speed[m.axis], 1.0)
            t, q = make_rotor_load_splines(m.rotor, m.pitch_deg)
            x, y = np.full(np.shape(w), pitch_off), np.log(w)
            torque[m.axis] = q(x, y, grid=False) * w**2
            return t(x, y, grid=False) * w**2, torque
        maps = make_pair_load_splines(m.rotor, m.lower_rotor, m.pitch_deg, m.lower_pitch_deg, self.spacing_m)
        up, low = (np.maximum(speed[s], 1.0) for s in ROTOR_SIDE_NAMES)
        x = np.clip(np.log(0.5 * (up + low)), np.log(1500 * RPM), np.log(9000 * RPM))
        y = np.clip(np.log(low / up), np.log(_MAP_SPEED_RATIOS[0]), np.log(_MAP_SPEED_RATIOS[-1]))
        tu, qu, td, qd = (f(x, y, grid=False) for f in maps)
        # Both rotors of a pair have the same pitch error, with the effect on a single rotor.
        w, mean = np.exp(x), np.zeros(np.shape(x))
        single_t, single_q = make_rotor_load_splines(m.rotor, m.pitch_deg)
        ft, fq = (
            f(mean + pitch_off, np.log(w), grid=False) / f(mean, np.log(w), grid=False) for f in (single_t, single_q)
        )
        return ft * (tu * up**2 + td * low**2), {"upper": fq * qu * up**2, "lower": fq * qd * low**2}

    def true_loads(self, speeds_rad_s: Mapping[str, float], *, as_mounted: bool = True) -> dict[str, float]:
        """Return the true loads at the present air density: thrust (N), torque of each axis (N m)."""
        thrust, torque = self.find_loads_at_map_density(speeds_rad_s, self._pitch_error_rad if as_mounted else 0.0)
        scale = self.true_density() / ROTOR_MAP_AIR.density_kg_m3
        return {
            "thrust": scale * float(thrust),
            **{f"torque_{s}": scale * float(torque[s]) for s in ROTOR_SIDE_NAMES},
        }

    def _cool_motors(self, duration_s: float) -> None:
        for side in ROTOR_SIDE_NAMES:
            heat, motor = self._motor_heat[side], self._motors[side]
            heat.winding_rise_K *= np.exp(-duration_s / motor.winding_time_constant_s)
            heat.magnet_rise_K *= np.exp(-duration_s / motor.magnet_time_constant_s)
        self._drift_sensors(duration_s)

    def _drift_sensors(self, duration_s: float) -> None:
        b, rng = self.imperfections, self._rng
        self._zero_walk_V += np.array(b.zero_walk_V_per_sqrt_h) * np.sqrt(duration_s / 3600.0) * rng.standard_normal(2)
        keep = np.exp(-duration_s / 2400.0)
        self._room_temperature_offset = keep * self._room_temperature_offset + b.room_temperature_std_K * np.sqrt(
            1 - keep**2
        ) * rng.standard_normal(1)
        if b.room_temperature_std_K:
            self._room_state[1] += 40.0 * np.sqrt(duration_s / 3600.0) * rng.standard_normal()
            self._room_state[2] += 0.01 * np.sqrt(duration_s / 3600.0) * rng.standard_normal()

    def advance_time(self, duration_s: float) -> dict[str, Array]:
        """Advance the simulation by ``duration_s``; return its samples."""
        n = max(2, round(duration_s * SAMPLE_RATE_Hz))
        if self.time_s + duration_s > self.faults.silent_from_s:
            raise DeviceError("simulated bench: does not answer")
        b, rng = self.imperfections, self._rng
        dt = duration_s / n
        t = self.time_s + dt * np.arange(1, n + 1)
        speed: dict[str, Array] = {}
        for side in ROTOR_SIDE_NAMES:
            went = np.exp(-dt * np.arange(1, n + 1) / 0.35)
            smooth = self.commanded_speed[side] + (self.speed[side] - self.commanded_speed[side]) * went
            self.speed[side] = float(smooth[-1])
            speed[side] = smooth * (1 + b.speed_ripple * np.sin(2 * np.pi * 2.7 * t + rng.uniform(0, 6.3)))
        scale = self.true_density() / ROTOR_MAP_AIR.density_kg_m3
        thrust, torque = self.find_loads_at_map_density(speed, self._pitch_error_rad)
        thrust = scale * thrust
        total = scale * sum(self.facts.torque_signs[s] * torque[s] for s in ROTOR_SIDE_NAMES)
        before = self._zero_walk_V.copy()
        self._drift_sensors(duration_s)
        along = np.linspace(0, 1, n)[:, None]
        zero = before + (self._zero_walk_V - before) * along
        zero = zero + self._warm_up_signs * np.array(b.zero_warm_up_V) * (1 - np.exp(-t / 900.0))[:, None]
        slow = np.empty((n, 2))
        keep = np.exp(-dt / 0.3)
        for k in range(2):
            kick = b.coloured_noise_V[k] * np.sqrt(1 - keep**2) * rng.standard_normal(n)
            slow[:, k], _ = lfilter([1.0], [1.0, -keep], kick, zi=np.array([keep * self._correlated_noise_V[k]]))
        self._correlated_noise_V = slow[-1]
        gain = 1.0 + self._gain_drift_signs * np.array(b.gain_per_K) * self._room_temperature_offset[0]
        y = self._zero_offset_V + gain * (np.column_stack([thrust, total]) @ self._sensitivity.T) + zero + slow
        y += np.array(b.white_noise_V) * rng.standard_normal((n, 2))
        for side in ROTOR_SIDE_NAMES:
            phase = np.cumsum(speed[side]) * dt
            # Averaging over the sample time attenuates a vibration; without it 6000 rpm would alias to zero.
            size = (speed[side] / (7000 * RPM)) ** 2 * np.sinc(speed[side] * dt / (2 * np.pi))
            for k in range(2):
                y[:, k] += b.vibration_V[k] * size * np.sin(phase + rng.uniform(0, 6.3))
        if self.faults.spike_share:
            hit = rng.random((n, 2)) < self.faults.spike_share
            y[hit] = rng.uniform(-5, 5, int(hit.sum()))
        y = np.clip(np.round(y / 1e-4) * 1e-4, -5.0, 5.0)
        out = {"thrust_raw": y[:, 0], "torque_raw": y[:, 1]}
        for side in ROTOR_SIDE_NAMES:
            out |= self._motor_samples(side, speed[side], scale * torque[side], duration_s)
        shaken = float(sum(float(np.mean(speed[s]) / (7000 * RPM)) ** 2 for s in ROTOR_SIDE_NAMES))
        out["vibration"] = np.abs(12.0 * shaken * (1 + 0.1 * rng.standard_normal(n)))
        air = self._room_state + np.array([self._room_temperature_offset[0], 0.0, 0.0]) + self._sensor_error
        for name, value, noise in zip(("temperature", "pressure", "humidity"), air, (0.02, 3.0, 0.002), strict=True):
            out[name] = value + noise * rng.standard_normal(max(2, n // 25))
        self.time_s += duration_s
        return out

    def _motor_samples(self, side: str, speed: Array, torque: Array, duration_s: float) -> dict[str, Array]:
        motor, heat, b, rng = self._motors[side], self._motor_heat[side], self.imperfections, self._rng
        turning = speed > 2.0
        k = motor.torque_Nm_A * (1.0 - 0.0011 * heat.magnet_rise_K)
        slack = 1.0 - 0.004 * heat.magnet_rise_K
        current = np.where(turning, (torque + slack * (motor.friction_Nm + motor.friction_Nm_s * speed)) / k, 0.0)
        resistance = motor.resistance_ohm * (1.0 + 0.00393 * heat.winding_rise_K)
        if b.motor_warms_up:
            power = resistance * float(np.mean(current)) ** 2
            goal = motor.winding_resistance_K_W * power + heat.magnet_rise_K
            heat.winding_rise_K += (goal - heat.winding_rise_K) * (
                1 - np.exp(-duration_s / motor.winding_time_constant_s)
            )
            loss = slack * float(np.mean(motor.friction_Nm * speed))
            to = motor.magnet_heating_fraction * motor.winding_resistance_K_W * (power + loss)
            heat.magnet_rise_K += (to - heat.magnet_rise_K) * (1 - np.exp(-duration_s / motor.magnet_time_constant_s))
        voltage = np.where(turning, k * speed + resistance * current, 0.0)
        n = speed.size
        quiet = float(b.speed_ripple > 0)
        return {
            f"speed_{side}": np.where(turning, speed * (1 + 2e-4 * quiet * rng.standard_normal(n)), 0.0),
            f"current_{side}": current + b.current_noise_A * rng.standard_normal(n),
            f"voltage_{side}": voltage + 0.01 * quiet * rng.standard_normal(n),
            f"motor_temperature_{side}": np.full(2, self._room_state[0] + heat.winding_rise_K),
        }


def make_simulated_rig(
    plan: SeriesPlan, seed: int, fault: str | None = None, time_s: float = 0.0
) -> tuple[SimulatedRig, Callable[[PlanStep], Mapping[str, float]]]:
    """Return a simulated bench for a plan, and a function that returns the true loads of a step.

    Parameters
    ----------
    plan : SeriesPlan
    seed : int
        Random seed of noise, drifts and errors.
    fault : str, optional
        Key of :data:`SIMULATED_FAULTS`.
    time_s : float
        Initial time of the bench clock (s).

    Returns
    -------
    rig : SimulatedRig
    true_loads : callable
        Function that returns the loads with mounting errors, ``thrust`` (N), ``torque_upper``, ``torque_lower`` (N m),
        and without them, with prefix ``nominal_``.
    """
    faults = SimulatedFaults() if fault is None else SIMULATED_FAULTS[fault]
    rig = SimulatedRig(seed, faults=faults, spacing_m=plan.spacing_m, time_s=time_s)

    def true_loads(step: PlanStep) -> dict[str, float]:
        speeds: dict[str, float] = {a: rig.speed[a] for a in plan.mounting[step.mounting_index].driven_rotors}
        nominal = rig.true_loads(speeds, as_mounted=False)
        return rig.true_loads(speeds) | {f"nominal_{k}": v for k, v in nominal.items()}

    return rig, true_loads
