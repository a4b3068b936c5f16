"""Fly missions with the emulated board alone, commanded through its UART by pymavlink or by stock MAVSDK.

    nice -n 19 python benchmarks/board_flights.py demonstration --flights 20
    nice -n 19 python benchmarks/board_flights.py box-on-leg --flights 20 --seed 100
    nice -n 19 python benchmarks/board_flights.py demonstration --flights 1 --station mavsdk

The station arms, starts the mission and watches; MAVSDK also sets a parameter and compares the mission that it
downloads with the one that it uploads. The board plans, estimates and controls. Wind 0.5 m/s, gusts 0.3 m/s.
A flight counts if its mission ends landed and disarmed with the outcome "succeeded". Every byte of the board's memory
is compared with the same code in single precision on this machine.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import socket
import threading
import time

os.environ.setdefault("MAVLINK20", "1")

from pymavlink import mavutil

from mufly.firmware.emulated.board_link import run_linked_board
from mufly.flight import Flight
from mufly.mission import load_mission
from mufly.vehicle import load_vehicle

LONGEST_FLIGHT_S = 240.0
ARM, START_MISSION, ARMED = 400, 300, 128


class Station(threading.Thread):
    """A station that arms, starts the mission, and waits for the end."""

    def __init__(self, port: int) -> None:
        super().__init__(daemon=True)
        self.port, self.over, self.texts = port, threading.Event(), []

    def run(self) -> None:
        c = mavutil.mavlink_connection(f"tcp:127.0.0.1:{self.port}", source_system=255, retries=200)
        c.wait_heartbeat(timeout=120)

        def command(number: int, *params: float) -> bool:
            c.mav.heartbeat_send(6, 8, 0, 0, 4)
            c.mav.command_long_send(1, 1, number, 0, *params, *[0.0] * (7 - len(params)))
            answer = c.recv_match(type="COMMAND_ACK", blocking=True, timeout=20)
            return answer is not None and answer.command == number and answer.result == 0

        while not (command(ARM, 1.0) and command(START_MISSION)) and not self.over.is_set():
            time.sleep(0.5)
        while not self.over.is_set():
            c.mav.heartbeat_send(6, 8, 0, 0, 4)
            m = c.recv_match(type=["HEARTBEAT", "STATUSTEXT"], blocking=True, timeout=5)
            if m is not None and m.get_type() == "STATUSTEXT":
                self.texts.append(m.text)
            elif m is not None and not m.base_mode & ARMED and any("landed" in t for t in self.texts):
                self.over.set()
        c.close()


class MavsdkStation(Station):
    """The same with the interface of MAVSDK, as its documentation describes it."""

    def run(self) -> None:
        try:
            asyncio.run(self.command_flight())
        except Exception as fault:  # the report of the flight shows it
            self.texts.append(f"MAVSDK: {fault!r}")

    async def command_flight(self) -> None:
        from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
        from mavsdk.asyncio.plugins.action import ActionAsync
        from mavsdk.asyncio.plugins.mission_raw import MissionRawAsync
        from mavsdk.asyncio.plugins.param import ParamAsync
        from mavsdk.asyncio.plugins.telemetry import TelemetryAsync

        async with Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION)) as mavsdk:
            await mavsdk.add_any_connection(f"tcpout://127.0.0.1:{self.port}")
            system = await mavsdk.first_autopilot(timeout_s=120.0)
            if system is None:
                raise ConnectionError("no autopilot")
            action, telemetry, param = ActionAsync(system), TelemetryAsync(system), ParamAsync(system)
            mission = MissionRawAsync(system)
            await param.set_param_float("MIS_TAKEOFF_ALT", 0.7)
            height = await param.get_param_float("MIS_TAKEOFF_ALT")
            count = len((await param.get_all_params()).float_params)
            items = await mission.download_mission()
            await mission.upload_mission(items)
            again = await mission.download_mission()
            same = [(m.command, m.x, m.y, m.z) for m in again] == [(m.command, m.x, m.y, m.z) for m in items]
            self.texts.append(f"height {height:.2f} m of {count} parameters, {len(items)} items, equal again: {same}")
            async for health in telemetry.subscribe_health():
                if health.is_armable and health.is_local_position_ok:
                    break
            await action.arm()
            await mission.start_mission()
            async for state in telemetry.subscribe_armed():
                if not state:
                    break
            self.texts.append("disarmed")
        self.over.set()


def fly_once(name: str, seed: int, counts_instructions: bool, kind: type[Station] = Station) -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    station, outcome = kind(port), []

    def stop(flight: Flight) -> bool:
        outcome[:] = [str(flight.autopilot.software.mission_state.outcome), flight.plant.crash_cause]
        return station.over.is_set() or bool(flight.plant.crash_cause) or flight.time_s > LONGEST_FLIGHT_S

    flown = run_linked_board(
        load_vehicle("mufly-1.1"), load_mission(name), port=port, wind=[0.5, 0.0, 0.0], gust=0.3, seed=seed, pace=0.0,
        counts_instructions=counts_instructions, stop=stop, on_open=station.start,
    )  # fmt: skip
    ended = station.over.is_set()
    station.over.set()
    print(
        f"{name} seed {seed}: {'landed' if ended else 'NOT ENDED'}, {' '.join(filter(None, outcome))}; "
        f"{flown.periods} periods, {flown.mismatch_count} differ {flown.first_mismatch}; "
        f"{flown.periods_per_s:.0f} periods/s; "
        f"worst period {flown.worst_instructions} instructions; {station.texts}",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("mission")
    parser.add_argument("--flights", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--instructions", action="store_true", help="count instructions; slower")
    parser.add_argument("--station", choices=("pymavlink", "mavsdk"), default="pymavlink")
    given = parser.parse_args()
    kind = MavsdkStation if given.station == "mavsdk" else Station
    for seed in range(given.seed, given.seed + given.flights):
        fly_once(given.mission, seed, given.instructions, kind)


if __name__ == "__main__":
    main()
