"""A million bad messages to a station: from vehicles that lie, beside one that does not.

    python benchmarks/fuzz_station.py [--messages 1000000] [--seed 0]

Many system numbers, floods of parameters and texts, missions of 65535 items, every message with extreme fields, damaged
frames and noise (:mod:`hostile_traffic`). Meanwhile the station asks every vehicle that it hears of for everything that
a page may ask. Nothing may raise an error, memory has to stay flat, what the station sends has to stay bounded, and the
honest vehicle has to be seen as it is. Time is simulated: nothing waits for a clock.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))
from fuzz_link import growth_MB, rss_MB
from hostile_traffic import AIMED_AT_STATION, Hostile

from mufly.link import Encoder, Peer, mavlink
from mufly.station import GroundLink, RemoteVehicle

US = (255, 190)
HONEST = Peer("udpin:127.0.0.1:14550", "127.0.0.1:40000")
STEP_S = 0.01
ASK_S = 2.0
SILENCE_S = 300.0


@dataclass
class Findings:
    """What a run has seen.

    Attributes
    ----------
    messages, bytes_in, bytes_out : int
    seconds : float
        Simulated (s).
    faults : list of str
        What must not happen and did.
    vehicles : int
        How many the station knew at the end.
    requests, open_requests : int
        What was asked of them; what has no answer after all that time.
    honest_off : float
        How far the honest vehicle was from where it said that it is (m), at the worst.
    rss_MB : list of (int, float)
        Memory of the process after so many messages.
    """

    messages: int = 0
    bytes_in: int = 0
    bytes_out: int = 0
    seconds: float = 0.0
    faults: list[str] = field(default_factory=list)
    vehicles: int = 0
    requests: int = 0
    open_requests: int = 0
    honest_off: float = 0.0
    rss_MB: list[tuple[int, float]] = field(default_factory=list)


class Honest:
    """A vehicle that tells where it is and that all is well."""

    def __init__(self) -> None:
        self._encode = Encoder(1, 1)
        self.position = (0.0, 0.0, 0.0)

    def say(self, now_s: float) -> bytes:
        """What it says now."""
        ms = round(now_s * 1e3) % 2**32
        self.position = (math.cos(now_s), math.sin(now_s), -1.0)
        n, e, d = self.position
        said = [mavlink.MAVLink_local_position_ned_message(ms, n, e, d, -e, n, 0.0)]
        if ms % 1000 < 1000 * STEP_S:
            said.append(mavlink.MAVLink_heartbeat_message(3, 12, 209, 4 << 16 | 3 << 24, 4, 3))
        return b"".join(self._encode(m) for m in said)


def asks(vehicle: RemoteVehicle) -> list[Callable[[], Any]]:
    """Everything that a page may ask of a vehicle."""
    return [
        vehicle.arm, vehicle.disarm, lambda: vehicle.take_off(1.0), vehicle.start_mission, vehicle.pause,
        lambda: vehicle.go_to((1.0, 0.0, -1.0)), vehicle.return_home, vehicle.land, vehicle.emergency_stop,
        vehicle.take_command, vehicle.release_command, vehicle.download_mission, vehicle.clear_mission,
        vehicle.refresh_parameters, lambda: vehicle.upload_mission("demonstration"),
        lambda: vehicle.set_parameter(next(iter(vehicle.parameters), "LIM_SPEED"), 0.5), lambda: vehicle.mark("x"),
    ]  # fmt: skip


def look(vehicle: RemoteVehicle) -> None:
    """Read everything that a page shows."""
    _ = vehicle.name, vehicle.kind, vehicle.firmware, vehicle.connected, vehicle.in_command, vehicle.commander
    _ = (
        vehicle.snapshot,
        vehicle.mission,
        vehicle.mission_progress,
        vehicle.parameters_missing,
        vehicle.checks,
    )
    _ = [str(m) for m in vehicle.messages], list(vehicle.parameters.items())
    vehicle.history.window(5.0, vehicle.history.names[:5])


def fuzz(messages: int, seed: int, *, per_step: int = 20, samples: int = 20) -> Findings:
    """Send so many bad messages to a station.

    Parameters
    ----------
    messages, seed : int
    per_step : int
        Messages in 10 ms.
    samples : int
        How often the memory is looked at.
    """
    found = Findings()
    ground = GroundLink(US, on_fault=found.faults.append)
    honest = Honest()
    hostile = Hostile(
        seed,
        AIMED_AT_STATION,
        parameters=[f"P_{k}" for k in range(300)],
        targets=(US, (0, 0), (254, 1)),
        senders=(*[(k, 1) for k in range(2, 6)], (7, 100), (1, 1), (250, 1)),
    )
    packets = hostile.packets()
    peers = [Peer("udpin:127.0.0.1:14550", f"127.0.0.1:{40001 + k}") for k in range(4)]
    requests: list[Any] = []
    now_s = next_sample = due = asked_s = 0.0
    turn = 0
    while found.messages < messages and len(found.faults) < 20:
        if found.messages >= next_sample:
            found.rss_MB.append((found.messages, rss_MB()))
            next_sample += max(1, messages // samples)
        due += per_step
        while due > 0:
            packet = next(packets)
            due -= packet.messages
            found.messages += packet.messages
            found.bytes_in += len(packet.data)
            ground.receive(now_s, peers[found.messages % len(peers)], packet.data)
        ground.receive(now_s, HONEST, honest.say(now_s))
        for out in ground.step(now_s, [HONEST]):
            found.bytes_out += len(out.data)
        now_s += STEP_S
        if now_s - asked_s >= ASK_S:
            asked_s = now_s
            turn += 1
            for vehicle in ground.vehicles:
                look(vehicle)
                todo = asks(vehicle)
                requests.append(todo[turn % len(todo)]())
                found.requests += 1
            known = [v for v in ground.vehicles if (v.system, v.color) == (1, 0)]
            if known and now_s > 5.0:
                found.honest_off = max(
                    found.honest_off, math.dist(known[0].snapshot.estimate.position, honest.position)
                )
            requests = [r for r in requests if not r.done][-500:]
    for _ in range(
        round(SILENCE_S / 0.05)
    ):  # everything that is open has to come to an end, one after the other
        ground.step(now_s, [HONEST])
        now_s += 0.05
    found.rss_MB.append((found.messages, rss_MB()))
    found.seconds, found.vehicles = now_s, len(ground.vehicles)
    found.open_requests = sum(not r.done for r in requests)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description="Bad messages to a station.")
    parser.add_argument("--messages", type=int, default=1_000_000, help="how many")
    parser.add_argument("--seed", type=int, default=0, help="another seed, other messages")
    options = parser.parse_args()
    start = time.perf_counter()
    found = fuzz(options.messages, options.seed)
    print(
        f"{found.messages} messages, {found.seconds:.0f} s simulated, {time.perf_counter() - start:.0f} s on the wall"
    )
    print(f"  faults              {len(found.faults)}")
    for fault in found.faults[:20]:
        print(f"    {fault}")
    print(f"  vehicles            {found.vehicles} known at the end")
    print(f"  requests            {found.requests} asked, {found.open_requests} never answered nor given up")
    print(f"  honest vehicle      {1e3 * found.honest_off:.2f} mm from where it said to be, at most")
    print(f"  traffic             {found.bytes_in / 1e6:.1f} MB in, {found.bytes_out / 1e6:.1f} MB out")
    print("  (a history of ten minutes takes 19 MB a vehicle as it fills, of 32 vehicles at most)")
    print(f"  memory              {found.rss_MB[0][1]:.1f} MB at first, {found.rss_MB[-1][1]:.1f} MB at the end, "
          f"{growth_MB(found.rss_MB):+.2f} MB in the second half")  # fmt: skip
    sys.exit(1 if found.faults or found.open_requests else 0)


if __name__ == "__main__":
    main()
