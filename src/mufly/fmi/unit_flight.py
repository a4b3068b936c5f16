"""Flights of co-simulation units: a minimal importer, and the comparison of a unit with the Python model, bit by bit.

The importer calls the library of an archive through the C interface of FMI 3.0 and knows scalar numbers only.
"""

from __future__ import annotations

import ctypes
import math
import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics import STATE_SIZE, DrydenWind, find_trim, integrate_state, model_parameters, standing_state
from mufly.dynamics.model_state import INPUT_SIZE
from mufly.errors import MuflyError
from mufly.estimate import Estimate, KalmanEstimator
from mufly.estimate.filter.filter_records import (
    ERROR_ACCEL_BIAS,
    ERROR_ATTITUDE,
    ERROR_GYRO_BIAS,
    ERROR_POSITION,
    ERROR_THRUST_SCALE,
    ERROR_VELOCITY,
    ERROR_WIND,
)
from mufly.flight.simulated_plant import SimulatedPlant, advance_period
from mufly.fmi.fmu_export import platform_tuple
from mufly.fmi.unit_sensors import SENSOR_RATE_HZ
from mufly.quantities.sensor_table import SENSORS
from mufly.results import ShownBlock, make_lines_block, result
from mufly.sensors import Readings, Truth, make_fitted_sensors, randomise_leg_lengths
from mufly.vehicle import Vehicle
from mufly.world import World

_LOG_TYPE = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p)
_STATUS_OK = 0
_STEP_SIZES_S = (0.01, 0.004, 0.0105, 0.02, 0.0007)
_COMPARISON_START_VALUES = {
    "start.position_down": -1.5, "start.velocity_north": 1.1, "start.velocity_east": -0.6,
    "start.velocity_down": 0.3, "start.roll": 0.2, "start.pitch": -0.15, "start.yaw": 2.0, "start.roll_rate": 0.7,
    "start.pitch_rate": -0.4, "start.yaw_rate": 1.2, "start.swash_roll": 0.03, "start.bar_roll": 0.1,
    "start.bar_pitch": -0.05, "start.battery_charge": 0.73,
}  # fmt: skip
"""Start of a comparison, near the floor."""


class UnitLibrary:
    """Extracted archive of a unit with its library for this machine.

    Parameters
    ----------
    file : Path
        Archive.
    folder : Path
        Folder to extract it to.

    Attributes
    ----------
    references : dict
        Value reference of each variable.
    inputs, outputs : list of str
        Names of the variables.
    starts : dict
        Start values of all variables that have one.
    seed_count : int
        Number of seeds of the sensors; 0 without sensors.

    Raises
    ------
    MuflyError
        If the archive has no library for this machine.
    """

    def __init__(self, file: Path, folder: Path) -> None:
        with zipfile.ZipFile(file) as archive:
            archive.extractall(folder)
        root = ElementTree.parse(folder / "modelDescription.xml").getroot()
        variables = [v.attrib for v in root.findall("ModelVariables/Float64")]
        self.folder = folder
        self.token = root.attrib["instantiationToken"]
        self.references = {v["name"]: int(v["valueReference"]) for v in variables}
        self.inputs = [v["name"] for v in variables if v["causality"] == "input"]
        self.outputs = [v["name"] for v in variables if v["causality"] == "output"]
        self.starts = {v["name"]: float(v["start"]) for v in variables if "start" in v}
        self.seed_count = sum(int(float(v["max"])) + 1 for v in variables if v["name"] == "sensors.seed")
        found = list((folder / "binaries" / platform_tuple()[0]).glob("*.*"))
        if len(found) != 1:
            raise MuflyError(
                f"{file} contains no library for this platform; export it again on a machine with a C compiler"
            )
        self.library = ctypes.CDLL(str(found[0]))
        self.library.fmi3InstantiateCoSimulation.restype = ctypes.c_void_p
        self.library.fmi3FreeInstance.restype = None


