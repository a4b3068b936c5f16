"""What a station costs: processor time at 100 Hz, of the station and of the vehicle's process, and memory over hours.

    python benchmarks/bench_station.py [--seconds 20] [--minutes 30] [--no-record]

First a simulated helicopter in a process of its own, hovering, and a station without a page in this one, over a UDP
port on the loopback address, in real time: processor time over wall time, of one core. Then a station alone on a
clock that is stepped, with the same messages at the same rates, both recordings written: resident memory every sixth
of the way. The history of a vehicle is allocated when the vehicle is found, so memory must not grow after that.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import socket
import statistics
import tempfile
import time
from pathlib import Path

from mufly.link import FrameEncoder, mavlink, parse_endpoint, start_vehicle_process
from mufly.mission import Mission
from mufly.station import GroundLink, GroundStation, StationRecorder

TARGET = 0.40
TICKS_S = os.sysconf("SC_CLK_TCK")


def processor_s(pid: int) -> float:
    """Processor time that a process has used so far (s), from Linux's /proc."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS_S


def resident_mb() -> float:
    """Resident memory of this process (MB)."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.bind(("127.0.0.1", 0))
        return int(line.getsockname()[1])


async def in_real_time(seconds: float, record: bool, folder: Path) -> None:
    port = free_port()
    station = GroundStation([f"udp:127.0.0.1:{port}"], folder=folder, record=record)
    await station.start()
    endpoint = parse_endpoint(f"udp:127.0.0.1:{port}", "vehicle")
    with start_vehicle_process("mufly-1.1", Mission(), endpoints=[endpoint], path=folder / "flight.mcap") as process:
        await asyncio.to_thread(process.wait_until_ready)
        while not (station.vehicles and station.vehicles[0].parameters and station.vehicles[0].snapshot.connected):
            await asyncio.sleep(0.1)
        vehicle = station.vehicles[0]
        request = vehicle.take_off(1.0)
        while not request.is_done:
            await asyncio.sleep(0.1)
        print(f"take-off: {request.outcome} {request.answer}")
        await asyncio.sleep(8.0)
        assert process.pid is not None
        wall, own, theirs = time.perf_counter(), time.process_time(), processor_s(process.pid)
        rates, rows = [], vehicle.history.newest_s
        while time.perf_counter() - wall < seconds:
            await asyncio.sleep(0.5)
            rates.append(vehicle.snapshot.link_rate_Hz)
            vehicle.preflight_checks  # noqa: B018
        wall = time.perf_counter() - wall
        own, theirs = time.process_time() - own, processor_s(process.pid) - theirs
        times, _ = vehicle.history.rows_since(rows)
        print(f"messages heard           {statistics.median(rates):8.0f} 1/s, state {vehicle.snapshot.state}")
        print(f"rows of history          {len(times) / wall:8.1f} 1/s")
        print(f"packets lost             {100 * vehicle.snapshot.link_loss:8.1f} %")
        print(f"station, no page         {100 * own / wall:8.1f} % of one core")
        print(f"vehicle and its link     {100 * theirs / wall:8.1f} % of one core (simulation included)")
        print(
            f"both                     {100 * (own + theirs) / wall:8.1f} %, target {100 * TARGET:.0f} % with the page"
        )
        vehicle.land()
        await asyncio.sleep(0.5)
    await station.stop()


def messages(k: int) -> list[mavlink.MAVLink_message]:
    """What a mufly vehicle sends at step k of 10 ms."""
    ms, x = 10 * k, 1e-3 * (k % 1000)
    out = [
        mavlink.MAVLink_attitude_message(ms, x, -x, x, x, x, x),
        mavlink.MAVLink_local_position_ned_message(ms, x, x, -1 - x, x, x, x),
        mavlink.MAVLink_position_target_local_ned_message(ms, 1, 0x9C0, x, x, -1, x, x, x, 0, 0, 0, x, 0),
        mavlink.MAVLink_attitude_target_message(ms, 0x47, [1.0, x, 0.0, 0.0], 0, 0, 0, 0),
        mavlink.MAVLink_actuator_output_status_message(1000 * ms, 4, [0.7, 0.7, x, -x] + [0.0] * 28),
    ]
    if k % 2 == 0:
        out += [mavlink.MAVLink_raw_rpm_message(j, 3600.0 + x) for j in (0, 1)]
        out.append(mavlink.MAVLink_vision_position_estimate_message(1000 * ms, x, x, -1, x, -x, x))
        out.append(mavlink.MAVLink_debug_float_array_message(1000 * ms, b"truth", 0, [x] * 17 + [0.0] * 41))
    if k % 4 == 0:
        ring = [100 + k % 200] * 8 + [65535] * 64
        out.append(mavlink.MAVLink_obstacle_distance_message(1000 * ms, 0, ring, 45, 5, 300, 45.0, 22.5, 12))
    if k % 50 == 0:
        out.append(mavlink.MAVLink_sys_status_message(0, 0, 0, 0, 7400, 300, 80, 0, 0, 0, 0, 0, 0))
        out.append(mavlink.MAVLink_mission_current_message(0))
    if k % 100 == 0:
        out.append(mavlink.MAVLink_heartbeat_message(3, 12, 1, 4 << 16 | 3 << 24, 4, 3))
        out.append(mavlink.MAVLink_statustext_message(6, b"message %d" % k))
    return out


def stepped(minutes: float, record: bool, folder: Path) -> None:
    clock_s = [0.0]
    recorder = StationRecorder(folder / "stepped", wall_s=lambda: 1.9e9 + clock_s[0])
    link = GroundLink(on_vehicle=recorder.attach_vehicle, on_packet=recorder.record_packet)
    if record:
        recorder.start_recording()
    encode = FrameEncoder(1, 1)
    steps, heard, spent = round(6000 * minutes), 0, 0.0
    # From the second minute on: by then every buffer has been used once.
    marks = {6000} | {round(6000 + (steps - 6000) * j / 6) for j in range(7)}
    found = []
    for k in range(steps + 1):
        clock_s[0] = 0.01 * k
        packets = [encode(message) for message in messages(k)]
        start = time.perf_counter()
        for packet in packets:
            link.process_bytes(clock_s[0], "vehicle", packet)
        link.take_due_frames(clock_s[0])
        spent += time.perf_counter() - start
        heard += len(packets)
        if k in marks:
            found.append(resident_mb())
            print(
                f"after {k / 6000:5.0f} min: {found[-1]:7.1f} MB resident, history {len(link.vehicles[0].history)} rows"
            )
    recorder.stop_recording()
    print(f"growth per hour          {(found[-1] - found[0]) / max(minutes - 1, 1e-9) * 60:8.2f} MB")
    print(f"a message costs          {1e6 * spent / heard:8.1f} us, recording {'on' if record else 'off'}")
    print(f"so at these rates        {100 * spent / clock_s[0]:8.1f} % of one core, sockets and loop apart")


def main() -> None:
    parser = argparse.ArgumentParser(description="What a station costs.")
    parser.add_argument("--seconds", type=float, default=20.0, help="length of the part in real time")
    parser.add_argument("--minutes", type=float, default=30.0, help="simulated minutes of the part on a stepped clock")
    parser.add_argument("--no-record", action="store_true", help="without recordings")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if options.seconds > 0:
            asyncio.run(in_real_time(options.seconds, not options.no_record, Path(folder)))
        if options.minutes > 1:
            stepped(options.minutes, not options.no_record, Path(folder))


if __name__ == "__main__":
    main()
