"""All controllers of a vehicle: synthesis, reduction, discretisation, analysis, and the gains for the law on board.

Choices, with their reasons, stand in docs/control.md. The weights of heave-yaw are eq. 6.4 but for W_r and
W_M; those of roll-pitch and velocity, which the thesis does not print, are chosen here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import control
import numpy as np

from mufly.control.analysis import LoopAnalysis, analyse, feedback_part, sample_plant
from mufly.control.cascade import analyse_cascade
from mufly.control.discretise import DiscreteController, discretise
from mufly.control.hinf import HinfResult, hinfsyn
from mufly.control.law import (
    HEAVE_YAW_GAINS,
    HEAVE_YAW_ORDER,
    POSITION_GAINS,
    ROLL_PITCH_GAINS,
    ROLL_PITCH_ORDER,
    VELOCITY_ORDER,
    pack,
)
from mufly.control.linear import Array, singular_values, state_space
from mufly.control.published import HEAVE_YAW, ROLL_PITCH, VELOCITY, PublishedDesign
from mufly.control.reduction import Reduction, reduce_controller
from mufly.control.schemes import (
    OneDegreeWeights,
    Scaling,
    TransferFunction,
    TwoDegreeWeights,
    one_degree_plant,
    scale_plant,
    two_degree_plant,
    unscale_controller,
)
from mufly.dynamics import GRAVITY, Linearisation, battery_state, linearise, model_parameters
from mufly.errors import InputError, MuflyError
from mufly.vehicle import Vehicle

__all__ = ["DEFAULT_RATE_HZ", "Design", "FlightController", "Settings", "design"]

DEFAULT_RATE_HZ = 200.0
POSITION_DIVIDER = 4  # the position cascade runs in every fourth period


@dataclass(frozen=True)
class Settings:
    """Everything that shapes the designs; the defaults fly ``mufly-1.1``.

    Attributes
    ----------
    heave_yaw_scaling : Scaling or None
        Outputs z (m), psi (rad), r (rad/s); inputs motor lower, upper. None: from the vehicle's authority, see
        ``heave_yaw_scaling``.
    heave_yaw_weights : TwoDegreeWeights
    heave_yaw_relaxation : float
        Factor on the smallest level; see ``hinfsyn``.
    roll_pitch_scaling, roll_pitch_weights, roll_pitch_relaxation
        Likewise: phi, theta (rad), p, q (rad/s); servos 1, 2; see ``roll_pitch_scaling``.
    velocity_scaling, velocity_weights, velocity_relaxation
        Likewise: u, v (m/s); phi, theta (rad).
    position_gain : float
        1/s.
    speed_limit : float
        Of the velocity that the position loop may ask for, m/s.
    tilt_limit : float
        Of the tilt that the cascade may ask for, rad.
    command_tilt_limit : float
        Of each tilt reference of roll-pitch, whoever asks, rad.
    reference_bandwidth : float
        Of the reference filters of heave and yaw, rad/s.
    planning_charge : float
        Fraction of the battery's charge for which the heave reference's acceleration is chosen.
    heave_share : float
        Share of the acceleration then available that a heave reference may ask for.
    heave_acceleration_max, heave_speed : float
        Upper bounds of a heave reference's acceleration and speed, m/s2, m/s, whatever the motors could give.
    yaw_acceleration, yaw_rate : float
        Bounds of a yaw reference, rad/s2, rad/s.
    voltage_filter : float
        Time constant of the battery voltage's filter, s.
    """

    heave_yaw_scaling: Scaling | None = None
    heave_yaw_weights: TwoDegreeWeights = TwoDegreeWeights(
        model_matching=TransferFunction((1.0, 18.0, 56.0), (1.0, 14.0, 0.0014)),
        reference_model=TransferFunction((9.0,), (1.0, 9.0)),
        auxiliary=0.0,
    )
    heave_yaw_relaxation: float = 1.003
    roll_pitch_scaling: Scaling | None = None
    roll_pitch_weights: OneDegreeWeights = OneDegreeWeights(
        control=TransferFunction((0.001,)),
        output_noise=TransferFunction((1.0, 35.0), (0.1, 70.0)),
        input_disturbance=TransferFunction((0.7, 7.0), (1.0, 0.03)),
        auxiliary=0.0,
    )
    roll_pitch_relaxation: float = 1.2
    velocity_scaling: Scaling = Scaling(outputs=(1.0, 1.0), inputs=(0.25, 0.25))
    velocity_weights: OneDegreeWeights = OneDegreeWeights(
        control=TransferFunction((0.001,)),
        output_noise=TransferFunction((1.0, 4.0), (0.1, 8.0)),
        input_disturbance=TransferFunction((0.7, 0.35), (1.0, 0.007)),
    )
    velocity_relaxation: float = 1.2
    position_gain: float = 1.0
    speed_limit: float = 1.5
    tilt_limit: float = 0.15
    command_tilt_limit: float = 0.35
    reference_bandwidth: float = 8.0
    planning_charge: float = 0.3
    heave_share: float = 0.4
    heave_acceleration_max: float = 1.5
    heave_speed: float = 1.0
    yaw_acceleration: float = 8.0
    yaw_rate: float = 2.0
    voltage_filter: float = 0.05


@dataclass(frozen=True)
class Design:
    """One controller, from synthesis to difference equations.

    Attributes
    ----------
    name : str
    plant : control.StateSpace
        In physical units.
    scaling : Scaling
    generalised : control.StateSpace
        The plant of the synthesis: scaled, with weights.
    controller : control.StateSpace
        Continuous, full order, physical units.
    gamma, gamma_optimal, norm : float
        Level claimed, smallest level found, and norm of the closed loop with weights as computed from it.
    reduction : Reduction
    reduced : control.StateSpace
        Continuous, physical units.
    discrete : DiscreteController
    full_loop, reduced_loop, sampled_loop : LoopAnalysis
        The last with zero-order hold and one sample of delay.
    plant_crossovers : tuple of float
        0 dB crossings of the unscaled plant's singular values, rad/s.
    feedback_inputs : tuple of int
        Controller inputs that are errors of the plant's outputs.
    published : PublishedDesign
        The thesis's figures.
    """

    name: str
    plant: control.StateSpace
    scaling: Scaling
    generalised: control.StateSpace
    controller: control.StateSpace
    gamma: float
    gamma_optimal: float
    norm: float
    reduction: Reduction
    reduced: control.StateSpace
    discrete: DiscreteController
    full_loop: LoopAnalysis
    reduced_loop: LoopAnalysis
    sampled_loop: LoopAnalysis
    plant_crossovers: tuple[float, ...]
    feedback_inputs: tuple[int, ...]
    published: PublishedDesign

    def feedback(self, controller: control.StateSpace | None = None) -> control.StateSpace:
        """K of ``u = -K y``, of the full controller or of another one with the same inputs."""
        return feedback_part(
            self.controller if controller is None else controller, self.plant, self.feedback_inputs
        )

    def __str__(self) -> str:
        """Summary of a few lines."""
        loops = (("full", self.full_loop), ("reduced", self.reduced_loop), ("sampled", self.sampled_loop))
        orders = (self.controller.nstates, self.reduced.nstates, self.discrete.order)
        lines = [
            f"{self.name}: gamma {self.gamma:.3f}, norm achieved {self.norm:.3f}; "
            f"order {orders[0]} -> {orders[1]} ({self.reduction.chosen.method}); "
            f"{1 / self.discrete.period_s:g} Hz, {self.discrete.form} form, anti-windup {self.discrete.anti_windup}",
            f"  {'loop':8} {'order':>5} {'crossovers rad/s':>17} {'S_u dB':>7} {'T_u dB':>7} {'GM dB':>6} {'PM deg':>7} "
            f"{'delay ms':>9}",
        ]
        for (label, loop), order in zip(loops, orders, strict=True):
            crossovers = ", ".join(f"{w:.1f}" for w in loop.crossovers)
            lines.append(
                f"  {label:8} {order:5d} {crossovers:>17} {loop.sensitivity_peak_dB:7.2f} "
                f"{loop.complementary_peak_dB:7.2f} {loop.gain_margin_dB:6.1f} {loop.phase_margin_deg:7.1f} "
                f"{1e3 * loop.delay_margin_s:9.1f}"
            )
        return "\n".join(lines)


@dataclass(frozen=True)
class FlightController:
    """All designs of a vehicle and the gains of the law on board.

    Attributes
    ----------
    vehicle_name : str
    rate_Hz, period_s : float
        Of heave-yaw and roll-pitch.
    position_divider : int
        The position cascade runs in every so-manieth period.
    voltage_V : float
        Design voltage.
    motor_trim : array, shape (2,)
        Hover motor inputs at the design voltage: upper, lower.
    heave_yaw, roll_pitch, velocity : Design
    cascade : LoopAnalysis
        The loop at the tilt reference with everything closed below it: full lateral model, roll-pitch controller
        sampled with one sample of delay, velocity and position controllers at their own rate.
    heave_yaw_gains, roll_pitch_gains, position_gains : record
        For :mod:`mufly.control.law`.
    settings : Settings
    """

    vehicle_name: str
    rate_Hz: float
    period_s: float
    position_divider: int
    voltage_V: float
    motor_trim: Array
    heave_yaw: Design
    roll_pitch: Design
    velocity: Design
    cascade: LoopAnalysis
    heave_yaw_gains: np.void
    roll_pitch_gains: np.void
    position_gains: np.void
    settings: Settings

    def __str__(self) -> str:
        """Summary of all designs."""
        head = (
            f"{self.vehicle_name}: {self.rate_Hz:g} Hz, position at {self.rate_Hz / self.position_divider:g} Hz, "
            f"{self.voltage_V:g} V, hover motor inputs {self.motor_trim[0]:.3f} upper, {self.motor_trim[1]:.3f} lower"
        )
        c = self.cascade
        tail = (
            f"position cascade at the tilt reference: S {c.sensitivity_peak_dB:.2f} dB, T {c.complementary_peak_dB:.2f} dB, "
            f"GM {c.gain_margin_dB:.1f} dB, PM {c.phase_margin_deg:.1f} deg, delay margin {1e3 * c.delay_margin_s:.0f} ms"
        )
        return "\n".join([head, str(self.heave_yaw), str(self.roll_pitch), str(self.velocity), tail])


def _finish(
    name: str,
    plant: control.StateSpace,
    scaling: Scaling,
    scaled: control.StateSpace,
    generalised: control.StateSpace,
    result: HinfResult,
    references: Sequence[int],
    order_max: int,
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
        order_max=order_max,
        order_min=max(2, order_max - 4),
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


def heave_yaw_scaling(plant: control.StateSpace) -> Scaling:
    """Scaling of heave-yaw from what the motors can do.

    One scaled unit of both inputs gives 4.4 m/s2 in the end, against one metre of height error; r is
    scaled so that one unit of one input starts to turn the fuselage by 5 units of r a second, and psi by a fifth of the scale of r.
    For ``mufly-1.1`` that is 0.22 of the motor input, 1 m, 20 rad/s and 4 rad. Vehicles of another authority so get the same
    scaled plant, and much the same loop.
    """
    states = list(plant.state_labels)
    motors = [states.index("Omega_dw"), states.index("Omega_up")]
    speed = -np.linalg.solve(plant.A[np.ix_(motors, motors)], plant.B[motors])
    unit = 4.4 / abs(float((plant.A[states.index("w"), motors] @ speed).sum()))
    turn = float(np.abs(plant.B[states.index("r")]).mean())
    rate = unit * turn / 5.0
    return Scaling(outputs=(1.0, rate / 5.0, rate), inputs=(unit, unit))


def roll_pitch_scaling(plant: control.StateSpace) -> Scaling:
    """Scaling of roll-pitch from what the servos can do.

    One scaled unit of an input gives 40 rad/s2 once the swash plate has followed, against 0.5 rad of tilt or
    5 rad/s. For ``mufly-1.1`` that is about the full servo.
    """
    states = list(plant.state_labels)
    tilts = [states.index("a_dw"), states.index("b_dw")]
    tilt = -np.linalg.solve(plant.A[np.ix_(tilts, tilts)], plant.B[tilts])
    turn = np.abs(plant.A[np.ix_([states.index("p"), states.index("q")], tilts)] @ tilt).max(axis=0)
    return Scaling(outputs=(0.5, 0.5, 5.0, 5.0), inputs=tuple(float(v) for v in 40.0 / turn))


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
            HEAVE_YAW_ORDER,
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
            ROLL_PITCH_ORDER,
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
            VELOCITY_ORDER,
            (0.05,),
            period_s,
            VELOCITY,
        )
    except MuflyError as error:
        raise _named("velocity", "one-degree scheme", error) from None


def _heave_acceleration(vehicle: Vehicle, linear: Linearisation, settings: Settings) -> float:
    """Acceleration (m/s2) of a heave reference that the motors follow, with the battery run down and sagging.

    A step of ``du`` on both motors ends in ``per_input * du``; ``du`` is what the battery's voltage at full input, with
    ``planning_charge`` left, has above hover. The motors' lag asks for several times the input at the start of a climb that its
    end needs, hence ``heave_share``.
    """
    plant = linear.heave_yaw
    states = list(plant.state_labels)
    motors = [states.index("Omega_dw"), states.index("Omega_up")]
    gain = -np.linalg.solve(plant.A[np.ix_(motors, motors)], plant.B[motors])  # rotor speed per input
    per_input = plant.A[states.index("w"), motors] @ gain
    state = linear.trim.state.copy()
    state[20] = settings.planning_charge
    sagged = float(battery_state(state, 1.0, 1.0, model_parameters(vehicle))[0])
    lower_upper = linear.trim.motor_input[::-1]
    headroom = np.maximum(sagged / linear.trim.voltage_V - lower_upper, 0.0)
    available = abs(float(per_input @ headroom))
    return float(np.clip(settings.heave_share * available, 0.1, settings.heave_acceleration_max))


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
    heave_yaw = design_heave_yaw(linear.heave_yaw, s, period)
    roll_pitch = design_roll_pitch(linear.roll_pitch, s, period)
    velocity = design_velocity(s, slow_period)
    cascade = analyse_cascade(
        linear.full, roll_pitch.discrete, velocity.discrete, s.position_gain, POSITION_DIVIDER
    )
    if not cascade.stable:
        raise MuflyError(
            f"position cascade: unstable with the real roll-pitch loop (crossovers {roll_pitch.full_loop.crossovers}); "
            "lower position_gain or slow down the velocity weights"
        )
    motor = np.asarray(linear.trim.motor_input, dtype=float)
    volts = float(linear.trim.voltage_V)
    lower_upper = motor[::-1].copy()
    acceleration = _heave_acceleration(vehicle, linear, s)
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
            yaw_bandwidth=s.reference_bandwidth,
            yaw_acceleration=s.yaw_acceleration,
            yaw_rate=s.yaw_rate,
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
