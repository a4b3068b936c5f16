"""Driver of load cells with HX711 converters and air sensors on a microcontroller (``sketches/hx711_cells.ino``).

The board sends lines of :mod:`mufly.bench.rig.serial_line` at 115200 baud, without request:

    B,cells,1                 started
    C,N,READING,READING,...   80 times a second: number of the line (0 to 65535), each cell's reading (24 bits, signed)
    A,CENTI_C,PA,PERMILLE     once a second, with a BME280: temperature, pressure, relative humidity

Readings of -8388608 or 8388607 are the ends of the converter's range (HX711 data sheet, Avia Semiconductor: "output
code saturates").
"""

from __future__ import annotations

from collections.abc import Sequence

from mufly.bench.rig.bench_devices import DeviceError, Samples
from mufly.bench.rig.serial_line import ChecksummedSerialLine

ADC_COUNT_RANGE = (-8388608.0, 8388607.0)


class SerialLoadCells:
    """Driver of load cells on a microcontroller; a :class:`mufly.bench.rig.bench_devices.Device`.

    Parameters
    ----------
    port : str
    channels : sequence of str
        Channels of the cells, in the order of the board.
    baud : int
    """

    driven_axes: tuple[str, ...] = ()

    def __init__(
        self, port: str, channels: Sequence[str] = ("thrust_raw", "torque_raw"), *, baud: int = 115_200
    ) -> None:
        self._line = ChecksummedSerialLine(port, baud, "load cells")
        self.name = self._line.name
        self._cells = tuple(channels)
        self.channel_names = (*self._cells, "temperature", "pressure", "humidity")
        self.lost_samples = 0
        self._last_sample_number: int | None = None
        self._was_reset = False

    @property
    def broken_line_count(self) -> int:
        """Number of received lines that were discarded because of a wrong checksum or form."""
        return self._line.broken_line_count

    def open(self) -> None:
        self._line.open()
        self._last_sample_number, self._was_reset = None, False
        for _ in range(40):
            if self._line.read_lines(0.1):
                return
        raise DeviceError(f"{self.name}: sends no data; check the sketch and the baud rate")

    def set_speed(self, axis: str, speed_rad_s: float) -> None:
        raise DeviceError(f"{self.name}: reads load cells and drives no motor")

    def read_new_samples(self) -> Samples:
        out: dict[str, list[float]] = {name: [] for name in self.channel_names}
        for cells in self._line.read_lines():
            try:
                numbers = [int(c) for c in cells[1:]] if cells[0] in "CA" else []
            except ValueError:
                continue
            if cells[0] == "C" and len(numbers) == 1 + len(self._cells):
                if self._last_sample_number is not None:
                    self.lost_samples += (numbers[0] - self._last_sample_number - 1) % 65536
                self._last_sample_number = numbers[0]
                for name, value in zip(self._cells, numbers[1:], strict=True):
                    out[name].append(float(value))
            elif cells[0] == "A" and len(numbers) == 3:
                out["temperature"].append(numbers[0] / 100.0 + 273.15)
                out["pressure"].append(float(numbers[1]))
                out["humidity"].append(numbers[2] / 1000.0)
            elif cells[0] == "B":
                self._was_reset = True
        if self._was_reset:
            self._was_reset = False
            raise DeviceError(f"{self.name}: was reset; its zero may have moved")
        self._line.check_silence()
        return out

    def stop(self) -> None:
        return

    def close(self) -> None:
        self._line.close()
