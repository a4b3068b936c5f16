"""All controllers of a vehicle: synthesis, reduction, discretisation, analysis, and the gains for the law on board.

The reasons for the design choices are in docs/explanation/control.md; weights, scaling and limits are in
:class:`DesignSettings`. The figures that the thesis prints for its controllers are listed beside the computed ones
(Sec. 6.1; facts.csv, keys S6.1-*).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import control
import numpy as np

from mufly.control.controller_design import (
    PUBLISHED_HEAVE_YAW,
    PUBLISHED_ROLL_PITCH,
    PUBLISHED_VELOCITY_DESIGN,
    ControllerDesign,
    ThesisDesignValues,
)
from mufly.control.design_store import load_or_compute_controller
from mufly.control.implementation import (
    analyse_position_cascade,
    discretise_controller,
    reduce_controller,
)
from mufly.control.law import (
    HEAVE_YAW_GAINS_DTYPE,
    HEAVE_YAW_ORDER,
    POSITION_GAINS_DTYPE,
    ROLL_PITCH_GAINS_DTYPE,
    ROLL_PITCH_ORDER,
    VELOCITY_ORDER,
    pack_gains,
)
from mufly.control.linear_systems import (
    Array,
    LoopAnalysis,
    analyse_loop,
    extract_feedback_controller,
    find_crossovers,
    frequency_response,
    sample_plant,
    singular_values,
    state_space,
)
from mufly.control.robust.parameter_spreads import default_spreads, differentiate_plants_by_parameters
from mufly.control.synthesis.indi import IndiGains
from mufly.control.synthesis.lqg import LqgWeights
from mufly.control.synthesis.synthesis_methods import (
    SYNTHESIS_METHODS,
    DkIterationSettings,
    FixedOrderGoals,
    GivenController,
    SynthesisMethod,
    SynthesisProblem,
    synthesise_controller,
)
from mufly.control.synthesis.weighting_schemes import (
    DesignSettings,
    SignalScaling,
    fill_missing_weights,
    heave_acceleration_per_input,
    heave_yaw_scaling,
    make_one_dof_generalised_plant,
    roll_pitch_scaling,
    scale_plant,
    unscale_controller,
    weight_heave_yaw_plant,
    weight_roll_pitch_plant,
)
from mufly.control.tuning.output_schedule import OutputSchedule, pack_schedule, schedule_roll_pitch
from mufly.dynamics import GRAVITY, Linearisation, compute_battery_supply, linearise_vehicle, model_parameters
from mufly.dynamics.model_state import MODEL_CHARGE
from mufly.errors import ArgumentError, MuflyError
from mufly.results import ShownBlock, make_lines_block, result
from mufly.vehicle import Vehicle, find_battery_voltage_range

DEFAULT_CONTROL_RATE_HZ = 200.0
POSITION_LOOP_RATE_DIVIDER = 4  # the position cascade runs in every fourth period


@result(
    json="warnings=design_warnings vehicle=vehicle_name method=settings.method rate_Hz position_rate_Hz "
    "design_voltage_V=voltage_V motor_trim_upper_lower=motor_trim position_gain_1_s=settings.position_gain "
    "designs=all_designs cascade=cascade_loop schedule",
)
class FlightController:
    """All controllers of a vehicle, and the gains of the control law on board.

    Attributes
    ----------
    vehicle_name : str
    rate_Hz, period_s : float
        Rate and period of the heave-yaw and roll-pitch controllers.
    position_divider : int
        The position cascade runs once in this number of periods.
    voltage_V : float
        Design voltage.
    motor_trim : array, shape (2,)
        Hover motor inputs at the design voltage: upper, lower.
    heave_yaw, roll_pitch, velocity : ControllerDesign
    cascade_loop : LoopAnalysis
        The loop broken at the tilt reference with all inner loops closed: full lateral model, sampled roll-pitch
        controller with one sample of delay, velocity and position controllers at their own rate.
    heave_yaw_gains, roll_pitch_gains, position_gains : record
        Gains for :mod:`mufly.control.law`.
    settings : DesignSettings
    schedule : OutputSchedule or None
        Roll-pitch over forward speed, by the method ``scheduled``; ``roll_pitch`` is its controller at hover.
    """

    vehicle_name: str
    rate_Hz: float
    period_s: float
    position_divider: int
    voltage_V: float
    motor_trim: Array
    heave_yaw: ControllerDesign
    roll_pitch: ControllerDesign
    velocity: ControllerDesign
    cascade_loop: LoopAnalysis
    heave_yaw_gains: np.void
    roll_pitch_gains: np.void
    position_gains: np.void
    settings: DesignSettings
    schedule: OutputSchedule | None = None

    @property
    def all_designs(self) -> tuple[ControllerDesign, ControllerDesign, ControllerDesign]:
        """The three controller designs: heave-yaw, roll-pitch and velocity."""
        return self.heave_yaw, self.roll_pitch, self.velocity

    @property
    def position_rate_Hz(self) -> float:
        """Rate of the position cascade (Hz)."""
        return self.rate_Hz / self.position_divider

    @property
    def design_warnings(self) -> tuple[str, ...]:
        """Warnings for the user before a flight: sampled loops with peaks above 6 dB, and remedies."""
        found = []
        for d in self.all_designs:
            loop = d.sampled_loop
            peak = max(loop.sensitivity_peak_dB, loop.complementary_peak_dB)
            if peak > 6.0:
                found.append(
                    f"{d.name}: sampled at {d.discrete.rate_Hz:g} Hz with one sample of delay its sensitivities "
                    f"peak at {peak:.1f} dB (continuous: {d.reduced_loop.sensitivity_peak_dB:.1f} and "
                    f"{d.reduced_loop.complementary_peak_dB:.1f} dB); raise the rate"
                )
        return tuple(found)

    def make_printed_blocks(self) -> list[ShownBlock]:
        """Return as printed text the motor trim and rates, all designs with their schedule, and the warnings."""
        c = self.cascade_loop
        return [
            make_lines_block(
                f" at {self.voltage_V:g} V: hover motor inputs {self.motor_trim[0]:.2f} upper, "
                f"{self.motor_trim[1]:.2f} lower; law at {self.rate_Hz:g} Hz, position at "
                f"{self.position_rate_Hz:g} Hz",
                head=self.vehicle_name,
            ),
            *(block for design in self.all_designs for block in design.make_printed_blocks()),
            *(self.schedule.make_printed_blocks() if self.schedule is not None else ()),
            make_lines_block("* with one sample of delay", style="dim"),
            make_lines_block(
                f"Position cascade with the real attitude loop: S {c.sensitivity_peak_dB:.2f} dB, "
                f"T {c.complementary_peak_dB:.2f} dB, phase margin {c.phase_margin_deg:.0f} deg, "
                f"delay margin {1e3 * c.delay_margin_s:.0f} ms"
            ),
            make_lines_block(*self.design_warnings, mark="Warning", style="yellow"),
        ]


def design_flight_controller(
    vehicle: Vehicle,
    *,
    rate_Hz: float | None = None,
    voltage: float | None = None,
    settings: DesignSettings | None = None,
) -> FlightController:
    """Design all controllers of a vehicle.

    Parameters
    ----------
    vehicle : Vehicle
    rate_Hz : float, optional
        Rate of the control law; 200 Hz by default, the lowest of the usual rates at which the roll-pitch loop keeps
        its peaks below 4.5 dB with one sample of delay.
    voltage : float, optional
        Battery voltage of the linear model (V); the vehicle's nominal voltage by default.
    settings : DesignSettings, optional
        Weights, scaling and limits.

    Returns
    -------
    FlightController

    Raises
    ------
    ArgumentError
        If method or order is unknown, the rate is out of range, or the voltage is outside the battery's range of use.
    MuflyError
        If the vehicle cannot hover, or a design fails: the message names the design and the failing mode, weight or
        step.
    """
    s = fill_missing_weights(DesignSettings() if settings is None else settings, vehicle)
    if s.method not in SYNTHESIS_METHODS:
        raise ArgumentError(
            "method", "", f"{s.method!r} is not a method", f"give one of {', '.join(SYNTHESIS_METHODS)}"
        )
    if not 2 <= s.roll_pitch_goals.order <= ROLL_PITCH_ORDER:
        raise ArgumentError("order", "", f"{s.roll_pitch_goals.order} is out of range", f"give 2 to {ROLL_PITCH_ORDER}")
    rate = DEFAULT_CONTROL_RATE_HZ if rate_Hz is None else float(rate_Hz)
    if not (np.isfinite(rate) and 20.0 <= rate <= 5000.0):
        raise ArgumentError("rate_Hz", "", f"{rate:g} Hz is out of range", "give 20 to 5000 Hz; 200 is usual")
    low, full = find_battery_voltage_range(vehicle.battery)
    if voltage is not None and not low <= voltage <= full:
        raise ArgumentError(
            "voltage", "", f"{voltage:g} V is out of the battery's range",
            f"give {low:g} V (where {vehicle.name} has to land) to {full:g} V (full, at rest)",
        )  # fmt: skip
    linear = linearise_vehicle(vehicle, voltage=voltage)
    period = 1.0 / rate
    derivatives: Sequence[Array] = ()
    if s.method == "mu":
        spreads = default_spreads(vehicle)
        derivatives = differentiate_plants_by_parameters(
            vehicle, float(linear.trim.battery_voltage_V), list(spreads), np.diag(list(spreads.values()))
        )["roll-pitch"]
    try:
        heave_yaw = design_heave_yaw(linear.heave_yaw, s, period)
        roll_pitch = design_roll_pitch(linear.roll_pitch, s, period, derivatives)
        velocity = design_velocity(s, POSITION_LOOP_RATE_DIVIDER * period)
        schedule = schedule_roll_pitch(vehicle, roll_pitch, s, linear) if s.method == "scheduled" else None
        cascade = analyse_position_cascade(
            linear.full, roll_pitch.discrete, velocity.discrete, s.position_gain, POSITION_LOOP_RATE_DIVIDER
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
    volts = float(linear.trim.battery_voltage_V)
    lower_upper = motor[::-1].copy()
    lags = ramp_following_lags(heave_yaw)
    acceleration = compute_heave_acceleration_limit(vehicle, linear, s)
    return FlightController(
        vehicle_name=vehicle.name,
        rate_Hz=rate,
        period_s=period,
        position_divider=POSITION_LOOP_RATE_DIVIDER,
        voltage_V=volts,
        motor_trim=motor,
        heave_yaw=heave_yaw,
        roll_pitch=roll_pitch,
        velocity=velocity,
        cascade_loop=cascade,
        heave_yaw_gains=pack_gains(
            HEAVE_YAW_GAINS_DTYPE,
            heave_yaw.discrete,
            trim=lower_upper,
            design_voltage=volts,
            voltage_blend=period / (period + s.voltage_filter_s),
            period=period,
            heave_bandwidth=s.reference_bandwidth,
            heave_acceleration=acceleration,
            heave_speed=s.heave_speed,
            heave_lead=s.reference_lead_share * lags[0],
            heave_tracking_error_limit=s.heave_tracking_error_limit,
            yaw_bandwidth=s.reference_bandwidth,
            yaw_acceleration=s.yaw_acceleration,
            yaw_rate=s.yaw_rate,
            yaw_lead=s.reference_lead_share * lags[1],
        ),
        roll_pitch_gains=pack_gains(
            ROLL_PITCH_GAINS_DTYPE,
            roll_pitch.discrete,
            trim=np.asarray(linear.trim.servo_input, dtype=float),
            tilt_limit=s.command_tilt_limit,
            **({} if schedule is None else pack_schedule(schedule)),
        ),
        position_gains=pack_gains(
            POSITION_GAINS_DTYPE,
            velocity.discrete,
            position_gain=s.position_gain,
            speed_limit=s.speed_limit,
            tilt_limit=s.tilt_limit,
            gravity=GRAVITY,
        ),
        settings=s,
        schedule=schedule,
    )


def _design_controller(
    name: str,
    plant: control.StateSpace,
    scaling: SignalScaling,
    generalise: Callable[[control.StateSpace], control.StateSpace],
    relaxation: float,
    period_s: float,
    *,
    method: SynthesisMethod = "hinf",
    lqg: LqgWeights | None = None,
    fixed: FixedOrderGoals | None = None,
    given: GivenController | None = None,
    derivatives: Sequence[Array] = (),
    robust: DkIterationSettings | None = None,
    indi: IndiGains | None = None,
    tracked: tuple[int, ...],
    references: tuple[int, ...] = (),
    orders: tuple[int, int],
    slow: tuple[float, ...],
    published: ThesisDesignValues,
    scheme: str = "one-degree scheme",
    windup_rate: float | None = None,
) -> ControllerDesign:
    """Synthesise, reduce, discretise and analyse a controller; its inputs are ``references`` and all output errors.

    ``tracked`` are the plant's outputs with a reference, whether or not the controller reads the reference separately.
    """
    rows = tuple(range(len(references), len(references) + plant.noutputs))
    output_scale, input_scale = np.array(scaling.outputs), np.array(scaling.inputs)
    read = np.concatenate([output_scale[list(references)], output_scale])
    scaled = scale_plant(plant, scaling)
    generalised = generalise(scaled)
    if fixed is not None:
        fixed = replace(fixed, output_noise_std=tuple(np.array(fixed.output_noise_std) / output_scale))
    try:
        problem = SynthesisProblem(
            generalised, scaled, tracked, bool(references), read.size, relaxation, lqg, fixed, generalise,
            2 * np.pi / period_s, None if given is None else given.to_scaled_units(generalised, read, input_scale),
            tuple(E * np.concatenate([np.ones(plant.nstates), input_scale]) for E in derivatives),
            robust or DkIterationSettings(), indi,
        )  # fmt: skip
        found = load_or_compute_controller(method, problem, synthesise_controller)
        reduction = reduce_controller(
            generalised,
            found.controller,
            found.anti_windup_matrix,
            scaled,
            rows,
            order_min=orders[0],
            order_max=orders[1],
            slow=slow,
        )
        full = unscale_controller(found.controller, read, input_scale)
        reduced = unscale_controller(reduction.controller, read, input_scale)
        discrete = discretise_controller(reduced, reduction.anti_windup_matrix / input_scale, period_s, windup_rate)
        full_loop, reduced_loop, sampled_loop = (
            analyse_loop(G, extract_feedback_controller(K, plant, rows), output_scale=output_scale)
            for G, K in (
                (plant, full),
                (plant, reduced),
                (sample_plant(plant, period_s, 1), discrete.to_state_space()),
            )
        )
        if not sampled_loop.stable:
            raise MuflyError(
                f"stable in continuous time, but not at {1 / period_s:g} Hz with one sample of delay "
                f"(delay margin {1e3 * reduced_loop.delay_margin_s:.1f} ms); raise the rate"
            )
    except MuflyError as error:
        raise MuflyError(f"{name} design, {scheme}: {error}") from None
    frequency = np.geomspace(1e-2, 1e5, 1500)
    return ControllerDesign(
        name=name,
        method=method,
        plant=plant,
        scaling=scaling,
        generalised_plant=generalised,
        controller=full,
        gamma=found.gamma,
        gamma_optimal=found.gamma_optimal,
        norm=found.norm,
        reduction=reduction,
        reduced=reduced,
        discrete=discrete,
        full_loop=full_loop,
        reduced_loop=reduced_loop,
        sampled_loop=sampled_loop,
        plant_crossovers=find_crossovers(frequency, singular_values(plant, frequency)),
        error_inputs=rows,
        published=published,
    )


def _own_order_range(given: GivenController | None, highest: int) -> tuple[int, int] | None:
    """Return the order range for the reduction of a given controller: only its own order, so it stays unchanged."""
    if given is None:
        return None
    if given.order > highest:
        raise MuflyError(f"the given controller has order {given.order}, the on-board law at most {highest}; reduce it")
    return given.order, given.order


def design_heave_yaw(plant: control.StateSpace, settings: DesignSettings, period_s: float) -> ControllerDesign:
    """Design the heave-yaw controller with two degrees of freedom (Sec. 6.1.4).

    Its inputs are the references of z and psi, then the control errors.

    The methods ``fixed``, ``scheduled``, ``mu`` and ``indi`` design roll-pitch alone; heave-yaw is H-infinity then.
    """
    given = settings.heave_yaw_given
    return _design_controller(
        "heave-yaw",
        plant,
        settings.heave_yaw_scaling or heave_yaw_scaling(plant),
        lambda scaled: weight_heave_yaw_plant(scaled, settings),
        settings.heave_yaw_relaxation,
        period_s,
        method="fixed"
        if given is not None
        else "hinf"
        if settings.method in ("fixed", "scheduled", "mu", "indi")
        else settings.method,
        lqg=settings.heave_yaw_lqg,
        given=given,
        tracked=(0, 1),
        references=(0, 1),
        # LQG fits on board as it is; a lower order would lose the roll-off that gives yaw its delay margin.
        orders=_own_order_range(given, HEAVE_YAW_ORDER)
        or (8 if settings.method in ("lqg", "ltr") else 6, HEAVE_YAW_ORDER),
        slow=(0.1, 3.0),
        published=PUBLISHED_HEAVE_YAW,
        scheme="weights of eq. 6.4",
        windup_rate=settings.heave_yaw_anti_windup_rad_s,
    )


def design_roll_pitch(
    plant: control.StateSpace, settings: DesignSettings, period_s: float, derivatives: Sequence[Array] = ()
) -> ControllerDesign:
    """Design roll-pitch: one degree of freedom (Sec. 6.1.5). Controller inputs: errors of phi, theta, p, q."""
    given = settings.roll_pitch_given
    fixed = settings.method in ("fixed", "scheduled") or given is not None
    tuned = fixed and given is None
    indi = settings.method == "indi" and given is None
    return _design_controller(
        "roll-pitch",
        plant,
        settings.roll_pitch_scaling or roll_pitch_scaling(plant),
        lambda scaled: weight_roll_pitch_plant(scaled, settings),
        settings.roll_pitch_relaxation,
        period_s,
        method="fixed" if fixed else settings.method,
        lqg=settings.roll_pitch_lqg,
        given=given,
        derivatives=derivatives,
        robust=settings.robust_goals,
        indi=settings.indi_gains if indi else None,
        fixed=settings.roll_pitch_goals if tuned else None,
        tracked=(0, 1),
        orders=_own_order_range(given, ROLL_PITCH_ORDER)
        or ((settings.roll_pitch_goals.order,) * 2 if tuned else (ROLL_PITCH_ORDER if indi else 4, ROLL_PITCH_ORDER)),
        slow=(0.1,),
        published=PUBLISHED_ROLL_PITCH,
        windup_rate=None if indi else settings.roll_pitch_anti_windup_rad_s,
    )


def design_velocity(settings: DesignSettings, period_s: float) -> ControllerDesign:
    """Design the velocity controller for ideal tilt (eq. 6.10): ``udot = -g theta``, ``vdot = g phi``.

    It has one degree of freedom (Sec. 6.1.6); its inputs are the errors of u, v.

    Thesis: eqs 6.6 to 6.10; Sec. 6.1.6.
    """
    plant = state_space(
        np.zeros((2, 2)),
        np.array([[0.0, -GRAVITY], [GRAVITY, 0.0]]),
        np.eye(2),
        np.zeros((2, 2)),
        inputs=("phi", "theta"),
        outputs=("u", "v"),
        states=("u", "v"),
    )
    return _design_controller(
        "velocity",
        plant,
        settings.velocity_scaling,
        lambda scaled: make_one_dof_generalised_plant(scaled, ("u", "v"), settings.velocity_weights),
        settings.velocity_relaxation,
        period_s,
        tracked=(0, 1),
        # Order two suffices for the peaks, but loses the roll-off that keeps noise out of the tilt reference.
        orders=(4, VELOCITY_ORDER),
        slow=(0.05,),
        published=PUBLISHED_VELOCITY_DESIGN,
    )


def ramp_following_lags(heave_yaw: ControllerDesign) -> tuple[float, float]:
    """Return the lags (s) of height and heading behind a ramp reference, from the phase lag at 0.05 rad/s."""
    frequency = np.array([0.05])
    sampled = sample_plant(heave_yaw.plant, heave_yaw.discrete.period_s, 1)
    g = frequency_response(sampled, frequency)[0]
    k = frequency_response(heave_yaw.discrete.to_state_space(), frequency)[0]
    response = np.linalg.solve(np.eye(g.shape[0]) + g @ k[:, 2:], g @ k[:, :2])
    z, psi = (max(0.0, float(-np.angle(response[i, i]) / frequency[0])) for i in (0, 1))
    return z, psi


def compute_heave_acceleration_limit(vehicle: Vehicle, linear: Linearisation, settings: DesignSettings) -> float:
    """Return the heave acceleration (m/s2) that the motors can follow with a discharged, loaded battery.

    An input step ``du`` of both motors gives the acceleration ``per_input * du`` in steady state. Here ``du`` is the
    margin of the voltage at full input over that of hover, at the charge ``planning_charge``. The motors lag, so a
    climb starts with several times its steady input; ``heave_acceleration_share`` allows for this.
    """
    state = linear.trim.state.copy()
    state[MODEL_CHARGE] = settings.planning_charge
    sagged = float(compute_battery_supply(state, 1.0, 1.0, model_parameters(vehicle))[0])
    lower_upper = linear.trim.motor_input[::-1]
    headroom = np.maximum(sagged / linear.trim.battery_voltage_V - lower_upper, 0.0)
    available = abs(float(heave_acceleration_per_input(linear.heave_yaw) @ headroom))
    return float(np.clip(settings.heave_acceleration_share * available, 0.1, settings.heave_acceleration_max))
