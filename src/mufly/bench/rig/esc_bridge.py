"""Driver of electronic speed controllers (ESC) behind a microcontroller, with the sketches in ``sketches/``.

``esc_bridge.ino`` outputs PWM and counts turns by Hall sensors; ``dshot_bridge.ino`` uses bidirectional DShot300, in
which the controllers return their speed. Both use the same protocol to the computer.

The protocol uses lines of :mod:`mufly.bench.rig.serial_line` at 115200 baud. To the bridge, axes counted from 0:

    S,AXIS,RPM      hold this speed; 0 stops.  Answer: OK,S,AXIS,RPM
    X               stop everything.           Answer: OK,X
    K               keep-alive (a motor without message for 500 ms is stopped)

From the bridge, without request:

    B,esc,1                                 started, after power-up or reset
    T,N,RPM,MA,MV,CENTI_K[,RPM,MA,...]      50 times a second: line number, and for each axis speed, current,
                                            mean motor voltage, temperature (0: not measured)
    F,AXIS,TEXT                             a fault: no speed signal, undervoltage, watchdog
"""

from __future__ import annotations

import time
from collections.abc import Sequence

from mufly.bench.rig.bench_devices import DeviceError, Samples
from mufly.bench.rig.serial_line import ChecksummedSerialLine, REPLY_TIMEOUT_s, SerialMotor
from mufly.quantities.units import RPM

MAX_COMMAND_TRIES = 4
KEEP_ALIVE_s = 0.15
_TELEMETRY_FIELDS_PER_AXIS = 4


class EscBridge(SerialMotor):
    """Driver of one or two motors whose speed controllers a microcontroller (the bridge) commands; a
    :class:`mufly.bench.rig.bench_devices.Device`.

    Parameters
    ----------
    port : str
    axes : sequence of str
        Axes in the order of the bridge.
    baud : int
    """

    _line: ChecksummedSerialLine

    def __init__(self, port: str, axes: Sequence[str] = ("upper",), *, baud: int = 115_200) -> None:
        self._line = ChecksummedSerialLine(port, baud, "speed controllers")
        self.name, self.driven_axes = self._line.name, tuple(axes)
        kinds = ("speed", "current", "voltage", "motor_temperature")
        self.channel_names = tuple(f"{k}_{a}" for a in self.driven_axes for k in kinds)
        self._target_speeds = dict.fromkeys(self.driven_axes, 0.0)
        self._replies: list[list[str]] = []
        self._samples: dict[str, list[float]] = {}
        self._last_command_s, self._is_open, self._fault_text = 0.0, False, ""

    @property
    def broken_line_count(self) -> int:
        """Number of received lines that were discarded because of a wrong checksum or form."""
        return self._line.broken_line_count

    def _process_lines(self, wait_s: float = 0.0) -> None:
        """Process received lines: telemetry, replies, resets and faults."""
        for cells in self._line.read_lines(wait_s):
            if cells[0] == "T" and len(cells) == 2 + _TELEMETRY_FIELDS_PER_AXIS * len(self.driven_axes):
                self._store_telemetry(cells)
            elif cells[0] == "OK":
                self._replies.append(cells)
            elif cells[0] == "B" and any(self._target_speeds.values()):
                self._fault_text = "was reset while a motor turned"
            elif cells[0] == "F":
                self._fault_text = f"reports a fault: {', '.join(cells[1:])}"

    def _store_telemetry(self, cells: list[str]) -> None:
        try:
            numbers = [float(c) for c in cells[2:]]
        except ValueError:
            return
        for k, axis in enumerate(self.driven_axes):
            rpm, milliampere, millivolt, heat = numbers[
                _TELEMETRY_FIELDS_PER_AXIS * k : _TELEMETRY_FIELDS_PER_AXIS * (k + 1)
            ]
            for name, value in (
                ("speed", rpm * RPM),
                ("current", milliampere / 1e3),
                ("voltage", millivolt / 1e3),
            ):
                self._samples.setdefault(f"{name}_{axis}", []).append(value)
            if heat > 0:
                self._samples.setdefault(f"motor_temperature_{axis}", []).append(heat / 100.0)

    def _send_command(self, body: str, answer: list[str], tries: int = MAX_COMMAND_TRIES) -> None:
        for _ in range(tries):
            self._replies.clear()
            self._line.send_line(body)
            self._last_command_s = time.monotonic()
            until = self._last_command_s + REPLY_TIMEOUT_s
            while (left := until - time.monotonic()) > 0:
                self._process_lines(left)
                if any(a[: len(answer)] == answer for a in self._replies):
                    return
        raise DeviceError(f"{self.name}: does not accept {body!r}")

    def open(self) -> None:
        self._line.open()
        self._target_speeds, self._fault_text, self._is_open = dict.fromkeys(self.driven_axes, 0.0), "", True
        self._samples.clear()
        # A board that resets when its port is opened needs two seconds to start.
        self._send_command("X", ["OK", "X"], tries=10)

    def set_speed(self, axis: str, speed_rad_s: float) -> None:
        rpm = round(speed_rad_s / RPM)
        k = self.driven_axes.index(axis)
        self._send_command(f"S,{k},{rpm}", ["OK", "S", f"{k}", f"{rpm}"])
        self._target_speeds[axis] = speed_rad_s

    def read_new_samples(self) -> Samples:
        if time.monotonic() - self._last_command_s > KEEP_ALIVE_s:
            self._line.send_line("K")
            self._last_command_s = time.monotonic()
        self._process_lines()
        if self._fault_text:
            trouble, self._fault_text = self._fault_text, ""
            raise DeviceError(f"{self.name}: {trouble}")
        self._line.check_silence()
        out, self._samples = self._samples, {}
        return out

    def stop(self) -> None:
        self._target_speeds = dict.fromkeys(self.driven_axes, 0.0)
        if self._is_open:
            self._send_command("X", ["OK", "X"], tries=2)