class UnitInstance:
    """Running instance of a co-simulation unit (FMU), called through its C interface.

    Parameters
    ----------
    library : UnitLibrary
    token : str, optional
        Instantiation token; by default that of the model description.

    Attributes
    ----------
    messages : list of str
        Messages that the unit has logged.
    """

    def __init__(self, library: UnitLibrary, token: str | None = None) -> None:
        self._library, self.messages = library, list[str]()
        self._log = _LOG_TYPE(lambda _, status, category, text: self.messages.append(text.decode()))
        made = library.library.fmi3InstantiateCoSimulation(
            b"unit", (library.token if token is None else token).encode(), b"", False, False, False, False, None,
            ctypes.c_size_t(0), None, self._log, None,
        )  # fmt: skip
        self.handle = ctypes.c_void_p(made)

    def call_fmi_function(self, function: str, *arguments: Any) -> int:
        """Call a function of the interface with this instance; return its status."""
        return int(getattr(self._library.library, function)(self.handle, *arguments))

    def free_instance(self) -> None:
        """Free the instance."""
        self._library.library.fmi3FreeInstance(self.handle)

    def set_values_by_name(self, values: Mapping[str, float]) -> int:
        """Set variables by name; return the status."""
        references = (ctypes.c_uint32 * len(values))(*(self._library.references[name] for name in values))
        count = ctypes.c_size_t(len(values))
        numbers = (ctypes.c_double * len(values))(*values.values())
        return self.call_fmi_function("fmi3SetFloat64", references, count, numbers, count)

    def get_values(self, names: Sequence[str] | None = None) -> NDArray[np.float64]:
        """Return the values of variables; by default all outputs.

        Raises
        ------
        MuflyError
            If the unit reports an error.
        """
        names = self._library.outputs if names is None else names
        references = (ctypes.c_uint32 * len(names))(*(self._library.references[name] for name in names))
        numbers, count = (ctypes.c_double * len(names))(), ctypes.c_size_t(len(names))
        self.check_status(self.call_fmi_function("fmi3GetFloat64", references, count, numbers, count))
        return np.array(numbers)

    def initialise(self, values: Mapping[str, float] | None = None) -> UnitInstance:
        """Set the start values ``values``, and enter and exit FMI's initialisation mode; return this instance.

        Raises
        ------
        MuflyError
            If the unit reports an error.
        """
        if values:
            self.check_status(self.set_values_by_name(values))
        zero = ctypes.c_double(0.0)
        self.check_status(self.call_fmi_function("fmi3EnterInitializationMode", False, zero, zero, False, zero))
        self.check_status(self.call_fmi_function("fmi3ExitInitializationMode"))
        return self

    def do_step(self, time_s: float, step_s: float) -> int:
        """Simulate a communication step; return the status."""
        flags = [ctypes.byref(ctypes.c_bool()) for _ in range(3)]
        last = ctypes.byref(ctypes.c_double())
        return self.call_fmi_function(
            "fmi3DoStep", ctypes.c_double(time_s), ctypes.c_double(step_s), True, *flags, last
        )

    def check_status(self, status: int) -> None:
        """Raise an error with the unit's last message if a status is not OK."""
        if status != _STATUS_OK:
            raise MuflyError(f"the unit reports: {self.messages[-1] if self.messages else 'an error'}")


@result
class UnitComparison:
    """Comparison of a unit (FMU) with the Python model in one flight with varying inputs and wind.

    Attributes
    ----------
    steps, different : int
        Communication steps, and those after which a bit of the state, or of a reading or the estimate, differs.
    on_floor : int
        Communication steps in contact with the floor, or close to it.
    largest_difference : float
        Largest difference of an entry.
    """

    steps: int
    different: int
    on_floor: int
    largest_difference: float

    def make_printed_blocks(self) -> list[ShownBlock]:
        """Return the difference as printed text."""
        differ = f"after {self.different} of {self.steps} communication steps, by {self.largest_difference:.2g} at most"
        return [make_lines_block(f"Unit and Python model differ {differ}.", style="red" if self.different else "")]


