"""Drivers of sensors against register models with errors, time-outs, wrong identity, stuck bus; signals of actuators.

No driver has met its device; registers and formulas are those of the data sheets.
"""

from __future__ import annotations

import numpy as np
import pytest
from driver_library import load_drivers, needs_cc

from mufly.estimate.filter.filter_records import (
    READING_ACCELERATION,
    READING_BATTERY,
    READING_PRESSURE,
    READING_RATES,
    READING_SONAR,
    READING_STARTS,
)
from mufly.sensors.pressure import STANDARD_PRESSURE_PA

pytestmark = needs_cc
IMU, BAROMETER, SONAR, LASER = range(4)
REFUSES, SILENT, UNKNOWN, FORGETS, IMPLAUSIBLE = 1, 2, 4, 8, 16  # of register_device.h
PERIOD_US = 5000
G = 9.80665
CALIBRATION = (27504, 26435, -1000, 36477, -10685, 3024, 2855, 140, -7, 15500, -14600, 6000)
"""Example of the data sheet of the BMP280, section 3.12: 519888 and 415148 give 25.08 degrees and 100653 Pa."""


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    sources = ["onboard/drivers/**/*.c", "check/models/bus_model.c", "check/models/sd_bus_model.c"]
    headers = ["onboard/drivers/sensor_suite", "onboard/drivers/actuator_outputs", "check/models/bus_model"]
    return load_drivers(tmp_path_factory.mktemp("drivers"), sources, headers)


def _words(values, big=True) -> list[int]:
    return [b for v in values for b in (v & 0xFFFF).to_bytes(2, "big" if big else "little")]


class Bench:
    """The sensors of a board on models of their devices."""

    def __init__(self, library, on_spi=True, laser=False) -> None:
        self.ffi, self.lib = library
        self.buses = self.ffi.new("bus_model_t *", {"barometer_on_spi": on_spi})
        self.lib.bus_model_attach(self.buses)
        for device in range(4):
            self.lib.bus_model_reset(self.buses, device)
        self.put(BAROMETER, 0x88, _words(CALIBRATION, big=False))
        self.put(BAROMETER, 0xF7, [*self.raw20(415148), *self.raw20(519888)])
        self.put(SONAR, 2, _words([2330]))
        self.buses.devices[LASER].takes_us = 33_000
        self.put_laser(9, 400)
        self.suite, self.readings = self.ffi.new("sensor_suite_t *"), self.ffi.new("hal_readings_t *")
        self.now_us = 2**32 - 300_000  # the clock runs over during the test
        self.rng = np.random.default_rng(1)
        self.imu_counts = [200, -100, 2048, 33, 164, -82]
        self.noise, self.fresh = True, dict.fromkeys(range(9), 0)
        ranging = self.lib.RANGING_VL53L1X if laser else self.lib.RANGING_SRF10
        self.lib.sensor_suite_start(self.suite, on_spi, ranging, self.now_us)

    @staticmethod
    def raw20(value) -> list[int]:
        return [value >> 12, value >> 4 & 0xFF, (value & 0xF) << 4]

    def put(self, device, address, data) -> None:
        for k, value in enumerate(data):
            self.buses.devices[device].registers[address + k] = value

    def put_laser(self, status, range_mm) -> None:
        self.put(LASER, 0x89, [0xE0 | status, *[0x55] * 12, *_words([range_mm])])

    def run(self, seconds, voltage=-1.0) -> None:
        self.fresh = dict.fromkeys(range(9), 0)
        for _ in range(round(seconds * 200)):
            self.now_us = (self.now_us + PERIOD_US) % 2**32
            self.buses.now_us = self.now_us
            noise = int(self.rng.integers(0, 9)) if self.noise else 0
            self.put(IMU, 0x1D, _words([1325 + noise, *self.imu_counts]))
            self.lib.sensor_suite_read(self.suite, self.now_us, voltage, self.readings)
            for k in self.fresh:
                self.fresh[k] += self.readings.fresh[k] == 1

    def value(self, reading, width=1) -> list[float]:
        return [self.readings.z[READING_STARTS[reading] + i] for i in range(width)]

    def device(self, number):
        return (self.suite.imu, self.suite.barometer, self.suite.sonar, self.suite.laser)[number].device


