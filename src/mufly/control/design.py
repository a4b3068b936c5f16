"""All controllers of a vehicle: synthesis, reduction, discretisation, analysis, and the gains for the law on board.

Choices, with their reasons, stand in docs/control.md; weights, scaling and limits in :mod:`mufly.control.settings`.
"""

from __future__ import annotations

from collections.abc import Sequence

import control
import numpy as np

from mufly.control.analysis import analyse, feedback_part, sample_plant
from mufly.control.cascade import analyse_cascade
from mufly.control.discretise import discretise
from mufly.control.gains import (
    HEAVE_YAW_GAINS,
    HEAVE_YAW_ORDER,
    POSITION_GAINS,
    ROLL_PITCH_GAINS,
    ROLL_PITCH_ORDER,
    VELOCITY_ORDER,
    pack,
)
from mufly.control.hinf import HinfResult, hinfsyn
from mufly.control.linear import singular_values, state_space
from mufly.control.published import HEAVE_YAW, ROLL_PITCH, VELOCITY, PublishedDesign
from mufly.control.reduction import reduce_controller
from mufly.control.reference import heave_acceleration, reference_lags
from mufly.control.result import Design, FlightController
from mufly.control.schemes import (
    Scaling,
    one_degree_plant,
    scale_plant,
    two_degree_plant,
    unscale_controller,
)
from mufly.control.settings import Settings, heave_yaw_scaling, roll_pitch_scaling
from mufly.dynamics import GRAVITY, Linearisation, linearise
from mufly.errors import InputError, MuflyError
from mufly.vehicle import Vehicle

__all__ = [
    "DEFAULT_RATE_HZ",
    "design",
    "design_heave_yaw",
    "design_roll_pitch",
    "design_velocity",
    "velocity_plant",
]

DEFAULT_RATE_HZ = 200.0
POSITION_DIVIDER = 4  # the position cascade runs in every fourth period


def _finish(
    name: str,
    plant: control.StateSpace,
    scaling: Scaling,
    scaled: control.StateSpace,
    generalised: control.StateSpace,
    result: HinfResult,
    references: Sequence[int],
    orders: tuple[int, int],
    slow: Sequence[float],
    period_s: float,
    published: PublishedDesign,
) -> Design:
    """Everything after the synthesis; the controller's inputs are ``references`` (output indices), then all errors."""
    first = len(references)
    rows = tuple(range(first, first + plant.noutputs))
    output_scale, input_scale = np.array(scaling.outputs), np.array(scaling.inputs)
    read = np.concatenate([output_scale[list(references)], output_scale])
    reduction = reduce_controller(
        generalised,
        result.controller,
        result.actuation,
        scaled,
        rows,
        order_min=orders[0],
        order_max=orders[1],
        slow=slow,
    )
    full = unscale_controller(result.controller, read, input_scale)
    reduced = unscale_controller(reduction.controller, read, input_scale)
    discrete = discretise(reduced, reduction.actuation / input_scale, period_s)
    loops = [
        analyse(plant, feedback_part(K, plant, rows), output_scale=output_scale) for K in (full, reduced)
    ]
    sampled = analyse(
        sample_plant(plant, period_s, 1),
        feedback_part(discrete.system(), plant, rows),
        output_scale=output_scale,
    )
    if not sampled.stable:
        raise MuflyError(
            f"{name} design: stable in continuous time, but not at {1 / period_s:g} Hz with one sample of delay "
            f"(delay margin {1e3 * loops[1].delay_margin_s:.1f} ms); raise the rate"
        )
    return Design(
        name=name,
        plant=plant,
        scaling=scaling,
        generalised=generalised,
        controller=full,
        gamma=result.gamma,
        gamma_optimal=result.gamma_optimal,
        norm=result.norm,
        reduction=reduction,
        reduced=reduced,
        discrete=discrete,
        full_loop=loops[0],
        reduced_loop=loops[1],
        sampled_loop=sampled,
        plant_crossovers=_plant_crossovers(plant),
        feedback_inputs=rows,
        published=published,
    )


