"""Kill an autopilot or its simulator at random moments of a flight, restart it, and check that the next flight begins.

    python benchmarks/autopilot_kills.py px4 --build PX4_BUILD --kills 10
    python benchmarks/autopilot_kills.py ardupilot --kills 10

The simulator is ``mufly link --simulator``, in a process of its own. PX4 is the program of a build folder
(``px4_flights.py``). ArduPilot is a script that sends the packets of its JSON interface and repeats a packet without an
answer. Kills are SIGKILL. A flight counts as recovered once the vehicle is armed and half a metre high. One line of
JSON per kill.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from px4_flights import SETPOINT_PERIODS, Companion, start_px4

PHASE_S = {
    "ready": 3.0,
    "climb": 14.0,
    "square": 32.0,
    "land": 4.0,
}  # time within which the kill falls: of the wall clock before arming, else simulated
FLIGHT_PHASES = tuple(PHASE_S)
LIMIT_S = 240.0  # wall-clock time to reach a phase
TOLD_LIMIT_S = 10.0
RECOVERED_HEIGHT_M = 0.5
RECONNECT_WATCH_S = 12.0
TERMINATE_LIMIT_S = 5.0
PERIOD_S = 0.02  # wall-clock time between set-points
ARDUPILOT_RATE_HZ, ARDUPILOT_RETRY_S = 400, 0.1
ARDUPILOT_START_PERIODS, ARDUPILOT_REPORT_PERIODS = 200, 20
ARDUPILOT_FLIGHT_S = 12.0
REST_PULSES = (1500, 1500, 1500, 1500, 1000, 1000)


class Link:
    """``mufly link --simulator`` as a process, with its lines and their wall-clock times."""

    def __init__(self, autopilot: str, speed: float, wind_m_s: float, seed: int) -> None:
        line = [sys.executable, "-u", "-m", "mufly", "link", "--simulator", autopilot]
        line += ["--speed", f"{speed:g}", "--wind", f"{wind_m_s:g}", "--seed", str(seed)]
        self.lines: list[tuple[float, str]] = []
        self.process = subprocess.Popen(
            line, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=os.environ | {"COLUMNS": "240"}
        )
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()
        self.wait_for("waiting for", 0, LIMIT_S)

    def _read(self) -> None:
        assert self.process.stdout is not None
        for text in self.process.stdout:
            self.lines.append((time.monotonic(), text.rstrip()))

    def find(self, word: str, first: int) -> float:
        """Return the wall-clock time of the first line with a word from line ``first`` on; NaN without one."""
        return next((at for at, text in self.lines[first:] if word in text), math.nan)

    def wait_for(self, word: str, first: int, limit_s: float) -> float:
        end = time.monotonic() + limit_s
        while math.isnan(at := self.find(word, first)) and time.monotonic() < end:
            time.sleep(0.02)
        return at

    def kill(self) -> None:
        self.process.kill()
        self.process.wait(10.0)
        self._thread.join(5.0)


class Px4View:
    """Time since the start of a PX4, and its estimated height."""

    def __init__(self) -> None:
        self.time_s = self.height_m = 0.0


class WallCompanion(Companion):
    """Companion computer in wall-clock time: it knows only what PX4 sends."""

    def __init__(self) -> None:
        super().__init__(Px4View(), 0)

    def handle_message(self, m: Any) -> None:
        super().handle_message(m)
        if m.get_type() == "LOCAL_POSITION_NED":
            self.vehicle.time_s, self.vehicle.height_m = m.time_boot_ms * 1e-3, -m.z


class Px4Flight:
    """A PX4 and its companion computer."""

    def __init__(self, build: Path, folder: Path) -> None:
        self.companion = WallCompanion()
        self.begun_s = time.monotonic()
        self.process = start_px4(build, folder, 0)

    def fly_until(self, done: Callable[[], bool], limit_s: float = LIMIT_S) -> bool:
        end = time.monotonic() + limit_s
        while not done():
            if time.monotonic() > end or self.companion.failure:
                return False
            for _ in range(SETPOINT_PERIODS):
                self.companion.step()
            time.sleep(PERIOD_S)
        return True

    def fly_to(self, phase: str, after_s: float) -> bool:
        c = self.companion
        if phase == "ready":
            return self.fly_until(lambda: time.monotonic() - self.begun_s >= after_s)

        def is_reached() -> bool:
            begun_s = c.legs[0][0] if phase == "square" and c.legs else c.phase_s
            return c.phase == phase and c.vehicle.time_s - begun_s >= after_s

        return self.fly_until(is_reached)

    def is_in_the_air(self) -> bool:
        return self.companion.armed and self.companion.vehicle.height_m > RECOVERED_HEIGHT_M

    def kill(self) -> None:
        self.process.kill()
        self.process.wait(10.0)
        self.companion.close()


def processor_time_s(pid: int) -> float:
    """Return the processor time that a process has used (s)."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def draw_moments(kills: int, rng: np.random.Generator) -> list[tuple[str, float]]:
    """Return a phase of the flight and a time within it for each kill; the phases take turns."""
    names = [FLIGHT_PHASES[k % len(FLIGHT_PHASES)] for k in range(kills)]
    return [(name, round(float(rng.uniform(0.0, PHASE_S[name])), 2)) for name in names]