@pytest.mark.parametrize("on_spi", [True, False])
def test_all_sensors_give_readings_in_body_axes_and_si_units(library, on_spi) -> None:
    bench = Bench(library, on_spi)
    bench.run(1.0, voltage=7.4)
    bench.run(1.0, voltage=7.4)
    assert bench.fresh[READING_ACCELERATION] == bench.fresh[READING_RATES] == bench.fresh[READING_BATTERY] == 200
    assert 15 <= bench.fresh[READING_PRESSURE] <= 20
    assert 25 <= bench.fresh[READING_SONAR] <= 34
    assert bench.value(READING_ACCELERATION, 3) == pytest.approx([200 * G / 2048, 100 * G / 2048, -G])
    assert bench.value(READING_RATES, 3) == pytest.approx(np.radians([33 / 16.4, -10.0, 5.0]))
    assert bench.suite.barometer.temperature == pytest.approx(25.08, abs=0.005)
    assert bench.value(READING_PRESSURE)[0] + STANDARD_PRESSURE_PA == pytest.approx(100653.27, abs=0.1)
    assert bench.value(READING_SONAR)[0] == pytest.approx(0.4, abs=1e-3)  # 2330 us there and back at 343.4 m/s
    assert bench.suite.imu.temperature == pytest.approx(298.15 + 1329 / 132.48, abs=0.1)
    assert not any(bench.device(k).fault_count for k in range(3))
    registers = bench.buses.devices[IMU].registers
    assert [registers[k] for k in (0x4E, 0x4F, 0x50)] == [0x0F, 0x06, 0x06]


@pytest.mark.parametrize("device", [IMU, BAROMETER, SONAR, LASER])
@pytest.mark.parametrize(
    ("fault", "bit"),
    [("refuses", REFUSES), ("reports_error", REFUSES), ("is_silent", SILENT)],
)
def test_a_failing_bus_is_named_and_comes_back(library, device, fault, bit) -> None:
    bench = Bench(library, laser=device == LASER)
    ranging = LASER if device == LASER else SONAR
    kinds = {IMU: READING_ACCELERATION, BAROMETER: READING_PRESSURE, ranging: READING_SONAR}
    bench.run(0.5)
    setattr(bench.buses.devices[device], fault, True)
    bench.run(1.0)
    bench.run(1.0)
    assert bench.fresh[kinds.pop(device)] == 0
    assert all(bench.fresh[k] > 10 for k in kinds.values())  # the others go on
    assert bench.device(device).faults == bit
    tried = bench.buses.devices[device].transfers
    assert tried < 400  # it pauses between its attempts
    setattr(bench.buses.devices[device], fault, False)
    bench.run(1.0)
    assert bench.device(device).faults == 0
    assert bench.fresh[{IMU: READING_ACCELERATION, BAROMETER: READING_PRESSURE}.get(device, READING_SONAR)] > 6


def test_a_stuck_bus_is_aborted_until_it_is_free(library) -> None:
    bench = Bench(library)
    bench.run(0.5)
    model = bench.buses.devices[SONAR]
    model.is_silent, model.stuck_aborts = True, 3
    bench.run(1.5)
    assert model.aborts == 3
    assert bench.fresh[READING_SONAR] > 20
    assert bench.device(SONAR).faults == 0


@pytest.mark.parametrize(
    ("device", "address"), [(IMU, 0x75), (BAROMETER, 0xD0), (SONAR, 1), (LASER, 0x10F), (LASER, 0x110)]
)
def test_another_device_is_not_used(library, device, address) -> None:
    bench = Bench(library)
    # A reset gives the model its own identity again: hold another one by a bus that floats.
    for value in (0x00, 0xFF, 0x12):
        bench = Bench(library, laser=device == LASER)
        bench.buses.devices[device].registers[address] = value
        # The first transfers reset the device; the identity stays the other one.
        for _ in range(200):
            bench.run(0.005)
            bench.buses.devices[device].registers[address] = value
        assert bench.device(device).faults & UNKNOWN
        assert bench.fresh[{IMU: READING_ACCELERATION, BAROMETER: READING_PRESSURE}.get(device, READING_SONAR)] == 0


def test_settings_that_do_not_hold_and_a_reset_in_flight_are_noticed(library) -> None:
    bench = Bench(library)
    bench.buses.devices[IMU].held = 0x50
    bench.run(1.0)
    assert bench.device(IMU).faults == FORGETS
    assert bench.fresh[READING_ACCELERATION] == 0
    # A brown-out of the unit alone: it sleeps, its registers hold the last sample.
    bench = Bench(library)
    bench.run(0.5)
    bench.noise = False
    bench.run(0.15)
    assert bench.device(IMU).faults == IMPLAUSIBLE
    bench.noise = True
    bench.run(1.0)
    assert bench.device(IMU).faults == 0
    assert bench.fresh[READING_ACCELERATION] > 150