def compare_fmu_with_model(unit: UnitLibrary, p: np.void, *, duration_s: float = 5.0) -> UnitComparison:
    """Compare a unit with the Python model under the same inputs and wind, which change at every communication step.

    The flight begins in motion and ends on the floor. The communication steps have five sizes, 0.7 to 20 ms.

    Parameters
    ----------
    unit : UnitLibrary
    p : record of :class:`~mufly.dynamics.ModelParameters`
        Parameters of the Python model.
    duration_s : float
        Simulated time (s).

    Raises
    ------
    MuflyError
        If the unit reports an error.
    """
    instance, rng = UnitInstance(unit).initialise(_COMPARISON_START_VALUES), np.random.default_rng(0)
    state = unit.outputs[:STATE_SIZE]
    hover = np.array([unit.starts[name] for name in unit.inputs[:INPUT_SIZE]])
    x, u, wind = instance.get_values(state), hover.copy(), np.zeros(3)
    time_s, steps, different, on_floor, largest = 0.0, 0, 0, 0, 0.0
    while time_s < duration_s:
        u += rng.normal(0.0, [0.02, 0.02, 0.1, 0.1]) + 0.1 * (hover - u)
        wind += rng.normal(0.0, 0.2, 3) - 0.05 * wind
        step_s = _STEP_SIZES_S[steps % len(_STEP_SIZES_S)]
        instance.check_status(instance.set_values_by_name(dict(zip(unit.inputs, (*u, *wind), strict=True))))
        instance.check_status(instance.do_step(time_s, step_s))
        count = max(1, math.ceil(step_s / unit.starts["solver.step"] - 1e-9))
        integrate_state(x, u, wind, p, step_s / count, count)
        there = instance.get_values(state)
        different += not np.array_equal(there, x)
        largest = max(largest, float(np.max(np.abs(there - x))))
        on_floor += bool(x[2] + p["contact_reach"] > 0.0)
        time_s, steps = time_s + step_s, steps + 1
    instance.free_instance()
    return UnitComparison(steps=steps, different=different, on_floor=on_floor, largest_difference=largest)


def compare_sensed_fmu_with_model(
    unit: UnitLibrary, vehicle: Vehicle, *, seed: int = 0, duration_s: float = 5.0
) -> UnitComparison:
    """Compare a unit that has sensors with model, sensors and filter in Python, as :func:`compare_fmu_with_model` does.

    The flight begins on the floor. The communication step is the period of the sensors.

    Parameters
    ----------
    unit : UnitLibrary
    vehicle : Vehicle
    seed : int
        Seed of the sensors.
    duration_s : float
        Simulated time (s).

    Raises
    ------
    MuflyError
        If the unit reports an error.
    """
    instance, rng = UnitInstance(unit).initialise({"sensors.seed": float(seed)}), np.random.default_rng(seed)
    own = randomise_leg_lengths(vehicle, seed=seed)
    plant = SimulatedPlant(
        own, World(), DrydenWind(step_s=1.0 / SENSOR_RATE_HZ), SENSOR_RATE_HZ, standing_state(own, (0.0, 0.0), 0.0)
    )
    sensors, estimator = (
        make_fitted_sensors(vehicle, World(), seed=seed),
        KalmanEstimator(vehicle, World(), SENSOR_RATE_HZ, code="c"),
    )
    sensors.reset()
    hover = find_trim(vehicle).input
    u, wind, largest, different, on_floor = np.zeros(4), np.zeros(3), 0.0, 0, 0
    steps = round(duration_s * SENSOR_RATE_HZ)
    for k in range(steps + 1):
        if k:
            u = np.clip(u + rng.normal(0.0, [0.02, 0.02, 0.1, 0.1]) + 0.1 * (hover - u), [0.0, 0.0, -1.0, -1.0], 1.0)
            wind = 0.95 * wind + rng.normal(0.0, 0.2, 3)
            plant.wind = wind
            advance_period(
                plant.state, u, wind, plant.packed_parameters, plant.step_s, plant.step_count, plant.battery_output
            )
            plant.advance_clock(1)
            instance.check_status(instance.set_values_by_name(dict(zip(unit.inputs, (*u, *wind), strict=True))))
            instance.check_status(instance.do_step((k - 1) / SENSOR_RATE_HZ, 1.0 / SENSOR_RATE_HZ))
        truth = plant.truth
        readings = sensors.read(truth)
        here = _sensed_values(unit.outputs, truth, readings, estimator.update(readings, u))
        there = instance.get_values(list(here))
        values = np.array(list(here.values()))
        different += not np.array_equal(there, values, equal_nan=True)
        largest = max(largest, float(np.nanmax(np.abs(there - values))))
        on_floor += bool(truth.state[2] + plant.parameters["contact_reach"] > 0.0)
    instance.free_instance()
    return UnitComparison(steps=steps, different=different, on_floor=on_floor, largest_difference=largest)


