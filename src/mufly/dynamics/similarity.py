"""Initial design of a vehicle of another mass and size by similarity with a known vehicle.

For the mass ratio ``mu``, the length ratio ``la`` and the same air, the rotors are geometrically similar and keep their
coefficients. Own derivation; ``w`` is the ratio of the rotor speeds in hover, ``P`` the ratio of the powers:

================================================  =========================================================
thrust = weight: c_T rho pi R^4 Omega^2           w = sqrt(mu) / la^2
power: c_Q rho pi R^5 Omega^3                     P = mu^1.5 / la (ideal power, weight^1.5 / R)
lengths, areas                                    la, la^2
inertias, of fuselage and rotors                  mu la^2 (constant mass fraction of the rotors)
bar: J over its damping rho Omega c l^4           T w = mu / la^3 (the inverse of Lock's number)
drag of the downwash on the fuselage              mu (disc loading mu / la^2 times area la^2)
rotor's inertia at the motor, gear i              J i^2 constant (eq. 4.29; the motor's part is small)
legs: static deflection scales with size          stiffness mu / la, damping mu / sqrt(la): half of critical
================================================  =========================================================

An unspecified motor is the known motor with another winding for the new voltage ``U`` and power: kE w / U, kM w / U and
R P / U^2 are constant. A motor given by its speed constant has kE = kM = 60 / (2 pi KV). Its friction follows from the
no-load current or, if unknown, from the known motor's ratio of friction to kM^2 / R, the electrical damping. The
default gear needs the least power (:func:`mufly.drive.find_least_power_gear_ratio`) with at most 80 % of the half-full
battery's
voltage in hover, which leaves a margin for control. Gear ratios are at least 1. The battery gives the same hover time
as the known one, including the electronics' power. Its cells have the same voltage curve and a resistance proportional
to 1 / capacity.

Similarity does not include scale effects (thrust per power decreases below a Reynolds number of about 30 000), the
actual mass distribution and vibration. Every value that is not given is marked as a guess.
"""

from __future__ import annotations

import math
from typing import Any

from mufly.drive import MotorConstants, find_least_power_gear_ratio
from mufly.dynamics.hover_limits import MAX_TIP_MACH, compute_tip_mach_number
from mufly.dynamics.linearisation import find_trim, hover_performance
from mufly.dynamics.model_state import compute_hover_rotor_speeds, model_parameters
from mufly.errors import ArgumentError, InputError, MuflyError
from mufly.files.input_files import validate_model
from mufly.quantities.units import RPM
from mufly.vehicle import Vehicle, find_battery_voltage_range, replace_parameters

MAX_HOVER_VOLTAGE_FRACTION = 0.8
"""Greatest motor voltage in hover over the half-full battery's voltage; the rest is a margin for climb and gusts."""


