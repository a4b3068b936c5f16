"""What the vehicle's end of the link costs: packing, reading, and the whole vehicle in real time.

    python benchmarks/bench_link.py

The second part starts a vehicle in a process of its own and a station here that asks for 100 Hz, as the page does.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

from mufly.link import Endpoint, FrameDecoder, FrameEncoder, open_port, start_vehicle_process, wait_for_input
from mufly.link import mavlink as m
from mufly.mission import Mission

N = 5000
WATCH_S = 10.0
FAST = {30: 100, 32: 100, 85: 100, 83: 100, 375: 100, 102: 50, 339: 50, 350: 50, 330: 25}
"""Message ids and rates (Hz) that the station asks for."""


def messages() -> None:
    """Time to pack and to read one message of each kind."""
    kinds = {
        "ATTITUDE": lambda k: m.MAVLink_attitude_message(k, 0.1, 0.2, 0.3, 0.1, 0.1, 0.1),
        "OBSTACLE_DISTANCE": lambda k: m.MAVLink_obstacle_distance_message(k, 1, [k % 99] * 72, 0, 5, 400, 45.0),
        "ACTUATOR_OUTPUT_STATUS": lambda k: m.MAVLink_actuator_output_status_message(k, 4, [0.1] * 32),
        "DEBUG_FLOAT_ARRAY": lambda k: m.MAVLink_debug_float_array_message(k, b"truth", 1, [0.1] * 58),
    }
    encode, codec = FrameEncoder(1, 1), FrameDecoder()
    for name, make in kinds.items():
        start = time.perf_counter()
        frames = [encode(make(k)) for k in range(N)]
        packed = time.perf_counter()
        read = sum(len(codec.decode_bytes(k * 0.01, "peer", frame)) for k, frame in enumerate(frames))
        done = time.perf_counter()
        assert read == N
        print(
            f"{name:24s} {len(frames[-1]):4d} bytes   pack {(packed - start) / N * 1e6:5.1f} us   "
            f"read {(done - packed) / N * 1e6:5.1f} us"
        )


def cpu_s(pid: int) -> float:
    """Processor time that a process has used (s)."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def vehicle() -> None:
    """Processor time of the vehicle's process, idle and at 100 Hz in flight."""
    port = open_port(Endpoint("udpin", "127.0.0.1", 14999))
    encode, codec = FrameEncoder(255, 190), FrameDecoder()

    def hear(seconds: float) -> int:
        end, heard = time.monotonic() + seconds, 0
        while time.monotonic() < end:
            wait_for_input([port], 0.02)
            heard += sum(len(codec.decode_bytes(time.monotonic(), *part)) for part in port.receive_bytes())
            if time.monotonic() - said[0] > 1.0:
                said[0] = time.monotonic()
                port.send_frame(None, encode(m.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)))
        return heard

    def command(number: int, *p: float) -> None:
        port.send_frame(None, encode(m.MAVLink_command_long_message(1, 1, number, 0, *p, *[0.0] * (7 - len(p)))))

    said = [0.0]
    with start_vehicle_process(
        "mufly-1.1", Mission(name="none"), endpoints=[Endpoint("udpout", "127.0.0.1", 14999)]
    ) as v:
        v.wait_until_ready()
        hear(1.0)
        for what in ("default rates, on the floor", "100 Hz, in flight"):
            before, pid = 0.0, v.pid or 0
            if what.startswith("100"):
                for number, rate in FAST.items():
                    command(511, number, 1e6 / rate)
                command(400, 1)
                command(22, 0, 0, 0, 0, 0, 0, 1.0)
                hear(9.0)
            before = cpu_s(pid)
            heard = hear(WATCH_S)
            share = (cpu_s(pid) - before) / WATCH_S
            report = v.report
            late = f"late {report.mean_lateness_ms:.2f} ms, worst {report.worst_lateness_ms:.1f} ms" if report else ""
            print(f"{what:30s} {100 * share:4.1f} % of a core, {heard / WATCH_S:5.0f} messages/s, {late}")
        peer = port.reachable_peers[0]
        print(f"lost on loopback: {codec.packet_counts(peer).loss_ratio:.2%}")
    port.close()


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    messages()
    vehicle()
