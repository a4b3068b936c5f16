"""What a design yields: the controller in its three forms, its figures, and the gains for the law on board."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import control
import numpy as np

from mufly.control.analysis import LoopAnalysis, feedback_part
from mufly.control.discretise import DiscreteController
from mufly.control.linear import Array
from mufly.control.published import PublishedDesign
from mufly.control.reduction import Reduction
from mufly.control.schemes import Scaling
from mufly.control.settings import Settings

__all__ = ["Design", "FlightController"]


def _loop_dict(loop: LoopAnalysis) -> dict[str, Any]:
    return {
        key: None if isinstance(value, float) and not np.isfinite(value) else value
        for key, value in asdict(loop).items()
    }


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

    def to_dict(self) -> dict[str, Any]:
        """The figures, ready for JSON: units in the keys, None for what is infinite."""
        return {
            "name": self.name,
            "gamma": self.gamma,
            "norm": self.norm,
            "plant_crossovers_rad_s": list(self.plant_crossovers),
            "output_scale": list(self.scaling.outputs),
            "input_scale": list(self.scaling.inputs),
            "order_full": self.controller.nstates,
            "order_reduced": self.reduced.nstates,
            "reduction_method": self.reduction.chosen.method,
            "reduction_tolerance_dB": self.reduction.tolerance_dB,
            "rate_Hz": 1 / self.discrete.period_s,
            "form": self.discrete.form,
            "anti_windup": self.discrete.anti_windup,
            "full": _loop_dict(self.full_loop),
            "reduced": _loop_dict(self.reduced_loop),
            "sampled_with_one_sample_of_delay": _loop_dict(self.sampled_loop),
            "thesis": asdict(self.published),
        }

    def __str__(self) -> str:
        """Summary of a few lines."""
        loops = (("full", self.full_loop), ("reduced", self.reduced_loop), ("sampled", self.sampled_loop))
        orders = (self.controller.nstates, self.reduced.nstates, self.discrete.order)
        lines = [
            f"{self.name}: gamma {self.gamma:.3f}, norm achieved {self.norm:.3f}; "
            f"order {orders[0]} -> {orders[1]} ({self.reduction.chosen.method}); "
            f"{1 / self.discrete.period_s:g} Hz, {self.discrete.form} form, anti-windup {self.discrete.anti_windup}",
            f"  {'loop':8} {'order':>5} {'crossovers rad/s':>17} {'S_u dB':>7} {'T_u dB':>7} {'GM dB':>6} "
            f"{'PM deg':>7} {'delay ms':>9}",
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

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user should know before flying: sampled loops with peaks above 6 dB, and how to mend them."""
        found = []
        for d in (self.heave_yaw, self.roll_pitch, self.velocity):
            loop = d.sampled_loop
            peak = max(loop.sensitivity_peak_dB, loop.complementary_peak_dB)
            if peak > 6.0:
                found.append(
                    f"{d.name}: sampled at {1 / d.discrete.period_s:g} Hz with one sample of delay its sensitivities "
                    f"peak at {peak:.1f} dB (continuous: {d.reduced_loop.sensitivity_peak_dB:.1f} and "
                    f"{d.reduced_loop.complementary_peak_dB:.1f} dB); raise the rate"
                )
        return tuple(found)

    def to_dict(self) -> dict[str, Any]:
        """The figures of all designs, ready for JSON."""
        return {
            "warnings": list(self.warnings),
            "vehicle": self.vehicle_name,
            "rate_Hz": self.rate_Hz,
            "position_rate_Hz": self.rate_Hz / self.position_divider,
            "design_voltage_V": self.voltage_V,
            "motor_trim_upper_lower": [float(v) for v in self.motor_trim],
            "position_gain_1_s": self.settings.position_gain,
            "designs": [d.to_dict() for d in (self.heave_yaw, self.roll_pitch, self.velocity)],
            "cascade": _loop_dict(self.cascade),
        }

    def __str__(self) -> str:
        """Summary of all designs."""
        head = (
            f"{self.vehicle_name}: {self.rate_Hz:g} Hz, position at {self.rate_Hz / self.position_divider:g} Hz, "
            f"{self.voltage_V:g} V, hover motor inputs {self.motor_trim[0]:.3f} upper, {self.motor_trim[1]:.3f} lower"
        )
        c = self.cascade
        tail = (
            f"position cascade at the tilt reference: S {c.sensitivity_peak_dB:.2f} dB, "
            f"T {c.complementary_peak_dB:.2f} dB, GM {c.gain_margin_dB:.1f} dB, PM {c.phase_margin_deg:.1f} deg, "
            f"delay margin {1e3 * c.delay_margin_s:.0f} ms"
        )
        designs = [str(d) for d in (self.heave_yaw, self.roll_pitch, self.velocity)]
        return "\n".join([head, *designs, tail, *(f"warning: {text}" for text in self.warnings)])
