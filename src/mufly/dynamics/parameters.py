"""The numbers of the equations of motion, taken from a vehicle once.

A NumPy record, because Numba reads ``p.mass`` from it as fast as from a C struct, and an array of records is a
batch of different vehicles.
"""

from __future__ import annotations

from typing import Any, cast

import numpy as np

from mufly.errors import InputError
from mufly.rotor.maps import at, packed
from mufly.vehicle import Vehicle
from mufly.vehicle.coefficient_map import MAP_NODES
from mufly.vehicle.schema import MAX_LEGS

GRAVITY = 9.81  # m/s2, mid-latitude, as the thesis's hover point implies

_CURVE_POINTS = 101
_RIM_POINTS = 8
_MAX_POINTS = MAX_LEGS + _RIM_POINTS
_FASTEST_FRICTION = 2000.0  # 1/s, resolved by Runge-Kutta steps of 1 ms

_f8 = np.float64
PARAMETERS = np.dtype(
    [
        ("mass", _f8),  # kg
        ("Ixx", _f8),  # kg m2
        ("Iyy", _f8),
        ("Izz", _f8),
        ("thrust_up", _f8),  # N s2, T = thrust_up * Omega^2
        ("thrust_dw", _f8),
        ("torque_up", _f8),  # N m s2, Q = torque_up * Omega^2
        ("torque_dw", _f8),
        ("z_up", _f8),  # m, hub in body axes
        ("z_dw", _f8),
        ("J_up", _f8),  # kg m2, as the motor sees it
        ("J_dw", _f8),
        ("Jreact_up", _f8),  # kg m2, reacting on the fuselage
        ("Jreact_dw", _f8),
        ("kE", _f8),  # V s
        ("kM", _f8),  # N m/A
        ("dR", _f8),  # N m s
        ("R_ohm", _f8),  # ohm
        ("gear_ratio", _f8),
        ("gear_efficiency", _f8),
        ("swash_rate", _f8),  # 1/s, 1 / T_f,dw
        ("swash_gain", _f8),  # rad at full servo input
        ("bar_rate", _f8),  # 1/s, 1 / T_f,up
        ("bar_gain", _f8),  # l_up
        ("downwash", _f8),  # N
        ("drag_x", _f8),  # N s2/m2, rho cD A / 2
        ("drag_y", _f8),
        ("drag_z", _f8),
        ("battery_capacity", _f8),  # A s
        ("battery_resistance", _f8),  # ohm
        ("electronics_current", _f8),  # A
        ("battery_curve", _f8, (_CURVE_POINTS,)),  # V over charge 0..1
        ("leg_stiffness", _f8),  # N/m
        ("leg_damping", _f8),  # N s/m
        ("leg_friction", _f8),
        ("slip_speed", _f8),  # m/s
        ("friction_bound", _f8, (_MAX_POINTS,)),  # N s/m, see mufly.dynamics.model
        ("contact_reach", _f8),  # m, farthest contact point from the centre of gravity
        ("contact_count", np.int64),
        (
            "contact_points",
            _f8,
            (_MAX_POINTS, 3),
        ),  # m, body axes: legs first, then the rim of the upper rotor
        # Coefficient map, see mufly.dynamics.model: what stands above as thrust_up ... torque_dw is not used with
        # one.
        ("map_nodes", np.int64),  # 0: no map
        ("map_size", np.int64, (3,)),  # mean speeds, ratios, climbs
        ("map_start", _f8, (3,)),
        ("map_per_step", _f8, (3,)),
        ("map_radius", _f8),  # m
        ("map_thrust_up", _f8, (MAP_NODES,)),  # N s2
        ("map_torque_up", _f8, (MAP_NODES,)),  # N m s2
        ("map_thrust_dw", _f8, (MAP_NODES,)),
        ("map_torque_dw", _f8, (MAP_NODES,)),
    ]
)


