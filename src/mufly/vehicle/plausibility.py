"""Warnings about possible but unusual parameters of a vehicle: wrong units, exchanged values, typing errors.

Impossible values are refused when the file is read (:mod:`mufly.vehicle.vehicle_schema`). The limits here come from
dimensional analysis or from the physics of small coaxial helicopters; each rule states its limit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from mufly.quantities.units import GRAVITY
from mufly.vehicle.vehicle_schema import Vehicle, compute_vehicle_reach_m

_MAX_DRAG_AREA_TO_DISC_AREA = 1.0  # a blunt body as large as the rotor disc has 1.0
_MAX_INERTIA_TO_OTHERS_SUM = 1.5  # a rigid body has up to 1; Izz is the fuselage's alone, and estimates are uncertain
_HUB_SPACING_RADII_RANGE = 0.05, 2.0  # rotor spacing over radius; blades touch below, the mast flexes above
_MAX_LEG_SPAN_RATIO = 3.0  # horizontal distance of a leg's tip over the rotor radius
_MIN_ACCELEROMETER_RANGE_G = 2.0  # standing and vibration take 1 g each
_MIN_GYRO_RANGE_RAD_S = 2.0  # gusts and control turn a helicopter of 0.1 kg by about 1 rad/s
_MAX_SPECIFIC_ENERGY_WH_KG = 300.0  # lithium cells, 2025
_ASSUMED_BATTERY_MASS_FRACTION = 0.5  # of the take-off mass, where the mass budget is missing
_MAX_SONAR_BLIND_HEIGHT_M = 0.3  # height up to which the estimator accepts the sonar's word about lift-off
_AIR_DENSITY_RANGE_KG_M3 = 0.3, 1.6  # kg/m3: 11 km height; sea level at -50 degC
_EARTH_FIELD_RANGE_T = 15e-6, 100e-6  # the Earth's field is 22 to 67 uT


class UnusualParameter(NamedTuple):
    """Parameter with an unusual value, and what to check."""

    key: str
    problem: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.key}: {self.problem}; {self.remedy}"


def find_unusual_parameters(vehicle: Vehicle) -> list[UnusualParameter]:
    """Return the parameters of a valid vehicle whose values are unusual, in the order of the file."""
    return [
        *_check_body(vehicle),
        *_check_rotors(vehicle),
        *_check_stabiliser_bar(vehicle),
        *_check_battery(vehicle),
        *_check_legs(vehicle),
        *_check_sensors(vehicle),
    ]


def _check_body(v: Vehicle) -> Iterator[UnusualParameter]:
    radius, mass, reach = float(v.rotors.radius), float(v.body.mass), compute_vehicle_reach_m(v)
    disc = math.pi * radius**2
    for axis in "xyz":
        area = float(getattr(v.body, f"drag_area_{axis}"))
        if area > _MAX_DRAG_AREA_TO_DISC_AREA * disc:
            yield UnusualParameter(
                f"body.drag_area_{axis}",
                f"{area:.3g} m2 is {area / disc:.2g} times the rotor disc's area, {disc:.3g} m2",
                "check the unit: a body of 4 x 10 cm has 0.004 m2",
            )
    inertia = {axis: float(getattr(v.body, f"inertia_{2 * axis}")) for axis in "xyz"}
    for axis, value in inertia.items():
        others = sum(inertia.values()) - value
        if value > _MAX_INERTIA_TO_OTHERS_SUM * others:
            yield UnusualParameter(
                f"body.inertia_{2 * axis}",
                f"{value:.3g} kg m2 exceeds the sum of the two others, {others:.3g} kg m2, which no rigid body does",
                "check the three moments of inertia",
            )
        elif value > mass * reach**2:
            yield UnusualParameter(
                f"body.inertia_{2 * axis}",
                f"{value:.3g} kg m2 exceeds that of all the mass at the farthest rotor tip or leg, "
                f"{mass * reach**2:.3g} kg m2",
                "check the unit and body.mass",
            )
    low, high = _AIR_DENSITY_RANGE_KG_M3
    if not low <= float(v.air.density) <= high:
        yield UnusualParameter(
            "air.density", f"{float(v.air.density):.3g} kg/m3 is not that of air", f"give {low:g} to {high:g} kg/m3"
        )


def _check_rotors(v: Vehicle) -> Iterator[UnusualParameter]:
    radius = float(v.rotors.radius)
    spacing = float(v.rotors.lower.hub_z) - float(v.rotors.upper.hub_z)
    low, high = _HUB_SPACING_RADII_RANGE
    if not low <= spacing / radius <= high:
        yield UnusualParameter(
            "rotors.upper.hub_z",
            f"the hubs are {1e3 * spacing:.3g} mm apart, {spacing / radius:.2g} rotor radii",
            f"check both hub_z: {low:g} to {high:g} radii are usual",
        )


def _check_stabiliser_bar(v: Vehicle) -> Iterator[UnusualParameter]:
    if not v.stabiliser_bar.fitted:
        yield UnusualParameter(
            "stabiliser_bar.fitted",
            "false: without the bar the helicopter is unstable and falls over within a second without control; a "
            "descent after the loss of the attitude or of the gyroscopes is not safe",
            "fly it only with a cage or a tether first; `mufly control servo-map` shows the servos and rate it needs",
        )


def _check_battery(v: Vehicle) -> Iterator[UnusualParameter]:
    b, curve = v.battery, v.battery.open_circuit_voltage.value
    nominal = float(b.nominal_voltage)
    if b.model != "constant" and not min(curve) <= nominal <= max(curve):
        yield UnusualParameter(
            "battery.nominal_voltage",
            f"{nominal:g} V is outside the open-circuit voltage, {min(curve):g} to {max(curve):g} V",
            "check the number of cells",
        )
    if v.mass_budget is not None and float(v.mass_budget.battery) > 0.0:
        mass = float(v.mass_budget.battery)
    else:
        mass = _ASSUMED_BATTERY_MASS_FRACTION * float(v.body.mass)
    energy = nominal * float(b.capacity) / 3600.0
    if energy > _MAX_SPECIFIC_ENERGY_WH_KG * mass:
        yield UnusualParameter(
            "battery.capacity",
            f"{float(b.capacity) / 3.6:.4g} mA h at {nominal:g} V are {energy / mass:.3g} W h/kg in {1e3 * mass:.3g} g",
            f"check the unit (mA h or A s) and the battery's mass; cells store up to {_MAX_SPECIFIC_ENERGY_WH_KG:g}",
        )


def _check_legs(v: Vehicle) -> Iterator[UnusualParameter]:
    radius = float(v.rotors.radius)
    tips = v.contact.legs.to_array()
    away = float(np.hypot(tips[:, 0], tips[:, 1]).max())
    if away > _MAX_LEG_SPAN_RATIO * radius:
        yield UnusualParameter(
            "contact.legs",
            f"a tip is {away:.3g} m beside the centre of gravity, {away / radius:.2g} rotor radii",
            "check the unit",
        )
    angles = np.sort(np.arctan2(tips[:, 1], tips[:, 0]))
    gaps = np.diff(np.append(angles, angles[0] + 2.0 * math.pi))
    if gaps.max() >= math.pi - 1e-9:
        yield UnusualParameter(
            "contact.legs",
            "the tips do not surround the centre of gravity: the standing vehicle tips over",
            "place legs on all sides",
        )


def _check_sensors(v: Vehicle) -> Iterator[UnusualParameter]:
    if v.sensors is None:
        return
    reach = compute_vehicle_reach_m(v)
    for name in ("imu", "sonar"):
        sensor = getattr(v.sensors, name)
        away = 0.0 if sensor is None else math.hypot(*sensor.position.value[0])
        if away > reach:
            yield UnusualParameter(
                f"sensors.{name}.position",
                f"{away:.3g} m from the centre of gravity; rotors and legs reach {reach:.3g} m",
                "check the unit",
            )
    if (imu := v.sensors.imu) is not None:
        if float(imu.accelerometer_range) < _MIN_ACCELEROMETER_RANGE_G * GRAVITY:
            yield UnusualParameter(
                "sensors.imu.accelerometer_range",
                f"{float(imu.accelerometer_range):.3g} m/s^2 is below {_MIN_ACCELEROMETER_RANGE_G:g} g: vibration "
                "clips it",
                "check the unit (gee or m/s^2)",
            )
        if float(imu.gyro_range) < _MIN_GYRO_RANGE_RAD_S:
            yield UnusualParameter(
                "sensors.imu.gyro_range",
                f"{float(imu.gyro_range):.3g} rad/s is below {_MIN_GYRO_RANGE_RAD_S:g} rad/s: gusts clip it",
                "check the unit (rad/s or deg/s)",
            )
        if float(imu.bandwidth) * float(imu.sample_period) > math.pi:
            yield UnusualParameter(
                "sensors.imu.bandwidth",
                f"{float(imu.bandwidth):.3g} rad/s is above half the sample rate, "
                f"{math.pi / float(imu.sample_period):.3g} rad/s",
                "lower it, or shorten sample_period",
            )
    if (sonar := v.sensors.sonar) is not None:
        x, y, z = sonar.position.value[0]
        if z < float(v.rotors.lower.hub_z) and math.hypot(x, y) < float(v.rotors.radius):
            yield UnusualParameter(
                "sensors.sonar.position",
                f"z = {z:g} m is above the lower rotor, z = {float(v.rotors.lower.hub_z):g} m: the beam meets blades",
                "give a place below the rotors",
            )
        blind = float(sonar.min_range) - (max(tip[2] for tip in v.contact.legs.value) - z)
        if blind > _MAX_SONAR_BLIND_HEIGHT_M:
            yield UnusualParameter(
                "sensors.sonar.min_range",
                f"{float(sonar.min_range):g} m: the sonar is blind up to {blind:.2g} m above the floor",
                "check the unit",
            )
    if (compass := v.sensors.magnetometer) is not None:
        low, high = _EARTH_FIELD_RANGE_T
        if not low <= float(compass.field_strength) <= high:
            yield UnusualParameter(
                "sensors.magnetometer.field_strength",
                f"{1e6 * float(compass.field_strength):.3g} uT is not the Earth's field",
                f"give {1e6 * low:g} to {1e6 * high:g} uT",
            )
    if (monitor := v.sensors.battery) is not None:
        step, nominal = float(monitor.voltage_resolution), float(v.battery.nominal_voltage)
        if step > 0.05 * nominal:
            yield UnusualParameter(
                "sensors.battery.voltage_resolution",
                f"{step:.3g} V is {step / nominal:.0%} of the nominal voltage, {nominal:g} V",
                "check the unit",
            )
