"""Flights of PX4 on mufly's plant: arm, take off, a square of 1 m, land; success and overshoot by the truth.

    python benchmarks/px4_flights.py PX4_BUILD --seeds 20 --wind 0.5
    python benchmarks/px4_flights.py PX4_BUILD --seeds 1 --minutes 30

PX4_BUILD is a build folder of px4_sitl_default with ``bin/px4`` and ``etc``, and the airframe file of
``mufly autopilot gains px4`` in ``etc/init.d-posix/airframes``. Every seed starts a PX4 of its own. A MAVLink program
commands it over UDP as a companion computer does, in simulated time. ``--minutes`` repeats the square
for this simulated time in the air, on a battery with the charge for it: the vehicle's own lasts a few minutes.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import shutil
import socket
import subprocess
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from mufly.bridges.autopilot_plant import AutopilotPlant
from mufly.bridges.px4.px4_airframe import AIRFRAME_NUMBER
from mufly.bridges.px4.px4_link import PX4_ENDPOINT, PX4_RATE_HZ, Px4Simulator
from mufly.dynamics import hover_performance
from mufly.link.codec import FrameDecoder, FrameEncoder, mavlink
from mufly.mission import Mission
from mufly.vehicle import Vehicle, load_vehicle, replace_parameters

HEIGHT_M, SIDE_M, LEG_S, HOVER_S = 1.0, 1.0, 8.0, 8.0
TIMEOUT_S, WALL_LIMIT_S = 150.0, 600.0  # of a flight with one square
LONGEST_WALL_RATIO = 3.0  # wall-clock time over simulated time of a longer flight
CHARGE_RESERVE = 1.5
HEIGHT_STEP_M, HEIGHT_STEP_PERIOD_S = 0.15, 5.0
YAW_STEP_RAD, YAW_STEP_PERIOD_S = 0.4, 3.6
READY_S = 60.0
SETPOINT_PERIODS = 12  # 20 Hz
OFFBOARD, AUTO, LAND = 6, 4, 6  # PX4's main and sub modes
ONBOARD_PORT, COMPANION_PORT = 14580, 14540


class PlantView(Protocol):
    """Simulated time and height of the vehicle, as a companion computer needs them."""

    @property
    def time_s(self) -> float: ...

    @property
    def height_m(self) -> float: ...


class Companion:
    """Companion computer of a PX4: arms, flies squares by position set-points, lands.

    Parameters
    ----------
    vehicle : AutopilotPlant or PlantView
        Source of simulated time and height.
    instance : int
        Number of the PX4 instance.
    flight_s : float
        Simulated time in the air, after which no further square begins.
    excite : bool
        Whether steps of heading and height are added to the squares, for a log to identify the vehicle from.
    """

    def __init__(
        self, vehicle: AutopilotPlant | PlantView, instance: int, flight_s: float = 0.0, *, excite: bool = False
    ) -> None:
        self.vehicle, self._flight_s, self._take_off_s, self._excite = vehicle, flight_s, math.nan, excite
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", COMPANION_PORT + instance))
        self._socket.setblocking(False)
        self._address = ("127.0.0.1", ONBOARD_PORT + instance)
        self._system = instance + 1
        self._encode, self._decode = FrameEncoder(255, 190), FrameDecoder(keep_duplicates=True)
        self._count = 0
        self.phase, self.phase_s = "ready", 0.0
        self.target = np.zeros(3)
        self.ready = self.armed = self.offboard = False
        self.texts: list[str] = []
        self.legs: list[tuple[float, float, np.ndarray, np.ndarray]] = []
        self.failure = ""

    def close(self) -> None:
        self._socket.close()

    def send(self, message: Any) -> None:
        self._socket.sendto(self._encode(message), self._address)

    def command(self, number: int, *params: float) -> None:
        values = [*params, *[0.0] * (7 - len(params))]
        self.send(mavlink.MAVLink_command_long_message(self._system, 1, number, 0, *values))

    def receive(self) -> None:
        while True:
            try:
                data = self._socket.recv(65536)
            except BlockingIOError:
                return
            for m in self._decode.decode_bytes(time.monotonic(), "px4", data):
                self.handle_message(m)

    def handle_message(self, m: Any) -> None:
        kind = m.get_type()
        if kind == "ESTIMATOR_STATUS":
            wanted = mavlink.ESTIMATOR_ATTITUDE | mavlink.ESTIMATOR_POS_HORIZ_REL | mavlink.ESTIMATOR_VELOCITY_HORIZ
            self.ready = m.flags & wanted == wanted
        elif kind == "HEARTBEAT" and m.get_srcComponent() == 1:
            self.armed = bool(m.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
            self.offboard = (m.custom_mode >> 16) & 0xFF == OFFBOARD
        elif kind == "COMMAND_ACK" and m.result != mavlink.MAV_RESULT_ACCEPTED:
            self.texts.append(f"{self.vehicle.time_s:.1f} command {m.command} answered {m.result}")
        elif kind == "STATUSTEXT":
            self.texts.append(f"{self.vehicle.time_s:.1f} {m.text}")

    def step(self) -> None:
        """Advance after every period of the simulation."""
        self._count += 1
        if self._count % SETPOINT_PERIODS:
            return
        self.receive()
        t = self.vehicle.time_s
        if self._count % (20 * SETPOINT_PERIODS) == 0:
            self.send(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
        if self.phase not in ("land", "done"):
            mask = 0b101111111000  # position and yaw
            place, yaw = self.target.copy(), 0.0
            if self._excite and self.phase == "square":
                place[2] += math.copysign(HEIGHT_STEP_M, math.sin(2.0 * math.pi * t / HEIGHT_STEP_PERIOD_S))
                yaw = math.copysign(YAW_STEP_RAD, math.sin(2.0 * math.pi * t / YAW_STEP_PERIOD_S))
            self.send(
                mavlink.MAVLink_set_position_target_local_ned_message(
                    0, self._system, 1, mavlink.MAV_FRAME_LOCAL_NED, mask, *place, *[0.0] * 6, yaw, 0.0
                )
            )
        getattr(self, f"_{self.phase}")(t)

    def _enter(self, phase: str, t: float) -> None:
        self.phase, self.phase_s = phase, t

    def _fail(self, why: str, t: float) -> None:
        self.failure = self.failure or f"{why} at {t:.1f} s"
        self._enter("done", t)

    def _ready(self, t: float) -> None:
        self.target = np.array([0.0, 0.0, -HEIGHT_M])
        if self.ready and t > 10.0 and self._count % (10 * SETPOINT_PERIODS) == 0:
            if not self.offboard:
                self.command(mavlink.MAV_CMD_DO_SET_MODE, 1, OFFBOARD)
            else:
                self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
        if self.armed:
            self._take_off_s = t
            self._enter("climb", t)
        elif t > READY_S:
            self._fail("PX4 was not ready", t)

    def _climb(self, t: float) -> None:
        if t - self.phase_s > HOVER_S + 6.0:
            if self.vehicle.height_m < 0.5 * HEIGHT_M:
                self._fail("no take-off", t)
                return
            self._next_leg(t)

    def _next_leg(self, t: float) -> None:
        corners = [(SIDE_M, 0.0), (SIDE_M, SIDE_M), (0.0, SIDE_M), (0.0, 0.0)]
        square, corner = divmod(len(self.legs), len(corners))
        if square and not corner and t - self._take_off_s >= self._flight_s:
            self.command(mavlink.MAV_CMD_DO_SET_MODE, 1, AUTO, LAND)
            self._enter("land", t)
            return
        before = self.target.copy()
        self.target[:2] = corners[corner]
        self.legs.append((t, t + LEG_S, before, self.target.copy()))
        self._enter("square", t)

    def _square(self, t: float) -> None:
        if not self.armed:
            self._fail("disarmed in flight", t)
        elif t - self.phase_s > LEG_S:
            self._next_leg(t)

    def _land(self, t: float) -> None:
        if self._count % (40 * SETPOINT_PERIODS) == 0 and self.offboard:
            self.command(mavlink.MAV_CMD_DO_SET_MODE, 1, AUTO, LAND)
        if not self.armed:
            self._enter("done", t)

    def _done(self, t: float) -> None:
        return


def start_px4(build: Path, folder: Path, instance: int) -> subprocess.Popen:
    """Start PX4 in a folder of its own; its output goes to px4.txt there."""
    for name in ("etc", "bin"):
        if not (folder / name).exists():
            (folder / name).symlink_to(build / name)
    environment = os.environ | {
        "PX4_SYS_AUTOSTART": str(AIRFRAME_NUMBER),
        "PATH": f"{build / 'bin'}:{os.environ['PATH']}",
        "PX4_SIM_SPEED_FACTOR": "1",
    }
    log = (folder / "px4.txt").open("w")
    line = [str(build / "bin" / "px4"), "-d", "-i", str(instance), "-s", "etc/init.d-posix/rcS", "-w", str(folder)]
    return subprocess.Popen(line, cwd=folder, env=environment, stdout=log, stderr=log, stdin=subprocess.DEVNULL)


def measure_overshoot(record: Any, legs: list) -> tuple[float, float]:
    """Return the largest overshoot along a leg and the largest deviation from the leg's line (m)."""
    time_s, position = record["time"].values, record["truth_position"].values
    overshoot = aside = 0.0
    for begin, end, start, goal in legs:
        part = position[(time_s >= begin) & (time_s <= end)] - start
        along = (goal - start) / np.linalg.norm(goal - start)
        overshoot = max(overshoot, float(np.max(part @ along)) - float(np.linalg.norm(goal - start)))
        across = part[:, :2] - np.outer(part @ along, along)[:, :2]
        aside = max(aside, float(np.max(np.hypot(*across.T))))
    return overshoot, aside