def model_parameters(vehicle: Vehicle, voltage: float | None = None) -> np.void:
    """Return the parameters of the equations of motion.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle.
    voltage : float, optional
        Holds the battery at this voltage (V), whatever current is drawn. By default the vehicle's own battery
        model holds: ``"lithium-polymer"`` sags, ``"constant"`` keeps the nominal voltage.

    Returns
    -------
    record of type :data:`PARAMETERS`
        SI units. ``np.array([first, second], dtype=PARAMETERS)`` makes a batch of different vehicles.

    Raises
    ------
    InputError
        If the voltage is not positive.
    """
    if voltage is not None and not (np.isfinite(voltage) and voltage > 0):
        raise InputError(vehicle.name, "voltage", f"{voltage} V is not possible", "give a positive voltage")
    b, r, m, c = vehicle.body, vehicle.rotors, vehicle.motor, vehicle.contact
    rho, radius = float(vehicle.air.density), float(r.radius)
    thrust_unit = np.pi * rho * radius**4  # eq. 4.11
    torque_unit = np.pi * rho * radius**5  # eq. 4.12

    constant = voltage if voltage is not None else float(vehicle.battery.nominal_voltage)
    sags = voltage is None and vehicle.battery.model == "lithium-polymer"
    curve = (
        vehicle.battery.open_circuit_voltage.sample(_CURVE_POINTS)
        if sags
        else np.full(_CURVE_POINTS, constant)
    )

    legs = c.legs.array()
    angle = np.arange(_RIM_POINTS) * 2 * np.pi / _RIM_POINTS
    rim = np.column_stack(
        [radius * np.cos(angle), radius * np.sin(angle), np.full(_RIM_POINTS, float(r.upper.hub_z))]
    )
    points = np.vstack([legs, rim])
    padded = np.zeros((_MAX_POINTS, 3))
    padded[: len(points)] = points
    arm = np.sum(points[:, :2] ** 2, axis=1)
    share = np.concatenate(
        [np.full(len(legs), arm[: len(legs)].sum()), np.full(_RIM_POINTS, arm[len(legs) :].sum())]
    )
    bound = np.full(_MAX_POINTS, np.inf)
    bound[: len(points)] = _FASTEST_FRICTION * float(b.inertia_zz) / np.maximum(share, 1e-12)

    values: dict[str, Any] = {
        "mass": float(b.mass),
        "Ixx": float(b.inertia_xx),
        "Iyy": float(b.inertia_yy),
        "Izz": float(b.inertia_zz),
        "thrust_up": float(r.upper.thrust_coefficient) * thrust_unit,
        "thrust_dw": float(r.lower.thrust_coefficient) * thrust_unit,
        "torque_up": float(r.upper.torque_coefficient) * torque_unit,
        "torque_dw": float(r.lower.torque_coefficient) * torque_unit,
        "z_up": float(r.upper.hub_z),
        "z_dw": float(r.lower.hub_z),
        "J_up": float(r.upper.drive_inertia),
        "J_dw": float(r.lower.drive_inertia),
        "Jreact_up": float(r.upper.reaction_inertia),
        "Jreact_dw": float(r.lower.reaction_inertia),
        "kE": float(m.back_emf_constant),
        "kM": float(m.torque_constant),
        "dR": float(m.friction),
        "R_ohm": float(m.resistance),
        "gear_ratio": float(vehicle.gear.ratio),
        "gear_efficiency": float(vehicle.gear.efficiency),
        "swash_rate": 1.0 / float(vehicle.swash_plate.time_constant),
        "swash_gain": float(vehicle.swash_plate.linkage) * float(vehicle.swash_plate.max_tilt),
        "bar_rate": 1.0 / float(vehicle.stabiliser_bar.time_constant),
        "bar_gain": float(vehicle.stabiliser_bar.linkage),
        "downwash": float(b.downwash_drag),
        "drag_x": 0.5 * rho * float(b.drag_area_x),
        "drag_y": 0.5 * rho * float(b.drag_area_y),
        "drag_z": 0.5 * rho * float(b.drag_area_z),
        "battery_capacity": float(vehicle.battery.capacity),
        "battery_resistance": float(vehicle.battery.internal_resistance) if sags else 0.0,
        "electronics_current": float(vehicle.battery.electronics_current),
        "battery_curve": curve,
        "leg_stiffness": float(c.stiffness),
        "leg_damping": float(c.damping),
        "leg_friction": float(c.friction),
        "slip_speed": float(c.slip_speed),
        "friction_bound": bound,
        "contact_reach": float(np.max(np.linalg.norm(points, axis=1))),
        "contact_count": len(points),
        "contact_points": padded,
        **_map_numbers(vehicle),
    }
    record = np.zeros((), dtype=PARAMETERS)
    for name, value in values.items():
        record[name] = value
    return cast(np.void, record[()])


def _map_numbers(vehicle: Vehicle) -> dict[str, Any]:
    """Return what a record holds of a vehicle's map; nothing without one.

    Tables hold thrust and torque over ``Omega^2`` (N s2, N m s2), the rest of a table its last value. With
    ``rotors.map_level = "constants"`` each table is scaled so that at the hover point of the constant coefficients
    (eq. 5.1) it gives them.
    """
    r, m = vehicle.rotors, vehicle.rotors.coefficient_map
    if m is None:
        return {}
    rho, radius = float(vehicle.air.density), float(r.radius)
    unit = np.pi * rho * radius**4 * np.array([1.0, radius, 1.0, radius])
    constants = np.array(
        [float(c) for q in (r.upper, r.lower) for c in (q.thrust_coefficient, q.torque_coefficient)]
    )
    level = np.ones(4)
    if r.map_level == "constants":
        ratio = np.sqrt(constants[1] / constants[3])
        load = float(vehicle.body.mass) * GRAVITY + float(vehicle.body.downwash_drag)
        speed = np.sqrt(load / (unit[0] * (constants[0] + constants[2] * ratio**2)))
        there, _ = at(m, 0.5 * speed * (1.0 + ratio), ratio, 0.0)
        if not np.all(there > 0.0):
            raise InputError(
                vehicle.name, "rotors.map_level", f"map {m.name!r} has no lift or no drag at hover to be scaled",
                "use 'computed', or another map",
            )  # fmt: skip
        level = constants / there
    *tables, size, start, per_step = packed(m)
    full = np.array([np.concatenate([t, np.full(MAP_NODES - t.size, t[-1])]) for t in tables])
    full *= (level * unit)[:, None]
    return {
        "map_nodes": int(tables[0].size),
        "map_size": size,
        "map_start": start,
        "map_per_step": per_step,
        "map_radius": radius,
        "map_thrust_up": full[0],
        "map_torque_up": full[1],
        "map_thrust_dw": full[2],
        "map_torque_dw": full[3],
    }
