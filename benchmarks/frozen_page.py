"""What becomes of a press while the station is out of reach: python benchmarks/frozen_page.py [--seconds 1,10,100]

`mufly station`, a vehicle that notes every command and when it came, and headless Chromium. For each length: the
station's process is stopped; the network between browser and station is cut both ways (as root: the browser gets a
network namespace of its own); the browser is stopped; the link of the vehicle is cut. *Land* is pressed
right after that and all through it, through the page and behind its back. Printed: how long after it the page was grey,
how long after the end it was back, and which commands reached the vehicle later than a second after their press. In
``--load N`` so many processes keep the machine busy.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from bench_page import FLAGS, free_port

from mufly.link import FrameDecoder, FrameEncoder, mavlink

COMMAND = "from mufly.cli import main; main()"
LAND = 21
NAMESPACE, HOST_END, THERE = "mufly-page", "mufly-veth0", "10.231.7"
NOTE_GREY = """
window.notes = [];
let before = false;
new MutationObserver(() => {
  const grey = document.body.classList.contains("mf-offline");
  if (grey !== before) window.notes.push([Date.now(), (before = grey)]);
})
  .observe(document.body, { attributes: true, attributeFilter: ["class"] });
"""
BEHIND = "() => Object.getPrototypeOf(window.socket).emit.call(window.socket, 'event', window.kept)"
"""The press of *Land* as it was sent once, sent again past the page's own watchdog."""
KEEP = """
() => {
  const packet = window.socket.packet.bind(window.socket);
  window.socket.packet = (one) => {
    if (one.data?.[0] === "event" && !window.kept) window.kept = structuredClone(one.data[1]);
    return packet(one);
  };
}
"""


class Vehicle(threading.Thread):
    """A vehicle in flight that notes the commands it hears; while it is ``deaf`` its link is cut."""

    def __init__(self, port: int) -> None:
        super().__init__(daemon=True)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setblocking(False)
        self.there = ("127.0.0.1", port)
        self.encode, self.codec = FrameEncoder(1, 1), FrameDecoder()
        self.heard: list[tuple[float, int]] = []
        self.deaf = self.ended = False

    def run(self) -> None:
        """Speak fifty times a second."""
        began = time.monotonic()
        while not self.ended:
            time.sleep(0.02)
            if self.deaf:  # its link is cut: what is sent to it is lost
                with contextlib.suppress(BlockingIOError):
                    while self.socket.recv(65536):
                        pass
                continue
            now = time.monotonic()
            ms = round(1e3 * (now - began))
            said = [
                mavlink.MAVLink_heartbeat_message(3, 12, 209, 4 << 16 | 3 << 24, 4, 3),
                mavlink.MAVLink_extended_sys_state_message(0, 2),
                mavlink.MAVLink_local_position_ned_message(ms, 0.1, 0.2, -1.0, 0.0, 0.0, 0.0),
                mavlink.MAVLink_attitude_message(ms, 0.01, 0.02, 0.3, 0.0, 0.0, 0.0),
            ]
            for message in said:
                self.socket.sendto(self.encode(message), self.there)
            with contextlib.suppress(BlockingIOError):
                while True:
                    data = self.socket.recv(65536)
                    for message in self.codec.decode_bytes(now, "station", data):
                        self._take(now, message)

    def _take(self, now: float, message: Any) -> None:
        if message.get_type() in ("COMMAND_LONG", "COMMAND_INT"):
            if message.command not in (511, 512):
                self.heard.append((now, message.command))
            there = message.get_srcSystem(), message.get_srcComponent()
            ack = mavlink.MAVLink_command_ack_message(message.command, 0, 0, 0, *there)
            self.socket.sendto(self.encode(ack), self.there)


@contextlib.contextmanager
def own_network() -> Iterator[str]:
    """Give the browser a network of its own; the address of the station in it."""
    call = subprocess.run
    ways = [
        ["ip", "netns", "add", NAMESPACE],
        ["ip", "link", "add", HOST_END, "type", "veth", "peer", "name", "eth0", "netns", NAMESPACE],
        ["ip", "addr", "add", f"{THERE}.1/24", "dev", HOST_END],
        ["ip", "link", "set", HOST_END, "up"],
        ["ip", "-n", NAMESPACE, "addr", "add", f"{THERE}.2/24", "dev", "eth0"],
        ["ip", "-n", NAMESPACE, "link", "set", "eth0", "up"],
        ["ip", "-n", NAMESPACE, "link", "set", "lo", "up"],
    ]
    try:
        for words in ways:
            call(words, check=True, capture_output=True)
        yield f"{THERE}.1"
    finally:
        call(["ip", "netns", "del", NAMESPACE], capture_output=True)
        call(["ip", "link", "del", HOST_END], capture_output=True)


def cut_network(yes: bool) -> None:
    """Take the cable between browser and station away, or put it back; no connection is told."""
    subprocess.run(["ip", "link", "set", HOST_END, "down" if yes else "up"], check=True)


def family(pid: int) -> list[int]:
    """A process and its descendants."""
    out = [pid]
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in task.read_text().split():
            out += family(int(child))
    return out


