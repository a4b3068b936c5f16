"""State and input vectors of the flight model, and the record of its parameters.

The state is a flat array (21,) with the indices ``MODEL_...``; vectors in it also have a slice:

=====================  ================  ======================================================================
first index            slice             meaning
=====================  ================  ======================================================================
``MODEL_POSITION``     ``NED_POSITION_SLICE``      N, E, D of the centre of gravity (m)
``MODEL_VELOCITY``     ``NED_VELOCITY_SLICE``      N, E, D (m/s)
``MODEL_ATTITUDE``     ``ATTITUDE_SLICE``      quaternion w, x, y, z: rotates body vectors to N-E-D, unit length
``MODEL_RATES``        ``BODY_RATE_SLICE``         p, q, r (rad/s), body axes
``MODEL_SWASH_ROLL``                     alpha_dw, tilt of the lower tip-path plane about x (rad)
``MODEL_SWASH_PITCH``                    beta_dw, tilt of the lower tip-path plane about y (rad)
``MODEL_BAR_NORMAL``          ``BAR_NORMAL_SLICE``    upward normal of the stabiliser bar's disc in N-E-D, unit length
``MODEL_SPEED_UPPER``  ``ROTOR_SPEED_SLICE``  speeds of upper and, at ``MODEL_SPEED_LOWER``, lower rotor (rad/s)
``MODEL_CHARGE``                         remaining fraction of the battery's charge
=====================  ================  ======================================================================

The input is ``[motor upper, motor lower, servo 1, servo 2]``, with the indices ``U_...``: motors 0..1, servos -1..1.
Positive servo 1 pitches the nose down, positive servo 2 rolls to the right (docs/thesis/thesis-errata.md, point 2).
"""

from __future__ import annotations

from collections.abc import Mapping
from operator import attrgetter
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.compiled.record_fields import int_or_array_field as _int
from mufly.compiled.record_fields import make_record_dtype, record_fields
from mufly.compiled.record_fields import real_or_array_field as _real
from mufly.errors import InputError
from mufly.quantities.units import GRAVITY
from mufly.rotations import quaternion_from_euler
from mufly.rotor.coax_maps import interpolate_map, pack_map_tables
from mufly.rotor.forward.edgewise_map import fit_flight_map_splines
from mufly.vehicle import Vehicle
from mufly.vehicle.coefficient_map import MAX_MAP_NODES
from mufly.vehicle.flight_map import MAX_MAP_ADVANCE_RATIOS, MAX_MAP_CLIMBS
from mufly.vehicle.vehicle_schema import MAX_LEGS

_Array = NDArray[np.float64]

STATE_SIZE = 21
INPUT_SIZE = 4
MODEL_POSITION, MODEL_VELOCITY, MODEL_ATTITUDE, MODEL_RATES, MODEL_SWASH_ROLL, MODEL_SWASH_PITCH = 0, 3, 6, 10, 13, 14
MODEL_BAR_NORMAL, MODEL_SPEED_UPPER, MODEL_SPEED_LOWER, MODEL_CHARGE = 15, 18, 19, 20
NED_POSITION_SLICE, NED_VELOCITY_SLICE, ATTITUDE_SLICE = (
    slice(MODEL_POSITION, MODEL_VELOCITY),
    slice(MODEL_VELOCITY, MODEL_ATTITUDE),
    slice(MODEL_ATTITUDE, MODEL_RATES),
)
BODY_RATE_SLICE, BAR_NORMAL_SLICE = slice(MODEL_RATES, MODEL_SWASH_ROLL), slice(MODEL_BAR_NORMAL, MODEL_SPEED_UPPER)
ROTOR_SPEED_SLICE = slice(MODEL_SPEED_UPPER, MODEL_CHARGE)
U_MOTOR_UPPER, U_MOTOR_LOWER, U_SERVO_1, U_SERVO_2 = range(INPUT_SIZE)
MOTOR_INPUT_SLICE, SERVO_INPUT_SLICE = slice(U_MOTOR_UPPER, U_SERVO_1), slice(U_SERVO_1, INPUT_SIZE)
SWAPPED_MOTOR_INPUT_INDICES = [U_MOTOR_LOWER, U_MOTOR_UPPER, U_SERVO_1, U_SERVO_2]  # the order of the linear models