def kill_px4(build: Path, kills: int, seed: int, speed: float, wind_m_s: float) -> None:
    """Kill PX4 at random moments; one simulator serves every PX4."""
    link = Link("px4", speed, wind_m_s, seed)
    try:
        with tempfile.TemporaryDirectory() as folder:
            flight = Px4Flight(build, Path(folder))
            for phase, after_s in draw_moments(kills, np.random.default_rng(seed)):
                if phase == "ready" and flight.companion.armed:
                    seen = len(link.lines)
                    flight.kill()
                    link.wait_for("closed the connection", seen, TOLD_LIMIT_S)
                    flight = Px4Flight(build, Path(folder))
                reached = flight.fly_to(phase, after_s)
                first = len(link.lines)
                killed_s = time.monotonic()
                flight.kill()
                told_s = link.wait_for("closed the connection", first, TOLD_LIMIT_S) - killed_s
                flight = Px4Flight(build, Path(folder))
                recovered = flight.fly_until(flight.is_in_the_air)
                print_row(
                    "PX4", phase, after_s, reached, recovered, time.monotonic() - flight.begun_s, link.lines[first:],
                    told_s=round(told_s, 2), lockstep_s=round(link.find("lockstep", first) - flight.begun_s, 1),
                )  # fmt: skip
            flight.kill()
    finally:
        link.kill()


def kill_px4_simulator(build: Path, kills: int, seed: int, speed: float, wind_m_s: float) -> None:
    """Kill the simulator at random moments; then restart it, and PX4 if it does not call again."""
    link = Link("px4", speed, wind_m_s, seed)
    with tempfile.TemporaryDirectory() as folder:
        flight = Px4Flight(build, Path(folder))
        try:
            for phase, after_s in draw_moments(kills, np.random.default_rng(seed + 1)):
                if phase == "ready" and flight.companion.armed:
                    flight.kill()
                    flight = Px4Flight(build, Path(folder))
                reached = flight.fly_to(phase, after_s)
                link.kill()
                used_s, begun_s = processor_time_s(flight.process.pid), time.monotonic()
                link = Link("px4", speed, wind_m_s, seed)
                reconnect_s = link.wait_for("has connected from", 0, RECONNECT_WATCH_S) - begun_s
                alive = flight.process.poll() is None
                share = (processor_time_s(flight.process.pid) - used_s) / (time.monotonic() - begun_s) if alive else 0.0
                first = len(link.lines)
                ended = True
                if math.isnan(reconnect_s):
                    flight.process.terminate()
                    with contextlib.suppress(subprocess.TimeoutExpired):
                        flight.process.wait(TERMINATE_LIMIT_S)
                    ended = flight.process.poll() is not None
                    flight.kill()
                    flight = Px4Flight(build, Path(folder))
                recovered = flight.fly_until(flight.is_in_the_air)
                print_row(
                    "simulator of PX4", phase, after_s, reached, recovered, time.monotonic() - flight.begun_s,
                    link.lines, px4_alive=alive, px4_processor_share=round(share, 2),
                    px4_reconnected=not math.isnan(reconnect_s), px4_ended_by_sigterm=ended,
                    lockstep_s=round(link.find("lockstep", first) - flight.begun_s, 1),
                )  # fmt: skip
        finally:
            flight.kill()
            link.kill()


