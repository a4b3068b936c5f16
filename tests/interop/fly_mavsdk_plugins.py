"""A tour of MAVSDK's plugins against a vehicle with a global origin; says of each call whether it worked.

    python tests/interop/fly_mavsdk_plugins.py udpin://127.0.0.1:14540 47.3769,8.5417,408

Prints a line "ok NAME" or "failed NAME: why" each, so that what works is a matter of record; the flight goes on.
"""

from __future__ import annotations

import asyncio
import math
import sys
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

from mavsdk.asyncio import ComponentType, Configuration, Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.info import InfoAsync
from mavsdk.asyncio.plugins.manual_control import ManualControlAsync
from mavsdk.asyncio.plugins.mission import MissionAsync
from mavsdk.asyncio.plugins.mission_raw import MissionRawAsync
from mavsdk.asyncio.plugins.offboard import OffboardAsync
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.plugins.mission import MissionItem, MissionPlan
from mavsdk.plugins.offboard import VelocityBodyYawspeed, VelocityNedYaw
from mavsdk.plugins.telemetry import FlightMode, LandedState

PATIENCE_S = 40.0
STREAMS = (
    "position", "home", "in_air", "landed_state", "armed", "attitude_quaternion", "attitude_euler",
    "attitude_angular_velocity_body", "velocity_ned", "gps_info", "raw_gps", "battery", "flight_mode", "health",
    "health_all_ok", "actuator_output_status", "position_velocity_ned", "distance_sensor", "heading", "altitude",
)  # fmt: skip


async def first(
    stream: AsyncIterator[Any], that: Callable[[Any], bool] = lambda v: True, seconds: float = PATIENCE_S
) -> Any:
    async with asyncio.timeout(seconds):
        async for value in stream:
            if that(value):
                return value
    raise ConnectionError("the stream ended")


async def step(name: str, work: Awaitable[Any]) -> Any:
    """Do one thing and say how it went."""
    try:
        async with asyncio.timeout(2.0 * PATIENCE_S):
            value = await work
    except Exception as error:  # what the library raises is what is recorded
        print(f"failed {name}: {type(error).__name__} {' '.join(str(error).split())}", flush=True)
        return None
    print(f"ok {name}", flush=True)
    return value


