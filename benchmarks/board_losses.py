"""Lose the link, the receiver or a bus of sensors at random instants of a flight, and fly on.

    nice -n 19 python benchmarks/board_losses.py --instants 200
    nice -n 19 python benchmarks/board_losses.py --instants 200 --seed 1 link
    nice -n 19 python benchmarks/board_losses.py --instants 20 --seed 1 --flights 20 --buses fix bus

The board's code of this machine flies the simulated plant in single precision, wind 0.5 m/s, gusts 0.3 m/s. At each
instant the process forks, and the copy flies on with the loss:

- link: a station has started the demonstration and falls silent;
- receiver: a pilot with random sticks; the bytes of the receiver end, no station is there;
- bus: the readings of one bus keep their last value and are never new: SPI (inertial unit, pressure), I2C (sonar), or
  the position fix.

COM_DL_LOSS_T is 2 s and COM_DL_LAND_T 3 s. A case counts if the board ends disarmed with the motors off within 90 s, on
the floor unless the inertial unit is lost; its log ends with a reason; the log's session and the settings are whole.
"""

from __future__ import annotations

import argparse
import json
import os
from collections import Counter
from io import BytesIO
from typing import Any

import numpy as np

os.environ.setdefault("MAVLINK20", "1")

from pymavlink.dialects.v20 import common as mavlink
from pyulog import ULog

from mufly.control import design_flight_controller
from mufly.estimate.filter.filter_records import (
    READING_ACCELERATION,
    READING_POSITION_FIX,
    READING_PRESSURE,
    READING_RATES,
    READING_SONAR,
)
from mufly.firmware.emulated import HostBoard, make_board
from mufly.firmware.emulated.board_flight import BoardEstimator, make_board_software
from mufly.flight import Flight
from mufly.logs.block_log import split_image_into_sessions
from mufly.mission import load_mission
from mufly.vehicle import load_vehicle

BUSES = {
    "SPI": (READING_ACCELERATION, READING_RATES, READING_PRESSURE),
    "I2C": (READING_SONAR,),
    "fix": (READING_POSITION_FIX,),
}
LONGEST_S = 90.0  # after the loss
FLOWN_S = 60.0  # instants are drawn from the first minute after arming
LOW, MIDDLE, HIGH = 172, 992, 1811
KINDS = ("link", "receiver", "bus")


class LossyBoard:
    """A board on this machine with a station, a pilot, and buses that can get stuck."""

    def __init__(self, board: HostBoard, has_pilot: bool, seed: int) -> None:
        self.board, self.has_pilot, self.lost = board, has_pilot, ""
        self.codec = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
        self.rng, self.count = np.random.default_rng(seed), 0
        self.channels = [MIDDLE] * 16
        self.channels[4:7] = [LOW, HIGH, LOW]
        self.texts: list[str] = []
        self.has_started = False
        self.decoder = mavlink.MAVLink(None)
        self.decoder.robust_parsing = True
        self._compute_estimate, self._compute_control = board.compute_estimate, board.compute_control
        board.compute_estimate, board.compute_control = self.compute_estimate, self.compute_control  # type: ignore
        board.lib.rc_start(board.ffi.addressof(board.record, "rc"), board.lib.RC_SBUS if has_pilot else 0)
        s = board.record.supervisor.settings
        s.link_loss_s, s.link_land_s = 2.0, 3.0

    def compute_estimate(self, period: Any) -> None:
        for sensor in BUSES.get(self.lost, ()):
            period.readings.fresh[sensor] = 0
        self._compute_estimate(period)

    def compute_control(self, request: Any) -> None:
        self._compute_control(request)
        self.count += 1
        record, ffi = self.board.record, self.board.ffi
        record.rc.input_count = 0
        if self.has_pilot and self.lost != "receiver" and self.count % 3 == 0:
            self._move_sticks()
            frame = b"\x0f" + sum(c << 11 * k for k, c in enumerate(self.channels)).to_bytes(22, "little") + bytes(2)
            ffi.memmove(record.rc.input, frame, len(frame))
            record.rc.input_count = len(frame)
        sends = b""
        if not self.has_pilot and self.lost != "link" and self.count % 100 == 0:
            sends = mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3).pack(self.codec)
            started = record.software.mission.state != 0 or record.software.motors != 0 or self.has_started
            if record.belief.time_s > 3.0 and not started:
                self.has_started = bool(record.supervisor.armed)
                number = 300 if self.has_started else 400
                params = [1.0, *[0.0] * 6] if number == 400 else [0.0] * 7
                sends = mavlink.MAVLink_command_long_message(1, 1, number, 0, *params).pack(self.codec)
        for m in self.decoder.parse_buffer(self.board.exchange_bytes(sends)) or []:
            if m.get_type() == "STATUSTEXT":
                self.texts.append(m.text)

    def _move_sticks(self) -> None:
        record = self.board.record
        height = -float(record.belief.motion.position[2])
        if not record.supervisor.armed and not self.lost:
            self.channels[4] = HIGH if record.belief.time_s > 3.0 and self.count // 60 % 2 else LOW
        if self.count % 120 == 0:
            self.channels[0:2] = self.rng.integers(MIDDLE - 150, MIDDLE + 150, 2).tolist()
        climbs = record.supervisor.armed and height < 0.6
        self.channels[2] = HIGH if climbs else LOW + 400 if height > 1.4 else MIDDLE