def _plant_crossovers(plant: control.StateSpace) -> tuple[float, ...]:
    frequency = np.geomspace(1e-2, 1e5, 1500)
    found = []
    for column in np.log(np.maximum(singular_values(plant, frequency), 1e-300)).T:
        for i in np.nonzero((column[:-1] > 0) != (column[1:] > 0))[0]:
            t = -column[i] / (column[i + 1] - column[i])
            found.append(float(frequency[i] * (frequency[i + 1] / frequency[i]) ** t))
    return tuple(sorted(found))


def _named(name: str, action: str, error: MuflyError) -> MuflyError:
    return MuflyError(f"{name} design, {action}: {error}")


def design_heave_yaw(plant: control.StateSpace, settings: Settings, period_s: float) -> Design:
    """Heave-yaw: two degrees of freedom (Sec. 6.1.4). Inputs of the controller: z, psi references, then errors."""
    s = settings
    scaling = s.heave_yaw_scaling or heave_yaw_scaling(plant)
    scaled = scale_plant(plant, scaling)
    generalised = two_degree_plant(scaled, ("z", "psi"), s.heave_yaw_weights)
    try:
        result = hinfsyn(generalised, 5, 2, relaxation=s.heave_yaw_relaxation)
        return _finish(
            "heave-yaw",
            plant,
            scaling,
            scaled,
            generalised,
            result,
            (0, 1),
            (6, HEAVE_YAW_ORDER),
            (0.1, 3.0),
            period_s,
            HEAVE_YAW,
        )
    except MuflyError as error:
        raise _named("heave-yaw", "weights of eq. 6.4", error) from None


def design_roll_pitch(plant: control.StateSpace, settings: Settings, period_s: float) -> Design:
    """Roll-pitch: one degree of freedom (Sec. 6.1.5). Inputs of the controller: errors of phi, theta, p, q."""
    s = settings
    scaling = s.roll_pitch_scaling or roll_pitch_scaling(plant)
    scaled = scale_plant(plant, scaling)
    generalised = one_degree_plant(scaled, ("phi", "theta"), s.roll_pitch_weights)
    try:
        result = hinfsyn(generalised, 4, 2, relaxation=s.roll_pitch_relaxation)
        return _finish(
            "roll-pitch",
            plant,
            scaling,
            scaled,
            generalised,
            result,
            (),
            (4, ROLL_PITCH_ORDER),
            (0.1,),
            period_s,
            ROLL_PITCH,
        )
    except MuflyError as error:
        raise _named("roll-pitch", "one-degree scheme", error) from None


def velocity_plant(gravity: float = GRAVITY) -> control.StateSpace:
    """Horizontal velocity under ideal tilt (eq. 6.10): ``udot = -g theta``, ``vdot = g phi``."""
    return state_space(
        np.zeros((2, 2)),
        np.array([[0.0, -gravity], [gravity, 0.0]]),
        np.eye(2),
        np.zeros((2, 2)),
        inputs=("phi", "theta"),
        outputs=("u", "v"),
        states=("u", "v"),
    )


def design_velocity(settings: Settings, period_s: float) -> Design:
    """Velocity: one degree of freedom on eq. 6.10 (Sec. 6.1.6). Inputs of the controller: errors of u, v."""
    s = settings
    plant = velocity_plant()
    scaled = scale_plant(plant, s.velocity_scaling)
    generalised = one_degree_plant(scaled, ("u", "v"), s.velocity_weights)
    try:
        result = hinfsyn(generalised, 2, 2, relaxation=s.velocity_relaxation)
        return _finish(
            "velocity",
            plant,
            s.velocity_scaling,
            scaled,
            generalised,
            result,
            (),
            (
                4,
                VELOCITY_ORDER,
            ),  # two are enough for the peaks, but lose the roll-off that keeps noise off the tilt
            (0.05,),
            period_s,
            VELOCITY,
        )
    except MuflyError as error:
        raise _named("velocity", "one-degree scheme", error) from None


