"""Roll-pitch scheduled over forward speed: one controller's states, with outputs that follow the speed.

The law on board is that of :mod:`mufly.control.law` with a second pair of output matrices::

    u = (C + s C_f) x + (D + s D_f) e,      s = min((v_x / V)^2, 1)

``v_x`` is the forward speed in the heading's direction and ``V`` the scheduled speed. The states ``x`` do not depend on
speed, so the modes of two designs cannot be confused, and no state is transferred when the speed changes: ``u`` is
continuous in ``s``. The share ``s`` is even in ``v_x`` because the plant is: half a turn about the vertical maps flight
forwards to flight backwards, and leaves the rotors and a body without products of inertia as they are.

A and B are those of the hover design. C and D at ``V`` are tuned for the plant there, with the goals of the method
``fixed`` (:mod:`mufly.control.tuning.fixed_order`). Between the two the loop is verified on a grid of frozen speeds,
with the model linearised at each of them. In wind the speed over ground is not the airspeed, so every plant is also
closed with every share. In sideways flight the law is that of hover.

Margins at frozen speeds hold as long as the speed changes slowly against the loop (Shamma and Athans, IEEE Trans.
Autom. Control 35, 1990). :attr:`OutputSchedule.max_share_rate_1_s` is the bound of the change of ``s`` by the largest
tilt.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import control
import numpy as np

from mufly.control.analysis.loop_margins import disk_margin
from mufly.control.controller_design import ControllerDesign
from mufly.control.design_store import load_or_compute_controller
from mufly.control.implementation import DiscreteController
from mufly.control.law import ROLL_PITCH_ORDER
from mufly.control.linear_systems import Array, analyse_loop, extract_feedback_controller, sample_plant, state_space
from mufly.control.synthesis.synthesis_methods import FixedOrderGoals, SynthesisProblem, synthesise_controller
from mufly.control.synthesis.weighting_schemes import (
    DesignSettings,
    SignalScaling,
    scale_plant,
    weight_roll_pitch_plant,
)
from mufly.dynamics import GRAVITY, Linearisation, find_trim, linearise_vehicle
from mufly.errors import MuflyError
from mufly.results import ShownBlock, make_lines_block, make_table_block, result
from mufly.vehicle import Vehicle

SPEED_STEP_m_s = 0.25
"""Step of the search for the largest speed of steady flight."""
SPEED_GRID_INTERVAL_COUNT = 8
"""Intervals between hover and the scheduled speed in the verification; an even number."""


@dataclass(frozen=True)
class ScheduledLoop:
    """Hover controller, scaling and goals, from which the output matrices for forward flight are tuned.

    Attributes
    ----------
    hover_controller : DiscreteController
        Roll-pitch controller at hover.
    scaling : SignalScaling
    generalise : callable
        Function from the scaled plant to the plant with weights.
    relaxation : float
        Factor on the smallest H-infinity level, to which the goals refer.
    goals : FixedOrderGoals
        Goals at the scheduled speed, with the noise in SI.
    """

    hover_controller: DiscreteController
    scaling: SignalScaling
    generalise: Callable[[control.StateSpace], control.StateSpace]
    relaxation: float
    goals: FixedOrderGoals


@result
class FrozenSpeedLoop:
    """Sampled loop at one constant forward speed, with one sample of delay.

    Attributes
    ----------
    speed_m_s : float
    sideways : bool
        Whether the vehicle flies to the right instead of forwards.
    share : float
        Share ``s`` of the schedule.
    disk_margin, sensitivity_peak_dB, complementary_peak_dB : float
        Margin and peaks with this share.
    hover_disk_margin : float
        Disk margin with the outputs of hover.
    least_disk_margin : float
        Least disk margin with any share of the grid; 0 if a loop is unstable.
    """

    speed_m_s: float
    sideways: bool
    share: float
    disk_margin: float
    sensitivity_peak_dB: float
    complementary_peak_dB: float
    hover_disk_margin: float
    least_disk_margin: float


@result
class OutputSchedule:
    """Output matrices of the roll-pitch controller over forward speed, and the loops at frozen speeds.

    The share s = min((v_x / V)^2, 1) blends the outputs from hover (0) to the speed V (1).

    Attributes
    ----------
    speed_m_s : float
        Scheduled speed V.
    C_forward_change, D_forward_change : array, shapes (2, n) and (2, 4)
        Change of C and D of the discrete controller from hover to V.
    has_flight_map : bool
    frozen : tuple of FrozenSpeedLoop
    max_saturated_pole_modulus : float
        Largest modulus of the poles of the saturated controller ``A - M C`` over all shares.
    max_share_rate_1_s : float
        Largest rate of change of s (1/s), when the vehicle accelerates at its tilt limit: ``2 g tan(tilt) / V``.
    crossover : float
        Slowest crossover of the loop at hover (rad/s).
    """

    speed_m_s: float
    C_forward_change: Array
    D_forward_change: Array
    has_flight_map: bool
    frozen: tuple[FrozenSpeedLoop, ...]
    max_saturated_pole_modulus: float
    max_share_rate_1_s: float
    crossover: float

    @property
    def forward_share_per_speed2_s2_m2(self) -> float:
        """Factor (s2/m2) on squared forward speed; the product, at most 1, weights the forward-flight outputs."""
        return 1.0 / self.speed_m_s**2

    def blend_controller(self, hover: DiscreteController, share: float) -> control.StateSpace:
        """Return the scheduled controller for a weight ``share`` of the forward-flight outputs (0: hover, 1: scheduled
        speed).
        """
        return blend_output_matrices(hover, self.C_forward_change, self.D_forward_change, share)

    def forward_share_at(self, speed_m_s: float) -> float:
        """Return the weight (0 to 1) of the forward-flight outputs at a forward speed."""
        return min(self.forward_share_per_speed2_s2_m2 * speed_m_s**2, 1.0)

    def make_printed_blocks(self) -> list[ShownBlock]:
        """Return the table of loops at constant speeds, and their least margins, as printed text."""
        heads = ("speed (m/s)", "share", "disk margin", "S_u (dB)", "T_u (dB)", "unscheduled", "any share")
        rows = [
            (
                f"{f.speed_m_s:.2f}{' sideways' if f.sideways else ''}", f"{f.share:.2f}", f"{f.disk_margin:.3f}",
                f"{f.sensitivity_peak_dB:.2f}", f"{f.complementary_peak_dB:.2f}", f"{f.hover_disk_margin:.3f}",
                f"{f.least_disk_margin:.3f}",
            )
            for f in self.frozen
        ]  # fmt: skip
        lines = [
            f"Margins hold at frozen speed: the share changes by at most {self.max_share_rate_1_s:.2f} 1/s, the loop "
            f"crosses over at {self.crossover:.0f} rad/s."
        ]
        if not self.has_flight_map:
            lines.append("The vehicle has no flight map, so only its drag changes with speed.")
        return [
            make_table_block(heads, rows, title=f"roll-pitch scheduled over 0 to {self.speed_m_s:g} m/s"),
            make_lines_block(*lines),
        ]


def blend_output_matrices(
    hover: DiscreteController, C_forward_change: Array, D_forward_change: Array, share: float
) -> control.StateSpace:
    """Return the hover controller with ``share`` times the forward-flight changes added to its C and D."""
    return state_space(
        hover.A, hover.B, hover.C + share * C_forward_change, hover.D + share * D_forward_change,
        inputs=hover.inputs, outputs=hover.outputs, dt=hover.period_s,
    )  # fmt: skip


def invert_tustin(controller: DiscreteController) -> tuple[Array, Array, Array, Array]:
    """Return the continuous-time matrices from which Tustin's rule gives the discrete controller, with the same
    states.

    The inverse of the rule in :mod:`mufly.control.implementation`: with ``L = 2 (A + I)^-1``,
    ``A_c = (A - I) L / T``, ``B_c = L B / T``, ``C_c = C L``, ``D_c = D - C B_c T / 2``.
    """
    T, one = controller.period_s, np.eye(controller.order)
    L = 2.0 * np.linalg.inv(controller.A + one)
    B = L @ controller.B / T
    return (controller.A - one) @ L / T, B, controller.C @ L, controller.D - controller.C @ B * (T / 2)


def tune_output_schedule(
    vehicle: Vehicle, loop: ScheduledLoop, *, speed_m_s: float, voltage: float, tilt_limit: float
) -> OutputSchedule:
    """Tune the output matrices of the roll-pitch controller at a forward speed, and verify the loop at frozen speeds.

    Parameters
    ----------
    vehicle : Vehicle
    loop : ScheduledLoop
    speed_m_s : float
        Scheduled speed; lowered in steps of :data:`SPEED_STEP_m_s` to one with steady flight.
    voltage : float
        Battery voltage of the linear models (V).
    tilt_limit : float
        Largest tilt of the position loop (rad).

    Raises
    ------
    MuflyError
        If no step has steady flight, the tuning fails, or a loop is unstable at a frozen speed.
    """
    fastest, plant = _plant_at_greatest_speed(vehicle, speed_m_s, voltage)
    hover = loop.hover_controller
    T = hover.period_s
    C_forward_change, D_forward_change = _tune_output_changes(plant, loop)
    speeds = fastest * np.arange(SPEED_GRID_INTERVAL_COUNT + 1) / SPEED_GRID_INTERVAL_COUNT
    controllers = [
        blend_output_matrices(hover, C_forward_change, D_forward_change, float((v / fastest) ** 2)) for v in speeds
    ]
    feedbacks = [extract_feedback_controller(K, plant, range(plant.noutputs)) for K in controllers]
    saturated = max(float(np.abs(np.linalg.eigvals(K.A - hover.M @ K.C)).max()) for K in controllers)
    if saturated >= 1.0:
        raise MuflyError("schedule: the anti-windup is unstable at a speed; choose another order")
    frozen: list[FrozenSpeedLoop] = []
    sideways = [(v, 1) for v in (0.5 * fastest, fastest) if _has_steady_flight(vehicle, (0.0, v, 0.0), voltage)]
    for v, axis in [(float(v), 0) for v in speeds] + sideways:
        held = sample_plant(_plant_at_velocity(vehicle, (v, 0.0, 0.0) if axis == 0 else (0.0, v, 0.0), voltage), T, 1)
        share = (v / fastest) ** 2 if axis == 0 else 0.0
        k = int(np.argmin(np.abs(speeds - v))) if axis == 0 else 0
        found = analyse_loop(held, feedbacks[k])
        if not found.stable:
            raise MuflyError(f"schedule: roll-pitch is unstable at {v:g} m/s; lower the scheduled speed")
        margins = [disk_margin(held, K).margin for K in feedbacks]
        frozen.append(
            FrozenSpeedLoop(
                v, axis == 1, share, margins[k], found.sensitivity_peak_dB, found.complementary_peak_dB, margins[0],
                min(margins),
            )
        )  # fmt: skip
    still = sample_plant(_plant_at_velocity(vehicle, (0.0, 0.0, 0.0), voltage), T, 1)
    slowest = min(analyse_loop(still, feedbacks[0]).crossovers)
    return OutputSchedule(
        fastest, C_forward_change, D_forward_change, vehicle.rotors.flight_map is not None, tuple(frozen), saturated,
        2.0 * GRAVITY * float(np.tan(tilt_limit)) / fastest, float(slowest),
    )  # fmt: skip


def _plant_at_velocity(vehicle: Vehicle, velocity: tuple[float, float, float], voltage: float) -> control.StateSpace:
    return linearise_vehicle(vehicle, find_trim(vehicle, velocity=velocity, voltage=voltage)).roll_pitch


def _has_steady_flight(vehicle: Vehicle, velocity: tuple[float, float, float], voltage: float) -> bool:
    try:
        find_trim(vehicle, velocity=velocity, voltage=voltage)
    except MuflyError:
        return False
    return True


def _plant_at_greatest_speed(vehicle: Vehicle, speed_m_s: float, voltage: float) -> tuple[float, control.StateSpace]:
    """Return the largest speed with steady flight, and the plant there."""
    for v in np.arange(speed_m_s, 0.5 * SPEED_STEP_m_s, -SPEED_STEP_m_s):
        if _has_steady_flight(vehicle, (float(v), 0.0, 0.0), voltage):
            return float(v), _plant_at_velocity(vehicle, (float(v), 0.0, 0.0), voltage)
    raise MuflyError(f"schedule: there is no steady flight at {SPEED_STEP_m_s:g} m/s; use the method fixed")


def _tune_output_changes(plant: control.StateSpace, loop: ScheduledLoop) -> tuple[Array, Array]:
    """Return the changes of C and D of the discrete controller from hover to the plant's speed."""
    K, T = loop.hover_controller, loop.hover_controller.period_s
    output_scale, input_scale = np.array(loop.scaling.outputs), np.array(loop.scaling.inputs)
    scaled = scale_plant(plant, loop.scaling)
    generalised = loop.generalise(scaled)
    A, B, C, D = invert_tustin(K)
    n, out = plant.noutputs, input_scale[:, None]
    given = state_space(
        A, B * output_scale, C / out, D * output_scale / out,
        inputs=generalised.output_labels[-n:], outputs=generalised.input_labels[-plant.ninputs:],
    )  # fmt: skip
    noise = tuple(float(v) for v in np.array(loop.goals.output_noise_std) / output_scale)
    goals = FixedOrderGoals(**{**vars(loop.goals), "output_noise_std": noise})
    problem = SynthesisProblem(
        generalised, scaled, (0, 1), False, n, loop.relaxation, None, goals, loop.generalise, 2 * np.pi / T, given
    )
    tuned = load_or_compute_controller("scheduled", problem, synthesise_controller).controller
    C_fast, D_fast = out * tuned.C, out * tuned.D / output_scale
    discrete_C = C_fast @ (K.A + np.eye(K.order)) / 2.0
    discrete_D = D_fast + discrete_C @ B * (T / 2)
    return discrete_C - K.C, discrete_D - K.D


def schedule_roll_pitch(
    vehicle: Vehicle, hover: ControllerDesign, settings: DesignSettings, linear: Linearisation
) -> OutputSchedule:
    """Return the schedule of a roll-pitch design over forward speed."""
    loop = ScheduledLoop(
        hover.discrete,
        hover.scaling,
        lambda scaled: weight_roll_pitch_plant(scaled, settings),
        settings.roll_pitch_relaxation,
        settings.roll_pitch_goals,
    )
    return tune_output_schedule(
        vehicle,
        loop,
        speed_m_s=settings.schedule_speed,
        voltage=float(linear.trim.battery_voltage_V),
        tilt_limit=settings.tilt_limit,
    )


def pack_schedule(schedule: OutputSchedule) -> dict[str, object]:
    """Return the fields of ``ROLL_PITCH_GAINS_DTYPE`` that hold a schedule."""
    C = np.zeros((2, ROLL_PITCH_ORDER))
    C[:, : schedule.C_forward_change.shape[1]] = schedule.C_forward_change
    return {
        "C_forward_change": C,
        "D_forward_change": schedule.D_forward_change,
        "schedule": schedule.forward_share_per_speed2_s2_m2,
    }
