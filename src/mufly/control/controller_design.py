"""Design of one controller, from synthesis to difference equations, with the thesis's figures for comparison."""

from __future__ import annotations

import control
import numpy as np

from mufly.control.implementation import ControllerReduction, DiscreteController
from mufly.control.linear_systems import LoopAnalysis, extract_feedback_controller
from mufly.control.synthesis.synthesis_methods import SYNTHESIS_METHOD_NAMES, SynthesisMethod
from mufly.control.synthesis.weighting_schemes import SignalScaling
from mufly.results import ShownBlock, format_value, make_table_block, result


@result
class ThesisDesignValues:
    """Values of one design that the thesis prints; None where it prints none.

    Attributes
    ----------
    gamma : float
        H-infinity level reached.
    plant_crossovers : tuple of float
        0 dB crossings of the unscaled plant's singular values (rad/s).
    crossover : float
        Crossover frequency of the loop gain (rad/s).
    sensitivity_peak_dB, complementary_peak_dB : float
        Peaks of S_u and T_u.
    resonance : float
        Resonance frequency of the plant (rad/s).
    order : int
        Order on the processor, after reduction.
    """

    gamma: float | None = None
    plant_crossovers: tuple[float, ...] | None = None
    crossover: float | None = None
    sensitivity_peak_dB: float | None = None
    complementary_peak_dB: float | None = None
    resonance: float | None = None
    order: int | None = None


PUBLISHED_HEAVE_YAW = ThesisDesignValues(
    gamma=1.38,
    plant_crossovers=(2.82, 575.0),
    crossover=3.26,
    sensitivity_peak_dB=3.7398,
    complementary_peak_dB=3.93,
    order=10,
)
PUBLISHED_ROLL_PITCH = ThesisDesignValues(crossover=36.0, complementary_peak_dB=1.9, resonance=14.5, order=8)
PUBLISHED_VELOCITY_DESIGN = ThesisDesignValues()


@result(
    json="name method gamma norm plant_crossovers_rad_s=plant_crossovers output_scale=scaling.outputs "
    "input_scale=scaling.inputs order_full=controller.nstates order_reduced=reduced.nstates "
    "reduction_method=reduction.chosen.method reduction_tolerance_dB=reduction.tolerance_dB rate_Hz=discrete.rate_Hz "
    "form=discrete.form anti_windup=discrete.anti_windup full=full_loop reduced=reduced_loop "
    "sampled_with_one_sample_of_delay=sampled_loop thesis=published",
)
class ControllerDesign:
    """Design of one controller: synthesis, reduced order, difference equations, and the analyses of its loops.

    Attributes
    ----------
    name : str
    method : str
        Method of synthesis: a key of ``synthesis_methods.SYNTHESIS_METHOD_NAMES``.
    plant : control.StateSpace
        Plant in physical units.
    scaling : SignalScaling
    generalised_plant : control.StateSpace
        Generalised plant of the synthesis: scaled, with weights.
    controller : control.StateSpace
        Controller: continuous, full order, physical units.
    gamma, gamma_optimal, norm : float
        Level of the controller, smallest feasible level found, and computed norm of the closed loop with weights; the
        levels are nan for methods that claim none.
    reduction : ControllerReduction
    reduced : control.StateSpace
        Reduced controller: continuous, physical units.
    discrete : DiscreteController
    full_loop, reduced_loop, sampled_loop : LoopAnalysis
        Analyses of the loop with the full, reduced and discrete controller, the last with hold and one sample of
        delay.
    plant_crossovers : tuple of float
        0 dB crossings of the unscaled plant's singular values, rad/s.
    error_inputs : tuple of int
        Controller inputs that are errors of the plant's outputs.
    published : ThesisDesignValues
        Figures of the thesis.
    """

    name: str
    method: SynthesisMethod
    plant: control.StateSpace
    scaling: SignalScaling
    generalised_plant: control.StateSpace
    controller: control.StateSpace
    gamma: float
    gamma_optimal: float
    norm: float
    reduction: ControllerReduction
    reduced: control.StateSpace
    discrete: DiscreteController
    full_loop: LoopAnalysis
    reduced_loop: LoopAnalysis
    sampled_loop: LoopAnalysis
    plant_crossovers: tuple[float, ...]
    error_inputs: tuple[int, ...]
    published: ThesisDesignValues

    @property
    def loop_analyses(self) -> tuple[tuple[str, int, LoopAnalysis], ...]:
        """Name, order and analysis of the loops with the full, the reduced and the sampled controller."""
        return (
            ("full", self.controller.nstates, self.full_loop),
            ("reduced", self.reduced.nstates, self.reduced_loop),
            ("sampled", self.discrete.order, self.sampled_loop),
        )

    def feedback_controller(self, controller: control.StateSpace | None = None) -> control.StateSpace:
        """Return the feedback K of ``u = -K y``, taken from ``controller`` or, by default, from the full-order
        controller.
        """
        return extract_feedback_controller(
            self.controller if controller is None else controller, self.plant, self.error_inputs
        )

    def make_printed_blocks(self) -> list[ShownBlock]:
        """Return a table that compares the full-order, reduced and sampled controllers with that of the thesis."""
        thesis = self.published
        loops = (self.full_loop, self.reduced_loop, self.sampled_loop)

        def loop_row(label: str, field: str, form: str, theirs: str = "-", factor: float = 1.0) -> tuple[str, ...]:
            return (label, *(f"{factor * getattr(loop, field):{form}}" for loop in loops), theirs)

        crossovers = (", ".join(f"{w:.1f}" for w in loop.crossovers) for loop in loops)
        plant = ", ".join(f"{w:.3g}" for w in self.plant_crossovers)
        printed = ", ".join(f"{w:g}" for w in thesis.plant_crossovers or ()) or "-"
        sensitivity, complementary = thesis.sensitivity_peak_dB, thesis.complementary_peak_dB
        rows = [
            ("order", *(f"{order}" for _, order, _ in self.loop_analyses), format_value(thesis.order)),
            (
                "gamma claimed",
                f"{self.gamma:.3f}" if np.isfinite(self.gamma) else "-",
                "",
                "",
                format_value(thesis.gamma, ".2f"),
            ),
            ("norm achieved", f"{self.norm:.3f}", f"{self.reduction.chosen.norm:.3f}", "", "-"),
            ("plant's crossovers (rad/s)", plant, "", "", printed),
            ("loop's crossovers (rad/s)", *crossovers, format_value(thesis.crossover)),
            loop_row("peak of S_u (dB)", "sensitivity_peak_dB", ".2f", format_value(sensitivity, ".2f")),
            loop_row("peak of T_u (dB)", "complementary_peak_dB", ".2f", format_value(complementary, ".2f")),
            loop_row("gain margin (dB)", "gain_margin_dB", ".1f"),
            loop_row("phase margin (deg)", "phase_margin_deg", ".1f"),
            loop_row("delay margin (ms)", "delay_margin_s", ".0f", factor=1e3),
        ]
        heads = ("", "full order", "reduced", f"{self.discrete.rate_Hz:g} Hz*", "thesis")
        title = self.name if self.method == "hinf" else f"{self.name}, {SYNTHESIS_METHOD_NAMES[self.method]}"
        return [make_table_block(heads, rows, title=title)]