def design(
    vehicle: Vehicle,
    *,
    rate_Hz: float | None = None,
    voltage: float | None = None,
    settings: Settings | None = None,
) -> FlightController:
    """Design all controllers of a vehicle.

    Parameters
    ----------
    vehicle : Vehicle
    rate_Hz : float, optional
        Rate of the control law; 200 Hz by default, the lowest of the usual rates at which roll-pitch keeps its
        peaks below 4.5 dB with one sample of delay.
    voltage : float, optional
        Battery voltage of the linear model (V); the vehicle's nominal voltage by default.
    settings : Settings, optional
        Weights, scaling and limits.

    Returns
    -------
    FlightController

    Raises
    ------
    InputError
        If rate or voltage is not possible.
    MuflyError
        If the vehicle cannot hover, or a design fails: the message names the design and the mode, weight or step at
        fault.
    """
    s = Settings() if settings is None else settings
    rate = DEFAULT_RATE_HZ if rate_Hz is None else float(rate_Hz)
    if not (np.isfinite(rate) and 20.0 <= rate <= 5000.0):
        raise InputError(
            "design", "rate_Hz", f"{rate:g} Hz is out of range", "give 20 to 5000 Hz; 200 is usual"
        )
    if voltage is not None and not (np.isfinite(voltage) and voltage > 0):
        raise InputError(
            "design", "voltage", f"{voltage:g} V is not possible", "give a positive voltage in V"
        )
    linear: Linearisation = linearise(vehicle, voltage=voltage)
    period = 1.0 / rate
    slow_period = POSITION_DIVIDER * period
    try:
        heave_yaw = design_heave_yaw(linear.heave_yaw, s, period)
        roll_pitch = design_roll_pitch(linear.roll_pitch, s, period)
        velocity = design_velocity(s, slow_period)
        cascade = analyse_cascade(
            linear.full, roll_pitch.discrete, velocity.discrete, s.position_gain, POSITION_DIVIDER
        )
        if not cascade.stable:
            raise MuflyError(
                f"position cascade: unstable with the real roll-pitch loop (crossovers "
                f"{roll_pitch.full_loop.crossovers} rad/s); check inertias, swash plate and bar of the vehicle, "
                "or lower Settings.position_gain"
            )
    except MuflyError as error:
        raise MuflyError(f"{vehicle.name}: {error}") from None
    motor = np.asarray(linear.trim.motor_input, dtype=float)
    volts = float(linear.trim.voltage_V)
    lower_upper = motor[::-1].copy()
    lags = reference_lags(heave_yaw)
    acceleration = heave_acceleration(vehicle, linear, s)
    return FlightController(
        vehicle_name=vehicle.name,
        rate_Hz=rate,
        period_s=period,
        position_divider=POSITION_DIVIDER,
        voltage_V=volts,
        motor_trim=motor,
        heave_yaw=heave_yaw,
        roll_pitch=roll_pitch,
        velocity=velocity,
        cascade=cascade,
        heave_yaw_gains=pack(
            HEAVE_YAW_GAINS,
            heave_yaw.discrete,
            trim=lower_upper,
            design_voltage=volts,
            voltage_blend=period / (period + s.voltage_filter),
            period=period,
            heave_bandwidth=s.reference_bandwidth,
            heave_acceleration=acceleration,
            heave_speed=s.heave_speed,
            heave_lead=s.reference_lead * lags[0],
            heave_slack=s.heave_slack,
            yaw_bandwidth=s.reference_bandwidth,
            yaw_acceleration=s.yaw_acceleration,
            yaw_rate=s.yaw_rate,
            yaw_lead=s.reference_lead * lags[1],
        ),
        roll_pitch_gains=pack(
            ROLL_PITCH_GAINS,
            roll_pitch.discrete,
            trim=np.asarray(linear.trim.servo_input, dtype=float),
            tilt_limit=s.command_tilt_limit,
        ),
        position_gains=pack(
            POSITION_GAINS,
            velocity.discrete,
            position_gain=s.position_gain,
            speed_limit=s.speed_limit,
            tilt_limit=s.tilt_limit,
            gravity=GRAVITY,
        ),
        settings=s,
    )