def test_data_that_cannot_be_are_no_readings(library) -> None:
    bench = Bench(library)
    bench.imu_counts = [-32768] * 6
    bench.run(1.0)
    assert bench.device(IMU).faults == IMPLAUSIBLE
    bench.imu_counts = [32767, -32768, 5, 1, 2, 3]
    bench.run(1.0)
    assert list(bench.suite.imu.clipping) == [1.0, 1.0, 0.0]
    for raw in (0x80000, 0, 0xFFFFF):
        bench.put(BAROMETER, 0xF7, bench.raw20(raw))
        bench.run(0.6)
        assert bench.device(BAROMETER).faults == IMPLAUSIBLE, raw
    bench = Bench(library)
    bench.put(BAROMETER, 0x88, [0] * 24)
    bench.run(1.0)
    assert bench.device(BAROMETER).faults == IMPLAUSIBLE
    assert bench.fresh[READING_PRESSURE] == 0
    for place, value in ((0, 0), (0, 0xFFFF), (3, 0)):  # of the calibration: temperature, pressure
        bench = Bench(library)
        bench.put(BAROMETER, 0x88 + 2 * place, _words([value], big=False))
        bench.run(1.0)
        assert bench.device(BAROMETER).faults == IMPLAUSIBLE, (place, value)
        assert bench.fresh[READING_PRESSURE] == 0
    # One unit of the inertial unit without samples is no fault of both.
    bench = Bench(library)
    bench.imu_counts = [-32768] * 3 + [1, 2, 3]
    bench.run(1.0)
    assert bench.device(IMU).faults == 0
    # Nothing within range is an invalid reading, not silence; a device that still listens is a fault.
    bench = Bench(library)
    bench.put(SONAR, 2, _words([0]))
    seen = set()
    for _ in range(100):
        bench.run(0.005)
        seen.add(bench.readings.fresh[READING_SONAR])
    assert seen == {0, 2}
    bench.put(SONAR, 2, _words([40_000]))  # 6.9 m, beyond twice its reach
    bench.run(0.5)
    assert bench.device(SONAR).faults == IMPLAUSIBLE
    bench = Bench(library)
    bench.put(SONAR, 2, [0xFF, 0xFF])
    bench.run(0.5)
    assert bench.device(SONAR).faults == IMPLAUSIBLE


def test_the_laser_measures_on_demand_and_judges_its_status(library) -> None:
    bench = Bench(library, laser=True)
    bench.run(1.0)
    bench.run(1.0)
    assert 14 <= bench.fresh[READING_SONAR] <= 17
    assert bench.value(READING_SONAR)[0] == pytest.approx(0.4)
    assert (bench.device(LASER).fault_count, bench.buses.devices[SONAR].transfers) == (0, 0)
    registers = bench.buses.devices[LASER].registers
    # Long distance in 33 ms, of ST's driver; ready is active high.
    assert [registers[k] for k in (0x5E, 0x5F, 0x60, 0x61, 0x62, 0x63, 0x69)] == [0, 0x60, 15, 0, 0x6E, 13, 0xB8]
    assert (registers[0x64] << 8 | registers[0x65]) / 4 == 90.0  # mm
    assert (registers[0x66] << 8 | registers[0x67]) / 128 == 1.0  # million counts per second
    # Statuses: complete; no target, phase, sigma, wrapped: invalid; broken: a fault; the first of a stream: nothing.
    for status, expected in ((9, {0, 1}), (4, {0, 2}), (5, {0, 2}), (6, {0, 2}), (7, {0, 2}), (8, {0, 2}), (18, {0})):
        bench.put_laser(status, 1234)
        bench.run(0.2)
        seen = set()
        for _ in range(60):
            bench.run(0.005)
            seen.add(bench.readings.fresh[READING_SONAR])
        assert seen == expected, status
        assert bench.device(LASER).faults == 0
    for status in (0, 1, 2, 3, 17):
        bench.put_laser(status, 1234)
        bench.run(0.2)
        assert bench.device(LASER).faults & IMPLAUSIBLE, status
        bench.put_laser(9, 1234)
        bench.run(1.0)
        assert bench.device(LASER).faults == 0
    for range_mm, expected in ((39, 2), (40, 1), (3600, 1), (3601, 2), (65535, 2)):
        bench.put_laser(9, range_mm)
        bench.run(0.2)
        while not bench.readings.fresh[READING_SONAR]:
            bench.run(0.005)
        assert bench.readings.fresh[READING_SONAR] == expected, range_mm