def try_case(name: str, begin: Callable[[], None], end: Callable[[], None], seconds: float, page: Any, vehicle: Vehicle,
             blind: bool = False) -> bool:  # fmt: skip
    """Cut, press, restore, and print what came of it; whether nothing was carried out late."""
    page.evaluate("window.notes.length = 0")
    vehicle.heard.clear()
    began, wall = time.monotonic(), time.time()
    begin()
    presses: list[float] = []
    try:
        if not blind:
            while time.monotonic() - began < seconds:
                presses.append(time.monotonic())
                for _ in range(2):  # it asks for a second press
                    page.keyboard.press("Shift+L")
                page.evaluate("document.querySelector('[data-testid=land]').click()")
                page.evaluate(BEHIND)
                time.sleep(min(0.4, seconds / 4))
        time.sleep(max(0.0, seconds - (time.monotonic() - began)))
        kept = page.evaluate("Boolean(window.kept)") if not blind else True
        assert kept, "no press was kept to be sent again"
        if seconds >= 2 and not blind and "SHOT" in os.environ:
            page.screenshot(path=os.environ["SHOT"])
    finally:
        end()
    ended = time.monotonic()
    ended_wall = time.time()
    while page.evaluate("document.body.classList.contains('mf-offline')") and time.monotonic() - ended < 60:
        time.sleep(0.05)
    time.sleep(3.0)
    notes = page.evaluate("window.notes")
    grey = next((at / 1e3 - wall for at, yes in notes if yes), None)
    back = [at / 1e3 - ended_wall for at, yes in notes if not yes]
    late = []
    for at, number in vehicle.heard:
        before = [p for p in presses if p <= at]
        if number == LAND and (not before or at - before[-1] > 1.0 or at > ended):
            late.append(round(at - began, 2))
    words = "never" if grey is None else f"{grey:5.2f} s"
    print(f"{name:34s} {seconds:5.0f} s   grey after {words}   back after {back[-1] if back else 0.0:5.2f} s   "
          f"presses {3 * len(presses):4d}   carried out late: {late or 'none'}", flush=True)  # fmt: skip
    return not late


def main() -> None:
    """Start everything, and try the cases."""
    words = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    words.add_argument("--seconds", default="1,10,100", help="lengths (s)")
    words.add_argument("--load", type=int, default=0, help="processes that keep the machine busy")
    options = words.parse_args()
    lengths = [float(s) for s in options.seconds.split(",")]
    from playwright.sync_api import sync_playwright

    link, port = free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_STREAM)
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(options.load)]
    vehicle = Vehicle(link)
    good = True
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        for process in busy:
            stack.callback(process.kill)
        chromium = shutil.which("chromium") or shutil.which("google-chrome") or "chromium"
        host, args = "127.0.0.1", []
        if os.geteuid() == 0 and shutil.which("ip"):
            host = stack.enter_context(own_network())
            starter = Path(folder) / "browser"
            starter.write_text(f'#!/bin/sh\nexec ip netns exec {NAMESPACE} {chromium} "$@"\n')
            starter.chmod(0o755)
            chromium, args = str(starter), ["--host", host, "--token", "a-token-for-this"]
        station = subprocess.Popen(
            [sys.executable, "-c", COMMAND, "station", "--no-browser", "--port", str(port),
             "--connect", f"udp:127.0.0.1:{link}", "--out", folder, "--no-record", *args],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        stack.callback(station.kill)
        vehicle.start()
        while socket.socket().connect_ex((host, port)):
            time.sleep(0.3)
        with sync_playwright() as play:
            browser = play.chromium.launch(executable_path=chromium, args=[*FLAGS, "--disable-gpu-compositing"])
            page = browser.new_page(viewport={"width": 1366, "height": 768})
            page.set_default_timeout(300_000)
            page.goto(f"http://{host}:{port}/" + ("?token=a-token-for-this" if args else ""))
            page.wait_for_selector("[data-testid=land]:enabled")
            page.evaluate(NOTE_GREY)
            page.evaluate("window.loaded_once = true")
            time.sleep(2.0)
            page.evaluate(KEEP)
            for _ in range(2):  # one that is obeyed; it is kept to be sent again
                page.keyboard.press("Shift+L")
                time.sleep(0.5)
            time.sleep(1.0)
            print(f"in contact: {len([1 for _, n in vehicle.heard if n == LAND])} Land reached the vehicle; load "
                  f"{os.getloadavg()[0]:.1f}")  # fmt: skip
            roots = [p for p in family(os.getpid()) if "chrom" in Path(f"/proc/{p}/comm").read_text()]

            def stop(which: Callable[[], list[int]], sign: int) -> Callable[[], None]:
                return lambda: [os.kill(p, sign) for p in which()] and None

            for seconds in lengths:
                both = [signal.SIGSTOP, signal.SIGCONT]
                good &= try_case("station's process stopped", *(stop(lambda: [station.pid], s) for s in both),
                                 seconds, page, vehicle)  # fmt: skip
                if args:
                    good &= try_case("network cut", lambda: cut_network(True), lambda: cut_network(False),
                                     seconds, page, vehicle)  # fmt: skip
                good &= try_case("browser stopped", *(stop(lambda: roots, s) for s in both), seconds, page, vehicle,
                                 blind=True)  # fmt: skip

                def deafen(yes: bool) -> Callable[[], None]:
                    return lambda: setattr(vehicle, "deaf", yes)

                good &= try_case("link of the vehicle cut", deafen(True), deafen(False), seconds, page, vehicle)
            print("the page was loaded anew" if not page.evaluate("window.loaded_once") else "never loaded anew")
            browser.close()
        vehicle.ended = True
        station.send_signal(signal.SIGINT)
        station.wait(30)
    sys.exit(0 if good else 1)


if __name__ == "__main__":
    main()
