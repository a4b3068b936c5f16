"""Bad messages to a station: from vehicles that lie, beside one honest vehicle.

:func:`fuzz` sends many system numbers, floods of parameters and texts, missions of 65535 items, messages with extreme
fields, damaged frames and noise (:mod:`hostile_traffic`). Meanwhile the station sends all requests of its page to each
vehicle. No error may be raised, memory and traffic stay bounded, and the honest vehicle is seen as it is. Time is
simulated.

:func:`watch_page` does the same to `mufly station` with its page in headless Chromium, in real time. Half of the
messages come from the vehicle that the page shows. All tabs of the page are opened in turn. Printed: the longest time
for which the browser's main thread was blocked, whether the emergency stop was reachable throughout, and whether it
still works. `tests/station/test_fuzz.py` runs both.
"""

from __future__ import annotations

import contextlib
import math
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fuzz_link import growth_MB, rss_MB
from hostile_traffic import _FLOATS, AIMED_AT_STATION, Hostile

from mufly.link import FrameEncoder, Peer, mavlink
from mufly.station import GroundLink, RemoteVehicle

US = (255, 190)
HONEST = Peer("udpin:127.0.0.1:14550", "127.0.0.1:40000")
STEP_S = 0.01
ASK_S = 2.0
SILENCE_S = 300.0
SHOWN = (
    "HEARTBEAT", "ATTITUDE", "ATTITUDE_QUATERNION", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "ATTITUDE_TARGET",
    "POSITION_TARGET_LOCAL_NED", "HOME_POSITION", "ACTUATOR_OUTPUT_STATUS", "RAW_RPM", "OBSTACLE_DISTANCE",
    "BATTERY_STATUS", "SYS_STATUS", "VFR_HUD", "ESTIMATOR_STATUS", "EXTENDED_SYS_STATE",
)  # fmt: skip
"""Messages whose numbers a page draws."""
TEXTS = (
    b"", b"\0", b"x" * 256, b"<img src=x onerror=alert(1)>", b"</script><script>alert(1)</script>",
    b"{{7*7}} ${7*7} %s%n", b"\xff\xfe\xfd", b"../../etc/passwd", b"\r\n\t\x1b[31m", "\u202e\u05d0\u05d1".encode(),
    "\U0001f681".encode() * 60, "e\u0301".encode() + "\u0301".encode() * 120, b"NaN", b"-1e400", b"__proto__",
)  # fmt: skip
WATCH = """
() => {
  const watch = (window.watch = { shown: 0, covered: 0, grey: 0, frame: 0, timer: 0, task: 0, lost: [] });
  const stop = () => document.querySelector("[data-testid=emergency-stop]");
  let drawn = performance.now(), called = drawn;
  const look = () => {
    const now = performance.now();
    watch.frame = Math.max(watch.frame, now - drawn);
    drawn = now;
    const button = stop(), b = button?.getBoundingClientRect();
    const there = b && button.contains(document.elementFromPoint(b.x + b.width / 2, b.y + b.height / 2));
    watch.shown += 1;
    if (document.body.classList.contains("mf-offline")) watch.grey += 1;
    else if (!there) {
      watch.covered += 1;
      const top = b && document.elementFromPoint(b.x + b.width / 2, b.y + b.height / 2);
      if (watch.lost.length < 5) watch.lost.push(top ? `${top.tagName}.${top.className}` : "no button");
    }
    requestAnimationFrame(look);
  };
  requestAnimationFrame(look);
  setInterval(() => {
    const now = performance.now();
    watch.timer = Math.max(watch.timer, now - called);
    called = now;
  }, 20);
  new PerformanceObserver((list) => {
    for (const one of list.getEntries()) watch.task = Math.max(watch.task, one.duration);
  }).observe({ type: "longtask" });
}
"""
"""Keeps the longest times between two pictures, between two calls of a timer of 20 ms, and of one task (ms)."""
OPEN_TAB = "k => { const t = document.querySelectorAll('[role=tab]'); t[k % t.length]?.click(); }"


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
        self._encode = FrameEncoder(1, 1)
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
        vehicle.request_operator_control, vehicle.release_operator_control, vehicle.download_mission,
        vehicle.clear_mission,
        vehicle.refresh_parameters, lambda: vehicle.upload_mission("demonstration"),
        lambda: vehicle.set_parameter(next(iter(vehicle.parameters), "LIM_SPEED"), 0.5), lambda: vehicle.add_mark("x"),
    ]  # fmt: skip


