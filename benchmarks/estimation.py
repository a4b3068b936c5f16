"""How good the estimator is, and whether it knows: a mission flown on ideal sensors, felt by many units.

    python benchmarks/estimation.py nees --seeds 100 [--scenario NAME] [--first 0] [--level]
    python benchmarks/estimation.py cost
    python benchmarks/estimation.py single
    python benchmarks/estimation.py nanobench --folder FOLDER

The wind is the same for all seeds; how level a unit stands, its sensors and their errors are not. So the estimator is
judged without the control loop. With --level all units stand level to the last bit, and the filter is not told.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import scipy.linalg
from figure_record import RECORD_HELP, make_recorder

from mufly.control import design_flight_controller
from mufly.errors import InputError
from mufly.estimate import (
    KalmanEstimator,
    estimate_flight_noise,
    estimate_rest_noise,
    measure_row_consistency,
    run_filter_on_log,
)
from mufly.estimate.nees import ERROR_BLOCKS, Consistency, measure_consistency
from mufly.flight import Flight
from mufly.flight.monte_carlo import parse_variations
from mufly.flight.record.foreign_log import AidRequest, read_foreign_log, truth_rows
from mufly.logs import load_column_map
from mufly.mission import Mission, parse_mission
from mufly.quantities.units import STANDARD_GRAVITY_M_S2
from mufly.sensors import Truth, make_fitted_sensors, parse_fault, randomise_leg_lengths
from mufly.vehicle import Vehicle, load_vehicle, replace_parameters

STANDS_S = 2.0
ROOM = {"north_m": [-1.2, 1.2], "east_m": [-1.2, 1.2], "height_m": 3.0}
HOP = {"waypoint": [{"position_m": [0.0, 0.0, -1.0], "wait_s": 12.0}]}
SQUARE = {
    "take_off": {"height_m": 1.0, "wait_s": 2.0},
    "waypoint": [{"position_m": p, "wait_s": 2.0} for p in ([-3.0, 0.0, -1.0], [-3.0, 3.0, -2.0], [0.0, 0.0, -1.0])],
}
BOX = {
    "take_off": {"height_m": 1.0, "wait_s": 2.0},
    "waypoint": [{"position_m": p, "wait_s": 1.0} for p in ([3.0, 0.0, -1.0], [0.0, 0.0, -1.0])],
    "box": [{"name": "step", "centre_m": [1.5, 0.0, -0.15], "size_m": [1.0, 1.0, 0.3]}],
}


@dataclass(frozen=True)
class Scenario:
    """A flight, and what is on board."""

    mission: dict
    without: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()
    vibration_g: tuple[float, float] = (1.0, 0.5)
    after_s: float = 9.0
    changes: dict = field(default_factory=dict)
    off: str = ""  # what of the vehicle is not as controllers and filter believe, drawn anew for each seed


SCENARIOS = {
    "V-SLAM + lasers": Scenario({**HOP, "room": ROOM}),
    "V-SLAM alone": Scenario({**HOP, "room": ROOM}, without=("ring_camera",)),
    "square": Scenario(SQUARE),
    "fix gone 2 s": Scenario(HOP, faults=("position.dropout@14s+2s",)),
    "fix gone 5 s": Scenario(HOP, faults=("position.dropout@12s+5s",)),
    "clipped 6 + 3 g": Scenario(SQUARE, vibration_g=(6.0, 3.0)),
    "box under path": Scenario(BOX),
    "10 % off its model": Scenario(SQUARE, off="parameters=10%"),
}


def flown(
    vehicle: Vehicle, mission: Mission, seed: int, designed_for: Vehicle | None = None
) -> tuple[list[Truth], list[np.ndarray]]:
    """Truth and what acted, a period each, until it has landed."""
    truths, acted = [], []
    controller = design_flight_controller(vehicle if designed_for is None else designed_for)
    with Flight(
        vehicle, mission, controller=controller, designed_for=designed_for,
        seed=seed, wind=(0.5, 0.0, 0.0), gust=0.3, keep=False,
    ) as flight:  # fmt: skip
        while flight.time_s < STANDS_S:
            flight.step_period()
            truths.append(flight.status.truth)
            acted.append(flight.status.actuators.input_array)
        flight.autopilot.arm(force=True, quiet=True)
        flight.autopilot.start_mission()
        while not flight.autopilot.software.mission_state.finished and flight.time_s < 90.0:
            flight.step_period()
            truths.append(flight.status.truth)
            acted.append(flight.status.actuators.input_array)
        if flight.plant.crash_cause:
            raise SystemExit(flight.plant.crash_cause)
    return truths, acted


def drawn(vehicle: Vehicle, what: str, seed: int) -> Vehicle:
    """A vehicle of which so much is off, that can be."""
    rng = np.random.default_rng([seed, 10])
    while True:
        values = {}
        for variation in parse_variations([what], vehicle):
            values |= variation.parameter_values(variation.draw_normalised_variables(rng))
        try:
            return replace_parameters(vehicle, values)
        except InputError:
            continue


def felt(vehicle: Vehicle, mission: Mission, seed: int, scenario: Scenario, level: bool) -> Consistency:
    """One unit on its flight: it stands as level as it does, and may be off the model."""
    true = drawn(vehicle, scenario.off, seed) if scenario.off else vehicle
    if not level:
        true = randomise_leg_lengths(true, seed=seed)
    flight = flown(true, mission, seed if scenario.off else 77, vehicle)
    faults = [parse_fault(f) for f in scenario.faults]
    sensors = make_fitted_sensors(true, mission.world, seed=seed, faults=faults)
    estimator = KalmanEstimator(vehicle, mission.world, 200.0)
    told = [estimator.update(sensors.read(t), a) for t, a in zip(*flight, strict=True)]
    return measure_consistency(flight[0], told, after_s=scenario.after_s)


def vehicle_of(scenario: Scenario) -> Vehicle:
    once, twice = (g * STANDARD_GRAVITY_M_S2 for g in scenario.vibration_g)
    changes = {
        "sensors.imu.vibration.once_per_rev": once,
        "sensors.imu.vibration.twice_per_rev": twice,
        **scenario.changes,
    }
    v = replace_parameters(load_vehicle("mufly-2.0"), changes)
    if scenario.without:
        v = v.model_copy(update={"sensors": v.sensors.model_copy(update=dict.fromkeys(scenario.without))})
    return v


def nees(asked: argparse.Namespace) -> None:
    """A table, a row a scenario."""
    head = (
        "scenario",
        "NEES/n",
        "in 95 %",
        "xy rms",
        "peak",
        "z rms",
        "peak",
        "tilt rms",
        "peak",
        "yaw rms",
        "NIS",
    )
    print(f"{head[0]:18s}" + "".join(f"{h:>9s}" for h in head[1:]) + f"   {', '.join(ERROR_BLOCKS)} (cm, degrees)")
    found = {}
    for name, scenario in SCENARIOS.items():
        if asked.scenario and asked.scenario != name:
            continue
        vehicle, mission = vehicle_of(scenario), parse_mission(scenario.mission)
        seeds = range(asked.first, asked.first + asked.seeds)
        all_ = [felt(vehicle, mission, k, scenario, asked.level) for k in seeds]
        found[name] = Consistency.merge_flights(all_)
        print(f"{name:18s}" + found[name].format_row(), flush=True)
    if not asked.scenario:
        record, varied = make_recorder(asked.record), found["10 % off its model"]
        others = [c.inside_share for c in found.values() if c is not varied]
        record("nees", min(c.nees for c in found.values()), max(c.nees for c in found.values()))
        record("nees_inside", 100 * min(others), 100 * max(others))
        record("nees_varied", 100 * varied.inside_share)
        record("nees_box", 100 * found["box under path"].z_peak_m)


def cost(asked: argparse.Namespace) -> None:
    """Median time of one period."""
    scenario = SCENARIOS["V-SLAM + lasers"]
    vehicle, mission = vehicle_of(scenario), parse_mission(scenario.mission)
    flight = flown(vehicle, mission, 77)
    sensors = make_fitted_sensors(vehicle, mission.world, seed=10_000)
    read = [sensors.read(t) for t in flight[0]]
    estimator = KalmanEstimator(vehicle, mission.world, 200.0)
    whole = []
    for r, a in zip(read, flight[1], strict=True):
        began = time.perf_counter()
        estimator.update(r, a)
        whole.append(time.perf_counter() - began)
    w = 1e6 * np.array(whole)
    print(f"a period, Python and compiled: median {np.median(w):.1f} us, mean {w[10:].mean():.1f} us")


def single(asked: argparse.Namespace) -> None:
    """The same flight in single and in double precision."""
    scenario = SCENARIOS["square"]
    vehicle, mission = vehicle_of(scenario), parse_mission(scenario.mission)
    flight = flown(vehicle, mission, 77)
    sensors = make_fitted_sensors(vehicle, mission.world, seed=10_000)
    read = [sensors.read(t) for t in flight[0]]
    told = []
    for kind in (np.float64, np.float32):
        e = KalmanEstimator(vehicle, mission.world, 200.0, kind)
        told.append([e.update(r, a) for r, a in zip(read, flight[1], strict=True)])
        print(f"{kind.__name__}: least d {e.memory['d'].min():.2g}")
    for name in ("position", "velocity", "attitude"):
        off = [np.abs(getattr(a, name) - getattr(b, name)).max() for a, b in zip(*told, strict=True)]
        print(f"{name}: differ by {max(off):.2g} at most (SI)")


def least_tilt_rms(gyro: float, accelerometer: float, aids: AidRequest) -> float:
    """Return the tilt error (rms over both axes, rad) that no causal filter can undercut on position fixes.

    An axis is a chain without bias or mounting error: tilt, driven by the gyroscopes' white noise ``gyro``
    (rad/s/sqrt(Hz)), times g is an acceleration, to which ``accelerometer`` (m/s2/sqrt(Hz)) is added. The stationary
    Kalman filter takes a fix every ``1 / rate_hz``; until the next fix and over its delay the gyroscopes' noise is
    integrated, on average over half a period more than the delay.
    """
    assert aids.rate_hz is not None
    assert aids.std_m is not None
    step = 1.0 / aids.rate_hz
    chain = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, STANDARD_GRAVITY_M_S2], [0.0, 0.0, 0.0]])
    driving = np.diag([0.0, accelerometer**2, gyro**2])
    both = scipy.linalg.expm(np.block([[-chain, driving], [np.zeros((3, 3)), chain.T]]) * step)  # Van Loan, 1978
    advance = both[3:, 3:].T
    fix = np.array([[1.0], [0.0], [0.0]])
    before = scipy.linalg.solve_discrete_are(advance.T, fix, advance @ both[:3, 3:], [[aids.std_m**2]])
    after = before - before @ fix @ fix.T @ before / (before[0, 0] + aids.std_m**2)
    return float(np.sqrt(2.0 * (after[2, 2] + gyro**2 * (aids.delay_s + 0.5 * step))))


def nanobench(asked: argparse.Namespace) -> None:
    """Four flights of a Crazyflie; aids made from Vicon: 2 cm of noise, 15 Hz, 150 ms late; beside tilt its bound."""
    off = {}
    for path in sorted(Path(asked.folder).glob("*.csv.gz")):
        aids = AidRequest("truth_position", None, 0.02, 0.02, 15.0, 0.15, asked.first)
        f = read_foreign_log(path, load_column_map("nanobench"), aids, None, [])
        noise = estimate_flight_noise(f.log, f.aids, estimate_rest_noise(f.log))
        told = run_filter_on_log(f.log, f.aids, noise)
        began = float(f.log.time_s[f.log.is_flying.argmax()]) + 2.0
        found = measure_row_consistency(truth_rows(f), told, after_s=began)
        less = ""
        if f.mounting_rad is not None:
            mounted = measure_row_consistency(truth_rows(f, mounted=True), told, after_s=began)
            less = f"; less mounting: tilt {np.degrees(mounted.tilt_rms_rad):.2f} NEES/n {mounted.nees:.2f}"
        bound = least_tilt_rms(noise.gyro, noise.accelerometer, aids)
        less += f"; least tilt possible {np.degrees(bound):.2f}"
        print(
            f"{path.name[:28]:30s}{found.format_row()}  gyro {noise.gyro:.3g} accelerometer "
            f"{noise.accelerometer:.3g}{less}",
            flush=True,
        )
        off[path.name] = 100 * found.xy_rms_m, np.degrees(found.tilt_rms_rad)
    record, eight = make_recorder(asked.record), next(k for k in off if "figure8" in k)
    record("nanobench_eight", *off.pop(eight))
    record("nanobench", max(v[0] for v in off.values()), max(v[1] for v in off.values()))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("nees", "cost", "single", "nanobench"))
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--scenario", default="")
    parser.add_argument("--folder", default=".")
    parser.add_argument("--level", action="store_true", help="units that stand level to the last bit")
    parser.add_argument("--record", action="store_true", help=RECORD_HELP)
    given = parser.parse_args()
    {"nees": nees, "cost": cost, "single": single, "nanobench": nanobench}[given.what](given)
