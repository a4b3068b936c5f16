"""The simulated vehicle in a process of its own: a page that draws and a vehicle that flies do not wait for each other.

The parent holds one end of a pipe. What happens in the vehicle comes through it; ``None`` sent into it asks the
vehicle to end. When the parent dies the pipe breaks, and the vehicle ends by itself. However it ends (asked, Ctrl-C,
terminated, the parent gone), it finishes its recording.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import queue
import signal
import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mufly.errors import MuflyError
from mufly.link.endpoint import Endpoint
from mufly.link.geodesy import Origin

if TYPE_CHECKING:
    from mufly.link.runner import Report
    from mufly.logs.layout import Event
    from mufly.mission import Mission
    from mufly.vehicle import Vehicle

__all__ = ["VehicleProcess", "start_vehicle"]

_KEPT_EVENTS = 1000
_WAITING = 1000


@dataclass(frozen=True, slots=True)
class _Order:
    """What the vehicle is to be; travels to the process."""

    vehicle: Vehicle | str | Path
    mission: Mission | str | Path
    endpoints: tuple[Endpoint, ...]
    path: Path | None
    tlog: Path | None
    wind: tuple[float, float, float] | None
    gust: float | None
    seed: int
    autostart: bool
    system: int
    origin: Origin | None


class VehicleProcess:
    """A vehicle that flies in a process of its own.

    Attributes
    ----------
    events : deque of Event
        What happened, the latest thousand; whoever shows them takes them out.
    notices : deque of str
        What happened to the ports.
    report : Report or None
        How its loop is doing.
    outcome, reason : str
        Of the flight; "" while it is open.
    error : str
        Why it ended, if it could not go on.
    """

    def __init__(self, order: _Order) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self.events: deque[Event] = deque(maxlen=_KEPT_EVENTS)
        self.notices: deque[str] = deque(maxlen=_KEPT_EVENTS)
        self.report: Report | None = None
        self.outcome = self.reason = self.error = ""
        self._ready = threading.Event()
        self._process = context.Process(target=_main, args=(order, theirs), name="mufly vehicle", daemon=True)
        self._process.start()
        theirs.close()
        self._reader = threading.Thread(target=self._read, name="mufly vehicle reader", daemon=True)
        self._reader.start()

    @property
    def finished(self) -> bool:
        """Whether the process has ended."""
        return not self._process.is_alive()

    @property
    def pid(self) -> int | None:
        """Number of the process."""
        return self._process.pid

    def wait_ready(self, timeout_s: float = 60.0) -> None:
        """Wait until it listens and ticks.

        Raises
        ------
        MuflyError
            If it cannot start; the message is the one that the vehicle's process gave.
        """
        if not self._ready.wait(timeout_s):
            raise MuflyError(f"the vehicle did not start within {timeout_s:g} s; is the machine very busy?")
        if self.error:
            raise MuflyError(self.error)

    def stop(self, timeout_s: float = 10.0) -> None:
        """Ask it to end, and wait until its recording is whole."""
        with contextlib.suppress(OSError, ValueError):
            self._pipe.send(None)
        self._process.join(timeout_s)
        if self._process.is_alive():
            self._process.terminate()
            self._process.join(timeout_s)
        self._reader.join(1.0)

    def __enter__(self) -> VehicleProcess:
        return self

    def __exit__(self, *exc: object) -> None:
        self.stop()

    def _read(self) -> None:
        ended = False
        while True:
            try:
                kind, content = self._pipe.recv()
            except (EOFError, OSError):
                break
            if kind == "event":
                self.events.append(content)
            elif kind == "notice":
                self.notices.append(content)
            elif kind == "report":
                self.report = content
                self.outcome = content.outcome
            elif kind == "ready":
                self._ready.set()
            elif kind == "done":
                self.outcome, self.reason = content
                ended = True
            elif kind == "error":
                self.error = content
        if not ended and not self.error:
            when = "while it flew" if self._ready.is_set() else "before it was ready"
            self.error = f"the vehicle's process ended {when}, without a word (killed, or out of memory?)"
        self._ready.set()


def start_vehicle(
    vehicle: Vehicle | str | Path,
    mission: Mission | str | Path,
    *,
    endpoints: Sequence[Endpoint],
    path: str | Path | None = None,
    tlog: str | Path | None = None,
    wind: Sequence[float] | None = None,
    gust: float | None = None,
    seed: int = 0,
    autostart: bool = False,
    system: int = 1,
    origin: Origin | None = None,
) -> VehicleProcess:
    """Start a simulated vehicle in a process of its own, behind a MAVLink link, in real time.

    Parameters
    ----------
    vehicle, mission : Vehicle and Mission, or names or files of them
    endpoints : sequence of Endpoint
    path, tlog : str or Path, optional
        Recording (MCAP) and telemetry log to write.
    wind, gust, seed
        As for :class:`mufly.flight.Flight`.
    autostart : bool
        Arm and fly the mission by itself.
    system : int
        Its number, 1..255.
    origin : Origin, optional
        Where on the globe it is.

    Returns
    -------
    VehicleProcess
        Starting; :meth:`VehicleProcess.wait_ready` waits until it is up, or raises what is wrong.
    """
    return VehicleProcess(
        _Order(
            vehicle,
            mission,
            tuple(endpoints),
            None if path is None else Path(path),
            None if tlog is None else Path(tlog),
            None if wind is None else (float(wind[0]), float(wind[1]), float(wind[2])),
            gust,
            seed,
            autostart,
            system,
            origin,
        )
    )


class _Teller:
    """Tells the parent, without ever waiting for it."""

    def __init__(self, pipe: Connection) -> None:
        self._pipe = pipe
        self._queue: queue.Queue[tuple[str, Any] | None] = queue.Queue(_WAITING)
        self._thread = threading.Thread(target=self._send, daemon=True)
        self._thread.start()

    def __call__(self, kind: str, content: Any = None) -> None:
        with contextlib.suppress(queue.Full):
            self._queue.put_nowait((kind, content))

    def close(self) -> None:
        """Say what is left, for a second at most."""
        with contextlib.suppress(queue.Full):
            self._queue.put(None, timeout=1.0)
        self._thread.join(1.0)

    def _send(self) -> None:
        while (said := self._queue.get()) is not None:
            try:
                self._pipe.send(said)
            except (OSError, ValueError):
                return  # nobody listens any more


def _main(order: _Order, pipe: Connection) -> None:
    """The vehicle's process."""
    asked = threading.Event()
    # Ctrl-C reaches every process of a terminal; the parent decides what it means, and asks.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: asked.set())
    tell = _Teller(pipe)

    def listen() -> None:
        with contextlib.suppress(EOFError, OSError):
            pipe.recv()
        asked.set()

    threading.Thread(target=listen, daemon=True).start()
    try:
        _fly(order, tell, asked)
    except MuflyError as error:
        tell("error", str(error))
    except OSError as error:
        tell("error", f"{error.filename or 'the vehicle'}: {error.strerror or error}")
    finally:
        tell.close()