def scale_vehicle_by_similarity(
    known: Vehicle,
    name: str,
    *,
    mass_kg: float,
    radius_m: float,
    speed_constant_rad_Vs: float | None = None,
    resistance_ohm: float | None = None,
    no_load_current_A: float | None = None,
    gear_ratio: float | None = None,
    cells: int | None = None,
    capacity_As: float | None = None,
    bar: bool = True,
) -> Vehicle:
    """Return a vehicle of another mass and rotor radius; values that are not given are guessed by similarity.

    Parameters
    ----------
    known : Vehicle
        Known vehicle with a lithium-polymer battery of two cells and no coefficient map, such as ``mufly-1.1``.
    name : str
        Name of the new vehicle.
    mass_kg, radius_m : float
        Take-off mass; radius of both rotors.
    speed_constant_rad_Vs, resistance_ohm : float, optional
        Speed constant KV and armature resistance of a motor; both or neither.
    no_load_current_A : float, optional
        No-load current at the nominal voltage; requires speed constant and resistance.
    gear_ratio : float, optional
        Motor speed over rotor speed; 1 is direct drive, without losses.
    cells : int, optional
        Number of cells in series.
    capacity_As : float, optional
        Charge of the battery.
    bar : bool
        Whether the new vehicle has a stabiliser bar. Without one both rotors have the lower one's inertia.

    Returns
    -------
    Vehicle
        New vehicle; every value has a source and a note on its origin. Notes of guesses begin with ``guess:``.

    Raises
    ------
    InputError
        If a number is impossible, the vehicle cannot hover, or its tips would be supersonic. The message names the
        option without which it hovers, and a remedy.
    """
    k = known
    for key, value in (
        ("mass_kg", mass_kg), ("radius_m", radius_m), ("speed_constant_rad_Vs", speed_constant_rad_Vs),
        ("resistance_ohm", resistance_ohm), ("no_load_current_A", no_load_current_A), ("gear_ratio", gear_ratio),
        ("capacity_As", capacity_As),
    ):  # fmt: skip
        if value is not None and not (math.isfinite(value) and value > 0.0):
            raise ArgumentError(key, "", f"{value:g} is out of range", "give a number above 0")
    for key, value, most, given_in in (
        ("mass_kg", mass_kg, 20.0, "grams"),
        ("radius_m", radius_m, 2.0, "millimetres"),
    ):
        if value > most:
            unit = key.rpartition("_")[2]
            problem = f"{value:g} {unit} is outside the range of similarity"
            raise ArgumentError(key, "", problem, f"give {unit}, not {given_in}: {value / 1e3:g}")
    if cells is not None and not 1 <= cells <= 24:
        raise ArgumentError("cells", "", f"{cells} is out of range", "give 1 to 24 cells in series")
    if (speed_constant_rad_Vs is None) != (resistance_ohm is None):
        missing = "speed_constant_rad_Vs" if speed_constant_rad_Vs is None else "resistance_ohm"
        raise ArgumentError(missing, "", "is missing", "give a motor's KV and its resistance together")
    if no_load_current_A is not None and resistance_ohm is None:
        raise ArgumentError(
            "speed_constant_rad_Vs",
            "",
            "is missing",
            "a current without load needs the motor's KV and resistance",
        )

    given: dict[str, Any] = {
        "speed_constant_rad_Vs": speed_constant_rad_Vs, "resistance_ohm": resistance_ohm,
        "no_load_current_A": no_load_current_A, "gear_ratio": gear_ratio, "cells": cells, "capacity_As": capacity_As,
    }  # fmt: skip
    if not bar:
        k = _remove_bar(k)
    try:
        vehicle = _build_similar(k, name, mass_kg, radius_m, **given)
    except _TooWeakError as weak:
        raise _blame_option(k, weak, mass_kg, radius_m, given) from None
    hover = hover_performance(vehicle)
    mach = compute_tip_mach_number(vehicle, hover)
    if mach >= MAX_TIP_MACH:
        raise ArgumentError(
            "radius_m", "", f"{mass_kg * 1e3:.4g} g on rotors of {radius_m * 1e3:.4g} mm need tips of Mach {mach:.2g} "
            f"({max(hover.rotor_speed_rad_s) / RPM:.0f} rpm)",
            "give larger rotors or less mass",
        )  # fmt: skip
    return vehicle


class _TooWeakError(Exception):
    """Raised for a vehicle that cannot hover on a half-full battery; ``what`` states the reason."""

    def __init__(self, vehicle: Vehicle, what: str) -> None:
        super().__init__(what)
        self.vehicle, self.what = vehicle, what


_MOTOR_OPTIONS = ("speed_constant_rad_Vs", "resistance_ohm", "no_load_current_A")
_MOTOR_REMEDY = "give a motor of more KV or less resistance, another gear, more cells, larger rotors or less mass"
_OPTION_REMEDIES: dict[str, tuple[tuple[str, ...], str]] = {
    "capacity_As": (("capacity_As",), "give a battery of more capacity: its resistance follows from that"),
    "no_load_current_A": (("no_load_current_A",), "give less current without load, or leave it out"),
    "gear_ratio": (("gear_ratio",), "give another gear ratio, or leave it out"),
    "cells": (("cells",), "give more cells, or leave the number out"),
    "resistance_ohm": (_MOTOR_OPTIONS, _MOTOR_REMEDY),
}
"""Options that can prevent a hover: those left out together to test the option, and the remedy."""


