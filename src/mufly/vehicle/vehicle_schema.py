"""Schema of vehicle files: declaration of all parameters of the flight model of a coaxial micro helicopter.

A file states each parameter with value, unit and provenance (:mod:`mufly.vehicle.quantity`).

Symbols are the thesis's (Table 5.3) in ASCII; ``up`` is the upper rotor (stabiliser bar), ``dw`` the lower
(swash plate). Positions are in body axes from the centre of gravity: x forward, y right, z down.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, Literal, NamedTuple

import tomli_w
from pydantic import BaseModel, Field, model_validator

from mufly.errors import InputError
from mufly.files.input_files import builtin_file_names, make_validation_error, read_toml, validate_model
from mufly.quantities.units import GRAVITY
from mufly.vehicle.coefficient_map import CoefficientMap
from mufly.vehicle.flight_map import FlightMap, insert_named_maps
from mufly.vehicle.quantity import BodyPoints, ParameterGroup, Quantity, TabulatedCurve, declare_parameter
from mufly.vehicle.sensor_schema import SensorSuite

# Each declaration contains the limits of its parameter. They cover coaxial vehicles from a gram to 100 kg: the lightest
# motor with its rotor has 1e-9 kg m2, the smallest cell 0.1 V; a rotor beyond cT = 0.2 is stalled, and no linkage tilts
# the disc by more than three times the plate. Zero is allowed for friction and drag. The checks of the groups cover
# relations between parameters, such as conservation of energy.

MAX_LEGS = 16
_MAP_RADIUS_TOLERANCE = 0.01
_MAP_SPACING_TOLERANCE, _MAP_THRUST_TOLERANCE = (
    0.25,
    0.25,
)  # of a flight map, wide enough for drawn and fitted parameters
MAX_SENSOR_PLACE_TO_REACH_RATIO = 2.0
"""Greatest distance of a sensor from the centre of gravity over the reach of rotors and legs; a boom is shorter."""
MAX_TORQUE_TO_EMF_RATIO = 1.02
"""Greatest ratio of torque to back-EMF constant, 1 plus measurement uncertainty; above it energy is not conserved."""


class Body(ParameterGroup):
    mass: Quantity = declare_parameter("kg", "m", "take-off mass", at_least=1e-3, at_most=100)
    inertia_xx: Quantity = declare_parameter("kg m2", "Ixx", "moment of inertia about x", at_least=1e-9, at_most=100)
    inertia_yy: Quantity = declare_parameter("kg m2", "Iyy", "moment of inertia about y", at_least=1e-9, at_most=100)
    inertia_zz: Quantity = declare_parameter(
        "kg m2", "Izz", "moment of inertia about z, fuselage alone", at_least=1e-9, at_most=100
    )
    downwash_drag: Quantity = declare_parameter(
        "N", "Whub", "drag of the rotors' downwash on the fuselage", at_least=0, at_most=500
    )
    drag_area_x: Quantity = declare_parameter(
        "m2", "cDAx", "drag coefficient times area, flow along x", at_least=0, at_most=10
    )
    drag_area_y: Quantity = declare_parameter(
        "m2", "cDAy", "drag coefficient times area, flow along y", at_least=0, at_most=10
    )
    drag_area_z: Quantity = declare_parameter(
        "m2", "cDAz", "drag coefficient times area, flow along z", at_least=0, at_most=10
    )


class Air(ParameterGroup):
    density: Quantity = declare_parameter("kg/m3", "rho", "density of the air", at_least=0.01, at_most=10)


class Rotor(ParameterGroup):
    thrust_coefficient: Quantity = declare_parameter("1", "cT", "T / (rho pi R^4 Omega^2)", at_least=1e-5, at_most=0.2)
    torque_coefficient: Quantity = declare_parameter("1", "cQ", "Q / (rho pi R^5 Omega^2)", at_least=1e-6, at_most=0.2)
    hub_z: Quantity = declare_parameter(
        "m", "z", "z of the hub in body axes (negative: above)", at_least=-10, at_most=-1e-4
    )
    drive_inertia: Quantity = declare_parameter(
        "kg m2",
        "Jdrive",
        "inertia of the drive train as the motor sees it (eq. 4.29)",
        at_least=1e-9,
        at_most=10,
    )
    reaction_inertia: Quantity = declare_parameter(
        "kg m2",
        "Jrot",
        "inertia whose acceleration reacts on the fuselage (eq. 4.13)",
        at_least=0,
        at_most=10,
    )


class Rotors(ParameterGroup):
    radius: Quantity = declare_parameter("m", "R", "radius of both rotors", at_least=5e-3, at_most=5)
    inplane_drag: Quantity = declare_parameter(
        "1",
        "cH",
        "drag of each rotor in its disc plane, H / (rho pi R^3 Omega V), V the edgewise velocity",
        at_least=0,
        at_most=0.2,
        absent=0.0,
    )
    ground_effect: Quantity = declare_parameter(
        "1",
        "kGE",
        "thrust gained near the floor over what Cheeseman and Bennett's image gives; 0 without ground effect",
        at_least=0,
        at_most=2,
        absent=0.0,
    )
    upper: Rotor
    lower: Rotor
    coefficient_map: CoefficientMap | None = Field(
        default=None,
        description="file of coefficients over speeds and climb (`mufly coax map`) that takes the constants' place",
    )
    map_level: Literal["computed", "constants"] = Field(
        default="computed",
        description="'computed' takes the map as it is; 'constants' scales it to the constant coefficients at hover",
    )
    flight_map: FlightMap | None = Field(
        default=None,
        description="file of loads in edgewise flow and of rate damping (`mufly coax flight-map`)",
    )

    @model_validator(mode="after")
    def _check_map_radius(self) -> Rotors:
        m, radius = self.coefficient_map, float(self.radius)
        if m is not None and abs(m.radius_m / radius - 1.0) > _MAP_RADIUS_TOLERANCE:
            raise make_validation_error(
                f"map {m.name!r} is for rotors of {1e3 * m.radius_m:g} mm, these have {1e3 * radius:g} mm",
                "make a map for these rotors: mufly coax map",
                "rotors.coefficient_map",
            )
        return self

    @model_validator(mode="after")
    def _check_flight_map(self) -> Rotors:
        """Check that the flight map belongs to these rotors: radius, distance, thrust coefficients, names of blades."""
        m = self.flight_map
        if m is None:
            return self
        problem = describe_rotor_differences(self, m)
        if problem:
            raise make_validation_error(
                f"map {m.name!r} is for {problem}", "make one for these rotors: mufly coax flight-map",
                "rotors.flight_map",
            )  # fmt: skip
        return self

    @model_validator(mode="after")
    def _check_hub_order(self) -> Rotors:
        upper, lower = float(self.upper.hub_z), float(self.lower.hub_z)
        if upper >= lower:
            raise make_validation_error(
                f"the upper hub, z = {upper:g} m, is not above the lower, z = {lower:g} m (z points down)",
                "exchange the two hubs, or correct one",
                "rotors.upper.hub_z",
            )
        return self

    @model_validator(mode="after")
    def _check_rotor_efficiency(self) -> Rotors:
        """Check that the power of each rotor is at least the ideal power of its thrust: figure of merit up to 1."""
        for name, rotor in (("upper", self.upper), ("lower", self.lower)):
            ideal = float(rotor.thrust_coefficient) ** 1.5 / math.sqrt(2.0)
            if float(rotor.torque_coefficient) < ideal:
                raise make_validation_error(
                    f"{float(rotor.torque_coefficient):g} is below {ideal:.3g}, the ideal rotor's value "
                    f"at this thrust_coefficient: the figure of merit would exceed 1",
                    "raise torque_coefficient, or lower thrust_coefficient",
                    f"rotors.{name}.torque_coefficient",
                )
        return self


def describe_rotor_differences(rotors: Rotors, flight_map: FlightMap) -> str:
    """Return a text on the differences between a flight map's rotors and a vehicle's; ``""`` if there are none."""
    m, c = flight_map, rotors.coefficient_map
    spacing = float(rotors.lower.hub_z) - float(rotors.upper.hub_z)
    for name, made, own, tolerance in (
        ("radius", m.radius_m, float(rotors.radius), _MAP_RADIUS_TOLERANCE),
        ("distance of the discs", m.spacing_m, spacing, _MAP_SPACING_TOLERANCE),
    ):
        if abs(made / own - 1.0) > tolerance:
            return f"rotors with a {name} of {1e3 * made:.4g} mm, these have {1e3 * own:.4g} mm"
    if c is not None:
        if (m.upper, m.lower) != (c.upper, c.lower):
            return f"blades {m.upper} and {m.lower}, the coefficient map is for {c.upper} and {c.lower}"
        return ""
    for side, made in zip(("upper", "lower"), m.thrust_coefficients, strict=True):
        own = float(getattr(rotors, side).thrust_coefficient)
        if abs(made / own - 1.0) > _MAP_THRUST_TOLERANCE:
            return f"a {side} rotor with thrust coefficient {made:.3g}, this one has {own:.3g}"
    return ""


class SwashPlate(ParameterGroup):
    time_constant: Quantity = declare_parameter(
        "s", "Tf_dw", "following time of the lower tip-path plane", at_least=1e-6, at_most=1e3
    )
    linkage: Quantity = declare_parameter(
        "1", "l_dw", "tilt of the tip-path plane per tilt of the plate", at_least=1e-3, at_most=3
    )
    max_tilt: Quantity = declare_parameter(
        "rad", "theta_SP_max", "tilt of the plate at full servo input", at_least=1e-3, below=0.7
    )
    phase: Quantity = declare_parameter(
        "rad",
        "phi_SP",
        "lag of the tip-path plane's tilt behind the plate's, along the lower rotor's rotation",
        at_least=-3.2,
        at_most=3.2,
        absent=0.0,
    )


class StabiliserBar(ParameterGroup):
    fitted: bool = Field(
        default=True,
        strict=True,
        description="false: no bar, upper blades fixed to the mast; time_constant and linkage may then be left out",
    )
    time_constant: Quantity = declare_parameter("s", "Tf_up", "following time of the bar", at_least=1e-4, at_most=1e9)
    linkage: Quantity = declare_parameter(
        "1", "l_up", "tilt of the upper tip-path plane per tilt of the bar", at_least=0, at_most=1
    )

    @model_validator(mode="before")
    @classmethod
    def _fill_missing_bar(cls, data: Any) -> Any:
        """Fill the two parameters of a bar that is not fitted; nothing depends on them."""
        if isinstance(data, dict) and data.get("fitted") is False:
            missing = {"source": "estimated", "note": "no bar"}
            data = {"time_constant": {"value": 1.0, "unit": "s"} | missing,
                    "linkage": {"value": 0.0, "unit": "1"} | missing} | data  # fmt: skip
        return data


class Motor(ParameterGroup):
    back_emf_constant: Quantity = declare_parameter(
        "V s", "kE", "back-EMF per motor speed (V per rad/s)", at_least=1e-6, at_most=10
    )
    torque_constant: Quantity = declare_parameter("N m/A", "kM", "torque per current", at_least=1e-6, at_most=10)
    friction: Quantity = declare_parameter("N m s", "dR", "viscous friction", at_least=0, at_most=1)
    friction_torque: Quantity = declare_parameter(
        "N m", "Mf", "constant friction: bearings, brushes, iron", at_least=0, at_most=10, absent=0.0
    )
    resistance: Quantity = declare_parameter("ohm", "Rohm", "armature resistance", at_least=1e-4, at_most=1e4)

    @model_validator(mode="after")
    def _check_torque_constant(self) -> Motor:
        """Check that kM does not exceed kE (SI units): the mechanical power kM w I is at most the power kE w I."""
        k_e, k_m = float(self.back_emf_constant), float(self.torque_constant)
        if k_m > MAX_TORQUE_TO_EMF_RATIO * k_e:
            raise make_validation_error(
                f"{k_m:g} N m/A is above back_emf_constant, {k_e:g} V s: such a motor generates power",
                "lower torque_constant (in SI units it equals back_emf_constant, less the iron losses)",
                "motor.torque_constant",
            )
        return self


class Gear(ParameterGroup):
    ratio: Quantity = declare_parameter("1", "igear", "motor speed over rotor speed", at_least=0.01, at_most=1000)
    efficiency: Quantity = declare_parameter("1", "eta_gear", "efficiency of the gear", at_least=0.01, at_most=1)


class Battery(ParameterGroup):
    model: Literal["lithium-polymer", "constant"] = Field(
        description="'lithium-polymer' sags with current and charge; 'constant' holds the nominal voltage"
    )
    nominal_voltage: Quantity = declare_parameter(
        "V", "Ubat", "voltage of the 'constant' model and of linear design", at_least=0.1, at_most=1000
    )
    capacity: Quantity = declare_parameter("A s", "C", "charge of the full battery", at_least=1e-3, at_most=1e7)
    internal_resistance: Quantity = declare_parameter(
        "ohm", "Rbat", "internal resistance of the pack", at_least=0, at_most=1e3
    )
    open_circuit_voltage: TabulatedCurve = declare_parameter(
        "V",
        "Uoc",
        "open-circuit voltage of the pack over the fraction of charge left",
        at_least=0.1,
        at_most=1000,
    )
    electronics_current: Quantity = declare_parameter(
        "A", "Iel", "current of electronics and sensors", at_least=0, at_most=100
    )
    low_voltage: Quantity = declare_parameter(
        "V", "Ulow", "terminal voltage at which a mission has to land", above=0, at_most=1000
    )

    @model_validator(mode="after")
    def _check_discharge_curve(self) -> Battery:
        c = self.open_circuit_voltage
        rising = all(b > a for a, b in zip(c.fraction, c.fraction[1:], strict=False))
        if len(c.fraction) != len(c.value) or not rising or c.fraction[0] != 0 or c.fraction[-1] != 1:
            raise make_validation_error(
                "open_circuit_voltage is not a curve over charge",
                "give as many fractions as values, rising from 0 (empty) to 1 (full)",
                "battery.open_circuit_voltage",
            )
        for k in range(1, len(c.value)):
            if c.value[k] < c.value[k - 1]:
                raise make_validation_error(
                    f"{c.value[k]:g} V at charge {c.fraction[k]:g} is below {c.value[k - 1]:g} V at charge "
                    f"{c.fraction[k - 1]:g}: a battery's voltage does not fall with charge",
                    "give voltages that rise from charge 0 (empty) to 1 (full)",
                    "battery.open_circuit_voltage",
                )
        for name in ("nominal_voltage", "low_voltage"):
            value, full = float(getattr(self, name)), max(c.value)
            if self.model != "constant" and value > full:
                raise make_validation_error(
                    f"{value:g} V is above the full battery's {full:g} V",
                    "lower it, or correct battery.open_circuit_voltage",
                    f"battery.{name}",
                )
        return self


def find_battery_voltage_range(battery: Battery) -> tuple[float, float]:
    """Return the battery's lowest and highest voltage in use (V): at a forced landing, and full without load."""
    nominal, rest = float(battery.nominal_voltage), battery.open_circuit_voltage.value
    return min(float(battery.low_voltage), nominal), max(*rest, nominal)


