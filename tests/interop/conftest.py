"""Real programs against the real loop: `mufly link` in a process of its own, in real time, over loopback UDP.

Nothing sleeps to wait for something: scripts wait for conditions, with limits that a loaded machine keeps. The flights
that the selected tests ask for are flown beside each other, so that together they take as long as the longest.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pytest
import xarray as xr
from free_ports import free_port

from mufly.flight import read_recording

ROOT = Path(__file__).resolve().parents[2]
START_S = 180.0  # the first time ever everything is compiled
STOP_S = 30.0


@dataclass
class Linked:
    """A simulated helicopter that sends to ``port``, and the program that flies it."""

    folder: Path
    port: int
    vehicle: subprocess.Popen[bytes]
    client: subprocess.Popen[bytes] | None = None
    said: str = ""
    ended: bool = False
    outcome: list[xr.Dataset] = field(default_factory=list)
    beside: dict[str, Linked] = field(default_factory=dict, repr=False)

    @property
    def vehicle_said(self) -> str:
        return (self.folder / "vehicle.txt").read_text(errors="replace")

    def wait_until_it_flies(self) -> None:
        """Wait until the vehicle has begun to speak."""
        end_s = time.monotonic() + START_S
        while "Ctrl-C ends it" not in self.vehicle_said:
            assert self.vehicle.poll() is None, self.vehicle_said
            assert time.monotonic() < end_s, f"not up in {START_S:g} s\n{self.vehicle_said}"
            time.sleep(0.1)

    def finish(self, seconds: float) -> str:
        """Wait until the client is done; return what it printed. Fails with both sides' words if it fails."""
        assert self.client is not None
        status: int | str | None = None
        end_s = time.monotonic() + seconds
        while (status := self.client.poll()) is None:
            gone = self.vehicle.poll() is not None
            if gone or time.monotonic() > end_s:
                self.client.kill()
                self.client.wait()
                status = "the vehicle has ended" if gone else f"not done in {seconds:g} s"
                break
            for other in self.beside.values():
                other.end_when_flown()
            time.sleep(0.1)
        self.said = (self.folder / "client.txt").read_text(errors="replace")
        assert status == 0, f"client: {status}\n{self.said}\nvehicle:\n{self.vehicle_said}"
        return self.said

    def end_when_flown(self) -> None:
        """End the vehicle as Ctrl-C does, once, when its client is done: it would take time from those that fly."""
        if not self.ended and self.client is not None and self.client.poll() is not None:
            self.ended = True
            if self.vehicle.poll() is None:
                self.vehicle.send_signal(signal.SIGINT)

    def recording(self) -> xr.Dataset:
        """End the vehicle, and read where it really went."""
        if not self.outcome:
            self.end_when_flown()
            self.vehicle.wait(STOP_S)
            files = sorted(self.folder.glob("out/**/*.mcap"))
            assert len(files) == 1, f"{files}\n{self.vehicle_said}"
            self.outcome.append(read_recording(files[0]))
        return self.outcome[0]

    def close(self) -> None:
        for process in (self.client, self.vehicle):
            if process is not None and process.poll() is None:
                process.terminate()
                try:
                    process.wait(STOP_S)
                except subprocess.TimeoutExpired:
                    process.kill()
                    process.wait()


def start_vehicle(folder: Path, *options: str) -> Linked:
    """Start `mufly link` and return at once; it sends its heartbeats to a port of its own."""
    folder.mkdir(parents=True, exist_ok=True)
    port = free_port()
    code = "from mufly.cli import main; main()"
    out = (folder / "vehicle.txt").open("wb")
    vehicle = subprocess.Popen(
        [
            sys.executable,
            "-c",
            code,
            "link",
            "--sensors",
            "ideal",
            "--link",
            f"udp:127.0.0.1:{port}",
            "--out",
            str(folder / "out"),
            *options,
        ],
        stdout=out,
        stderr=subprocess.STDOUT,
        stdin=subprocess.DEVNULL,
        cwd=folder,
        env={**os.environ, "PYTHONUNBUFFERED": "1", "COLUMNS": "120"},
    )
    return Linked(folder, port, vehicle)


def start_client(linked: Linked, command: Sequence[str]) -> None:
    """Start the program that flies it."""
    linked.client = subprocess.Popen(
        command,
        stdout=(linked.folder / "client.txt").open("wb"),
        stderr=subprocess.STDOUT,
        stdin=subprocess.DEVNULL,
        cwd=linked.folder,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )


@pytest.fixture(scope="session")
def flights(request: pytest.FixtureRequest) -> Iterator[dict[str, Linked]]:
    """Every flight that a selected module names in its FLIGHTS, all under way at once.

    A flight is a name with the options of `mufly link` and the command of the client, in which ``{port}`` stands for
    the port that the vehicle sends to.
    """
    wanted: dict[str, tuple[list[str], list[str]]] = {}
    for item in request.session.items:
        wanted.update(getattr(getattr(item, "module", None), "FLIGHTS", {}))
    with tempfile.TemporaryDirectory(prefix="mufly-interop-") as folder:
        running: dict[str, Linked] = {}
        try:
            # The first one compiles what has to be compiled; the others find it done.
            for name, (options, _) in wanted.items():
                running[name] = start_vehicle(Path(folder) / name, *options)
                running[name].beside = running
                if len(running) == 1:
                    running[name].wait_until_it_flies()
            for name, (_, command) in wanted.items():
                linked = running[name]
                linked.wait_until_it_flies()
                start_client(linked, [part.replace("{port}", str(linked.port)) for part in command])
            yield running
        finally:
            for linked in running.values():
                linked.close()
