"""Level flight of a coaxial helicopter over airspeed, with both rotors computed by blade elements over azimuth.

The blades are those of a rotor file. The pitch settings give the hover thrusts of the vehicle's own coefficients at
its own hover speeds, and torques are scaled to the vehicle's in hover. Unknowns of a trim are pitch and roll attitude,
both servo inputs and both rotor speeds; equations are the balances of force and moment, fuselage drag included:

    0 = F_rotors + F_fuselage + A^T m g,    0 = M_hub + r_hub x F_rotors,    0 = Q_up - Q_dw

Linkage and tilt of the swash plate are identified as a product only: the moment l_dw theta_max T_dw z_dw at full input
in hover. The cyclic pitch of the lower blades is therefore scaled such that full input gives that moment, and the plate
is turned such that in hover each servo acts on one axis. In steady flight the stabiliser bar of the upper rotor is
perpendicular to the mast.

The result depends strongly on the flap frequency, so two trims are computed, one for each end of its band
(:func:`mufly.rotor.forward.estimate_flap_mode_range`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import root

from mufly.drive.drive_train import battery_voltage, drive_of_vehicle, open_circuit_voltage
from mufly.dynamics.linearisation import find_trim
from mufly.errors import InputError, MuflyError
from mufly.quantities.units import GRAVITY
from mufly.results import ResultColumn, ShownBlock, draws, make_lines_block, result, tabulate_results
from mufly.results.result_figure import blank_figure, label_axes
from mufly.rotor import Air, Blading, Rotor, prepare_blading
from mufly.rotor.forward import (
    ForwardCondition,
    ForwardPair,
    RigidFlapMode,
    estimate_flap_mode_range,
    solve_forward_pair,
)
from mufly.vehicle import Vehicle

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

_TRIM_TOLERANCE = 1e-5  # of weight, full servo moment and hover torque
_TRIM_OPTIONS: Any = {"eps": 1e-4}  # relative step of the differences, far above the tolerance of the coupling
_COUPLING_TOLERANCE = 1e-6
_CYCLIC_STEP_RAD = math.radians(0.5)
_MAX_TRIM_SERVO_INPUT = 1.6  # of full input, up to which a trim is followed
_BATTERY_CHARGE_FRACTION = 0.5  # of the battery, as for the hover performance
_RADIUS_TOLERANCE = 0.01


@result
class LevelTrim:
    """Steady level flight at an airspeed.

    Attributes
    ----------
    airspeed_m_s : float
    flap_frequency_ratio : float
        Flap frequency over rotor speed of the upper rotor.
    pitch_rad, roll_rad : float
        Attitude; pitch nose up.
    servo_pitch, servo_roll : float
        Servo inputs over full input, positive for moments nose up and right side down.
    rotor_speed_rad_s : (float, float)
        Speed of upper and lower rotor.
    shaft_power_W, power_W : float
        Power of both shafts; power at the battery's terminals, with electronics.
    motor_input : (float, float)
        Inputs of both motors on a half-full battery, 1 is full.
    thrust_margin : float
        Thrust at full input of the first motor that reaches it, over the thrust needed, less 1.
    is_outside_method_range : bool
        True if a rotor lies outside the range of its method.
    """

    airspeed_m_s: float
    flap_frequency_ratio: float
    pitch_rad: float
    roll_rad: float
    servo_pitch: float
    servo_roll: float
    rotor_speed_rad_s: tuple[float, float]
    shaft_power_W: float
    power_W: float
    motor_input: tuple[float, float]
    thrust_margin: float
    is_outside_method_range: bool

    @property
    def larger_servo_input(self) -> float:
        """Larger of both servo inputs (1: full input)."""
        return max(abs(self.servo_pitch), abs(self.servo_roll))


_RESULT_COLUMNS = (
    ResultColumn("flap_frequency_ratio", form=".3g", head="nu"),
    ResultColumn("airspeed_m_s", form=".3g", head="V", own_unit="m/s"),
    ResultColumn("pitch_rad", "deg", "z.1f", head="pitch"),
    ResultColumn("roll_rad", "deg", "z.1f", head="roll"),
    ResultColumn("servo_pitch", form="z.2f", head="servo pitch"),
    ResultColumn("servo_roll", form="z.2f", head="servo roll"),
    ResultColumn("power_W", "W", ".2f", head="power"),
    ResultColumn("thrust_margin", form="z.2f", head="thrust margin"),
)


@result(eq=False)
class LevelFlight:
    """Level flight over airspeed, for the lowest and the highest flap frequency of the blades' uncertainty band.

    Attributes
    ----------
    vehicle, rotor : str
        Names of vehicle and blades.
    flap_basis : str
        Origin of the flap frequencies.
    trims : tuple of tuples of LevelTrim
        Trims by flap frequency and airspeed; a row ends where no trim is found.
    greatest_speed_m_s : (float, float)
        Greatest level airspeed, smallest and largest over the band; infinite if no limit is met.
    endurance_speed_m_s : (float, float)
        Airspeed of least power below that limit, smallest and largest over the band.
    """

    vehicle: str
    rotor: str
    flap_basis: str
    trims: tuple[tuple[LevelTrim, ...], ...]
    greatest_speed_m_s: tuple[float, float]
    endurance_speed_m_s: tuple[float, float]

    def make_printed_blocks(self) -> tuple[ShownBlock, ...]:
        """Return the results over airspeed, and the limits of airspeed, as printed text."""
        rows = [t for line in self.trims for t in line]
        low, high = self.greatest_speed_m_s
        fastest = max((t.airspeed_m_s for t in rows), default=0.0)
        least, most = self.endurance_speed_m_s
        if math.isinf(low):
            limit = f"above {fastest:g} m/s"
        elif math.isinf(high):
            limit = f"{low:.1f} to more than {fastest:g} m/s"
        else:
            limit = f"{low:.1f} to {high:.1f} m/s"
        blocks: list[ShownBlock] = [
            make_lines_block(f" with blades {self.rotor}; {self.flap_basis}", head=self.vehicle),
            tabulate_results(rows, _RESULT_COLUMNS),
            make_lines_block(
                f"greatest level airspeed: {limit} (full servo or full motor input); least power: at {least:.1f} to "
                f"{most:.1f} m/s"
            ),
        ]
        if any(t.is_outside_method_range for t in rows):
            at = ", ".join(dict.fromkeys(f"{t.airspeed_m_s:g}" for t in rows if t.is_outside_method_range))
            blocks.append(
                make_lines_block(
                    f"{at} m/s: a rotor is outside the range of its method", mark="Warning", style="yellow"
                )
            )
        return tuple(blocks)


(
    _TRIM_INDEX_PITCH,
    _TRIM_INDEX_ROLL,
    _TRIM_INDEX_SERVO_ROLL,
    _TRIM_INDEX_SERVO_PITCH,
    _TRIM_INDEX_UPPER_SPEED_FACTOR,
    _TRIM_INDEX_LOWER_SPEED_FACTOR,
) = range(6)  # unknowns of a trim


class LevelFlightModel:
    """Equations of level flight: blades, hover point, servo authority, and a flap mode for each rotor."""

    def __init__(self, vehicle: Vehicle, blading: Blading, flaps: tuple[RigidFlapMode, RigidFlapMode]) -> None:
        hover = find_trim(vehicle, charge=_BATTERY_CHARGE_FRACTION)
        self.vehicle, self.blading, self.flaps = vehicle, blading, flaps
        self.air = Air(density_kg_m3=float(vehicle.air.density))
        self.heights = (-float(vehicle.rotors.upper.hub_z), -float(vehicle.rotors.lower.hub_z))
        self.speeds = (float(hover.rotor_speed[0]), float(hover.rotor_speed[1]))
        self.torque = float(hover.torque_Nm[0])
        self.last: ForwardPair | None = None
        self.pitch = self._find_hover_pitch((float(hover.thrust_N[0]), float(hover.thrust_N[1])))
        at_rest = self.solve_pair_loads()
        self.torque_scale = tuple(
            float(q) / r.torque_Nm for q, r in zip(hover.torque_Nm, (at_rest.upper, at_rest.lower), strict=True)
        )
        self.servo_moment = (
            float(vehicle.swash_plate.linkage) * float(vehicle.swash_plate.max_tilt) * float(hover.thrust_N[1])
            * self.heights[1]
        )  # fmt: skip
        slopes = np.zeros((2, 2))
        for k in range(2):
            for sign in (1.0, -1.0):
                cyclic = [0.0, 0.0]
                cyclic[k] = sign * _CYCLIC_STEP_RAD
                lower = self.solve_pair_loads(cyclic=(cyclic[0], cyclic[1])).lower
                moment = (
                    lower.roll_moment_Nm + self.heights[1] * lower.y_force_N,
                    lower.pitch_moment_Nm + self.heights[1] * lower.h_force_N,
                )
                slopes[:, k] += 0.5 * sign / _CYCLIC_STEP_RAD * np.array(moment)
        self.cyclic_per_servo = np.linalg.inv(slopes) * self.servo_moment  # columns: roll, pitch
        self.last = at_rest

    def solve_pair_loads(
        self, edgewise: float = 0.0, climb: float = 0.0, azimuth: float = 0.0,
        factors: tuple[float, float] = (1.0, 1.0), cyclic: tuple[float, float] = (0.0, 0.0),
    ) -> ForwardPair:  # fmt: skip
        """Compute the loads of both rotors in forward flight; the iteration starts from the preceding solution."""
        first = ForwardCondition(
            self.pitch[0], factors[0] * self.speeds[0], edgewise, climb, wind_azimuth_rad=azimuth, air=self.air
        )
        second = replace(
            first, pitch_rad=self.pitch[1], speed_rad_s=factors[1] * self.speeds[1], cyclic_rad=cyclic, rotation_sign=-1
        )
        self.last = solve_forward_pair(
            self.blading, self.blading, (first, second), self.flaps, spacing_m=self.heights[0] - self.heights[1],
            start=self.last, tolerance=_COUPLING_TOLERANCE,
        )  # fmt: skip
        return self.last

    def _find_hover_pitch(self, thrust: tuple[float, float]) -> tuple[float, float]:
        """Return the pitch settings that give the thrusts in hover."""

        def hover_thrust_error(pitch: Array) -> Array:
            self.pitch = (float(pitch[0]), float(pitch[1]))
            pair = self.solve_pair_loads()
            return np.array([pair.upper.thrust_N / thrust[0] - 1.0, pair.lower.thrust_N / thrust[1] - 1.0])

        self.pitch = (0.2, 0.2)
        try:
            found: Any = root(hover_thrust_error, np.array(self.pitch), tol=1e-6, options={"eps": 1e-3})
        except MuflyError:
            found = None
        if found is None or not np.max(np.abs(found.fun)) < 1e-4:
            raise MuflyError(
                f"{self.vehicle.name}: the blades {self.blading.rotors[0].name} do not reach the hover thrusts "
                f"{thrust[0]:.3g} and {thrust[1]:.3g} N at {self.speeds[0]:.0f} and {self.speeds[1]:.0f} "
                "rad/s; give "
                "other blades by --rotor"
            )
        return float(found.x[0]), float(found.x[1])

    def wrench_imbalance(self, x: Array, airspeed: float) -> tuple[Array, ForwardPair]:
        """Return the dimensionless imbalance of forces and moments in level flight, and the rotor loads, at ``x``.

        The unknowns are pitch, roll, two servo inputs, and the factors of the upper and the lower rotor speed.
        """
        v, body = self.vehicle, self.vehicle.body
        pitch, roll = float(x[_TRIM_INDEX_PITCH]), float(x[_TRIM_INDEX_ROLL])
        flow = airspeed * np.array(
            [math.cos(pitch), math.sin(pitch) * math.sin(roll), math.sin(pitch) * math.cos(roll)]
        )
        edgewise, azimuth = math.hypot(flow[0], flow[1]), math.atan2(flow[1], flow[0])
        cyclic = self.cyclic_per_servo @ x[[_TRIM_INDEX_SERVO_ROLL, _TRIM_INDEX_SERVO_PITCH]]
        pair = self.solve_pair_loads(
            edgewise,
            -float(flow[2]),
            azimuth,
            (float(x[_TRIM_INDEX_UPPER_SPEED_FACTOR]), float(x[_TRIM_INDEX_LOWER_SPEED_FACTOR])),
            (float(cyclic[0]), float(cyclic[1])),
        )
        weight = float(body.mass) * GRAVITY
        gravity = weight * np.array(
            [-math.sin(pitch), math.cos(pitch) * math.sin(roll), math.cos(pitch) * math.cos(roll)]
        )
        area = np.array([float(body.drag_area_x), float(body.drag_area_y), float(body.drag_area_z)])
        force = gravity - 0.5 * float(v.air.density) * area * np.abs(flow) * flow
        force += np.array([-pair.h_force_N, pair.y_force_N, float(body.downwash_drag) - pair.thrust_N])
        up, dw = pair.upper, pair.lower
        roll_moment = pair.roll_moment_Nm + self.heights[0] * up.y_force_N + self.heights[1] * dw.y_force_N
        pitch_moment = pair.pitch_moment_Nm + self.heights[0] * up.h_force_N + self.heights[1] * dw.h_force_N
        yaw = self.torque_scale[0] * up.torque_Nm - self.torque_scale[1] * dw.torque_Nm
        moments = np.array([roll_moment / self.servo_moment, pitch_moment / self.servo_moment, yaw / self.torque])
        return np.concatenate((force / weight, moments)), pair

    def solve_trim(self, airspeed: float, start: Array) -> tuple[Array, ForwardPair] | None:
        """Solve level flight at an airspeed (m/s): return the unknowns of :meth:`wrench_imbalance` and the loads, or
        None.
        """

        def trim_residual(x: Array) -> Array:
            return self.wrench_imbalance(x, airspeed)[0]

        try:
            found: Any = root(trim_residual, start, tol=1e-7, options=_TRIM_OPTIONS)
            miss, pair = self.wrench_imbalance(found.x, airspeed)
        except MuflyError:
            return None
        return (found.x, pair) if np.max(np.abs(miss)) < _TRIM_TOLERANCE else None

    def battery_power_and_inputs(
        self, torques: Sequence[float], speeds: Sequence[float]
    ) -> tuple[float, tuple[float, float]]:
        """Return the battery power (W) and the inputs of both motors, nan beyond the battery's power."""
        m = drive_of_vehicle(self.vehicle).motor_constants()
        ratio, battery = float(m.gear_ratio), self.vehicle.battery
        volts, watts = [], 0.0
        for torque, speed in zip(torques, speeds, strict=True):
            load = torque / (ratio * float(m.gear_efficiency)) + float(m.friction_Nm)
            current = (load + float(m.friction_Nm_s) * ratio * speed) / float(m.torque_Nm_A)
            volts.append(float(m.resistance_ohm) * current + float(m.back_emf_V_s) * ratio * speed)
            watts += volts[-1] * current / float(m.controller_efficiency)
        supply = float(battery_voltage(battery, open_circuit_voltage(battery, _BATTERY_CHARGE_FRACTION), watts))
        inputs = (volts[0] / supply, volts[1] / supply)
        return watts + supply * float(battery.electronics_current), inputs

    def thrust_margin(self, torques: Sequence[float], speeds: Sequence[float]) -> float:
        """Return the relative reserve of thrust, if both speeds rise by one factor until a motor is at full input."""
        low, high = 0.2, 5.0
        for _ in range(50):
            middle = 0.5 * (low + high)
            inputs = self.battery_power_and_inputs([q * middle**2 for q in torques], [w * middle for w in speeds])[1]
            if max(inputs) <= 1.0:  # false for nan
                low = middle
            else:
                high = middle
        return low**2 - 1.0