class LegContact(ParameterGroup):
    legs: BodyPoints = declare_parameter("m", "legs", "tips of the legs", at_least=-10, at_most=10)
    stiffness: Quantity = declare_parameter("N/m", "k_leg", "stiffness of one leg", at_least=1e-2, at_most=1e8)
    damping: Quantity = declare_parameter("N s/m", "c_leg", "damping of one leg", at_least=0, at_most=1e6)
    friction: Quantity = declare_parameter("1", "mu", "friction between leg and floor", at_least=0, at_most=10)
    slip_speed: Quantity = declare_parameter(
        "m/s",
        "v_slip",
        "sliding speed at which friction has 71 % of its full value",
        at_least=1e-5,
        at_most=10,
    )

    @model_validator(mode="after")
    def _check_legs(self) -> LegContact:
        tips = self.legs.value
        if not 3 <= len(tips) <= MAX_LEGS:
            raise make_validation_error(f"{len(tips)} legs", f"give 3 to {MAX_LEGS} points [x, y, z]", "contact.legs")
        if max(z for _, _, z in tips) <= 0:
            raise make_validation_error(
                "no leg reaches below the centre of gravity", "give z above 0 (down)", "contact.legs"
            )
        return self


class RangeRing(ParameterGroup):
    count: int = Field(ge=1, le=64, strict=True, description="number of beams, evenly spread over the circle")
    first_angle: Quantity = declare_parameter(
        "rad", "alpha_0", "direction of beam 0, from x towards y (Fig. 6.18)", at_least=-7, at_most=7
    )
    min_range: Quantity = declare_parameter(
        "m", "l_min", "shortest distance that is measured", at_least=0, at_most=1000
    )
    max_range: Quantity = declare_parameter(
        "m", "l_max", "greatest distance that is measured", at_least=0.01, at_most=1000
    )

    @model_validator(mode="after")
    def _check_range_limits(self) -> RangeRing:
        low, high = float(self.min_range), float(self.max_range)
        if low >= high:
            raise make_validation_error(
                f"{low:g} m is not below max_range, {high:g} m", "exchange them", "range_ring.min_range"
            )
        return self