def _blame_option(
    known: Vehicle, weak: _TooWeakError, mass_kg: float, radius_m: float, given: dict[str, Any]
) -> ArgumentError:
    """Return an error that names the first option without which the vehicle can hover."""
    _, full = find_battery_voltage_range(weak.vehicle.battery)
    problem = f"{weak.what} ({full:.3g} V, {1e3 * mass_kg:.4g} g)"
    for option, (left_out, remedy) in _OPTION_REMEDIES.items():
        if given[option] is None:
            continue
        try:
            estimate = _build_similar(
                known, weak.vehicle.name, mass_kg, radius_m, **{**given, **dict.fromkeys(left_out)}
            )
        except (_TooWeakError, InputError):
            continue
        if option != "resistance_ohm":
            return ArgumentError(option, "", problem, remedy)
        # The estimated motor with its winding changed to the given KV has this resistance.
        turns = 1.0 / (given["speed_constant_rad_Vs"] * float(estimate.motor.back_emf_constant))
        rewound = float(estimate.motor.resistance) * turns**2
        blamed = "resistance_ohm" if given["resistance_ohm"] > rewound else "speed_constant_rad_Vs"
        return ArgumentError(blamed, "", problem, remedy)
    blamed = "mass_kg" if given["resistance_ohm"] is None else "resistance_ohm"
    return ArgumentError(blamed, "", problem, _MOTOR_REMEDY)


def _remove_bar(known: Vehicle) -> Vehicle:
    """Return the known vehicle without stabiliser bar; the upper rotor's inertias become those of the lower rotor.

    The share of the bar in the upper rotor's torque is not known separately (Sec. 5.2), so the torque stays.
    """
    r = known.rotors
    return replace_parameters(
        known,
        {
            "stabiliser_bar.fitted": False,
            "rotors.upper.drive_inertia": float(r.lower.drive_inertia),
            "rotors.upper.reaction_inertia": float(r.lower.reaction_inertia),
        },
    )


