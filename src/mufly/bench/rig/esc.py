"""Speed controllers of models behind a microcontroller, with the sketches in ``sketches/``.

``esc_bridge.ino`` gives PWM and counts turns by Hall sensors; ``dshot_bridge.ino`` speaks bidirectional DShot300, in
which the controllers answer with their speed. Both speak the same lines to the computer.

Lines of :mod:`mufly.bench.rig.line`, at 115200 baud. To the bridge, axes counted from 0:

    S,AXIS,RPM      hold this speed; 0 stops.  Answer: OK,S,AXIS,RPM
    X               stop everything.           Answer: OK,X
    K               nothing, but I am here (a motor that has heard nothing for 500 ms is stopped)

and from it, by itself:

    B,esc,1                                 has just started: after power, or after a reset
    T,N,RPM,MA,MV,CENTI_K[,RPM,MA,...]      50 times a second: number of the line, and of each axis speed, current,
                                            mean voltage at the motor, temperature (0: not measured)
    F,AXIS,TEXT                             a fault: no speed signal, undervoltage, watchdog
"""

from __future__ import annotations

import time
from collections.abc import Sequence

from mufly.bench.rig.devices import DeviceError, Samples
from mufly.bench.rig.line import PATIENCE_s, TextLine
from mufly.units import RPM

TRIES = 4
KEEP_s = 0.15
_FIELDS = 4


class EscBridge:
    """One or two motors on a bridge; a :class:`mufly.bench.rig.devices.Device`.

    Parameters
    ----------
    port : str
    axes : sequence of str
        In the bridge's order.
    baud : int
    """

    def __init__(self, port: str, axes: Sequence[str] = ("upper",), *, baud: int = 115_200) -> None:
        self._line = TextLine(port, baud, "speed controllers")
        self.name, self.axes = self._line.name, tuple(axes)
        kinds = ("speed", "current", "voltage", "motor_temperature")
        self.channels = tuple(f"{k}_{a}" for a in self.axes for k in kinds)
        self._targets = dict.fromkeys(self.axes, 0.0)
        self._answers: list[list[str]] = []
        self._samples: dict[str, list[float]] = {}
        self._said_s, self._opened, self._trouble = 0.0, False, ""

    @property
    def broken(self) -> int:
        """Lines that were passed over."""
        return self._line.broken

    def _take(self, wait_s: float = 0.0) -> None:
        """Sort what came."""
        for cells in self._line.lines(wait_s):
            if cells[0] == "T" and len(cells) == 2 + _FIELDS * len(self.axes):
                self._telemetry(cells)
            elif cells[0] == "OK":
                self._answers.append(cells)
            elif cells[0] == "B" and any(self._targets.values()):
                self._trouble = "was reset while a motor turned"
            elif cells[0] == "F":
                self._trouble = f"reports a fault: {', '.join(cells[1:])}"

    def _telemetry(self, cells: list[str]) -> None:
        try:
            numbers = [float(c) for c in cells[2:]]
        except ValueError:
            return
        for k, axis in enumerate(self.axes):
            rpm, milliampere, millivolt, heat = numbers[_FIELDS * k : _FIELDS * (k + 1)]
            for name, value in (
                ("speed", rpm * RPM),
                ("current", milliampere / 1e3),
                ("voltage", millivolt / 1e3),
            ):
                self._samples.setdefault(f"{name}_{axis}", []).append(value)
            if heat > 0:
                self._samples.setdefault(f"motor_temperature_{axis}", []).append(heat / 100.0)

    def _order(self, body: str, answer: list[str], tries: int = TRIES) -> None:
        for _ in range(tries):
            self._answers.clear()
            self._line.say(body)
            self._said_s = time.monotonic()
            until = self._said_s + PATIENCE_s
            while (left := until - time.monotonic()) > 0:
                self._take(left)
                if any(a[: len(answer)] == answer for a in self._answers):
                    return
        raise DeviceError(f"{self.name}: does not take {body!r}")

    def open(self) -> None:
        self._line.open()
        self._targets, self._trouble, self._opened = dict.fromkeys(self.axes, 0.0), "", True
        self._samples.clear()
        # A board that resets when its port is opened takes two seconds to wake up.
        self._order("X", ["OK", "X"], tries=10)

    def turn(self, axis: str, speed_rad_s: float) -> None:
        rpm = round(speed_rad_s / RPM)
        k = self.axes.index(axis)
        self._order(f"S,{k},{rpm}", ["OK", "S", f"{k}", f"{rpm}"])
        self._targets[axis] = speed_rad_s

    def read(self) -> Samples:
        if time.monotonic() - self._said_s > KEEP_s:
            self._line.say("K")
            self._said_s = time.monotonic()
        self._take()
        if self._trouble:
            trouble, self._trouble = self._trouble, ""
            raise DeviceError(f"{self.name}: {trouble}")
        self._line.check_silence()
        out, self._samples = self._samples, {}
        return out

    def stop(self) -> None:
        self._targets = dict.fromkeys(self.axes, 0.0)
        if self._opened:
            self._order("X", ["OK", "X"], tries=2)

    def close(self) -> None:
        try:
            self.stop()
        finally:
            self._opened = False
            self._line.close()