class MassBudget(ParameterGroup):
    battery: Quantity = declare_parameter("kg", "m_bat", "battery", at_least=0, at_most=100)
    actuators: Quantity = declare_parameter(
        "kg", "m_act", "motors, servos and their controllers", at_least=0, at_most=100
    )
    rotor_system: Quantity = declare_parameter(
        "kg", "m_rot", "blades, hubs, swash plate, stabiliser bar, gears", at_least=0, at_most=100
    )
    electronics: Quantity = declare_parameter(
        "kg", "m_ele", "processors, power supply, radio, cables", at_least=0, at_most=100
    )
    sensors: Quantity = declare_parameter(
        "kg", "m_sen", "IMU, ultrasonic sensor, cameras, lasers", at_least=0, at_most=100
    )
    structure: Quantity = declare_parameter("kg", "m_str", "frame, cage, legs", at_least=0, at_most=100)


class Vehicle(ParameterGroup):
    """Coaxial micro helicopter as read from a vehicle file; all values in SI units.

    ``float(vehicle.body.mass)`` is the mass in kg; ``vehicle.body.mass.source`` is its provenance.
    """

    name: str = Field(min_length=1, description="short name")
    description: str = Field(default="", description="one line about the vehicle")
    body: Body
    air: Air
    rotors: Rotors
    swash_plate: SwashPlate
    stabiliser_bar: StabiliserBar
    motor: Motor
    gear: Gear
    battery: Battery
    contact: LegContact
    range_ring: RangeRing
    sensors: SensorSuite | None = None
    mass_budget: MassBudget | None = None

    @model_validator(mode="after")
    def _check_standing_on_legs(self) -> Vehicle:
        """Check that the legs carry the weight with the centre of gravity above the floor."""
        tips = self.contact.legs.to_array()
        lowest, stiffness = float(tips[:, 2].max()), float(self.contact.stiffness)
        carrying = int((tips[:, 2] > lowest - 1e-6).sum())
        pressed = float(self.body.mass) * GRAVITY / (carrying * stiffness)
        if pressed >= lowest:
            raise make_validation_error(
                f"{stiffness:g} N/m: the weight presses the legs in by {1e3 * pressed:.3g} mm, and the centre of "
                f"gravity is {1e3 * lowest:.3g} mm above their tips",
                "give stiffer or longer legs",
                "contact.stiffness",
            )
        return self

    @model_validator(mode="after")
    def _check_sensor_positions(self) -> Vehicle:
        """Check that the sensors are at the vehicle, and the sonar above the floor on which the vehicle stands."""
        if self.sensors is None:
            return self
        reach = compute_vehicle_reach_m(self)
        for name in ("imu", "sonar"):
            sensor = getattr(self.sensors, name)
            away = 0.0 if sensor is None else math.hypot(*sensor.position.value[0])
            if away > MAX_SENSOR_PLACE_TO_REACH_RATIO * reach:
                raise make_validation_error(
                    f"{away:.3g} m from the centre of gravity; rotors and legs reach {reach:.3g} m",
                    "correct the coordinates or their unit",
                    f"sensors.{name}.position",
                )
        lowest = max(z for _, _, z in self.contact.legs.value)
        if self.sensors.sonar is not None:
            low, longest = self.sensors.sonar.position.value[0][2], float(self.sensors.sonar.max_range)
            if low >= lowest:
                raise make_validation_error(
                    f"z = {low:g} m is not above the tips of the legs, z = {lowest:g} m (z points down)",
                    "give the sonar's place a smaller z, or longer legs",
                    "sensors.sonar.position",
                )
            if lowest - low >= longest:
                raise make_validation_error(
                    f"{longest:g} m does not reach the floor, {lowest - low:.3g} m below the standing vehicle's sonar",
                    "give a greater max_range, or a lower place",
                    "sensors.sonar.max_range",
                )
        return self

    @model_validator(mode="after")
    def _check_mass_budget(self) -> Vehicle:
        if self.mass_budget is not None:
            total = sum(float(q) for _, q in self.mass_budget)
            if abs(total - float(self.body.mass)) > 1e-4:
                raise make_validation_error(
                    f"its groups add up to {total * 1e3:.1f} g, but body.mass is {float(self.body.mass) * 1e3:.1f} g",
                    "correct a group or body.mass (0.1 g apart at most)",
                    "mass_budget",
                )
        return self