def _find_speed_reaching_value(speeds: list[float], values: list[float], level: float) -> float:
    """Return the first speed at which values rise to a level; infinite if they do not."""
    for k, value in enumerate(values):
        if value >= level:
            if k == 0:
                return speeds[0]
            part = (level - values[k - 1]) / (value - values[k - 1])
            return speeds[k - 1] + part * (speeds[k] - speeds[k - 1])
    return math.inf


def check_blade_radius(vehicle: Vehicle, rotor: Rotor) -> None:
    """Check that blades have the vehicle's rotor radius.

    Raises
    ------
    InputError
        If the radii differ by more than 1 %.
    """
    radius = float(vehicle.rotors.radius)
    if abs(rotor.radius_m / radius - 1.0) > _RADIUS_TOLERANCE:
        raise InputError(
            vehicle.name, "rotors.radius", f"is {1e3 * radius:g} mm, but the blades {rotor.name} have "
            f"{1e3 * rotor.radius_m:g} mm", "give the vehicle's blades by --rotor FILE",
        )  # fmt: skip


def compute_level_flight(vehicle: Vehicle, rotor: Rotor, airspeeds: Sequence[float]) -> LevelFlight:
    """Compute level flight over airspeed.

    Parameters
    ----------
    vehicle : Vehicle
    rotor : Rotor
        Blades of both rotors, with the vehicle's rotor radius.
    airspeeds : sequence of float
        Rising airspeeds (m/s); 0 is added.

    Raises
    ------
    InputError
        If the radius differs from the vehicle's, or the airspeeds do not rise.
    MuflyError
        If the blades cannot give the hover thrusts.
    """
    check_blade_radius(vehicle, rotor)
    wanted = sorted({0.0, *map(float, airspeeds)})
    if not all(math.isfinite(v) and v >= 0.0 for v in wanted):
        raise InputError(vehicle.name, "airspeeds", "are not all 0 or more", "give finite airspeeds")
    blading = prepare_blading(rotor)
    hover = find_trim(vehicle, charge=_BATTERY_CHARGE_FRACTION)
    bands = [estimate_flap_mode_range(rotor, float(w)) for w in hover.rotor_speed]
    lines, greatest, best = [], [], []
    for end in range(2):
        model = LevelFlightModel(vehicle, blading, (bands[0][0][end], bands[1][0][end]))
        x, line, stopped = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 1.0]), [], math.inf
        for v in wanted:
            found = model.solve_trim(v, x)
            if found is None:
                stopped = v
                break
            x, pair = found
            torques = [k * r.torque_Nm for k, r in zip(model.torque_scale, (pair.upper, pair.lower), strict=True)]
            speeds = (
                float(x[_TRIM_INDEX_UPPER_SPEED_FACTOR]) * model.speeds[0],
                float(x[_TRIM_INDEX_LOWER_SPEED_FACTOR]) * model.speeds[1],
            )
            power, inputs = model.battery_power_and_inputs(torques, speeds)
            line.append(
                LevelTrim(
                    v,
                    model.flaps[0].frequency_ratio,
                    float(x[_TRIM_INDEX_PITCH]),
                    float(x[_TRIM_INDEX_ROLL]),
                    float(x[_TRIM_INDEX_SERVO_PITCH]),
                    float(x[_TRIM_INDEX_SERVO_ROLL]),
                    speeds,
                    sum(q * w for q, w in zip(torques, speeds, strict=True)),
                    power,
                    inputs,
                    model.thrust_margin(torques, speeds),
                    pair.upper.is_outside_range or pair.lower.is_outside_range,
                )
            )
            if line[-1].larger_servo_input > _MAX_TRIM_SERVO_INPUT:
                break
        flown = [t.airspeed_m_s for t in line]
        limit = min(
            _find_speed_reaching_value(flown, [t.larger_servo_input for t in line], 1.0),
            _find_speed_reaching_value(flown, [-t.thrust_margin for t in line], 0.0),
            stopped,
        )  # fmt: skip
        able = [t for t in line if t.airspeed_m_s <= limit]
        lines.append(tuple(line))
        greatest.append(limit)
        best.append(min(able, key=lambda t: t.power_W).airspeed_m_s if able else 0.0)
    return LevelFlight(
        vehicle.name, rotor.name, bands[0][1], tuple(lines), (min(greatest), max(greatest)), (min(best), max(best))
    )