class Tour:
    """One vehicle and the plugins that ask it."""

    def __init__(self, system: Any, origin: tuple[float, float, float]) -> None:
        self.origin = origin
        self.action, self.telemetry, self.param = (
            ActionAsync(system),
            TelemetryAsync(system),
            ParamAsync(system),
        )
        self.mission, self.raw = MissionAsync(system), MissionRawAsync(system)
        self.offboard, self.sticks, self.info = (
            OffboardAsync(system),
            ManualControlAsync(system),
            InfoAsync(system),
        )

    def there(self, north: float, east: float) -> tuple[float, float]:
        """Latitude and longitude of a place (deg), on a sphere: good to a millimetre over a room."""
        lat, lon, _ = self.origin
        m = math.degrees(1.0 / 6_371_000.0)
        return lat + north * m, lon + east * m / math.cos(math.radians(lat))

    async def at(self, north: float | None = None, east: float | None = None, height: float | None = None) -> None:
        """Wait until it is within 12 cm of a place and slow."""

        def near(x: Any) -> bool:
            p, v = x.position, x.velocity
            off = [
                abs(have - want)
                for have, want in ((p.north_m, north), (p.east_m, east), (-p.down_m, height))
                if want is not None
            ]
            return max(off) < 0.12 and math.hypot(v.north_m_s, v.east_m_s, v.down_m_s) < 0.15

        await first(self.telemetry.subscribe_position_velocity_ned(), near)

    async def mode(self, *modes: FlightMode) -> None:
        await first(self.telemetry.subscribe_flight_mode(), lambda m: m in modes)

    async def down(self) -> None:
        await first(self.telemetry.subscribe_landed_state(), lambda s: s == LandedState.ON_GROUND)
        await first(self.telemetry.subscribe_armed(), lambda armed: not armed)

    async def look(self) -> None:
        for name in STREAMS:
            stream = getattr(self.telemetry, f"subscribe_{name}")()
            good = (lambda v: v is True) if name == "health_all_ok" else (lambda v: True)
            await step(f"telemetry.{name}", first(stream, good, 10.0))
        await step("telemetry.set_rate_position_velocity_ned", self.telemetry.set_rate_position_velocity_ned(25.0))
        await step("telemetry.get_gps_global_origin", self.telemetry.get_gps_global_origin())
        for name in ("get_version", "get_product", "get_identification"):
            await step(f"info.{name}", getattr(self.info, name)())

    async def tune(self) -> None:
        everything = await step("param.get_all_params", self.param.get_all_params())
        for p in everything.float_params if everything else []:
            if p.name == "LIM_SPEED":
                await step("param.set_param_float", self.param.set_param_float(p.name, 0.5))
        for p in everything.int_params if everything else []:
            await step("param.get_param_int", self.param.get_param_int(p.name))
            await step("param.set_param_int", self.param.set_param_int(p.name, p.value))
            break
        await step("action.set_takeoff_altitude", self.action.set_takeoff_altitude(0.7))
        height = await step("action.get_takeoff_altitude", self.action.get_takeoff_altitude())
        print(f"take-off altitude {height}", flush=True)
        await step("action.set_return_to_launch_altitude", self.action.set_return_to_launch_altitude(1.0))
        await step("action.get_return_to_launch_altitude", self.action.get_return_to_launch_altitude())

    async def up(self) -> None:
        await step("action.arm", self.action.arm())
        await step("action.takeoff", self.action.takeoff())
        await step("take-off height", self.at(height=0.7))

    async def go(self) -> None:
        await step("action.set_current_speed", self.action.set_current_speed(0.5))
        lat, lon = self.there(0.8, 0.4)
        await step("action.goto_location", self.action.goto_location(lat, lon, self.origin[2] + 1.0, 0.0))
        await step("goto arrived", self.at(0.8, 0.4, 1.0))
        lat, lon = self.there(-2.0, 0.4)
        await step("action.goto_location far", self.action.goto_location(lat, lon, self.origin[2] + 1.0, 0.0))
        await step("under way", first(self.telemetry.subscribe_velocity_ned(), lambda v: v.north_m_s < -0.2))
        await step("action.hold", self.action.hold())
        await step("hold mode", self.mode(FlightMode.HOLD))
        await step("hold stands", first(self.telemetry.subscribe_velocity_ned(), lambda v: abs(v.north_m_s) < 0.03))

    async def by_hand(self) -> None:
        async def push(x: float, z: float, times: int) -> None:
            for _ in range(times):
                await self.sticks.set_manual_control_input(x, 0.0, z, 0.0)
                await asyncio.sleep(0.05)  # sticks are a stream by nature

        height = -(await first(self.telemetry.subscribe_position_velocity_ned())).position.down_m
        await step("manual_control.input", push(0.0, 0.5, 5))
        await step("manual_control.start_altitude_control", self.sticks.start_altitude_control())
        moving = asyncio.create_task(push(0.0, 0.9, 40))
        higher = self.telemetry.subscribe_position_velocity_ned()
        await step("manual_control climbs", first(higher, lambda x: -x.position.down_m > height + 0.1))
        await moving
        await step("action.hold after sticks", self.action.hold())
        await step("hold mode again", self.mode(FlightMode.HOLD))

    async def missions(self) -> None:
        items = [
            MissionItem(
                *self.there(n, e),
                relative_altitude_m=1.0,
                speed_m_s=0.5,
                is_fly_through=False,
                loiter_time_s=0.5,
            )
            for n, e in ((0.3, 0.0), (0.3, 0.5))
        ]
        await step(
            "mission.set_return_to_launch_after_mission",
            self.mission.set_return_to_launch_after_mission(False),
        )
        await step("mission.upload_mission", self.mission.upload_mission(MissionPlan(items)))
        plan = await step("mission.download_mission", self.mission.download_mission())
        print(f"mission items {len(plan.mission_items) if plan else None}", flush=True)
        await step("mission.start_mission", self.mission.start_mission())
        await step("mission mode", self.mode(FlightMode.MISSION))
        await step("mission.pause_mission", self.mission.pause_mission())
        await step("mission paused", self.mode(FlightMode.HOLD))
        await step("mission.start_mission again", self.mission.start_mission())
        progress = self.mission.subscribe_mission_progress()
        await step("mission progress to the end", first(progress, lambda p: p.total > 0 and p.current == p.total))
        await step("mission arrived", self.at(0.3, 0.5, 1.0))
        finished = await step("mission.is_mission_finished", self.mission.is_mission_finished())
        print(f"mission finished {finished}", flush=True)
        await step("mission.clear_mission", self.mission.clear_mission())
        fence = await step("mission_raw.download_geofence", self.raw.download_geofence())
        print(f"fence items {None if fence is None else len(fence)}", flush=True)
        rally = await step("mission_raw.download_rallypoints", self.raw.download_rallypoints())
        print(f"rally items {None if rally is None else len(rally)}", flush=True)

    async def stream(self) -> None:
        still = VelocityNedYaw(0.0, 0.0, 0.0, 0.0)
        await step("offboard.set_velocity_ned", self.offboard.set_velocity_ned(still))
        await step("offboard.start", self.offboard.start())
        await step("offboard.is_active", self.offboard.is_active())
        await self.offboard.set_velocity_ned(VelocityNedYaw(-0.3, 0.0, 0.0, 0.0))
        velocity = self.telemetry.subscribe_velocity_ned()
        await step("offboard velocity NED", first(velocity, lambda v: abs(v.north_m_s + 0.3) < 0.05))
        heading = self.telemetry.subscribe_heading()  # right is east once the nose points north
        await step("nose north", first(heading, lambda h: min(h.heading_deg, 360.0 - h.heading_deg) < 4.0))
        await self.offboard.set_velocity_body(VelocityBodyYawspeed(0.0, 0.3, 0.0, 0.0))
        velocity = self.telemetry.subscribe_velocity_ned()
        await step("offboard velocity body", first(velocity, lambda v: abs(v.east_m_s - 0.3) < 0.05))
        await step("offboard.stop", self.offboard.stop())

    async def home(self) -> None:
        await step("action.return_to_launch", self.action.return_to_launch())
        await step("home and down", self.down())

    async def kill(self) -> None:
        await self.up()
        await step("action.land", self.action.land())
        await step("landing mode", self.mode(FlightMode.LAND))
        await step("landed", self.down())
        await self.up()
        await step("action.kill", self.action.kill())
        await step("killed: disarmed", first(self.telemetry.subscribe_armed(), lambda armed: not armed))
        await step("action.reboot", self.action.reboot())
        # The simulation stands at its start again, ready.
        health = self.telemetry.subscribe_health()
        await step("armable again", first(health, lambda h: h.is_armable))


async def main(url: str, origin: tuple[float, float, float]) -> None:
    config = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    async with Mavsdk(config) as mavsdk:
        await mavsdk.add_any_connection(url)
        system = await mavsdk.first_autopilot(timeout_s=120.0)
        if system is None:
            raise SystemExit(f"no vehicle at {url}")
        tour = Tour(system, origin)
        await step(
            "ready",
            first(tour.telemetry.subscribe_health(), lambda h: h.is_armable and h.is_local_position_ok),
        )
        for part in (
            tour.look,
            tour.tune,
            tour.up,
            tour.go,
            tour.by_hand,
            tour.missions,
            tour.stream,
            tour.home,
            tour.kill,
        ):
            await part()
        print("end of the tour", flush=True)


if __name__ == "__main__":
    lat, lon, alt = (float(part) for part in sys.argv[2].split(","))
    asyncio.run(main(sys.argv[1], (lat, lon, alt)))
