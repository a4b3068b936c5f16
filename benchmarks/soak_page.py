"""An hour at the page: python benchmarks/soak_page.py [--minutes 60]

The simulated helicopter behind its link, `mufly station`, and headless Chromium with the page open, all in real time.
The helicopter flies the demonstration again and again until its battery is low, and stands then; the link goes on at
100 Hz. Every two minutes: frames that the page drew, its JavaScript heap after a collection, and memory and share of a
core of both processes. All have to stay where they are once the history (ten minutes) is full.
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
import time

from bench_page import FLAGS, free_port, used

COMMAND = "from mufly.cli import main; main()"
EVERY_S = 120.0
COUNT = "() => { window.n = 0; window.muflyLive.panel({}, (f) => { if (f.s && !f.repeated) window.n += 1; }); }"


def start(*words: str) -> subprocess.Popen[bytes]:
    """Start a command of mufly."""
    quiet = subprocess.DEVNULL
    return subprocess.Popen([sys.executable, "-c", COMMAND, *words], stdout=quiet, stderr=quiet)


def watch(port: int, processes: list[subprocess.Popen[bytes]], minutes: float) -> None:
    """Open the page, keep it flying, and print how everybody is."""
    from playwright.sync_api import Error, sync_playwright

    with sync_playwright() as play:
        chromium = shutil.which("chromium") or shutil.which("google-chrome")
        browser = play.chromium.launch(executable_path=chromium, args=[*FLAGS, "--enable-precise-memory-info"])
        page = browser.new_page(viewport={"width": 1100, "height": 700})
        complaints: list[str] = []
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.goto(f"http://127.0.0.1:{port}")
        page.wait_for_timeout(5000)
        page.evaluate(COUNT)
        tools = page.context.new_cdp_session(page)
        print("  min  frames/s  heap MB   station MB, % of a core   vehicle MB, % of a core   errors")
        began = last_s = time.monotonic()
        frames, spent = 0, [used(p.pid)[0] for p in processes]
        while time.monotonic() - began < 60.0 * minutes:
            fly = page.get_by_text("Start mission", exact=True)
            with contextlib.suppress(Error):  # it may be taken away between the question and the press
                if fly.count() and fly.first.is_enabled():
                    fly.first.click(timeout=2000)
            page.wait_for_timeout(15_000)
            now = time.monotonic()
            if now - last_s < EVERY_S:
                continue
            tools.send("HeapProfiler.collectGarbage")
            drawn, heap = page.evaluate("[window.n, performance.memory.usedJSHeapSize / 1e6]")
            (a, mine), (b, theirs) = (used(p.pid) for p in processes)
            shares = [100.0 * (x - y) / (now - last_s) for x, y in zip((a, b), spent, strict=True)]
            print(
                f"{(now - began) / 60:5.1f}  {(drawn - frames) / (now - last_s):8.2f}  {heap:7.2f}   "
                f"{mine:10.1f}  {shares[0]:11.1f}   {theirs:10.1f}  {shares[1]:11.1f}   {len(complaints)}",
                flush=True,
            )
            frames, spent, last_s = drawn, [a, b], now
        browser.close()


def main() -> None:
    """Start both processes and watch them."""
    words = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    words.add_argument("--minutes", type=float, default=60.0, help="how long (min)")
    minutes = words.parse_args().minutes
    mavlink, port = free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_STREAM)
    with tempfile.TemporaryDirectory() as folder:
        link = f"udp:127.0.0.1:{mavlink}"
        processes = [
            start("station", "--no-browser", "--port", str(port), "--connect", link,
                  "--mission", "demonstration", "--out", folder),
            start("link", "demonstration", "--link", link, "--out", os.path.join(folder, "vehicle")),
        ]  # fmt: skip
        try:
            while socket.socket().connect_ex(("127.0.0.1", port)):
                time.sleep(0.3)
            watch(port, processes, minutes)
        finally:
            for process in processes:
                process.send_signal(signal.SIGINT)
            for process in processes:
                process.wait(30)


if __name__ == "__main__":
    main()