def _sensed_values(outputs: Sequence[str], truth: Truth, readings: Readings, estimate: Estimate) -> dict[str, float]:
    """Return state, readings and estimate of the Python simulation by the names of a unit's outputs."""
    values = dict(zip(outputs[:STATE_SIZE], truth.state.tolist(), strict=True))
    for sensor, rows in SENSORS.items():
        for reading in (readings.latest.get(row.name) for row in rows[:1]):
            if reading is not None and f"sensor.{sensor}.time" in outputs:
                values |= {f"sensor.{sensor}.time": reading.time_s, f"sensor.{sensor}.valid": float(reading.valid)}
    for name, reading in readings.latest.items():
        places = [o for o in outputs if o == f"sensor.{name}" or o.startswith(f"sensor.{name}_")]
        values |= dict(zip(places, np.atleast_1d(reading.value).tolist(), strict=bool(places)))
    more = estimate.auxiliary_states
    assert more is not None
    ned, body, angles = ("north", "east", "down"), ("x", "y", "z"), ("roll", "pitch", "yaw")
    groups = (
        (estimate.position, "position_", ned, ERROR_POSITION), (estimate.velocity, "velocity_", ned, ERROR_VELOCITY),
        (estimate.attitude, "", angles, ERROR_ATTITUDE), (more.gyro_bias, "gyro_bias_", body, ERROR_GYRO_BIAS),
        (more.accelerometer_bias, "accelerometer_bias_", body, ERROR_ACCEL_BIAS),
        (more.wind, "wind_", ned[:2], ERROR_WIND), ([more.thrust_scale], "thrust_scale", ("",), ERROR_THRUST_SCALE),
    )  # fmt: skip
    for numbers, prefix, ends, error in groups:
        for k, end in enumerate(ends):
            values[f"estimate.{prefix}{end}"] = float(numbers[k])
            angle = error == ERROR_ATTITUDE  # its sigma is about N, E, D; the covariance that of roll, pitch, yaw
            values[f"estimate.sigma.{prefix}{end}"] = (
                math.sqrt(estimate.covariance[error + k, error + k])
                if angle
                else float(more.error_state_sigma[error + k])
            )
    values |= {f"estimate.{axis}_rate": float(rate) for axis, rate in zip(angles, estimate.rates, strict=True)}
    return {**values, "estimate.valid": float(estimate.valid)}


def check_fmu_file(file: Path, vehicle: Vehicle) -> UnitComparison:
    """Compare the library in an archive with the Python model of a vehicle; see :func:`compare_fmu_with_model`.

    A unit with sensors contains the sensor errors of the seeds 0 to ``seed_count - 1``; the last one is compared.

    Parameters
    ----------
    file : Path
        Archive with a library for this machine.
    vehicle : Vehicle
    """
    with tempfile.TemporaryDirectory(prefix="mufly-fmu-") as folder:
        unit = UnitLibrary(file, Path(folder))
        if unit.seed_count:
            return compare_sensed_fmu_with_model(unit, vehicle, seed=unit.seed_count - 1)
        return compare_fmu_with_model(unit, model_parameters(vehicle))