def open_flight(board: HostBoard, seed: int) -> Flight:
    vehicle, mission = load_vehicle("mufly-1.1"), load_mission("demonstration")
    controller = design_flight_controller(vehicle)
    flight = Flight(
        vehicle, mission, controller=controller, wind=[0.5, 0.0, 0.0], gust=0.3, seed=seed, keep=False,
        sensors="fitted",
        estimator=BoardEstimator(board, vehicle, mission.world, controller.rate_Hz),
        controllers=make_board_software(board),
    )  # fmt: skip
    flight.autopilot.software.commands_itself = True
    return flight


def judge_loss(flight: Flight, lossy: LossyBoard, flash: np.ndarray) -> dict[str, Any]:
    """Fly on until the motors are off; return the answer."""
    record, lib = lossy.board.record, lossy.board.lib
    began, wrong = flight.time_s, []
    height = -float(flight.truth.position[2])
    flying = bool(record.software.motors) and height > 0.12

    def runs() -> bool:
        return bool(record.supervisor.armed) or record.software.motors != lib.MOTORS_OFF

    off_for = 0
    while flight.time_s < began + LONGEST_S and off_for < 500:
        off_for = 0 if runs() else off_for + 1
        flight.step_period()
        if flight.plant.crash_cause and not runs():
            off_for = 500
    if off_for < 500:
        wrong.append(f"armed {record.supervisor.armed}, motors {record.software.motors} after {LONGEST_S:.0f} s")
    crash = flight.plant.crash_cause
    if crash and lossy.lost != "SPI":
        wrong.append(f"crash: {crash}")
    session = split_image_into_sessions(lossy.board.log_blocks[: record.log.device.place + 1].tobytes())[-1]
    log = ULog(BytesIO(session.ulog))
    reason = [m.message for m in log.logged_messages if m.timestamp * 1e-6 >= began - 0.5]
    if flying and not reason:
        wrong.append("the log names no reason")
    if not np.array_equal(flash, lossy.board.flash):
        wrong.append("settings changed")
    rows = log.data_list[0].data["timestamp"]
    if not np.all(np.diff(rows.astype(np.int64)) > 0):
        wrong.append("rows of the log are out of order")
    return {
        "lost": lossy.lost, "at_s": round(began, 3), "flying": flying, "crash": crash, "wrong": wrong,
        "reason": reason, "took_s": round(flight.time_s - began, 1),
    }  # fmt: skip


def fly_and_lose(
    kind: str, board: HostBoard, instants: int, seed: int, buses: list[str] | None = None
) -> list[dict[str, Any]]:
    """Fly once, and fork at each instant; ``buses`` are those of which one is lost."""
    rng = np.random.default_rng(seed + KINDS.index(kind))
    board.log_blocks[:] = 0
    board.restart()
    answers = []
    with open_flight(board, seed) as flight:
        lossy = LossyBoard(board, kind == "receiver", seed)
        flash = board.flash.copy()
        while not board.record.supervisor.armed:
            flight.step_period()
            if flight.time_s > 30.0:
                raise SystemExit(f"{kind}: the board did not arm: {lossy.texts}")
        armed_s = flight.time_s
        for at_s in sorted(rng.uniform(0.0, FLOWN_S, instants).tolist()):
            while flight.time_s < armed_s + at_s:
                flight.step_period()
            ends = os.pipe()
            child = os.fork()
            if child == 0:
                lossy.lost = str(rng.choice(buses or list(BUSES))) if kind == "bus" else kind
                os.write(ends[1], json.dumps(judge_loss(flight, lossy, flash)).encode())
                os._exit(0)
            rng.random()
            os.close(ends[1])
            with os.fdopen(ends[0], "rb") as told:
                text = told.read()
            os.waitpid(child, 0)
            answers.append(json.loads(text) if text else {"lost": kind, "wrong": [f"ended by itself at {at_s:.2f} s"]})
            if answers[-1]["wrong"]:
                print(answers[-1], flush=True)
    return answers


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kinds", nargs="*", default=KINDS)
    parser.add_argument("--instants", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--flights", type=int, default=1, help="flights, each with the next seed")
    parser.add_argument("--buses", default=",".join(BUSES), help="buses to lose, with commas")
    given = parser.parse_args()
    buses = given.buses.split(",")
    if unknown := set(buses) - set(BUSES):
        parser.error(f"--buses: no bus is called {', '.join(sorted(unknown))}; choose of {', '.join(BUSES)}")
    vehicle, mission = load_vehicle("mufly-1.1"), load_mission("demonstration")
    for kind in given.kinds:
        board = make_board(vehicle, design_flight_controller(vehicle), mission, emulated=False)
        assert isinstance(board, HostBoard)
        answers = []
        for seed in range(given.seed, given.seed + given.flights):
            answers += fly_and_lose(kind, board, given.instants, seed, buses)
        wrong = sum(bool(a["wrong"]) for a in answers)
        flying = sum(a.get("flying", False) for a in answers)
        print(f"{kind}: {len(answers)} instants, {flying} in the air, {wrong} wrong", flush=True)
        ends = Counter((a["lost"], a.get("crash", ""), (a.get("reason") or ["-"])[-1]) for a in answers)
        for (lost, crash, reason), count in sorted(ends.items()):
            print(f"  {count} of {lost}: {crash or 'no crash'}; last entry: {reason}", flush=True)


if __name__ == "__main__":
    main()