def _build_similar(
    known: Vehicle,
    name: str,
    mass_kg: float,
    radius_m: float,
    *,
    speed_constant_rad_Vs: float | None,
    resistance_ohm: float | None,
    no_load_current_A: float | None,
    gear_ratio: float | None,
    cells: int | None,
    capacity_As: float | None,
) -> Vehicle:
    """Return the vehicle of :func:`scale_vehicle_by_similarity`; raise :class:`_TooWeakError` if it cannot hover."""
    k, mu, la = known, mass_kg / float(known.body.mass), radius_m / float(known.rotors.radius)
    speed, power = math.sqrt(mu) / la**2, mu**1.5 / la
    volts = (cells or 2) / 2
    hover = find_trim(k, charge=0.5)
    electronics = float(k.battery.electronics_current) * hover.battery_voltage_V / hover.battery_power_W
    energy = (1.0 - electronics) * power + electronics
    charge = energy / volts if capacity_As is None else capacity_As / float(k.battery.capacity)

    tables = k.model_dump(exclude_none=True)
    tables |= {
        "name": name,
        "description": f"guessed from {k.name} by similarity; values that were not given are marked as guesses",
    }
    _scale_entries(tables, k.name, {
        "body.inertia_xx": (mu * la**2, "mass times size squared"),
        "body.inertia_yy": (mu * la**2, "mass times size squared"),
        "body.inertia_zz": (mu * la**2, "mass times size squared"),
        "body.downwash_drag": (mu, "share of the weight"),
        "body.drag_area_x": (la**2, "size squared"),
        "body.drag_area_y": (la**2, "size squared"),
        "body.drag_area_z": (la**2, "size squared"),
        "rotors.inplane_drag": (1.0, "same shape of blade"),
        "rotors.ground_effect": (1.0, "same physics"),
        "swash_plate.time_constant": (1.0, "follows at once"),
        "swash_plate.linkage": (1.0, "same linkage"),
        "swash_plate.max_tilt": (1.0, "same linkage"),
        "stabiliser_bar.time_constant": (mu / la**3 / speed, "Lock number and rotor speed"),
        "stabiliser_bar.linkage": (1.0, "same linkage"),
        "gear.ratio": (1.0, "same gear"),
        "gear.efficiency": (1.0, "same gear"),
        "battery.nominal_voltage": (volts, f"{cells or 2} cells"),
        "battery.open_circuit_voltage": (volts, f"{cells or 2} cells"),
        "battery.low_voltage": (volts, f"{cells or 2} cells"),
        "battery.internal_resistance": (volts / charge, "cells over capacity"),
        "battery.electronics_current": (1.0 / volts, "same power"),
        "battery.capacity": (charge, "holds a hover as long"),
        "contact.legs": (la, "size"),
        "contact.stiffness": (mu / la, "static deflection in proportion to size"),
        "contact.damping": (mu / math.sqrt(la), "half of critical in heave"),
        "contact.friction": (1.0, "same feet"),
        "contact.slip_speed": (1.0, "same feet"),
        "range_ring.first_angle": (1.0, "same ring"),
        "range_ring.min_range": (1.0, "same ring"),
        "range_ring.max_range": (1.0, "same ring"),
        "motor.back_emf_constant": (volts / speed, "wound for voltage and rotor speed"),
        "motor.torque_constant": (volts / speed, "wound for voltage and rotor speed"),
        "motor.resistance": (volts**2 / power, "wound for voltage and power"),
        "motor.friction": (power / speed**2, "share of the electrical damping"),
        "motor.friction_torque": (power / speed, "share of the torque"),
        "air.density": (1.0, "same air"),
        **{f"rotors.{r}.{key}": rule for r in ("upper", "lower") for key, rule in {
            "thrust_coefficient": (1.0, "same shape of blade; `mufly coax map` computes it"),
            "torque_coefficient": (1.0, "same shape of blade; `mufly coax map` computes it"),
            "hub_z": (la, "size"),
            "drive_inertia": (mu * la**2, "mass times size squared"),
            "reaction_inertia": (mu * la**2, "mass times size squared"),
        }.items()},
    })  # fmt: skip
    _scale_sensors(tables, k, la)
    _set_value_if_given(tables, "body.mass", mass_kg)
    _set_value_if_given(tables, "rotors.radius", radius_m)
    _set_value_if_given(tables, "battery.capacity", capacity_As)
    for group in tables.get("mass_budget", {}).values():
        group |= {"value": group["value"] * mu, "source": "estimated", "note": f"guess: share of {k.name}"}
    if speed_constant_rad_Vs is not None and resistance_ohm is not None:
        _set_motor(tables, k, speed_constant_rad_Vs, resistance_ohm, no_load_current_A)
    if gear_ratio is not None:
        _set_value_if_given(tables, "gear.ratio", gear_ratio)
        _adapt_drive_to_gear(tables, float(k.gear.ratio), gear_ratio)
    try:
        vehicle = validate_model(Vehicle, tables, name)
    except InputError as error:
        raise ArgumentError(
            "radius_m", "", f"{mass_kg * 1e3:.4g} g on rotors of {radius_m * 1e3:.4g} mm is outside the range of "
            f"similarity: {error.key}: {error.problem}",
            "give a mass and a radius of a similar vehicle",
        ) from None  # fmt: skip
    if gear_ratio is None and speed_constant_rad_Vs is not None:
        vehicle = _choose_gear(vehicle, tables)
    _check_hover_trim(vehicle)
    return vehicle


def _find_file_entry(tables: dict[str, Any], key: str) -> dict[str, Any]:
    found: Any = tables
    for part in key.split("."):
        found = found[part]
    assert isinstance(found, dict)
    return found


def _set_value_if_given(tables: dict[str, Any], key: str, value: float | None) -> None:
    if value is not None:
        entry = _find_file_entry(tables, key)
        entry.pop("std", None)
        entry |= {"value": value, "source": "specified", "note": "given"}


def _scale_entries(tables: dict[str, Any], known: str, rules: dict[str, tuple[float, str]]) -> None:
    for key, (factor, why) in rules.items():
        entry = _find_file_entry(tables, key)
        entry |= {"value": _scale_value(entry["value"], factor), "source": "estimated"}
        entry["note"] = f"guess: {known}'s, by {why}" if factor != 1.0 else f"guess: as {known}, {why}"
        if "std" in entry:
            entry["std"] = _scale_value(entry["std"], factor)


def _scale_value(value: Any, factor: float) -> Any:
    """Return a number, or numbers in lists, times a factor, rounded to five digits."""
    if isinstance(value, list | tuple):
        return [_scale_value(v, factor) for v in value]
    return float(f"{value * factor:.5g}")