def compute_vehicle_reach_m(vehicle: Vehicle) -> float:
    """Return the distance (m) from the centre of gravity to the farthest point of rotor discs and legs."""
    radius = float(vehicle.rotors.radius)
    rims = [math.hypot(radius, float(r.hub_z)) for r in (vehicle.rotors.upper, vehicle.rotors.lower)]
    return max(*rims, *(math.hypot(*tip) for tip in vehicle.contact.legs.value))


_BUILTIN_VEHICLES_FOLDER = resources.files("mufly.vehicle") / "builtin"


class Parameter(NamedTuple):
    """Row of a vehicle's parameter table; ``value`` is in SI units."""

    key: str
    symbol: str
    value: Any
    unit: str
    source: str
    description: str
    note: str
    std: float | None = None


def list_builtin_vehicles() -> list[str]:
    """Return the names of the built-in vehicles."""
    return builtin_file_names(_BUILTIN_VEHICLES_FOLDER)


def load_vehicle(name_or_path: str | Path) -> Vehicle:
    """Read a vehicle by built-in name or from a TOML file.

    Parameters
    ----------
    name_or_path : str or Path
        A name that :func:`list_builtin_vehicles` lists, or the path of a vehicle file.

    Returns
    -------
    Vehicle
        Frozen and checked; all values in SI units.

    Raises
    ------
    InputError
        If there is no such vehicle, the file is not TOML, or a parameter is missing, unknown, without a unit
        or impossible. The message names file, key, value and remedy.

    Thesis: Table 5.3.
    """
    tables, where = read_toml(name_or_path, _BUILTIN_VEHICLES_FOLDER, "vehicle")
    folder = None if str(name_or_path) in list_builtin_vehicles() else Path(name_or_path).parent
    return validate_model(Vehicle, insert_named_maps(tables, folder, where), where)


