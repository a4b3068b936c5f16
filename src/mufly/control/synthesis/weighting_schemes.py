"""Weighting schemes of the H-infinity synthesis: GS/T with one and two degrees of freedom; settings.

All signals are scaled first, by an output scale ``s_y`` (the unit of error) and an input scale ``s_u`` (the unit of
actuation). The scaled plant is ``G = diag(1/s_y) G_physical diag(s_u)``, and its controller is converted back by
``K_physical = diag(s_u) K diag(1/s_y)``.

Two degrees of freedom (thesis Fig. 6.4, eqs 6.3 and 6.4; Christen and Geering's dual scheme): the controller reads the
references ``r`` and the errors ``e = W_d w_d - y``, and commands ``u~``. The plant gets ``u = u~ + W_dbar w_dbar``;
``r = W_rbar w_rbar + W_r w_r``. The errors are ``z_u = W_u u~`` and ``z_y = y - W_M W_r w_r``, so that

    w_dbar -> z_y  is  G S_u W_dbar           (disturbances at the plant's input),

    w_rbar -> z_y  is  T_yr W_rbar            (roll-off of the response to references),

    w_r    -> z_y  is  (T_yr - W_M) W_r       (distance from the reference model),

    w_d    -> z_y  is  T_e W_d                (roll-off of the loop at the output).

One degree of freedom (thesis Fig. 6.6, eq. 6.5): the controller reads ``e = W_r w_r - y``, the plant gets
``u = u~ + W_v w_v``, and ``z_u = W_u u~``, ``z_y = W_y y``: G S_u W_v and T_e W_r.

A measured output without a reference (a rate gyro) supports the feedback. It enters ``z_y`` only if its ``weight`` is
not zero.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import control
import numpy as np
from scipy import signal

from mufly.control.linear_systems import Array, connect_blocks, replace_matrices, state_space
from mufly.control.synthesis.indi import IndiGains
from mufly.control.synthesis.lqg import LqgWeights
from mufly.control.synthesis.synthesis_methods import (
    DkIterationSettings,
    FixedOrderGoals,
    GivenController,
    SynthesisMethod,
)
from mufly.errors import MuflyError
from mufly.vehicle import Vehicle


@dataclass(frozen=True)
class TransferFunction:
    """Proper transfer function ``numerator / denominator``, coefficients of falling powers of s (rad/s)."""

    numerator: tuple[float, ...]
    denominator: tuple[float, ...] = (1.0,)

    def to_block(self, name: str, source: str, sink: str) -> control.StateSpace:
        """Return a state-space block from signal ``source`` to ``sink``."""
        order = len(self.denominator) - 1
        if len(self.numerator) > order + 1:
            raise MuflyError(f"weight {name}: its numerator has the higher degree; give a proper transfer function")
        if order and np.roots(self.denominator).real.max() >= 0:
            raise MuflyError(
                f"weight {name}: a pole in the right half plane or on the axis; move it to the left, by 1e-4 rad/s say"
            )
        if order:
            A, B, C, D = signal.tf2ss(self.numerator, self.denominator)
        else:
            A, B, C = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0))
            D = np.array([[self.numerator[-1] / self.denominator[0]]])
        labels = [f"{name}[{i}]" for i in range(order)]
        return state_space(A, B, C, D, inputs=[source], outputs=[sink], states=labels)


@dataclass(frozen=True)
class SignalScaling:
    """Physical size of one unit of each scaled signal.

    Attributes
    ----------
    outputs : tuple of float
        For each measured output, in its unit: errors of equal importance.
    inputs : tuple of float
        For each plant input: the actuation acceptable for such an error.
    """

    outputs: tuple[float, ...]
    inputs: tuple[float, ...]


@dataclass(frozen=True)
class TwoDegreeWeights:
    """Weights of the two-degree-of-freedom scheme.

    The defaults are those of eq. 6.4, but W_r lacks the factor 1e-4 that is printed there.

    Thesis: eq. 6.4.
    """

    control: TransferFunction = TransferFunction((0.001,))  # W_u~
    output_noise: TransferFunction = TransferFunction((1.0, 10.0), (0.1, 20.0))  # W_d
    input_disturbance: TransferFunction = TransferFunction((0.7, 1.0), (1.0, 0.007))  # W_dbar
    reference_rolloff: TransferFunction = TransferFunction((1.0, 7.0), (0.01, 14.0))  # W_rbar
    model_matching: TransferFunction = TransferFunction((1.0, 15.0, 14.0), (1.0, 14.0, 0.0014))  # W_r
    reference_model: TransferFunction = TransferFunction((14.0,), (1.0, 14.0))  # W_M
    auxiliary: float = 1.0  # weight of measured outputs that have no reference


@dataclass(frozen=True)
class OneDegreeWeights:
    """Weights of the one-degree-of-freedom scheme."""

    control: TransferFunction  # W_u~
    output_noise: TransferFunction  # W_r of Fig. 6.6: it enters at the reference and bounds T_e
    input_disturbance: TransferFunction  # W_v
    output: TransferFunction = field(default_factory=lambda: TransferFunction((1.0,)))  # W_y
    auxiliary: float = 1.0


def scale_plant(plant: control.StateSpace, scaling: SignalScaling) -> control.StateSpace:
    """Return ``diag(1/s_y) plant diag(s_u)`` with the same labels."""
    sy, su = np.array(scaling.outputs), np.array(scaling.inputs)
    if sy.shape != (plant.noutputs,) or su.shape != (plant.ninputs,):
        raise MuflyError(
            f"scaling: {sy.size} output and {su.size} input scales for a plant with outputs "
            f"{', '.join(plant.output_labels)} and inputs {', '.join(plant.input_labels)}; give one for each"
        )
    if not (np.all(sy > 0) and np.all(su > 0)):
        raise MuflyError("scaling: every scale must be positive")
    return replace_matrices(plant, B=plant.B * su, C=plant.C / sy[:, None], D=plant.D * su / sy[:, None])


def unscale_controller(controller: control.StateSpace, input_scale: Array, output_scale: Array) -> control.StateSpace:
    """Return the controller in physical units: inputs divided by ``input_scale``, outputs times ``output_scale``."""
    out = output_scale[:, None]
    return replace_matrices(
        controller, B=controller.B / input_scale, C=controller.C * out, D=controller.D * out / input_scale
    )


def _signal_names(**signals: Sequence[str]) -> list[str]:
    """Return the names of all signals: ``w_d=("z", "psi")`` gives ``w_d[z]`` and ``w_d[psi]``."""
    return [f"{name}[{i}]" for name, over in signals.items() for i in over]


class _WeightedDiagram:
    """A scaled plant with weights; signals are named ``name[signal of the plant]``."""

    def __init__(self, plant: control.StateSpace) -> None:
        self.blocks = [replace_matrices(plant, inputs=_signal_names(plant=plant.input_labels))]
        self.wiring: dict[str, dict[str, float]] = {}

    def add_weight(self, weight: TransferFunction, name: str, sink: str, source: str, over: Sequence[str]) -> None:
        """Add a weight from ``source`` ("" for the plant's signal itself) to ``sink``, for every signal in ``over``."""
        for i in over:
            self.blocks.append(weight.to_block(f"{name}[{i}]", f"{name}_in[{i}]", f"{sink}[{i}]"))
            self.wiring[f"{name}_in[{i}]"] = {f"{source}[{i}]" if source else i: 1.0}

    def add_sum(self, name: str, over: Sequence[str], **terms: float) -> None:
        """Define for every plant signal in ``over`` a weighted sum of other signals; the term ``own`` is the plant
        signal itself.
        """
        for i in over:
            self.wiring[f"{name}[{i}]"] = {i if k == "own" else f"{k}[{i}]": v for k, v in terms.items()}


def make_two_dof_generalised_plant(
    plant: control.StateSpace, references: Sequence[str], weights: TwoDegreeWeights
) -> control.StateSpace:
    """Return the generalised plant of the dual two-degree-of-freedom GS/T scheme (thesis Fig. 6.4, eq. 6.3).

    Parameters
    ----------
    plant : control.StateSpace
        Scaled, labelled plant.
    references : sequence of str
        Outputs that follow a reference.
    weights : TwoDegreeWeights

    Returns
    -------
    control.StateSpace
        Inputs ``w_dbar[u]``, ``w_rbar[y]``, ``w_r[y]``, ``w_d[y]``, then the controls ``u``; outputs ``z_u[u]``,
        ``z_y[y]``, then the measurements ``reference[y]`` and ``error[y]``.

    Thesis: eq. 6.3; Fig. 6.4.
    """
    y, u, ref = list(plant.output_labels), list(plant.input_labels), list(references)
    unknown = [name for name in ref if name not in y]
    if unknown:
        raise MuflyError(f"scheme: reference {unknown[0]!r} is not an output of the plant ({', '.join(y)})")
    w, d = weights, _WeightedDiagram(plant)
    d.add_weight(w.input_disturbance, "W_dbar", "dbar", "w_dbar", u)
    d.add_weight(w.reference_rolloff, "W_rbar", "rbar", "w_rbar", ref)
    d.add_weight(w.model_matching, "W_r", "r", "w_r", ref)
    d.add_weight(w.reference_model, "W_M", "model", "r", ref)
    d.add_weight(w.output_noise, "W_d", "d", "w_d", y)
    d.add_weight(w.control, "W_u", "z_u", "", u)
    shown = [i for i in y if i in ref or w.auxiliary != 0.0]
    d.add_sum("plant", u, own=1.0, dbar=1.0)
    d.add_sum("z_y", [i for i in shown if i not in ref], own=w.auxiliary)
    d.add_sum("z_y", ref, own=1.0, model=-1.0)
    d.add_sum("reference", ref, rbar=1.0, r=1.0)
    d.add_sum("error", y, d=1.0, own=-1.0)
    return connect_blocks(
        d.blocks,
        d.wiring,
        [*_signal_names(w_dbar=u, w_rbar=ref, w_r=ref, w_d=y), *u],
        _signal_names(z_u=u, z_y=shown, reference=ref, error=y),
    )


def make_one_dof_generalised_plant(
    plant: control.StateSpace, references: Sequence[str], weights: OneDegreeWeights
) -> control.StateSpace:
    """Return the generalised plant of the dual one-degree-of-freedom GS/T scheme (thesis Fig. 6.6, eq. 6.5).

    Parameters
    ----------
    plant : control.StateSpace
        Scaled, labelled plant.
    references : sequence of str
        Outputs with a reference; the others are auxiliary measurements, weighted by ``weights.auxiliary``.
    weights : OneDegreeWeights

    Returns
    -------
    control.StateSpace
        Inputs ``w_v[u]``, ``w_r[y]``, then the controls ``u``; outputs ``z_u[u]``, ``z_y[y]``, then ``error[y]``.

    Thesis: eq. 6.5; Fig. 6.6.
    """
    y, u, ref = list(plant.output_labels), list(plant.input_labels), list(references)
    w, d = weights, _WeightedDiagram(plant)
    shown = [i for i in y if i in ref or w.auxiliary != 0.0]
    d.add_weight(w.input_disturbance, "W_v", "v", "w_v", u)
    d.add_weight(w.output_noise, "W_r", "r", "w_r", y)
    d.add_weight(w.control, "W_u", "z_u", "", u)
    d.add_weight(w.output, "W_y", "z_y", "", shown)
    d.add_sum("plant", u, own=1.0, v=1.0)
    d.add_sum("error", y, r=1.0, own=-1.0)
    d.add_sum("W_y_in", [i for i in shown if i not in ref], own=w.auxiliary)
    return connect_blocks(
        d.blocks,
        d.wiring,
        [*_signal_names(w_v=u, w_r=y), *u],
        _signal_names(z_u=u, z_y=shown, error=y),
    )


# The weights of heave-yaw are those of eq. 6.4 except W_r and W_M. The thesis does not print those of roll-pitch and
# velocity; they are chosen here, with reasons in docs/explanation/control.md.
# W_r without its factor 1e-4, and its zero at 4 instead of 1 rad/s; W_M at 9 instead of 14 rad/s.
HEAVE_YAW_WEIGHTS = TwoDegreeWeights(
    model_matching=TransferFunction((1.0, 18.0, 56.0), (1.0, 14.0, 0.0014)),
    reference_model=TransferFunction((9.0,), (1.0, 9.0)),
    auxiliary=0.0,
)
ROLL_PITCH_WEIGHTS = OneDegreeWeights(
    control=TransferFunction((0.001,)),
    output_noise=TransferFunction((1.0, 35.0), (0.1, 70.0)),
    input_disturbance=TransferFunction((0.7, 7.0), (1.0, 0.03)),
    auxiliary=0.0,
)
# Without a bar a crossover of 25 to 35 rad/s holds the unstable poles at 4 rad/s with any servo up to 80 ms.
NO_BAR_ROLL_PITCH_WEIGHTS = replace(
    ROLL_PITCH_WEIGHTS,
    output_noise=TransferFunction((1.0, 12.0), (0.1, 24.0)),
    input_disturbance=TransferFunction((0.7, 2.4), (1.0, 0.03)),
)
VELOCITY_WEIGHTS = OneDegreeWeights(
    control=TransferFunction((0.001,)),
    output_noise=TransferFunction((1.0, 20.0), (0.1, 40.0)),
    input_disturbance=TransferFunction((0.7, 0.14), (1.0, 0.007)),
)
VELOCITY_SCALING = SignalScaling(outputs=(1.0, 1.0), inputs=(0.08, 0.08))
# Heave has the weight on its rate that lowers the peak of T_u; its gyro noise is stated higher than it is, so that the
# filter's yaw pole stays below the sampling rate while heave recovers.
HEAVE_YAW_LQG = LqgWeights(
    error=(1.0, 1.0), rate=(0.2, 0.0), integral=(0.1, 0.1), control=0.05, noise=(0.01, 0.1, 0.1),
    process_noise=1.0, recovery=15.0,
)  # fmt: skip
ROLL_PITCH_LQG = LqgWeights(
    error=(1.0, 1.0), rate=(0.0, 0.0), integral=(20.0, 20.0), control=0.03, noise=(0.02, 0.02, 0.02, 0.02),
    process_noise=0.2, recovery=10.0,
)  # fmt: skip


ROLL_PITCH_GOALS = FixedOrderGoals(
    order=4, sensitivity_dB=2.6, complementary_dB=2.0,
    output_noise_std=(math.radians(0.1), math.radians(0.1), math.radians(0.3), math.radians(0.3)),
)  # fmt: skip
DK_ITERATION_SETTINGS = DkIterationSettings()
INDI_GAINS = IndiGains()


@dataclass(frozen=True)
class DesignSettings:
    """Settings of the designs; the defaults suit ``mufly-1.1``.

    Attributes
    ----------
    method : str
        Method of synthesis of heave-yaw and roll-pitch (``synthesis_methods.SYNTHESIS_METHODS``); velocity is
        H-infinity.
    heave_yaw_scaling : SignalScaling or None
        Outputs z (m), psi (rad), r (rad/s); inputs motor lower, upper. None: from the motors' capability, see
        :func:`heave_yaw_scaling`.
    heave_yaw_weights : TwoDegreeWeights
    heave_yaw_relaxation : float
        Factor on the smallest level; see ``hinfsyn``.
    roll_pitch_scaling, roll_pitch_weights, roll_pitch_relaxation
        Likewise: phi, theta (rad), p, q (rad/s); servos 1, 2; see :func:`roll_pitch_scaling`. Weights None: those of
        a vehicle with or without a stabiliser bar, see :func:`fill_missing_weights`.
    velocity_scaling, velocity_weights, velocity_relaxation
        Likewise: u, v (m/s); phi, theta (rad).
    heave_yaw_lqg, roll_pitch_lqg : LqgWeights
        Weights of LQG and LTR, in scaled units.
    roll_pitch_goals : FixedOrderGoals
        Order and goals of the method ``fixed``, which tunes roll-pitch; heave-yaw is H-infinity then.
    schedule_speed : float
        Forward speed to which the method ``scheduled`` schedules roll-pitch (m/s); its order and goals are those of
        ``fixed``.
    indi_gains : IndiGains
        Gains of the method ``indi``, which designs roll-pitch; heave-yaw is H-infinity then.
    robust_goals : DkIterationSettings
        Settings of the method ``mu``, which designs roll-pitch; heave-yaw is H-infinity then.
    heave_yaw_given, roll_pitch_given : GivenController or None
        Controllers that exist, in place of a synthesis.
    heave_yaw_anti_windup_rad_s, roll_pitch_anti_windup_rad_s : float or None
        Rate at which the integrators follow saturated actuators (rad/s); None: the observer's anti-windup.
    position_gain : float
        Gain of the position loop (1/s).
    speed_limit : float
        Largest velocity reference of the position loop (m/s).
    tilt_limit : float
        Largest tilt reference of the cascade (rad).
    command_tilt_limit : float
        Largest tilt reference of roll-pitch per axis, from any source (rad).
    reference_bandwidth : float
        Bandwidth of the reference filters of heave and yaw (rad/s).
    planning_charge : float
        State of charge for which the acceleration of the heave reference is chosen.
    heave_acceleration_share : float
        Share of the acceleration available at that charge which a heave reference may use.
    heave_acceleration_max, heave_speed : float
        Upper bounds of a heave reference's acceleration and speed (m/s2, m/s), for any motors.
    heave_tracking_error_limit : float
        Largest error of height before the filtered reference waits (m).
    reference_lead_share : float
        Share of the loops' lag behind a ramp reference that is compensated.
    yaw_acceleration, yaw_rate : float
        Bounds of a yaw reference (rad/s2, rad/s).
    voltage_filter_s : float
        Time constant of the battery voltage's filter (s).
    """

    method: SynthesisMethod = "hinf"
    heave_yaw_scaling: SignalScaling | None = None
    heave_yaw_weights: TwoDegreeWeights = HEAVE_YAW_WEIGHTS
    heave_yaw_relaxation: float = 1.003
    roll_pitch_scaling: SignalScaling | None = None
    roll_pitch_weights: OneDegreeWeights | None = None
    roll_pitch_relaxation: float = 1.2
    velocity_scaling: SignalScaling = VELOCITY_SCALING
    velocity_weights: OneDegreeWeights = VELOCITY_WEIGHTS
    velocity_relaxation: float = 1.2
    heave_yaw_lqg: LqgWeights = HEAVE_YAW_LQG
    roll_pitch_lqg: LqgWeights = ROLL_PITCH_LQG
    roll_pitch_goals: FixedOrderGoals = ROLL_PITCH_GOALS
    schedule_speed: float = 2.0
    indi_gains: IndiGains = INDI_GAINS
    robust_goals: DkIterationSettings = DK_ITERATION_SETTINGS
    heave_yaw_given: GivenController | None = None
    roll_pitch_given: GivenController | None = None
    heave_yaw_anti_windup_rad_s: float | None = 1.5
    roll_pitch_anti_windup_rad_s: float | None = 20.0
    position_gain: float = 1.0
    speed_limit: float = 1.5
    tilt_limit: float = 0.15
    command_tilt_limit: float = 0.35
    reference_bandwidth: float = 8.0
    planning_charge: float = 0.3
    heave_acceleration_share: float = 0.37
    heave_acceleration_max: float = 1.5
    heave_speed: float = 1.0
    heave_tracking_error_limit: float = 0.3
    reference_lead_share: float = 1.0
    yaw_acceleration: float = 8.0
    yaw_rate: float = 2.0
    voltage_filter_s: float = 0.05


def fill_missing_weights(settings: DesignSettings, vehicle: Vehicle) -> DesignSettings:
    """Return the settings; missing roll-pitch weights are set to the defaults for a vehicle with or without stabiliser
    bar.
    """
    if settings.roll_pitch_weights is not None:
        return settings
    weights = ROLL_PITCH_WEIGHTS if vehicle.stabiliser_bar.fitted else NO_BAR_ROLL_PITCH_WEIGHTS
    return replace(settings, roll_pitch_weights=weights)


def heave_yaw_scaling(plant: control.StateSpace) -> SignalScaling:
    """Return the physical size of one unit of each heave-yaw signal, from the motors' authority.

    One scaled unit of both inputs gives 4.4 m/s2 in steady state, against one metre of height error. r is scaled so
    that one unit of one input gives an initial yaw acceleration of 5 units of r a second, and psi by a fifth of the
    scale of r. For ``mufly-1.1`` that is 0.22 of the motor input, 1 m, 20 rad/s and 4 rad. Vehicles of other capability
    get the same scaled plant and nearly the same loop.
    """
    unit = 4.4 / abs(float(heave_acceleration_per_input(plant).sum()))
    turn = float(np.abs(plant.B[plant.state_labels.index("r")]).mean())
    rate = unit * turn / 5.0
    return SignalScaling(outputs=(1.0, rate / 5.0, rate), inputs=(unit, unit))


def heave_acceleration_per_input(plant: control.StateSpace) -> Array:
    """Return the steady vertical acceleration (m/s2, down) per input of the lower and of the upper motor."""
    states = list(plant.state_labels)
    motors = [states.index("Omega_dw"), states.index("Omega_up")]
    speed = -np.linalg.solve(plant.A[np.ix_(motors, motors)], plant.B[motors])
    gain: Array = plant.A[states.index("w"), motors] @ speed
    return gain


def roll_pitch_scaling(plant: control.StateSpace) -> SignalScaling:
    """Return the physical size of one unit of each roll-pitch signal, from the servos' authority.

    One scaled unit of an input gives 40 rad/s2 once the swash plate has settled, against 0.5 rad of tilt or 5 rad/s.
    For ``mufly-1.1`` that is about full servo travel.
    """
    states = list(plant.state_labels)
    tilts = [states.index("a_dw"), states.index("b_dw")]
    tilt = -np.linalg.solve(plant.A[np.ix_(tilts, tilts)], plant.B[tilts])
    turn = np.abs(plant.A[np.ix_([states.index("p"), states.index("q")], tilts)] @ tilt).max(axis=0)
    return SignalScaling(outputs=(0.5, 0.5, 5.0, 5.0), inputs=tuple(float(v) for v in 40.0 / turn))


def weight_heave_yaw_plant(scaled: control.StateSpace, settings: DesignSettings) -> control.StateSpace:
    """Return the generalised plant of heave-yaw from its scaled plant."""
    return make_two_dof_generalised_plant(scaled, ("z", "psi"), settings.heave_yaw_weights)


def weight_roll_pitch_plant(scaled: control.StateSpace, settings: DesignSettings) -> control.StateSpace:
    """Return the generalised plant of roll-pitch from its scaled plant."""
    return make_one_dof_generalised_plant(scaled, ("phi", "theta"), settings.roll_pitch_weights or ROLL_PITCH_WEIGHTS)
