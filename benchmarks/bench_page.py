"""What the station's page costs, and how late it is: real processes, a real browser.

Three processes: the simulated helicopter behind its link, `mufly station`, and headless Chromium with the page open.
The helicopter flies the demonstration; the station asks for its motion at 100 Hz, the page is sent 20 frames a second.

Latency is taken from the vehicle's clock to the browser. The stamp of a frame is the vehicle's time of the newest
message in it; the vehicle's clock on the wall is known from its reports (five a second). "received": the
browser has the frame; "drawn": the next picture of the browser after it. CPU shares are of one core, from /proc.

    python benchmarks/bench_page.py --seconds 40

With ``--soak MINUTES`` there is no browser, but two windows that speak the page's protocol: one that draws every frame
and one that never does. What is looked at is the station's memory; it must be flat once the history (ten minutes) is
full.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import multiprocessing
import os
import re
import shutil
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path
from typing import Any

import numpy as np

FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
TICKS = os.sysconf("SC_CLK_TCK")
PROBE = """
() => {
  window.late = { received: [], drawn: [] };
  window.muflyLive.panel({}, (f) => {
    if (!f.s || f.repeated) return;
    const stamp = f.s.time_s, now = () => (performance.timeOrigin + performance.now()) / 1000;
    window.late.received.push([now(), stamp]);
    requestAnimationFrame(() => setTimeout(() => window.late.drawn.push([now(), stamp]), 0));
  });
}
"""


def fly(port: int, pipe: Any) -> None:
    """The vehicle's process: flies its mission; at the end it tells what its clock showed when."""
    from mufly.flight import Flight
    from mufly.link import LoopReport, fly_in_real_time, parse_endpoint

    flight = Flight("mufly-1.1", "demonstration", keep=False)
    clock: list[tuple[float, float]] = []

    def note(report: LoopReport) -> None:
        clock.append((time.time(), report.state.time_s))

    fly_in_real_time(
        flight,
        [parse_endpoint(f"udp:127.0.0.1:{port}", "vehicle")],
        stop=pipe.poll,
        on_report=note,
        autostart=True,
    )
    pipe.send(clock)


def ahead(clock: np.ndarray, wall: float) -> float:
    """By how much the wall's clock is ahead of the vehicle's, between its reports (five a second).

    It changes on a busy machine: a vehicle that was not given the processor is late itself, and may lose time for good.
    """
    return float(np.interp(wall, clock[:, 0], clock[:, 0] - clock[:, 1]))


def free_port(kind: int) -> int:
    """Return a port that nobody uses."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def used(pid: int) -> tuple[float, float]:
    """Return processor time (s) and resident memory (MB) of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS, int(fields[21]) * os.sysconf("SC_PAGE_SIZE") / 1e6


async def soak(port: int, pid: int, minutes: float) -> None:
    """Two windows without a browser, one of which never draws; print the station's memory every minute."""
    import websockets

    got = [0]

    async def window(draws: bool) -> None:
        def ask() -> str:
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/") as answer:
                return str(answer.read().decode())

        found = re.search(r"client_id[^0-9a-f]+([0-9a-f-]{36})", await asyncio.to_thread(ask))
        assert found is not None
        address = f"ws://127.0.0.1:{port}/live/{found[1]}"
        names = [f"{s}_{q}" for s in ("estimated", "measured", "reference") for q in ("position_N", "attitude_yaw")]
        sections = ["scene", "messages", "mission", "checks", "parameters", "catalog"]
        async with websockets.connect(address, max_size=None) as web:
            await web.send(json.dumps({"want": {"sections": sections, "signals": names, "window_s": 30}}))
            while draws:
                await web.send(json.dumps({"drawn": json.loads(await web.recv())["n"]}))
                got[0] += 1
            await asyncio.Event().wait()

    tasks = [asyncio.create_task(window(draws)) for draws in (True, False)]
    for minute in range(round(minutes) + 1):
        cpu, memory = used(pid)
        print(f"{minute:4d} min  {memory:.1f} MB  {cpu:.1f} s of processor time  {got[0]} frames", flush=True)
        done, _ = await asyncio.wait(tasks, timeout=60.0 if minute < round(minutes) else 0.0)
        for task in done:
            task.result()
    for task in tasks:
        task.cancel()


def main() -> None:
    """Run the three processes and print what was measured."""
    from playwright.sync_api import sync_playwright

    words = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    words.add_argument("--seconds", type=float, default=40.0, help="how long to measure (s)")
    words.add_argument("--soak", type=float, metavar="MINUTES", help="look at the memory for so long instead")
    given = words.parse_args()
    seconds = given.seconds
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    mavlink, page_port = free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_STREAM)
    folder = tempfile.mkdtemp()
    station = subprocess.Popen(
        [sys.executable, "-c", "from mufly.cli import main; main()", "station", "--no-browser",
         "--port", str(page_port), "--connect", f"udp:127.0.0.1:{mavlink}", "--mission", "demonstration",
         "--out", folder],
        stderr=subprocess.DEVNULL,
    )  # fmt: skip
    mine, theirs = multiprocessing.Pipe()
    vehicle = multiprocessing.get_context("spawn").Process(target=fly, args=(mavlink, theirs), daemon=True)
    vehicle.start()
    try:
        while socket.socket().connect_ex(("127.0.0.1", page_port)):
            time.sleep(0.2)
        if given.soak is not None:
            asyncio.run(soak(page_port, station.pid, given.soak))
            return
        with sync_playwright() as play:
            browser = play.chromium.launch(executable_path=chromium, args=FLAGS)
            page = browser.new_page(viewport={"width": 1366, "height": 768})
            page.goto(f"http://127.0.0.1:{page_port}/")
            page.wait_for_function("window.muflyLive?.latest?.s?.position[0] != null", timeout=60_000)
            time.sleep(3.0)
            page.evaluate(PROBE)
            at, (cpu, memory), (cpu_v, _) = time.monotonic(), used(station.pid), used(vehicle.pid or 0)
            load = os.getloadavg()[0]
            time.sleep(seconds)
            spent = time.monotonic() - at
            cpu_after, memory_after = used(station.pid)
            cpu_v_after, _ = used(vehicle.pid or 0)
            late = page.evaluate("window.late")
            browser.close()
    finally:
        mine.send("stop")
        station.terminate()
        station.wait(20)
    clock = np.array(mine.recv())
    vehicle.join(10)
    print(f"{spent:.0f} s, {os.cpu_count()} cores, load {load:.1f} (the browser draws in software on the same cores)")
    print(f"frames: {len(late['received']) / spent:.1f} a second")
    for name, pairs in late.items():
        delay = np.array([wall - stamp - ahead(clock, wall) for wall, stamp in pairs]) * 1e3
        print(
            f"latency vehicle to browser, {name}: median {np.median(delay):.0f} ms, "
            f"95 % {np.percentile(delay, 95):.0f} ms, worst {delay.max():.0f} ms"
        )
    print(
        f"station with page: {(cpu_after - cpu) / spent:.1%} of one core; vehicle: {(cpu_v_after - cpu_v) / spent:.1%}"
    )
    print(f"station's memory: {memory:.1f} MB, after {spent:.0f} s {memory_after:.1f} MB")


if __name__ == "__main__":
    main()
