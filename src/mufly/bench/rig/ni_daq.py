"""Driver of load cells and an accelerometer on a National Instruments module (the dissertation used a USB-6009).

The driver uses the manufacturer's Python package ``nidaqmx`` (``pip install nidaqmx``), which is not a dependency and
not available on all platforms. Sampling is continuous at ``rate_Hz`` times ``average``; blocks of ``average`` samples
are averaged to one reading, which avoids aliasing of the rotor frequency and its harmonics onto the mean. A channel
named ``vibration`` returns the RMS about the mean of each block, in m/s2.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from mufly.bench.rig.bench_devices import DeviceError, Samples
from mufly.bench.rig.serial_line import SILENCE_TIMEOUT_s


class NiDaq:
    """Driver of analogue inputs; a :class:`mufly.bench.rig.bench_devices.Device`.

    Parameters
    ----------
    inputs : dict of str to str
        Channel -> physical input: ``{"thrust_raw": "Dev1/ai0"}``.
    scale : dict of str to float, optional
        Units of the channel per volt; 1 by default.
    rate_Hz, average : float, int
        Readings per second, and samples per reading.
    range_V : float
        Symmetric range of the inputs.
    """

    driven_axes: tuple[str, ...] = ()

    def __init__(
        self, inputs: Mapping[str, str], *, scale: Mapping[str, float] | None = None, rate_Hz: float = 100.0,
        average: int = 20, range_V: float = 10.0,
    ) -> None:  # fmt: skip
        self._inputs, self._scale = dict(inputs), dict(scale or {})
        self._reading_rate_Hz, self._samples_per_reading, self._input_range_V = rate_Hz, average, range_V
        self.channel_names = tuple(self._inputs)
        self.name = f"data acquisition ({', '.join(self._inputs.values())})"
        self._task: Any = None
        self._leftover_samples = np.zeros((len(self._inputs), 0))
        self._last_data_s = 0.0

    def open(self) -> None:
        try:
            nidaqmx = importlib.import_module("nidaqmx")
            constants = importlib.import_module("nidaqmx.constants")
        except ImportError as error:
            raise DeviceError(f"{self.name}: needs the package nidaqmx and NI's driver; pip install nidaqmx") from error
        self.close()
        try:
            self._task = nidaqmx.Task()
            for where in self._inputs.values():
                self._task.ai_channels.add_ai_voltage_chan(
                    where, min_val=-self._input_range_V, max_val=self._input_range_V
                )
            rate = self._reading_rate_Hz * self._samples_per_reading
            self._task.timing.cfg_samp_clk_timing(
                rate, sample_mode=constants.AcquisitionType.CONTINUOUS, samps_per_chan=int(4 * rate)
            )
            self._task.start()
        except Exception as error:  # the package raises its own exception types
            self.close()
            raise DeviceError(f"{self.name}: cannot be started ({error})") from error
        self._leftover_samples = np.zeros((len(self._inputs), 0))
        self._last_data_s = time.monotonic()

    def set_speed(self, axis: str, speed_rad_s: float) -> None:
        raise DeviceError(f"{self.name}: reads sensors and drives no motor")

    def read_new_samples(self) -> Samples:
        if self._task is None:
            raise DeviceError(f"{self.name}: is not open")
        try:
            new = np.atleast_2d(np.asarray(self._task.read(number_of_samples_per_channel=-1), dtype=np.float64))
        except Exception as error:
            raise DeviceError(f"{self.name}: cannot be read ({error})") from error
        data = np.hstack([self._leftover_samples, new.reshape(len(self._inputs), -1)])
        if new.size:
            self._last_data_s = time.monotonic()
        elif time.monotonic() - self._last_data_s > SILENCE_TIMEOUT_s:
            raise DeviceError(f"{self.name}: silent for {time.monotonic() - self._last_data_s:.1f} s")
        whole = data.shape[1] // self._samples_per_reading
        used = data[:, : whole * self._samples_per_reading]
        self._leftover_samples = data[:, whole * self._samples_per_reading :]
        blocks = used.reshape(len(self._inputs), whole, self._samples_per_reading)
        out = {}
        for k, name in enumerate(self._inputs):
            scale = self._scale.get(name, 1.0)
            values = blocks[k].std(axis=1) if name == "vibration" else blocks[k].mean(axis=1)
            out[name] = scale * values
        return out

    def stop(self) -> None:
        return

    def close(self) -> None:
        if self._task is not None:
            task, self._task = self._task, None
            task.close()