def look(vehicle: RemoteVehicle) -> None:
    """Read everything that a page shows."""
    _ = (
        vehicle.display_name,
        vehicle.kind,
        vehicle.firmware_kind,
        vehicle.is_connected,
        vehicle.has_operator_control,
        vehicle.commander_text,
    )
    _ = (
        vehicle.snapshot,
        vehicle.mission_rows,
        vehicle.passed_row_count,
        vehicle.missing_parameter_count,
        vehicle.preflight_checks,
    )
    _ = [str(m) for m in vehicle.status_messages], list(vehicle.parameters.items())
    vehicle.history.recent_rows(5.0, vehicle.history.names[:5])


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
            ground.process_bytes(now_s, peers[found.messages % len(peers)], packet.data)
        ground.process_bytes(now_s, HONEST, honest.say(now_s))
        for out in ground.take_due_frames(now_s, [HONEST]):
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
            requests = [r for r in requests if not r.is_done][-500:]
    for _ in range(round(SILENCE_S / 0.05)):  # everything that is open has to come to an end, one after the other
        ground.take_due_frames(now_s, [HONEST])
        now_s += 0.05
    found.rss_MB.append((found.messages, rss_MB()))
    found.seconds, found.vehicles = now_s, len(ground.vehicles)
    found.open_requests = sum(not r.is_done for r in requests)
    return found


def udp_drops(port: int) -> int:
    """Return how many packets to a local port the kernel has dropped, as nobody read them in time."""
    lines = [line.split() for line in Path("/proc/net/udp").read_text().splitlines()[1:]]
    return sum(int(words[-1]) for words in lines if int(words[1].rpartition(":")[2], 16) == port)


def pour(messages: int, seed: int, rate: float, port: int, shown: socket.socket) -> int:
    """Send so many bad messages a second to a port, half of them from the vehicle that is shown; how many were sent."""
    floats = (*_FLOATS, -1e30, 1e-30, -1e-30, 1e15, -1e15)
    common: dict[str, Any] = {"targets": (US, (0, 0)), "floats": floats, "texts": TEXTS}
    common["parameters"] = [f"P_{k}" for k in range(300)]
    aimed = (*AIMED_AT_STATION, *SHOWN, *SHOWN)
    liar = Hostile(seed, aimed, senders=((1, 1),), **common).packets()
    others = (*[(k, 1) for k in range(2, 6)], (7, 100), (1, 1), (250, 1))
    beside = Hostile(seed + 1, AIMED_AT_STATION, senders=others, **common).packets()
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(4)]
    sent, began, draw = 0, time.monotonic(), random.Random(seed)
    while sent < messages:
        shows = draw.random() < 0.5
        packet = next(liar if shows else beside)
        with contextlib.suppress(BlockingIOError, OSError):
            (shown if shows else draw.choice(sockets)).sendto(packet.data, ("127.0.0.1", port))
        sent += packet.messages
        time.sleep(max(0.0, began + sent / rate - time.monotonic()))
    for one in sockets:
        one.close()
    return sent


