"""MAVProxy, headless, its commands piped in: lists waypoints and parameters, arms, takes off, lands.

    python tests/interop/fly_mavproxy.py mavproxy.py 14550

MAVProxy is a program of its own in an environment of its own; nothing of it is imported here.
"""

from __future__ import annotations

import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable


class MavProxy:
    """A running MAVProxy: say something, read until it answers."""

    def __init__(self, program: str, port: int) -> None:
        self._process = subprocess.Popen(
            [program, f"--master=udpin:127.0.0.1:{port}", "--no-state", "--nowait"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )
        self._text = ""
        self._news = threading.Condition()
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        while data := self._process.stdout.read1(4096):  # type: ignore[union-attr]
            text = data.decode(errors="replace")
            print(text, end="", flush=True)
            with self._news:
                self._text += text
                self._news.notify_all()

    def say(self, line: str) -> int:
        """Type a line; return where its answer begins."""
        assert self._process.stdin is not None
        at = len(self._text)
        self._process.stdin.write(line.encode() + b"\n")
        self._process.stdin.flush()
        return at

    def expect(self, pattern: str, seconds: float, since: int = 0) -> re.Match[str] | None:
        """Wait until it prints something."""
        end_s = time.monotonic() + seconds
        with self._news:
            while True:
                found = re.search(pattern, self._text[since:])
                if found is not None or time.monotonic() > end_s:
                    return found
                self._news.wait(0.2)

    def until(
        self, line: str, pattern: str, seconds: float, that: Callable[[re.Match[str]], bool] | None = None
    ) -> str:
        """Type a line, again every second, until the answer is right."""
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            asked_s = time.monotonic()
            found = self.expect(pattern, 5.0, self.say(line))
            if found is not None and (that is None or that(found)):
                return found.group()
            time.sleep(max(0.0, asked_s + 1.0 - time.monotonic()))
        raise SystemExit(f"\nMAVProxy: {line!r} was never answered by {pattern!r}")

    def end(self) -> None:
        """As Ctrl-D does."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.terminate()
        self._process.wait(20)


def main(program: str, port: int) -> None:
    proxy = MavProxy(program, port)
    try:
        if proxy.expect(r"Detected vehicle 1:1", 120.0) is None:
            raise SystemExit("no vehicle")
        if (found := proxy.expect(r"Received (\d+) parameters", 60.0)) is None:
            raise SystemExit("no parameters")
        print(f"\n== {found.group(1)} parameters", flush=True)
        proxy.until("param show MIS_TAKEOFF_ALT", r"MIS_TAKEOFF_ALT\s+[\d.]+", 20.0)
        # take-off, four waypoints, landing
        proxy.until("wp list", r"Requesting 6 waypoints[^\0]*\n22 1 [^\0]*(\n16 1 [^\n]*){4}\n21 1 ", 20.0)
        proxy.until("wp status", r"Have 6 of 6", 20.0)
        print("\n== waypoints listed", flush=True)

        proxy.until("arm throttle", r"(?<!DIS)ARMED", 30.0)
        print("\n== armed", flush=True)
        at = proxy.say("takeoff 0.8")
        if proxy.expect(r"Got COMMAND_ACK: NAV_TAKEOFF: ACCEPTED", 20.0, at) is None:
            raise SystemExit("take-off was not accepted")
        height = r"LOCAL_POSITION_NED.*\bz : (-?[\d.]+)"
        proxy.until("status LOCAL_POSITION_NED", height, 40.0, lambda m: abs(float(m[1]) + 0.8) < 0.04)
        print("\n== in the air", flush=True)
        at = proxy.say("land")
        if proxy.expect(r"Got COMMAND_ACK: DO_LAND_START: ACCEPTED", 20.0, at) is None:
            raise SystemExit("landing was not accepted")
        if proxy.expect(r"DISARMED", 60.0, at) is None:
            raise SystemExit("it never disarmed")
        print("\n== landed and disarmed", flush=True)
    finally:
        proxy.end()


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