def test_a_slow_laser_is_waited_for_and_a_dead_one_starts_again(library) -> None:
    bench = Bench(library, laser=True)
    model = bench.buses.devices[LASER]
    bench.run(1.0)
    model.takes_us = 90_000
    bench.run(1.0)
    bench.run(1.0)
    assert 7 <= bench.fresh[READING_SONAR] <= 9
    assert bench.device(LASER).fault_count == 0
    model.takes_us = 10_000_000
    bench.run(0.2)
    resets = model.resets
    bench.run(1.0)
    assert bench.device(LASER).faults == SILENT
    assert model.resets > resets
    assert bench.fresh[READING_SONAR] == 0
    model.takes_us = 33_000
    bench.run(1.5)
    assert bench.device(LASER).faults == 0
    for register, value in ((0x60, 0x0F), (0x81, 0x9B)):  # a setting that does not hold
        bench = Bench(library, laser=True)
        model = bench.buses.devices[LASER]
        model.held = register
        bench.run(1.5)
        assert (bench.device(LASER).faults, bench.fresh[READING_SONAR]) == (FORGETS, 0)
        model.held = 0
        bench.run(1.5)
        assert model.registers[register] == value
        assert bench.fresh[READING_SONAR] > 5


def test_slow_transfers_give_fewer_readings_and_no_fault(library) -> None:
    bench = Bench(library)
    for device in range(3):
        bench.buses.devices[device].polls = 3
    bench.buses.devices[BAROMETER].polls = bench.buses.devices[SONAR].polls = 1
    bench.run(1.0)
    bench.run(1.0)
    assert 60 <= bench.fresh[READING_ACCELERATION] <= 101
    assert bench.fresh[READING_PRESSURE] > 10
    assert not any(bench.device(k).fault_count for k in range(3))


def test_random_faults_of_all_buses_never_stop_a_period(library) -> None:
    rng = np.random.default_rng(5)
    bench = Bench(library)
    for _ in range(1500):
        for device in range(3):
            model = bench.buses.devices[device]
            if rng.random() < 0.05:
                model.refuses, model.reports_error, model.is_silent = (bool(b) for b in rng.random(3) < 0.3)
                model.registers[int(rng.integers(256))] = int(rng.integers(256))
        bench.run(0.005)
        assert np.isfinite(bench.value(READING_ACCELERATION, 3)).all()
    for device in range(3):
        model = bench.buses.devices[device]
        model.refuses = model.reports_error = model.is_silent = False
        bench.lib.bus_model_reset(bench.buses, device)
    bench.put(BAROMETER, 0x88, _words(CALIBRATION, big=False))
    bench.put(BAROMETER, 0xF7, [*bench.raw20(415148), *bench.raw20(519888)])
    bench.put(SONAR, 2, _words([2330]))
    bench.run(2.0)
    bench.run(1.0)
    assert min(bench.fresh[k] for k in (READING_ACCELERATION, READING_PRESSURE, READING_SONAR)) > 10


def test_dshot_frames_servo_pulses_and_battery(library) -> None:
    ffi, lib = library
    # Published example: throttle 1046 without telemetry is 1000001011000110.
    share = (1046 - 48) / (2047 - 48)
    assert lib.dshot_frame(share) == 0b1000001011000110
    for value, throttle in ((0.0, 0), (-1.0, 0), (float("nan"), 0), (1e-9, 48), (1.0, 2047), (5.0, 2047)):
        frame = lib.dshot_frame(value)
        assert frame >> 5 == throttle
        assert frame & 0xF == ((frame >> 4) ^ (frame >> 8) ^ (frame >> 12)) & 0xF
    out = ffi.new("uint32_t[17]")
    lib.dshot_compare_values(0b1000001011000110, 280, out)  # DShot300 at 84 MHz
    assert [v == 210 for v in out] == [c == "1" for c in "10000010110001100"]
    assert set(out) == {0, 105, 210}
    assert [lib.servo_pulse_us(v) for v in (-2.0, -1.0, 0.0, 0.5, 1.0, 3.0)] == [1000, 1000, 1500, 1750, 2000, 2000]
    assert [lib.servo_pulse_us(v) for v in (-1.2, -1.01, 1.01, 1.2)] == [1000, 1000, 2000, 2000]
    assert lib.servo_pulse_us(float("nan")) == 1500
    assert lib.battery_voltage(2048, 3.3, 11.0) == pytest.approx(18.154, abs=1e-3)
    assert lib.battery_voltage(5000, 3.3, 11.0) == -1.0


def test_a_repeated_step_at_the_start_of_the_loop_is_its_last_one(library) -> None:
    """A driver asks again for what it has just read, also where the program has gone on to the loop's start."""
    bench = Bench(library)
    bench.run(0.5)
    device = bench.ffi.addressof(bench.suite.imu, "device")
    loop_from, count = device.program.loop_from, device.program.count
    for step, expected in ((loop_from, count - 1), (count, count - 1), (loop_from + 1, loop_from)):
        device.step = step
        bench.lib.register_device_repeat(device, 1000, bench.now_us)
        assert (device.step, device.waits, device.pause_us) == (expected, True, 1000)