def watch_page(messages: int, seed: int, rate: float, calm_s: float = 10.0) -> bool:
    """Send bad messages to a station with a page and print what the browser bore; whether it bore all.

    Parameters
    ----------
    messages, seed : int
    rate : float
        Messages a second.
    calm_s : float
        So long the page is looked at before, with the honest vehicle only (s).
    """
    from frozen_page import COMMAND, FLAGS, Vehicle, free_port
    from playwright.sync_api import sync_playwright

    link, port = free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_STREAM)
    vehicle = Vehicle(link)
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        station = subprocess.Popen(
            [sys.executable, "-c", COMMAND, "station", "--no-browser", "--port", str(port),
             "--connect", f"udp:127.0.0.1:{link}", "--out", folder, "--no-record"],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        stack.callback(station.kill)
        vehicle.start()
        while socket.socket().connect_ex(("127.0.0.1", port)):
            time.sleep(0.3)
        play = stack.enter_context(sync_playwright())
        chromium = shutil.which("chromium") or shutil.which("google-chrome")
        browser = play.chromium.launch(executable_path=chromium, args=[*FLAGS, "--disable-gpu-compositing"])
        page = browser.new_page(viewport={"width": 1366, "height": 768})
        page.set_default_timeout(300_000)
        faults: list[str] = []
        page.on("pageerror", lambda e: faults.append(str(e)))
        page.goto(f"http://127.0.0.1:{port}/")
        page.wait_for_selector("[data-testid=land]:enabled")
        page.wait_for_function("Boolean(window.muflyScene)")

        def look(what: str, busy: Callable[[], bool]) -> dict[str, Any]:
            page.evaluate(WATCH)
            tab, began = 0, time.monotonic()
            while busy():
                page.evaluate(OPEN_TAB, tab)
                tab += 1
                page.wait_for_timeout(1000)
            seen: dict[str, Any] = page.evaluate("window.watch")
            print(f"{what:12s} {time.monotonic() - began:4.0f} s, load {os.getloadavg()[0]:4.1f}: longest time between "
                  f"two pictures {seen['frame']:.0f} ms, between calls of a timer {seen['timer']:.0f} ms, longest task "
                  f"{seen['task']:.0f} ms; stop button covered in {seen['covered']} of {seen['shown']} pictures, "
                  f"page grey in {seen['grey']} {seen['lost'] or ''}", flush=True)  # fmt: skip
            return seen

        end = time.monotonic() + calm_s
        look("honest only", lambda: time.monotonic() < end)
        page.reload()
        page.wait_for_function("Boolean(window.muflyScene && window.muflyLive?.latest)")
        time.sleep(2.0)
        sent: list[int] = []
        sender = threading.Thread(
            target=lambda: sent.append(pour(messages, seed, rate, link, vehicle.socket)), daemon=True
        )
        sender.start()
        seen = look("hostile", sender.is_alive)
        print(f"{sum(sent)} messages, {udp_drops(link)} packets never read; errors of the page: {faults[:5] or 'none'}")
        vehicle.heard.clear()
        end = time.monotonic() + 20.0
        while not vehicle.heard and time.monotonic() < end:
            for _ in range(2):  # it asks for a second press
                page.click("[data-testid=emergency-stop]")
                time.sleep(0.5)
        heard = sorted({number for _, number in vehicle.heard})
        print(f"emergency stop after it: commands {heard or 'none'} heard by the vehicle")
        scripts = page.evaluate("document.querySelectorAll('img[src=x]').length")
        browser.close()
        vehicle.ended = True
        alive = station.poll() is None
        station.send_signal(signal.SIGINT)
        station.wait(30)
    return alive and not seen["covered"] and not scripts and not faults and bool(vehicle.heard)


def report(found: Findings) -> None:
    """Print the findings of a run; ``pytest -s`` shows them."""
    print(f"\n{found.messages} messages, {found.seconds:.0f} s simulated")
    print(f"  vehicles            {found.vehicles} known at the end")
    print(f"  requests            {found.requests} sent, {found.open_requests} neither answered nor given up")
    print(f"  honest vehicle      {1e3 * found.honest_off:.2f} mm between its report and its estimate, at most")
    print(f"  traffic             {found.bytes_in / 1e6:.1f} MB in, {found.bytes_out / 1e6:.1f} MB out")
    print("  (a history of ten minutes takes 19 MB a vehicle as it fills, for 32 vehicles at most)")
    print(f"  memory              {found.rss_MB[0][1]:.1f} MB at first, {found.rss_MB[-1][1]:.1f} MB at the end, "
          f"{growth_MB(found.rss_MB):+.2f} MB in the second half")  # fmt: skip