def _fly(order: _Order, tell: _Teller, asked: threading.Event) -> None:
    from mufly.control import design
    from mufly.flight import Flight
    from mufly.link.runner import run, warm_up
    from mufly.link.tlog import TlogWriter
    from mufly.link.vehicle import VehicleLink
    from mufly.mission import Mission, load_mission
    from mufly.vehicle import Vehicle, load_vehicle

    vehicle = order.vehicle if isinstance(order.vehicle, Vehicle) else load_vehicle(order.vehicle)
    mission = order.mission if isinstance(order.mission, Mission) else load_mission(order.mission)
    controller = design(vehicle)
    warm_up(vehicle, controller)
    flight = Flight(
        vehicle,
        mission,
        controller=controller,
        wind=order.wind,
        gust=order.gust,
        seed=order.seed,
        path=order.path,
        keep=False,
    )
    with flight, contextlib.ExitStack() as stack:
        log = None if order.tlog is None else stack.enter_context(TlogWriter(order.tlog))
        flight.autopilot.listeners.append(lambda event: tell("event", event))
        run(
            flight,
            order.endpoints,
            link=VehicleLink(flight, system=order.system, origin=order.origin),
            stop=asked.is_set,
            tlog=log,
            on_open=lambda: tell("ready"),
            on_notice=lambda line: tell("notice", line),
            on_report=lambda report: tell("report", report),
            autostart=order.autostart,
        )
        tell("done", flight.judge())
