"""What a coaxial micro helicopter is made of: every parameter of the flight model, declared once.

Symbols are the thesis's (Table 5.3) in ASCII; ``up`` is the upper rotor (stabiliser bar), ``dw`` the lower
(swash plate). Positions are in body axes from the centre of gravity: x forward, y right, z down.
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from mufly.vehicle.coefficient_map import CoefficientMap
from mufly.vehicle.quantity import Curve, Group, Points, Quantity, parameter

__all__ = ["MAX_LEGS", "Vehicle"]

MAX_LEGS = 16
_SAME_RADIUS = 0.01


def _fault(key: str, problem: str, remedy: str) -> PydanticCustomError:
    context = {"key": key, "problem": problem, "remedy": remedy}
    return PydanticCustomError("mufly", "{problem}; {remedy}", context)


class Body(Group):
    mass: Quantity = parameter("kg", "m", "take-off mass", above=0)
    inertia_xx: Quantity = parameter("kg m2", "Ixx", "moment of inertia about x", above=0)
    inertia_yy: Quantity = parameter("kg m2", "Iyy", "moment of inertia about y", above=0)
    inertia_zz: Quantity = parameter("kg m2", "Izz", "moment of inertia about z, fuselage alone", above=0)
    downwash_drag: Quantity = parameter(
        "N", "Whub", "drag of the rotors' downwash on the fuselage", at_least=0
    )
    drag_area_x: Quantity = parameter("m2", "cDAx", "drag coefficient times area, flow along x", at_least=0)
    drag_area_y: Quantity = parameter("m2", "cDAy", "drag coefficient times area, flow along y", at_least=0)
    drag_area_z: Quantity = parameter("m2", "cDAz", "drag coefficient times area, flow along z", at_least=0)


class Air(Group):
    density: Quantity = parameter("kg/m3", "rho", "density of the air", above=0)


class Rotor(Group):
    thrust_coefficient: Quantity = parameter("1", "cT", "T / (rho pi R^4 Omega^2)", above=0)
    torque_coefficient: Quantity = parameter("1", "cQ", "Q / (rho pi R^5 Omega^2)", above=0)
    hub_z: Quantity = parameter("m", "z", "z of the hub in body axes (negative: above)", below=0)
    drive_inertia: Quantity = parameter(
        "kg m2", "Jdrive", "inertia of the drive train as the motor sees it (eq. 4.29)", above=0
    )
    reaction_inertia: Quantity = parameter(
        "kg m2", "Jrot", "inertia whose acceleration reacts on the fuselage (eq. 4.13)", at_least=0
    )


class Rotors(Group):
    radius: Quantity = parameter("m", "R", "radius of both rotors", above=0)
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

    @model_validator(mode="after")
    def _map_fits(self) -> Rotors:
        m, radius = self.coefficient_map, float(self.radius)
        if m is not None and abs(m.radius_m / radius - 1.0) > _SAME_RADIUS:
            raise _fault(
                "rotors.coefficient_map",
                f"map {m.name!r} is for rotors of {1e3 * m.radius_m:g} mm, these have {1e3 * radius:g} mm",
                "make a map for these rotors: mufly coax map",
            )
        return self


class SwashPlate(Group):
    time_constant: Quantity = parameter("s", "Tf_dw", "following time of the lower tip-path plane", above=0)
    linkage: Quantity = parameter("1", "l_dw", "tilt of the tip-path plane per tilt of the plate", above=0)
    max_tilt: Quantity = parameter(
        "rad", "theta_SP_max", "tilt of the plate at full servo input", above=0, below=0.7
    )


class StabiliserBar(Group):
    time_constant: Quantity = parameter("s", "Tf_up", "following time of the bar", above=0)
    linkage: Quantity = parameter(
        "1", "l_up", "tilt of the upper tip-path plane per tilt of the bar", at_least=0, at_most=1
    )


class Motor(Group):
    back_emf_constant: Quantity = parameter("V s", "kE", "back-EMF per motor speed (V per rad/s)", above=0)
    torque_constant: Quantity = parameter("N m/A", "kM", "torque per current", above=0)
    friction: Quantity = parameter("N m s", "dR", "viscous friction", at_least=0)
    resistance: Quantity = parameter("ohm", "Rohm", "armature resistance", above=0)


class Gear(Group):
    ratio: Quantity = parameter("1", "igear", "motor speed over rotor speed", above=0)
    efficiency: Quantity = parameter("1", "eta_gear", "efficiency of the gear", above=0, at_most=1)


class Battery(Group):
    model: Literal["lithium-polymer", "constant"] = Field(
        description="'lithium-polymer' sags with current and charge; 'constant' holds the nominal voltage"
    )
    nominal_voltage: Quantity = parameter(
        "V", "Ubat", "voltage of the 'constant' model and of linear design", above=0
    )
    capacity: Quantity = parameter("A s", "C", "charge of the full battery", above=0)
    internal_resistance: Quantity = parameter("ohm", "Rbat", "internal resistance of the pack", at_least=0)
    open_circuit_voltage: Curve = parameter(
        "V", "Uoc", "open-circuit voltage of the pack over the fraction of charge left", above=0
    )
    electronics_current: Quantity = parameter(
        "A", "Iel", "current of electronics and sensors", at_least=0
    )  # fmt: skip
    low_voltage: Quantity = parameter("V", "Ulow", "terminal voltage at which a mission has to land", above=0)

    @model_validator(mode="after")
    def _curve_spans_charge(self) -> Battery:
        c = self.open_circuit_voltage
        rising = all(b > a for a, b in zip(c.fraction, c.fraction[1:], strict=False))
        if len(c.fraction) != len(c.value) or not rising or c.fraction[0] != 0 or c.fraction[-1] != 1:
            raise _fault(
                "battery.open_circuit_voltage",
                "open_circuit_voltage is not a curve over charge",
                "give as many fractions as values, rising from 0 (empty) to 1 (full)",
            )
        return self


class Contact(Group):
    legs: Points = parameter("m", "legs", "tips of the legs")
    stiffness: Quantity = parameter("N/m", "k_leg", "stiffness of one leg", above=0)
    damping: Quantity = parameter("N s/m", "c_leg", "damping of one leg", at_least=0)
    friction: Quantity = parameter("1", "mu", "friction between leg and floor", at_least=0)
    slip_speed: Quantity = parameter(
        "m/s", "v_slip", "sliding speed at which friction has 71 % of its full value", above=0
    )

    @model_validator(mode="after")
    def _can_stand(self) -> Contact:
        tips = self.legs.value
        if not 3 <= len(tips) <= MAX_LEGS:
            raise _fault("contact.legs", f"{len(tips)} legs", f"give 3 to {MAX_LEGS} points [x, y, z]")
        if max(z for _, _, z in tips) <= 0:
            raise _fault(
                "contact.legs", "no leg reaches below the centre of gravity", "give z above 0 (down)"
            )
        return self


class RangeRing(Group):
    count: int = Field(ge=1, le=64, strict=True, description="number of beams, evenly spread over the circle")
    first_angle: Quantity = parameter("rad", "alpha_0", "direction of beam 0, from x towards y (Fig. 6.18)")
    min_range: Quantity = parameter("m", "l_min", "shortest distance that is measured", at_least=0)
    max_range: Quantity = parameter("m", "l_max", "greatest distance that is measured", above=0)

    @model_validator(mode="after")
    def _min_below_max(self) -> RangeRing:
        low, high = float(self.min_range), float(self.max_range)
        if low >= high:
            raise _fault(
                "range_ring.min_range", f"{low:g} m is not below max_range, {high:g} m", "exchange them"
            )
        return self


class MassBudget(Group):
    battery: Quantity = parameter("kg", "m_bat", "battery", at_least=0)
    actuators: Quantity = parameter("kg", "m_act", "motors, servos and their controllers", at_least=0)
    rotor_system: Quantity = parameter(
        "kg", "m_rot", "blades, hubs, swash plate, stabiliser bar, gears", at_least=0
    )
    electronics: Quantity = parameter("kg", "m_ele", "processors, power supply, radio, cables", at_least=0)
    sensors: Quantity = parameter("kg", "m_sen", "IMU, ultrasonic sensor, cameras, lasers", at_least=0)
    structure: Quantity = parameter("kg", "m_str", "frame, cage, legs", at_least=0)


class Vehicle(Group):
    """A coaxial micro helicopter, as read from a vehicle file. All values in SI units.

    ``float(vehicle.body.mass)`` is the mass in kg; ``vehicle.body.mass.source`` says where it came from.
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
    contact: Contact
    range_ring: RangeRing
    mass_budget: MassBudget | None = None

    @model_validator(mode="after")
    def _budget_adds_up(self) -> Vehicle:
        if self.mass_budget is not None:
            total = sum(float(q) for _, q in self.mass_budget)
            if abs(total - float(self.body.mass)) > 1e-4:
                raise _fault(
                    "mass_budget",
                    f"its groups add up to {total * 1e3:.1f} g, but body.mass is {float(self.body.mass) * 1e3:.1f} g",
                    "correct a group or body.mass (0.1 g apart at most)",
                )
        return self