def load_charged_vehicle(name: str, flight_s: float) -> Vehicle:
    """Return a vehicle whose battery lasts for ``flight_s`` in hover with a reserve; its own if that suffices."""
    vehicle = load_vehicle(name)
    needed = CHARGE_RESERVE * flight_s / hover_performance(vehicle).endurance_s
    if needed <= 1.0:
        return vehicle
    return replace_parameters(
        vehicle, {"battery.capacity": needed * float(vehicle.battery.capacity)}, source="specified"
    )


def fly(
    build: Path, seed: int, wind_m_s: float, vehicle: str, out: Path | None, speed: float, instance: int,
    flight_s: float = 0.0, excite: bool = False,
) -> dict:  # fmt: skip
    """Fly one seed; return its figures."""
    towards = np.random.default_rng(seed).uniform(-math.pi, math.pi)
    wind = (wind_m_s * math.cos(towards), wind_m_s * math.sin(towards), 0.0)
    path = None if out is None else out / f"seed_{seed}.mcap"
    begun = time.monotonic()
    with (
        tempfile.TemporaryDirectory() as folder,
        AutopilotPlant(
            load_charged_vehicle(vehicle, flight_s), Mission(name="hall"), rate_Hz=PX4_RATE_HZ, autopilot="PX4",
            wind=wind, seed=seed, path=path, keep=True,
        ) as plant,
    ):  # fmt: skip
        endpoint = replace(PX4_ENDPOINT, port=PX4_ENDPOINT.port + instance)
        simulator = Px4Simulator(plant, endpoint=endpoint, speed=speed)
        companion = Companion(plant, instance, flight_s, excite=excite)
        simulator.on_period = companion.step
        events: list[str] = []
        plant.listeners.append(lambda e: events.append(f"{e.time_s:.1f} {e.text}"))
        limit_s, wall_limit_s = TIMEOUT_S + flight_s, WALL_LIMIT_S + LONGEST_WALL_RATIO * flight_s
        process = start_px4(build, Path(folder), instance)
        try:
            simulator.run(
                lambda: (
                    companion.phase == "done"
                    or plant.time_s > limit_s
                    or time.monotonic() - begun > wall_limit_s
                    or process.poll() is not None
                )
            )
        finally:
            companion.close()
            process.terminate()
            process.wait(10)
            if out is not None:
                shutil.copy(Path(folder) / "px4.txt", out / f"seed_{seed}.txt")
                for k, log in enumerate(sorted(Path(folder).rglob("*.ulg"))):
                    shutil.copy(log, out / f"seed_{seed}_{k}.ulg")
        record = plant.to_dataset()
        overshoot, aside = measure_overshoot(record, companion.legs)
        attitude = np.degrees(np.abs(record["truth_attitude"].values[:, :2]).max())
        crash = plant.plant.crash_cause
        done = companion.phase == "done" and not companion.failure and not crash and len(companion.legs) >= 4
        return {
            "seed": seed, "landed": done, "reason": companion.failure or crash or ("" if done else companion.phase),
            "overshoot_m": round(overshoot, 3), "aside_m": round(aside, 3), "tilt_deg": round(float(attitude), 1),
            "land_error_m": round(float(np.hypot(*plant.truth.position[:2])), 3),
            "squares": len(companion.legs) // 4, "simulated_s": round(plant.time_s, 1),
            "steps": simulator.lockstep_period_count, "unanswered": simulator.unanswered_count,
            "wall_s": round(time.monotonic() - begun, 1),
            "texts": companion.texts if not done else [], "events": events,
        }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("build", type=Path)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--wind", type=float, default=0.5)
    parser.add_argument("--vehicle", default="mufly-1.1")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--speed", type=float, default=0.0)
    parser.add_argument("--instance", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=0.0, help="simulated time in the air, in squares")
    parser.add_argument("--excite", action="store_true", help="add steps of heading and height, for an identification")
    a = parser.parse_args()
    if a.out is not None:
        a.out.mkdir(parents=True, exist_ok=True)
    flights = []
    for seed in range(a.first, a.first + a.seeds):
        flights.append(
            fly(a.build.absolute(), seed, a.wind, a.vehicle, a.out, a.speed, a.instance, 60.0 * a.minutes, a.excite)
        )
        print(json.dumps(flights[-1]), flush=True)
    landed = [f for f in flights if f["landed"]]
    print(f"{len(landed)} of {len(flights)} landed; largest overshoot {max(f['overshoot_m'] for f in flights):.3f} m")


if __name__ == "__main__":
    main()