def _iterate_parameters(model: BaseModel, prefix: str = "") -> Iterator[tuple[str, dict[str, Any], Any, str]]:
    for name, field in type(model).model_fields.items():
        value = getattr(model, name)
        extra = field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}
        if isinstance(value, Quantity | BodyPoints | TabulatedCurve):
            yield f"{prefix}{name}", extra, value, field.description or ""
        elif isinstance(value, StabiliserBar) and not value.fitted:
            continue
        elif isinstance(value, BaseModel):
            yield from _iterate_parameters(value, f"{prefix}{name}.")


def list_parameters(vehicle: Vehicle) -> list[Parameter]:
    """Return every parameter of a vehicle with symbol, SI value, unit, source and meaning, in file order."""
    rows = []
    for key, extra, q, description in _iterate_parameters(vehicle):
        symbol = str(extra["symbol"])
        if key.startswith("rotors.upper."):
            symbol += "_up"
        elif key.startswith("rotors.lower."):
            symbol += "_dw"
        rows.append(Parameter(key, symbol, q.value, q.unit, q.source, description, q.note, getattr(q, "std", None)))
    return rows


def replace_parameters(
    vehicle: Vehicle, values: Mapping[str, float | str | Sequence[Any] | None], *, source: str = "estimated"
) -> Vehicle:
    """Return a vehicle with some parameters changed.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle to start from.
    values : mapping of str to float, str, sequence or None
        New SI values by dotted key, as in ``{"body.mass": 0.08, "battery.model": "constant"}``.
        ``"rotors.coefficient_map"`` and ``"rotors.flight_map"`` take the name or path of a map, or None. A new
        ``body.mass`` removes the mass budget, whose sum would differ.
    source : str
        Provenance of the changed parameters.

    Raises
    ------
    InputError
        If a key does not exist or a value is impossible.
    """
    tables = vehicle.model_dump()
    for key, value in values.items():
        *path, last = key.split(".")
        table: Any = tables
        for part in path:
            table = table.get(part) if isinstance(table, dict) else None
        if not isinstance(table, dict) or last not in table:
            raise InputError("replace", key, "no such parameter", "use a key that `mufly vehicle show` lists")
        if isinstance(table[last], dict) and "source" in table[last]:
            told = {"value": value, "source": source, "note": "set by hand"}
            table[last] = {k: v for k, v in table[last].items() if k != "std"} | told
        else:
            table[last] = value
    if "body.mass" in values:
        tables["mass_budget"] = None
    return validate_model(Vehicle, insert_named_maps(tables, None, vehicle.name), vehicle.name)


def format_vehicle_toml(vehicle: Vehicle) -> str:
    """Return the text of a vehicle file in SI units that :func:`load_vehicle` can read.

    It contains its maps in full and needs no other file.
    """
    tables = vehicle.model_dump(exclude_none=True)
    return tomli_w.dumps(tables, multiline_strings=True)