def _scale_sensors(tables: dict[str, Any], known: Vehicle, la: float) -> None:
    """Scale the positions of the sensors by the ratio of length ``la``; keep their other parameters."""
    for sensor in tables.get("sensors", {}).values():
        for entry in sensor.values():
            if isinstance(entry, dict) and "source" in entry:
                entry |= {"source": "estimated", "note": f"guess: as {known.name}"}
        if "position" in sensor:
            sensor["position"]["value"] = _scale_value(sensor["position"]["value"], la)


def _set_motor(
    tables: dict[str, Any], known: Vehicle, speed_constant: float, resistance: float, no_load: float | None
) -> None:
    constant = float(f"{1.0 / speed_constant:.5g}")
    _set_value_if_given(tables, "motor.back_emf_constant", constant)
    _set_value_if_given(tables, "motor.torque_constant", constant)
    tables["motor"]["torque_constant"]["note"] = "as the back-EMF constant: given"
    _set_value_if_given(tables, "motor.resistance", resistance)
    m, friction = known.motor, tables["motor"]["friction"]
    if no_load is None:
        share = float(m.friction) * float(m.resistance) / float(m.torque_constant) ** 2
        friction |= {"value": _scale_value(share, constant**2 / resistance), "source": "estimated"}
        friction["note"] = f"guess: {known.name}'s share of the electrical damping"
        return
    volts = tables["battery"]["nominal_voltage"]["value"]
    if no_load * resistance >= volts:
        raise ArgumentError(
            "no_load_current_A", "",
            f"{no_load:g} A times {resistance:g} ohm is not less than the {volts:g} V of the battery",
            "correct the current or the resistance",
        )  # fmt: skip
    turns = (volts - no_load * resistance) / constant
    _set_value_if_given(tables, "motor.friction", _scale_value(constant * no_load, 1.0 / turns))
    tables["motor"]["friction"]["note"] = "from the current without load: given"


def _adapt_drive_to_gear(tables: dict[str, Any], before: float, ratio: float) -> None:
    """Change the gear of the motors; a ratio of 1 is direct drive without losses."""
    for rotor in ("upper", "lower"):
        entry = tables["rotors"][rotor]["drive_inertia"]
        entry["value"] = _scale_value(entry["value"], (before / ratio) ** 2)
        entry["note"] += ", and the gear squared"
    if ratio == 1.0:
        tables["gear"]["efficiency"] |= {"value": 1.0, "source": "specified", "note": "direct drive"}


def _choose_gear(vehicle: Vehicle, tables: dict[str, Any]) -> Vehicle:
    """Choose the gear of least power in hover; direct drive if no ratio above 1 needs less."""
    m, p = vehicle.motor, model_parameters(vehicle)
    upper, lower = compute_hover_rotor_speeds(p)
    torque = float(p["torque_up"]) * upper**2  # equals the lower rotor's torque in trim
    curve = vehicle.battery.open_circuit_voltage
    available = MAX_HOVER_VOLTAGE_FRACTION * float(curve.sample_evenly(3)[1])
    constants = MotorConstants(
        back_emf_V_s=float(m.back_emf_constant), torque_Nm_A=float(m.torque_constant),
        resistance_ohm=float(m.resistance), friction_Nm_s=float(m.friction), gear_ratio=1.0,
        gear_efficiency=float(vehicle.gear.efficiency), friction_Nm=float(m.friction_torque),
    )  # fmt: skip
    ratio = float(find_least_power_gear_ratio(constants, max(upper, lower), torque, available))
    if not math.isfinite(ratio):
        raise _TooWeakError(vehicle, "no gear lets it hover")
    note = (
        "guess: the least power in hover" if ratio > 1.0 else "guess: direct drive; no ratio above 1 needs less power"
    )
    ratio = _scale_value(max(ratio, 1.0), 1.0)
    tables["gear"]["ratio"] |= {"value": ratio, "source": "estimated", "note": note}
    _adapt_drive_to_gear(tables, float(vehicle.gear.ratio), ratio)
    return validate_model(Vehicle, tables, vehicle.name)


def _check_hover_trim(vehicle: Vehicle) -> None:
    try:
        find_trim(vehicle, charge=0.5)
    except MuflyError:
        raise _TooWeakError(vehicle, "does not hover on a half-full battery") from None