def run_ardupilot_peer(port: int) -> None:
    """Send the packets of ArduPilot's JSON interface: stand, spin up, and climb to a metre on the true state.

    Every packet without an answer is repeated, as ArduPilot does.
    """
    line = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    line.connect(("127.0.0.1", port))
    line.settimeout(ARDUPILOT_RETRY_S)
    frame, state = 0, None
    while True:
        frame += 1
        words = [*ardupilot_pulses(state), *[0] * 10]
        packet = struct.pack("<HHI16H", 18458, ARDUPILOT_RATE_HZ, frame, *words)
        while True:
            try:
                line.send(packet)
                state = json.loads(line.recv(65536))
                break
            except OSError:  # no answer, or no simulator
                time.sleep(0.01)
        if frame % ARDUPILOT_REPORT_PERIODS == 0:
            print(json.dumps({"frame": frame, "time_s": state["timestamp"], "height_m": -state["position"][2]}))
            sys.stdout.flush()


def ardupilot_pulses(state: dict[str, Any] | None) -> tuple[int, ...]:
    """Return the pulses (us) of a proportional and derivative law for height, heading and attitude."""
    if state is None or state["timestamp"] < ARDUPILOT_START_PERIODS / ARDUPILOT_RATE_HZ:
        return REST_PULSES
    height_m, climb_m_s = -state["position"][2], -state["velocity"][2]
    roll, pitch, yaw = state["attitude"]
    p, q, r = state["imu"]["gyro"]
    spin = min(1.0, (state["timestamp"] - 0.5) / 2.0)
    mean = spin * (720.0 + 300.0 * min(0.5, 1.0 - height_m) - 150.0 * climb_m_s)
    turn = -100.0 * yaw - 50.0 * r
    aside, ahead = (round(float(np.clip(-800.0 * a - 100.0 * b, -400, 400))) for a, b in ((roll, p), (pitch, q)))
    upper, lower = (
        round(float(np.clip(1000.0 + mean + s, 1000, 2000))) for s in (turn - 33.0 * spin, 33.0 * spin - turn)
    )
    return 1500 + aside, 1500 + ahead, 1500 - aside, 1500 - ahead, upper, lower


class ArduPilotFlight:
    """The scripted ArduPilot as a process, with the last state that it reported."""

    def __init__(self, port: int) -> None:
        self.begun_s = time.monotonic()
        self.state: dict[str, float] = {"frame": 0, "time_s": 0.0, "height_m": 0.0}
        self.process = subprocess.Popen(
            [sys.executable, __file__, "peer", "--port", str(port)], stdout=subprocess.PIPE, text=True
        )
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for text in self.process.stdout:
            with contextlib.suppress(ValueError):
                self.state = json.loads(text)

    def wait_for(self, done: Callable[[], bool], limit_s: float = LIMIT_S) -> bool:
        end = time.monotonic() + limit_s
        while not done():
            if time.monotonic() > end:
                return False
            time.sleep(0.01)
        return True

    def fly_to_random_moment(self, rng: np.random.Generator) -> tuple[float, bool]:
        """Wait for a random time of the flight; return it (s), and whether it was reached."""
        after_s = round(float(rng.uniform(0.0, ARDUPILOT_FLIGHT_S)), 2)
        return after_s, self.wait_for(lambda: self.state["time_s"] >= after_s)

    def is_in_the_air(self) -> bool:
        return self.state["height_m"] > RECOVERED_HEIGHT_M

    def kill(self) -> None:
        self.process.kill()
        self.process.wait(10.0)


