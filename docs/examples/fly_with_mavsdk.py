"""Fly the simulated helicopter with MAVSDK: parameters, take-off, a mission in metres, an offboard square, landing.

In one terminal ``mufly link``, in another::

    pip install mavsdk
    python docs/examples/fly_with_mavsdk.py                          # or: ... udpin://127.0.0.1:14541

Nothing here is mufly's own: it is MAVSDK's asyncio interface as its documentation describes it.
"""

from __future__ import annotations

import asyncio
import math
import sys
from collections.abc import AsyncIterator, Callable
from typing import TypeVar

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.mission_raw import MissionRawAsync
from mavsdk.asyncio.plugins.offboard import OffboardAsync
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.mission_raw import MissionItem
from mavsdk.plugins.offboard import PositionNedYaw
from mavsdk.plugins.telemetry import FlightMode

LOCAL_NED, WAYPOINT = 1, 16  # MAV_FRAME_LOCAL_NED: metres from where the simulation's floor has its origin
HEIGHT_M = 0.8
MISSION = [(0.0, 0.0, -1.0), (0.6, 0.0, -1.0), (0.6, 0.6, -1.2)]  # N, E, D
SQUARE = [(0.6, -0.1), (-0.1, -0.1), (-0.1, 0.6), (0.6, 0.6)]  # N, E
PATIENCE_S = 45.0  # for one leg; a machine under load may run slower than real time

T = TypeVar("T")


async def first(stream: AsyncIterator[T], that: Callable[[T], bool], what: str) -> T:
    """Wait for the first value of a stream that fits."""
    async with asyncio.timeout(PATIENCE_S):
        async for value in stream:
            if that(value):
                return value
    raise ConnectionError(f"the stream ended while waiting for {what}")


def item(seq: int, north: float, east: float, down: float, wait_s: float = 0.5) -> MissionItem:
    """One waypoint in metres, as MISSION_ITEM_INT has it: x and y in units of 0.1 mm."""
    return MissionItem(
        seq=seq,
        frame=LOCAL_NED,
        command=WAYPOINT,
        current=int(seq == 0),
        autocontinue=1,
        param1=wait_s,
        param2=0.1,
        param3=0.0,
        param4=math.nan,  # heading: as the vehicle likes
        x=round(north * 1e4),
        y=round(east * 1e4),
        z=down,
    )


async def arrive(telemetry: TelemetryAsync, north: float, east: float) -> None:
    """Wait until the helicopter is within 10 cm of a place."""

    def near(at: object) -> bool:
        p = at.position  # type: ignore[attr-defined]
        return math.hypot(p.north_m - north, p.east_m - east) < 0.1

    await first(telemetry.subscribe_position_velocity_ned(), near, "the place")


async def fly(url: str) -> None:
    config = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    async with Mavsdk(config) as mavsdk:
        await mavsdk.add_any_connection(url)
        system = await mavsdk.first_autopilot(timeout_s=PATIENCE_S)
        if system is None:
            raise SystemExit(f"no vehicle at {url}; is `mufly link` running?")
        action, telemetry, param = ActionAsync(system), TelemetryAsync(system), ParamAsync(system)
        mission, offboard = MissionRawAsync(system), OffboardAsync(system)

        battery = await first(telemetry.subscribe_battery(), lambda b: b.voltage_v > 0.0, "battery")
        # An indoor vehicle has no global position, so `health_all_ok` never comes; these two are what counts.
        health = telemetry.subscribe_health()
        await first(health, lambda h: h.is_armable and h.is_local_position_ok, "readiness")
        print(f"connected: battery {battery.voltage_v:.2f} V, ready to arm", flush=True)

        await param.set_param_float("MIS_TAKEOFF_ALT", HEIGHT_M)
        height = await param.get_param_float("MIS_TAKEOFF_ALT")
        print(
            f"take-off height {height:.2f} m, one of {len((await param.get_all_params()).float_params)}",
            flush=True,
        )

        await action.arm()
        await first(telemetry.subscribe_armed(), lambda armed: armed, "armed")
        await action.takeoff()
        await first(telemetry.subscribe_flight_mode(), lambda mode: mode == FlightMode.HOLD, "the end of the take-off")
        await first(telemetry.subscribe_in_air(), lambda flying: flying, "in the air")
        print("in the air", flush=True)

        items = [item(seq, *place) for seq, place in enumerate(MISSION)]
        await mission.upload_mission(items)
        back = await mission.download_mission()
        same = [(m.frame, m.command, m.x, m.y, round(m.z, 4)) for m in back] == [
            (m.frame, m.command, m.x, m.y, round(m.z, 4)) for m in items
        ]
        print(f"mission of {len(back)} uploaded, download equal: {same}", flush=True)
        await mission.start_mission()
        async with asyncio.timeout(PATIENCE_S * len(items)):
            async for progress in mission.subscribe_mission_progress():
                print(f"mission {progress.current}/{progress.total}", flush=True)
                if progress.current == progress.total:
                    break
        print(f"mission finished: {await mission.is_mission_finished()}", flush=True)
        await mission.clear_mission()
        print(f"mission cleared, {len(await mission.download_mission())} items left", flush=True)

        await offboard.set_position_ned(PositionNedYaw(0.6, 0.6, -1.2, 0.0))  # a set-point has to be there first
        await offboard.start()
        for north, east in SQUARE:
            await offboard.set_position_ned(PositionNedYaw(north, east, -1.0, 0.0))
            await arrive(telemetry, north, east)
            print(f"offboard: at {north:.1f} m N, {east:.1f} m E", flush=True)
        await offboard.stop()

        await action.land()
        await first(telemetry.subscribe_in_air(), lambda flying: not flying, "the ground")
        await first(telemetry.subscribe_armed(), lambda armed: not armed, "disarmed")
        print("landed and disarmed", flush=True)


if __name__ == "__main__":
    asyncio.run(fly(sys.argv[1] if len(sys.argv) > 1 else "udpin://127.0.0.1:14540"))
