"""Driver of thrust stands of the RCbenchmark kind, which measure loads and accept pulses for a speed controller.

Such stands send rows of comma-separated values and accept a pulse width. The columns differ between stands. The stand
names them in its first row, and on request, with headers known to :mod:`mufly.bench.bench_table`:

    to the stand        head                request the row of headers
                        esc,MICROSECONDS    1000 (stop) to 2000
                        stop
    from the stand      #time (s),thrust (N),torque (N m),voltage (V),current (A),rpm,...        headers, after a #
                        12.34,0.513,0.0042,11.1,1.52,5021,...                                   20 to 100 times a second

The stand holds a pulse width, not a speed. The driver corrects the pulse four times a second by about a third of the
speed error, with the slope estimated from the last steps. Files of the manufacturer's program need no driver:
``mufly identify``, ``mufly rotor fit`` and ``compare`` read them (docs/reference/bench.md).

Rows have no checksum. A row is valid only if it has as many numbers as there are headers; implausible values are
discarded.
"""

from __future__ import annotations

import math
import time

from mufly.bench.bench_table import ColumnMeaning, parse_column_header
from mufly.bench.rig.bench_devices import DeviceError, Samples
from mufly.bench.rig.serial_line import SerialLine, SerialMotor, SILENCE_TIMEOUT_s

MIN_PULSE_us, MAX_PULSE_us = 1000.0, 2000.0
_SPEED_CORRECTION_GAIN = 0.35  # share of the speed error that one step corrects
_INITIAL_SLOPE_us = 0.12  # us per rad/s, before the slope is estimated
_MAX_PULSE_STEP_us = 60.0  # largest step of the pulse width
_MAX_PLAUSIBLE_READINGS = {"thrust": 1e3, "torque": 100.0, "speed": 2e4, "current": 1e3, "voltage": 1e3}


class ThrustStand(SerialMotor):
    """Driver of a thrust stand; a :class:`mufly.bench.rig.bench_devices.Device`.

    Parameters
    ----------
    port : str
    axis : 'upper' or 'lower'
    baud : int
    """

    def __init__(self, port: str, axis: str = "upper", *, baud: int = 115_200, pace: float = 1.0) -> None:
        self._line = SerialLine(port, baud, "stand")
        self.name, self.driven_axes, self._axis, self._pace = self._line.name, (axis,), axis, pace
        self.channel_names: tuple[str, ...] = (
            "thrust",
            "torque",
            f"speed_{axis}",
            f"current_{axis}",
            f"voltage_{axis}",
        )
        self.broken_rows = 0
        self._columns: list[ColumnMeaning | None] = []
        self._partial_row, self._last_row_s, self._last_pulse_s = b"", 0.0, 0.0
        self._target_speed, self._pulse_us, self._pulse_per_speed = 0.0, MIN_PULSE_us, _INITIAL_SLOPE_us
        self._last_pulse_and_speed: tuple[float, float] | None = None
        self._is_open = False

    def open(self) -> None:
        self._line.open()
        self._partial_row, self._columns, self._target_speed, self._pulse_us = b"", [], 0.0, MIN_PULSE_us
        self._is_open = True
        self._line.write(b"stop\n")
        for _ in range(20):
            self._line.write(b"head\n")
            self._read_rows(0.1)
            if self._columns:
                self._last_row_s = time.monotonic()
                return
        raise DeviceError(f"{self.name}: sends no header row; check port and baud rate")

    def _read_rows(self, wait_s: float = 0.0) -> list[list[float]]:
        data = self._partial_row + self._line.read(wait_s)
        *whole, self._partial_row = data.split(b"\n")
        self._partial_row = self._partial_row[-4096:]
        out = []
        for raw in whole:
            text = raw.decode("ascii", errors="replace").strip()
            if text.startswith("#"):
                columns = [parse_column_header(h) for h in text[1:].split(",")]
                if any(c is not None and c.name == "speed" for c in columns):
                    self._columns = columns
                continue
            try:
                values = [float(c) for c in text.split(",")]
            except ValueError:
                values = []
            if self._columns and len(values) == len(self._columns) and all(map(math.isfinite, values)):
                out.append(values)
            elif text:
                self.broken_rows += 1
        return out

    def set_speed(self, axis: str, speed_rad_s: float) -> None:
        self._target_speed = speed_rad_s
        if speed_rad_s == 0.0:
            self._pulse_us, self._last_pulse_and_speed = MIN_PULSE_us, None
            self._line.write(b"stop\n")

    def read_new_samples(self) -> Samples:
        out: dict[str, list[float]] = {}
        side = ("speed", "current", "voltage")
        for values in self._read_rows():
            row: dict[str, float] = {}
            for column, value in zip(self._columns, values, strict=True):
                if column is not None:
                    si = column.factor * value + column.offset
                    if abs(si) > _MAX_PLAUSIBLE_READINGS.get(column.base_quantity, math.inf):
                        row = {}
                        self.broken_rows += 1
                        break
                    row[f"{column.name}_{self._axis}" if column.name in side else column.name] = si
            for name, si in row.items():
                if name not in ("time", "run"):
                    out.setdefault(name, []).append(si)
            if row:
                self._last_row_s = time.monotonic()
        if time.monotonic() - self._last_row_s > SILENCE_TIMEOUT_s:
            raise DeviceError(f"{self.name}: silent for {time.monotonic() - self._last_row_s:.1f} s")
        if speeds := out.get(f"speed_{self._axis}"):
            self._regulate_speed(sum(speeds[-5:]) / len(speeds[-5:]))
        return out

    def _regulate_speed(self, speed: float) -> None:
        """Correct the pulse width towards the target speed, four times a second."""
        now = time.monotonic() * self._pace
        if self._target_speed <= 0.0 or now - self._last_pulse_s < 0.25:
            return
        if self._last_pulse_and_speed is not None:
            moved = self._pulse_us - self._last_pulse_and_speed[0]
            turned = speed - self._last_pulse_and_speed[1]
            if abs(moved) > 2.0 and moved * turned > 0.0:
                self._pulse_per_speed = min(max(0.5 * self._pulse_per_speed + 0.5 * moved / turned, 0.02), 2.0)
        self._last_pulse_and_speed, self._last_pulse_s = (self._pulse_us, speed), now
        step = _SPEED_CORRECTION_GAIN * self._pulse_per_speed * (self._target_speed - speed)
        self._pulse_us = min(
            max(self._pulse_us + min(max(step, -_MAX_PULSE_STEP_us), _MAX_PULSE_STEP_us), MIN_PULSE_us),
            MAX_PULSE_us,
        )
        self._line.write(f"esc,{self._pulse_us:.1f}\n".encode())

    def stop(self) -> None:
        self._target_speed, self._pulse_us, self._last_pulse_and_speed = 0.0, MIN_PULSE_us, None
        if not self._is_open:
            return
        # The stand does not acknowledge a stop; further rows show that the line works, and their speed is monitored.
        self._line.write(b"\nstop\n")
        self._line.write(b"stop\n")
