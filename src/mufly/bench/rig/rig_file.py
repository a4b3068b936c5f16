"""Bench file (TOML): devices, load cell calibration and uncertainties. For example:

name = "bench in the cellar"
cells = "load_cells.csv"                    # calibration, beside this file: see docs/reference/bench.md

[[device]]
kind = "epos"
port = "/dev/ttyUSB0"
axes = ["upper"]

[[device]]
kind = "cells"
port = "/dev/ttyACM0"
channels = ["thrust_raw", "torque_raw"]
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field, model_validator

from mufly.bench.bench_loads import fit_cell_calibration
from mufly.bench.bench_table import read_bench_file
from mufly.bench.rig.bench_devices import BenchFacts, Clock, Device, DeviceRig, calibration_to_dict
from mufly.bench.rig.epos_controller import EposController
from mufly.bench.rig.esc_bridge import EscBridge
from mufly.bench.rig.ni_daq import NiDaq
from mufly.bench.rig.serial_load_cells import ADC_COUNT_RANGE, SerialLoadCells
from mufly.bench.rig.thrust_stand import ThrustStand
from mufly.bench.series.series_plan import RotorSide
from mufly.errors import InputError
from mufly.files.input_files import make_validation_error, read_toml, validate_model
from mufly.vehicle.quantity import ParameterGroup


class DeviceTable(ParameterGroup):
    """Table of one device in the bench file."""

    kind: Literal["epos", "esc", "stand", "cells", "nidaq"] = Field(
        description="'epos', 'esc', 'stand', 'cells' or 'nidaq'"
    )
    port: str = Field(default="", description="serial port")
    baud: int = Field(default=115_200, ge=300, description="baud rate of the port")
    axes: tuple[RotorSide, ...] = Field(default=(), description="axis that the device drives: 'upper' or 'lower'")
    channels: tuple[str, ...] = Field(default=(), description="names of the load cells, in the device's order")
    node: int = Field(default=1, ge=1, le=127, description="EPOS: node")
    generation: Literal[2, 4] = Field(default=4, description="EPOS: 2 or 4")
    direction: Literal[-1, 1] = Field(default=1, description="EPOS: sense of rotation with upward thrust")
    gear: float = Field(default=1.0, gt=0, description="EPOS: motor speed over rotor speed")
    inputs: dict[str, str] = Field(default_factory=dict, description="nidaq: channel to input, as 'Dev1/ai0'")
    scale: dict[str, float] = Field(default_factory=dict, description="nidaq: units of each channel per volt")
    rate_Hz: float = Field(default=100.0, gt=0, description="nidaq: readings per second")
    average: int = Field(default=20, ge=1, description="nidaq: samples averaged to one reading")
    range_V: float = Field(default=10.0, gt=0, description="nidaq: range of the inputs, plus and minus")

    @model_validator(mode="after")
    def _check_consistency(self) -> DeviceTable:
        if self.kind == "nidaq" and self.port:
            raise make_validation_error("does not belong to a nidaq", "remove port; inputs name the device", "port")
        if self.kind != "nidaq" and not self.port:
            raise make_validation_error("is missing", 'write port = "/dev/ttyUSB0"', "port")
        if self.kind == "nidaq" and not self.inputs:
            raise make_validation_error("names no inputs", 'write inputs = { thrust_raw = "Dev1/ai0" }', "inputs")
        if self.kind in ("epos", "stand") and len(self.axes) != 1:
            raise make_validation_error("drives exactly one axis", 'write axes = ["upper"]', "axes")
        if self.kind == "esc" and not self.axes:
            raise make_validation_error("names no axis", 'write axes = ["upper"]', "axes")
        return self

    def make_driver(self, pace: float) -> Device:
        """Return the driver of the device, not yet connected."""
        if self.kind == "epos":
            return EposController(self.port, self.axes[0], baud=self.baud, node=self.node, generation=self.generation,
                        direction=self.direction, gear=self.gear)  # fmt: skip
        if self.kind == "esc":
            return EscBridge(self.port, self.axes, baud=self.baud)
        if self.kind == "stand":
            return ThrustStand(self.port, self.axes[0], baud=self.baud, pace=pace)
        if self.kind == "cells":
            return SerialLoadCells(self.port, self.channels or ("thrust_raw", "torque_raw"), baud=self.baud)
        return NiDaq(self.inputs, scale=self.scale, rate_Hz=self.rate_Hz, average=self.average, range_V=self.range_V)

    def cell_reading_ranges(self) -> dict[str, tuple[float, float]]:
        """Return the range of the readings of each load cell channel."""
        if self.kind == "cells":
            return dict.fromkeys(self.channels or ("thrust_raw", "torque_raw"), ADC_COUNT_RANGE)
        if self.kind == "nidaq":
            # 0.1 % margin, because the trimmed range of converters may be slightly smaller.
            ends = {n: 0.999 * self.range_V * self.scale.get(n, 1.0) for n in self.inputs if n.endswith("_raw")}
            return {n: (-e, e) for n, e in ends.items()}
        return {}


class RigTable(ParameterGroup):
    """Contents of a bench file: devices, calibration of the load cells, and uncertainties."""

    name: str = Field(min_length=1, description="name of the bench")
    cells: str = Field(default="", description="calibration file of the cells; none if readings are loads")
    device: tuple[DeviceTable, ...] = Field(min_length=1, description="devices")
    upper_torque_sign: Literal[-1, 1] = Field(
        default=1, description="sign of the upper rotor's torque on the torque cell"
    )
    lower_torque_sign: Literal[-1, 1] = Field(
        default=-1, description="sign of the lower rotor's torque on the torque cell"
    )
    pressure_std_Pa: float = Field(default=100.0, ge=0, description="standard uncertainty")
    temperature_std_K: float = Field(default=0.3, ge=0, description="standard uncertainty")
    humidity_std: float = Field(default=0.03, ge=0, le=1, description="standard uncertainty")
    nonlinearity: dict[str, float] = Field(
        default_factory=dict, description="nonlinearity of each load, as a share of full scale"
    )
    full_scale: dict[str, float] = Field(default_factory=dict, description="full scale of each load, N or N m")
    poll_Hz: float = Field(default=20.0, gt=0, le=1000, description="rate at which the devices are read")
    manual: bool = Field(default=True, description="true if a person changes the blades")
    pace: float = Field(default=1.0, gt=0, le=100, description="seconds of an emulated bench per second of real time")

    @model_validator(mode="after")
    def _check_axes(self) -> RigTable:
        axes = [a for d in self.device for a in d.axes]
        if not axes:
            raise make_validation_error(
                "no device drives an axis", 'write axes = ["upper"] for a device with a motor', "device"
            )
        if len(axes) != len(set(axes)):
            raise make_validation_error("two devices drive the same axis", "give each axis one device", "device")
        return self


def load_rig(path: str | Path) -> DeviceRig:
    """Create the bench described by a file, without opening its devices.

    Raises
    ------
    InputError
        If the file does not exist, or the file or the calibration is invalid.
    """
    file = Path(path)
    if not file.is_file():
        raise InputError(str(path), "", "no such bench", "give 'sim' or a bench file (docs/reference/bench.md)")
    tables, where = read_toml(file, file.parent, "bench")
    table = validate_model(RigTable, tables, where)
    calibration = {}
    ranges = {n: r for d in table.device for n, r in d.cell_reading_ranges().items()}
    if table.cells:
        calibration = calibration_to_dict(fit_cell_calibration(read_bench_file(file.parent / table.cells)))
        raw = {f"{c}_raw" for c in calibration["channels"]}
        if ranges and not raw <= set(ranges):
            missing = ", ".join(sorted(raw - set(ranges)))
            raise InputError(
                where, "cells", f"calibrates {missing}, which no device measures", "name it in its channels"
            )
    elif any(n.endswith("_raw") for n in ranges):
        raise InputError(where, "cells", "is missing, but there are raw readings", "give the calibration file")
    facts = BenchFacts(
        table.name, calibration, ranges, table.nonlinearity, table.full_scale, table.pressure_std_Pa,
        table.temperature_std_K, table.humidity_std,
        torque_signs={"upper": float(table.upper_torque_sign), "lower": float(table.lower_torque_sign)},
        manual=table.manual,
    )  # fmt: skip
    return DeviceRig([d.make_driver(table.pace) for d in table.device], facts, Clock(table.pace), table.poll_Hz)