@draws(LevelFlight)
def draw_level_flight(flight: LevelFlight) -> Figure:
    """Draw power, attitude, servo inputs and thrust margin over airspeed, a line for each flap frequency."""
    figure = blank_figure(10.0, 7.0)
    axes = power, attitude, servo, margin = figure.subplots(2, 2).ravel()
    for k, line in enumerate(flight.trims):
        speed = [t.airspeed_m_s for t in line]
        label = f"{line[0].flap_frequency_ratio:.3g}/rev" if line else ""
        power.plot(speed, [t.power_W for t in line], color=f"C{k}", label=label)
        attitude.plot(speed, [math.degrees(t.pitch_rad) for t in line], color=f"C{k}", label=f"pitch, {label}")
        attitude.plot(speed, [math.degrees(t.roll_rad) for t in line], "--", color=f"C{k}", label=f"roll, {label}")
        servo.plot(speed, [t.larger_servo_input for t in line], color=f"C{k}", label=label)
        margin.plot(speed, [t.thrust_margin for t in line], color=f"C{k}", label=label)
    servo.axhline(1.0, color="0.4", linewidth=0.8, linestyle=":")
    margin.axhline(0.0, color="0.4", linewidth=0.8, linestyle=":")
    names = ("Power at the battery (W)", "Attitude (deg)", "Larger servo input (1 is full)", "Thrust margin (1)")
    for one, name in zip(axes, names, strict=True):
        label_axes(one, "Airspeed (m/s)", name)
    axes[0].legend(title="Flap frequency", fontsize="small")
    axes[1].legend(fontsize="small")
    figure.suptitle(f"{flight.vehicle}, blades {flight.rotor}: {flight.flap_basis}", fontsize="medium")
    return figure