@cached_njit(error_model="numpy")
def rotation_entries(
    w: float, x: float, y: float, z: float
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """Return the nine entries of :func:`body_to_ned_matrix`, row by row, of a unit quaternion.

    The equations of motion use them as numbers, which lanes and symbols have too.
    """
    return (
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    )  # fmt: skip


@cached_njit(error_model="numpy")
def body_to_ned_matrix(quaternion: _Array) -> _Array:
    """Return the 3x3 rotation matrix from body axes to N-E-D of a unit quaternion (w, x, y, z).

    Thesis: eqs 4.1, 4.2.
    """
    w, x, y, z = quaternion
    a00, a01, a02, a10, a11, a12, a20, a21, a22 = rotation_entries(w, x, y, z)
    return np.array([[a00, a01, a02], [a10, a11, a12], [a20, a21, a22]])


def initial_state(
    *,
    position: ArrayLike = (0.0, 0.0, 0.0),
    velocity: ArrayLike = (0.0, 0.0, 0.0),
    attitude: ArrayLike = (0.0, 0.0, 0.0),
    rates: ArrayLike = (0.0, 0.0, 0.0),
    rotor_speed: ArrayLike = (0.0, 0.0),
    bar_attitude: ArrayLike | None = None,
    charge: float = 1.0,
) -> NDArray[np.float64]:
    """Return the flight model's state (21,) of a vehicle with the given motion, rotor speeds, bar tilt and charge.

    Parameters
    ----------
    position, velocity : (3,) array_like
        N, E, D (m, m/s).
    attitude : (3,) array_like
        Roll, pitch, yaw (rad).
    rates : (3,) array_like
        p, q, r (rad/s).
    rotor_speed : (2,) array_like
        Speeds of upper and lower rotor (rad/s).
    bar_attitude : (2,) array_like, optional
        Roll and pitch (rad) of the stabiliser bar's disc at the heading of the fuselage; by default the disc is normal
        to the mast.
    charge : float
        Fraction of the battery's charge.

    Returns
    -------
    (21,) array
    """
    roll, pitch, yaw = np.asarray(attitude, dtype=np.float64)
    state = np.zeros(STATE_SIZE)
    state[NED_POSITION_SLICE] = position
    state[NED_VELOCITY_SLICE] = velocity
    state[ATTITUDE_SLICE] = quaternion_from_euler(roll, pitch, yaw)
    state[BODY_RATE_SLICE] = rates
    bar_roll, bar_pitch = (roll, pitch) if bar_attitude is None else np.asarray(bar_attitude, np.float64)
    state[BAR_NORMAL_SLICE] = -body_to_ned_matrix(quaternion_from_euler(float(bar_roll), float(bar_pitch), yaw))[:, 2]
    state[ROTOR_SPEED_SLICE] = rotor_speed
    state[MODEL_CHARGE] = charge
    return state


# ----------------------------------------------------------------------------
# Parameters of the equations of motion as a NumPy record. Numba reads ``p.mass`` from it as fast as from a C struct,
# and an array of records is a batch of different vehicles.


_BATTERY_CURVE_POINT_COUNT = 101
_ROTOR_RIM_POINT_COUNT = 8
_MAX_CONTACT_POINTS = MAX_LEGS + _ROTOR_RIM_POINT_COUNT
_MAX_CONTACT_DAMPING_RATE_PER_S = 2000.0  # 1/s, resolved by Runge-Kutta steps of 1 ms


class ModelParameters:
    """Parameters of the equations of motion (:func:`model_parameters`), SI units.

    Without a coefficient map, the tables of the map are zero. With a map, ``thrust_up`` to ``torque_dw`` are not used.
    The fields from ``swash_phase`` on are not part of the filter's model.
    """

    mass: float = _real("mass", unit="kg", source="body.mass")
    Ixx: float = _real("moment of inertia about x", unit="kg m2", source="body.inertia_xx")
    Iyy: float = _real("moment of inertia about y", unit="kg m2", source="body.inertia_yy")
    Izz: float = _real("moment of inertia about z", unit="kg m2", source="body.inertia_zz")
    thrust_up: float = _real("upper thrust over the speed's square", unit="N s2")
    thrust_dw: float = _real("lower thrust over the speed's square", unit="N s2")
    torque_up: float = _real("upper torque over the speed's square", unit="N m s2")
    torque_dw: float = _real("lower torque over the speed's square", unit="N m s2")
    inplane: float = _real("drag in a disc's plane over speed and edgewise velocity", unit="N s2/m")
    ground_effect: float = _real("0: none, 1: Cheeseman and Bennett's", source="rotors.ground_effect")
    ground_radius: float = _real("rotor radius", unit="m", source="rotors.radius")
    ground_thrust_over_induced_speed2: float = _real(
        "2 rho pi R^2: thrust over the square of the induced velocity", unit="kg/m"
    )
    z_up: float = _real("hub of the upper rotor, body axes", unit="m", source="rotors.upper.hub_z")
    z_dw: float = _real("hub of the lower rotor, body axes", unit="m", source="rotors.lower.hub_z")
    J_up: float = _real("inertia that the motor sees", unit="kg m2", source="rotors.upper.drive_inertia")
    J_dw: float = _real("inertia that the motor sees", unit="kg m2", source="rotors.lower.drive_inertia")
    Jreact_up: float = _real("inertia reacting on the fuselage", unit="kg m2", source="rotors.upper.reaction_inertia")
    Jreact_dw: float = _real("inertia reacting on the fuselage", unit="kg m2", source="rotors.lower.reaction_inertia")
    kE: float = _real("back-EMF constant", unit="V s", source="motor.back_emf_constant")
    kM: float = _real("torque constant", unit="N m/A", source="motor.torque_constant")
    dR: float = _real("viscous friction of a motor", unit="N m s", source="motor.friction")
    Mf: float = _real("dry friction of a motor", unit="N m", source="motor.friction_torque")
    R_ohm: float = _real("armature resistance", unit="ohm", source="motor.resistance")
    gear_ratio: float = _real("motor speed over rotor speed", source="gear.ratio")
    gear_efficiency: float = _real("efficiency of a gear", source="gear.efficiency")
    swash_rate: float = _real("1 / T_f,dw", unit="1/s")
    swash_gain: float = _real("tilt at full servo input", unit="rad")
    bar_rate: float = _real("1 / T_f,up", unit="1/s")
    bar_gain: float = _real("l_up; 0 without a bar")
    downwash_drag: float = _real("drag in the downwash", unit="N", source="body.downwash_drag")
    drag_over_speed2_x: float = _real("rho cD A / 2 along x", unit="N s2/m2")
    drag_over_speed2_y: float = _real("rho cD A / 2 along y", unit="N s2/m2")
    drag_over_speed2_z: float = _real("rho cD A / 2 along z", unit="N s2/m2")
    battery_capacity: float = _real("charge of the full battery", unit="A s", source="battery.capacity")
    battery_resistance: float = _real("internal resistance of the battery", unit="ohm")
    electronics_current: float = _real("of the electronics", unit="A", source="battery.electronics_current")
    battery_curve: _Array = _real("open-circuit voltage over charge 0..1", _BATTERY_CURVE_POINT_COUNT, unit="V")
    leg_stiffness: float = _real("stiffness of a leg", unit="N/m", source="contact.stiffness")
    leg_damping: float = _real("damping of a leg", unit="N s/m", source="contact.damping")
    leg_friction: float = _real("coefficient of friction", source="contact.friction")
    slip_speed: float = _real("sliding speed from which friction is Coulomb's", unit="m/s", source="contact.slip_speed")
    contact_friction_damping_limit: _Array = _real("bound of each point's friction", _MAX_CONTACT_POINTS, unit="N s/m")
    contact_reach: float = _real("distance of the farthest contact point from the centre of gravity", unit="m")
    contact_count: int = _int("contact points")
    contact_points: _Array = _real("legs, then the upper rotor's rim, body axes", _MAX_CONTACT_POINTS, 3, unit="m")
    map_node_count: int = _int("nodes of a table of the coefficient map; 0: no map")
    map_size: NDArray[np.int64] = _int("mean speeds, ratios, climbs of the map", 3)
    map_start: _Array = _real("first of each", 3)
    map_inverse_steps: _Array = _real("inverse of the step of each", 3)
    map_radius: float = _real("rotor radius", unit="m")
    thrust_over_speed2_table_up: _Array = _real("upper thrust over the speed's square", MAX_MAP_NODES, unit="N s2")
    torque_over_speed2_table_up: _Array = _real("upper torque over the speed's square", MAX_MAP_NODES, unit="N m s2")
    thrust_over_speed2_table_dw: _Array = _real("lower thrust over the speed's square", MAX_MAP_NODES, unit="N s2")
    torque_over_speed2_table_dw: _Array = _real("lower torque over the speed's square", MAX_MAP_NODES, unit="N m s2")
    swash_phase: float = _real(
        "lag of the lower disc's tilt behind the plate's", unit="rad", source="swash_plate.phase"
    )
    flight_map_node_count: int = _int("climbs times edgewise velocities of the flight map; 0: no map")
    flight_map_size: NDArray[np.int64] = _int("climbs and edgewise velocities of the map", 2)
    flight_map_start: _Array = _real("first of each", 2)
    flight_map_inverse_steps: _Array = _real("inverse of the step of each", 2)
    flight_map_speed_ratios: _Array = _real("middle, lowest and highest speed ratio of the map", 3)
    flight_map_knee2: float = _real("k^2 of the edgewise axis")
    flight_map_scale: float = _real("rho pi R^3", unit="kg")
    flight_map_radius: float = _real("rotor radius", unit="m", source="rotors.radius")
    flight_map_table: _Array = _real(
        "spline coefficients of the loads of both rotors", 12 * (MAX_MAP_CLIMBS + 2) * MAX_MAP_ADVANCE_RATIOS
    )
    flight_map_rate_loads: _Array = _real("loads of roll and pitch rate", 8 * MAX_MAP_ADVANCE_RATIOS)


_PARAMETER_GETTERS = {
    name: attrgetter(field.source) for name, field in record_fields(ModelParameters).items() if field.source
}
PARAMETER_DTYPE = make_record_dtype(ModelParameters, int_kind=np.int64)
"""Type of a record of :class:`ModelParameters`."""
MAP_TABLE_FIELDS = tuple(f"{what}_over_speed2_table_{side}" for side in ("up", "dw") for what in ("thrust", "torque"))
"""Fields of :class:`ModelParameters` with the tables of a coefficient map."""


def model_parameters(vehicle: Vehicle, voltage: float | None = None) -> np.void:
    """Return the parameters of the equations of motion of a vehicle.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle.
    voltage : float, optional
        Constant battery voltage (V), independent of the current. By default the vehicle's battery model applies:
        ``"lithium-polymer"`` with voltage drop, ``"constant"`` at the nominal voltage.

    Returns
    -------
    record of type :data:`PARAMETER_DTYPE`
        Parameters in SI units. ``np.array([first, second], dtype=PARAMETER_DTYPE)`` is a batch of different vehicles.

    Raises
    ------
    InputError
        If the voltage is not positive.

    Thesis: eqs 4.11, 4.12.
    """
    if voltage is not None and not (np.isfinite(voltage) and voltage > 0):
        raise InputError(vehicle.name, "voltage", f"{voltage} V is out of range", "give a positive voltage")
    b, r, c = vehicle.body, vehicle.rotors, vehicle.contact
    rho, radius = float(vehicle.air.density), float(r.radius)
    constant = voltage if voltage is not None else float(vehicle.battery.nominal_voltage)
    sags = voltage is None and vehicle.battery.model == "lithium-polymer"
    curve = vehicle.battery.open_circuit_voltage

    legs = c.legs.to_array()
    angle = np.arange(_ROTOR_RIM_POINT_COUNT) * 2 * np.pi / _ROTOR_RIM_POINT_COUNT
    rim = np.column_stack(
        [radius * np.cos(angle), radius * np.sin(angle), np.full(_ROTOR_RIM_POINT_COUNT, float(r.upper.hub_z))]
    )
    points = np.vstack([legs, rim])
    padded = np.zeros((_MAX_CONTACT_POINTS, 3))
    padded[: len(points)] = points
    arm = np.sum(points[:, :2] ** 2, axis=1)
    share = np.concatenate(
        [np.full(len(legs), arm[: len(legs)].sum()), np.full(_ROTOR_RIM_POINT_COUNT, arm[len(legs) :].sum())]
    )
    bound = np.full(_MAX_CONTACT_POINTS, np.inf)
    bound[: len(points)] = _MAX_CONTACT_DAMPING_RATE_PER_S * float(b.inertia_zz) / np.maximum(share, 1e-12)

    values: dict[str, Any] = {name: float(take(vehicle)) for name, take in _PARAMETER_GETTERS.items()}
    for side, rotor in (("up", r.upper), ("dw", r.lower)):
        values[f"thrust_{side}"] = float(rotor.thrust_coefficient) * (np.pi * rho * radius**4)  # eq. 4.11
        values[f"torque_{side}"] = float(rotor.torque_coefficient) * (np.pi * rho * radius**5)  # eq. 4.12
    values |= {
        "inplane": float(r.inplane_drag) * (np.pi * rho * radius**3),
        "ground_thrust_over_induced_speed2": 2.0 * rho * np.pi * radius**2,
        "swash_rate": 1.0 / float(vehicle.swash_plate.time_constant),
        "swash_gain": float(vehicle.swash_plate.linkage) * float(vehicle.swash_plate.max_tilt),
        "bar_gain": float(vehicle.stabiliser_bar.linkage) * vehicle.stabiliser_bar.fitted,
        "bar_rate": 1.0 / float(vehicle.stabiliser_bar.time_constant),
        "drag_over_speed2_x": 0.5 * rho * float(b.drag_area_x),
        "drag_over_speed2_y": 0.5 * rho * float(b.drag_area_y),
        "drag_over_speed2_z": 0.5 * rho * float(b.drag_area_z),
        "battery_resistance": float(vehicle.battery.internal_resistance) if sags else 0.0,
        "battery_curve": curve.sample_evenly(_BATTERY_CURVE_POINT_COUNT)
        if sags
        else np.full(_BATTERY_CURVE_POINT_COUNT, constant),
        "contact_friction_damping_limit": bound,
        "contact_reach": float(np.max(np.linalg.norm(points, axis=1))),
        "contact_count": len(points),
        "contact_points": padded,
    }
    values |= _coefficient_map_fields(vehicle, values) | _flight_map_fields(vehicle)
    record = np.zeros((), dtype=PARAMETER_DTYPE)
    for name, value in values.items():
        record[name] = value
    return cast(np.void, record[()])


def compute_hover_rotor_speeds(
    p: np.void | NDArray[Any] | Mapping[str, float],
    thrust: ArrayLike | None = None,
    torque: ArrayLike | None = None,
) -> NDArray[np.float64]:
    """Return the rotor speeds (upper, lower; rad/s; shape (..., 2)) in hover: eq. 5.1.

    The thrust balances weight and downwash drag, and the torques balance each other::

        cT_up k_T Wu^2 + cT_dw k_T Wd^2 = m g + W_hub        cQ_up Wu^2 = cQ_dw Wd^2

    Parameters
    ----------
    p : record of type :data:`PARAMETER_DTYPE`, or array of them
        Parameters; a mapping with the same fields is accepted.
    thrust, torque : (2, ...) array_like, optional
        Thrust and torque of upper and lower rotor over the squares of their speeds (N s^2, N m s^2); default: the
        constants of ``p``.

    Thesis: eq. 5.1.
    """
    t_up, t_dw = (p["thrust_up"], p["thrust_dw"]) if thrust is None else np.asarray(thrust)
    q_up, q_dw = (p["torque_up"], p["torque_dw"]) if torque is None else np.asarray(torque)
    ratio = q_up / q_dw  # (lower speed / upper speed)^2
    upper = np.sqrt((p["mass"] * GRAVITY + p["downwash_drag"]) / (t_up + t_dw * ratio))
    return np.stack([upper, upper * np.sqrt(ratio)], axis=-1)


def _coefficient_map_fields(vehicle: Vehicle, constants: dict[str, float]) -> dict[str, Any]:
    """Return the fields of the model's record that hold a vehicle's coefficient map; empty without a map.

    Tables contain thrust and torque over ``Omega^2`` (N s^2, N m s^2); unused entries repeat the last value. With
    ``rotors.map_level = "constants"`` each table is scaled to match the constant coefficients at their hover point (eq.
    5.1).
    """
    r, m = vehicle.rotors, vehicle.rotors.coefficient_map
    if m is None:
        return {}
    rho, radius = float(vehicle.air.density), float(r.radius)
    unit = np.pi * rho * radius**4 * np.array([1.0, radius, 1.0, radius])
    level = np.ones(4)
    if r.map_level == "constants":
        up, dw = compute_hover_rotor_speeds(constants)
        there, _ = interpolate_map(m, 0.5 * (up + dw), dw / up, 0.0)
        if not np.all(there > 0.0):
            raise InputError(
                vehicle.name, "rotors.map_level", f"map {m.name!r} has zero thrust or torque at hover and "
                "cannot be scaled",
                "use 'computed', or another map",
            )  # fmt: skip
        level = np.array([constants[f] for f in ("thrust_up", "torque_up", "thrust_dw", "torque_dw")]) / unit / there
    *tables, size, start, per_step = pack_map_tables(m)
    full = np.array([np.concatenate([t, np.full(MAX_MAP_NODES - t.size, t[-1])]) for t in tables])
    full *= (level * unit)[:, None]
    return {
        "map_node_count": int(tables[0].size),
        "map_size": size,
        "map_start": start,
        "map_inverse_steps": per_step,
        "map_radius": radius,
        **dict(zip(MAP_TABLE_FIELDS, full, strict=True)),
    }


def _flight_map_fields(vehicle: Vehicle) -> dict[str, Any]:
    """Return the fields of the model's record that hold a vehicle's flight map; empty without a map."""
    m = vehicle.rotors.flight_map
    if m is None:
        return {}
    splines = fit_flight_map_splines(m.decode_map_tables())
    padded = {}
    for name, values, room in (
        ("flight_map_table", splines.coefficient_table, 12 * (MAX_MAP_CLIMBS + 2) * MAX_MAP_ADVANCE_RATIOS),
        ("flight_map_rate_loads", splines.rate_coefficient_table, 8 * MAX_MAP_ADVANCE_RATIOS),
    ):
        padded[name] = np.zeros(room)
        padded[name][: values.size] = values.ravel()
    return padded | {
        "flight_map_node_count": int(np.prod(splines.size)),
        "flight_map_size": splines.size,
        "flight_map_start": splines.start,
        "flight_map_inverse_steps": splines.per_step,
        "flight_map_speed_ratios": [splines.speed_ratio_middle, splines.speed_ratio_low, splines.speed_ratio_high],
        "flight_map_knee2": m.knee**2,
        "flight_map_scale": np.pi * float(vehicle.air.density) * float(vehicle.rotors.radius) ** 3,
    }