def kill_ardupilot(kills: int, seed: int, speed: float, wind_m_s: float, port: int = 9002) -> None:
    """Kill the scripted ArduPilot at random moments; it restarts after 0 s or 4 s in turns."""
    rng = np.random.default_rng(seed)
    link = Link("ardupilot", speed, wind_m_s, seed)
    flight = ArduPilotFlight(port)
    try:
        for k in range(kills):
            after_s, reached = flight.fly_to_random_moment(rng)
            first = len(link.lines)
            killed_s = time.monotonic()
            flight.kill()
            told_s = math.nan
            if k % 2:
                told_s = link.wait_for("has sent nothing", first, TOLD_LIMIT_S) - killed_s
                time.sleep(2.0)
            flight = ArduPilotFlight(port)
            recovered = flight.wait_for(flight.is_in_the_air)
            print_row(
                "ArduPilot", "flight", after_s, reached, recovered, time.monotonic() - flight.begun_s,
                link.lines[first:], told_s=round(told_s, 2),
                told_restart=not math.isnan(link.find("restarted", first)),
            )  # fmt: skip
    finally:
        flight.kill()
        link.kill()


def kill_ardupilot_simulator(kills: int, seed: int, speed: float, wind_m_s: float, port: int = 9002) -> None:
    """Kill the simulator of the scripted ArduPilot at random moments, and restart it; ArduPilot runs on."""
    rng = np.random.default_rng(seed + 1)
    link = Link("ardupilot", speed, wind_m_s, seed)
    flight = ArduPilotFlight(port)
    try:
        for _ in range(kills):
            after_s, reached = flight.fly_to_random_moment(rng)
            link.kill()
            frame = flight.state["frame"]
            begun_s = time.monotonic()
            link = Link("ardupilot", speed, wind_m_s, seed)
            again = flight.wait_for(lambda at=frame: flight.state["time_s"] < 1.0 and flight.state["frame"] > at)
            recovered = again and flight.wait_for(flight.is_in_the_air)
            print_row(
                "simulator of ArduPilot", "flight", after_s, reached, recovered, time.monotonic() - begun_s, link.lines,
                ardupilot_alive=flight.process.poll() is None,
            )  # fmt: skip
    finally:
        flight.kill()
        link.kill()


def print_row(
    killed: str, phase: str, after_s: float, reached: bool, recovered: bool, recovery_s: float,
    lines: list[tuple[float, str]], **more: Any,
) -> None:  # fmt: skip
    row = {
        "killed": killed, "phase": phase, "after_s": after_s, "reached": reached, "recovered": recovered,
        "recovery_s": round(recovery_s, 1), **more, "lines": [text for _, text in lines],
    }  # fmt: skip
    print(json.dumps(row), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("autopilot", choices=("px4", "ardupilot", "peer"))
    parser.add_argument("--build", type=Path, help="build folder of px4_sitl_default")
    parser.add_argument("--kills", type=int, default=10, help="of either side")
    parser.add_argument("--side", choices=("autopilot", "simulator", "both"), default="both")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--speed", type=float, default=0.0)
    parser.add_argument("--wind", type=float, default=0.5)
    parser.add_argument("--port", type=int, default=9002, help="of the scripted ArduPilot (peer)")
    a = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    if a.autopilot == "peer":
        run_ardupilot_peer(a.port)
    if a.autopilot == "px4" and a.build is None:
        parser.error("px4 needs --build")
    rest = (a.kills, a.seed, a.speed, a.wind)
    if a.side != "simulator":
        kill_px4(a.build.absolute(), *rest) if a.autopilot == "px4" else kill_ardupilot(*rest)
    if a.side != "autopilot":
        kill_px4_simulator(a.build.absolute(), *rest) if a.autopilot == "px4" else kill_ardupilot_simulator(*rest)


if __name__ == "__main__":
    main()
