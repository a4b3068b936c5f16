"""Rotor speeds as measurements of heave-yaw: their benefit over height, heading and yaw rate alone.

The motors' back-EMF gives the rotor speeds (Sec. 6.1.9). Both loops are LQG/LTR with the same weights and the same
bound on the filter's poles; one loop reads z, psi and r, the other one also both rotor speeds, with the noise of the
vehicle's ``sensors.rotor_speed``. The weight of the inputs is swept. Every row is a sampled loop with one sample of
delay:

- height and heading: deviations by disturbances of both motors' inputs and by the noise of all sensors, from the
  covariance of the loop, ``X = A X A' + B B'``. Disturbances represent gusts, ground and battery as changes of the
  inputs. They are independent, with the deviation :data:`INPUT_DISTURBANCE_STD` below the frequency
  :data:`INPUT_DISTURBANCE_CORNER_RAD_S`;
- inputs: the larger deviation of a motor's command.

The verdict compares the smallest height deviations with a disk margin of :data:`LEAST_DISK_MARGIN`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import control
import numpy as np
from scipy import linalg

from mufly.control.analysis.comparison import compute_output_noise_std
from mufly.control.analysis.loop_margins import disk_margin
from mufly.control.implementation import discretise_controller
from mufly.control.linear_systems import Array, analyse_loop, extract_feedback_controller, sample_plant
from mufly.control.synthesis.lqg import LqgWeights, design_lqg, find_largest_ltr_parameter
from mufly.control.synthesis.weighting_schemes import (
    HEAVE_YAW_LQG,
    SignalScaling,
    heave_yaw_scaling,
    scale_plant,
    unscale_controller,
)
from mufly.dynamics import extract_submodel, linearise_vehicle
from mufly.dynamics.linearisation import LINEAR_INPUTS
from mufly.errors import MuflyError
from mufly.results import ShownBlock, make_lines_block, make_table_block, result
from mufly.vehicle import Vehicle

CONTROL_WEIGHTS = (0.4, 0.2, 0.1, 0.05, 0.025, 0.0125)
INPUT_DISTURBANCE_STD, INPUT_DISTURBANCE_CORNER_RAD_S = 0.02, 2.0
LEAST_DISK_MARGIN = 0.7
DEFAULT_BACK_EMF_NOISE_V = 0.01
"""Noise of a back-EMF reading (V) on a vehicle without that sensor."""
_HEAVE_YAW_STATES = ["z", "w", "psi", "r", "Omega_dw", "Omega_up"]
_ROTOR_SPEED_STATES = ["Omega_dw", "Omega_up"]
_HEAVE_YAW_OUTPUTS = ["z", "psi", "r"]


@result
class HeaveYawRow:
    """One heave-yaw loop of the comparison, with or without measured rotor speeds.

    Attributes
    ----------
    rotor_speeds : bool
    control_weight : float
        Weight of the squared inputs (1).
    crossover_rad_s : float
        Lowest crossover of the loop gain's singular values: that of heave.
    sensitivity_peak_dB, disk_margin : float
    height_m, heading_rad, input : float
        Deviations by disturbances and noise.
    """

    rotor_speeds: bool
    control_weight: float
    crossover_rad_s: float
    sensitivity_peak_dB: float
    disk_margin: float
    height_m: float
    heading_rad: float
    input: float


@result
class RotorSpeedComparison:
    """Margins and errors of heave-yaw loops with and without measured rotor speeds.

    Attributes
    ----------
    vehicle_name : str
    speed_noise_rad_s : float
        Noise of a measured rotor speed.
    rows : tuple of HeaveYawRow
    """

    vehicle_name: str
    speed_noise_rad_s: float
    rows: tuple[HeaveYawRow, ...]

    def best_row(self, rotor_speeds: bool) -> HeaveYawRow | None:
        """Return the row of least height deviation with enough disk margin; None without one."""
        rows = [r for r in self.rows if r.rotor_speeds == rotor_speeds and r.disk_margin >= LEAST_DISK_MARGIN]
        return min(rows, key=lambda r: r.height_m, default=None)

    @property
    def verdict_sentence(self) -> str:
        """Sentence on the benefit of the rotor speeds."""
        plain, more = self.best_row(False), self.best_row(True)
        if plain is None or more is None:
            which = "without" if plain is None else "with"
            return f"No loop {which} rotor speeds has a disk margin of {LEAST_DISK_MARGIN:g}."
        return (
            f"At a disk margin of {LEAST_DISK_MARGIN:g} feedback of rotor speeds changes the height's deviation from "
            f"{100 * plain.height_m:.2f} to {100 * more.height_m:.2f} cm, the crossover of heave from "
            f"{plain.crossover_rad_s:.1f} to {more.crossover_rad_s:.1f} rad/s and the inputs' deviation from "
            f"{100 * plain.input:.1f} to {100 * more.input:.1f} %."
        )

    def make_printed_blocks(self) -> list[ShownBlock]:
        """Return the table of the compared loops and the verdict, as text."""
        heads = ("rotor speeds", "weight", "crossover", "S_u", "disk", "height", "heading", "inputs")
        rows: list[tuple[str, ...]] = [("", "", "rad/s", "dB", "", "cm", "deg", "%")]
        for r in self.rows:
            rows.append(
                (
                    "measured" if r.rotor_speeds else "-", f"{r.control_weight:g}", f"{r.crossover_rad_s:.1f}",
                    f"{r.sensitivity_peak_dB:.2f}", f"{r.disk_margin:.2f}", f"{100 * r.height_m:.2f}",
                    f"{np.degrees(r.heading_rad):.2f}", f"{100 * r.input:.1f}",
                )
            )  # fmt: skip
        return [
            make_table_block(heads, rows, title=f"{self.vehicle_name}, heave-yaw by LQG/LTR"),
            make_lines_block(f"Noise of a rotor speed: {self.speed_noise_rad_s:.2f} rad/s", self.verdict_sentence),
        ]


def compute_back_emf_speed_noise(vehicle: Vehicle) -> float:
    """Return the noise of a rotor speed by back-EMF (rad/s): the voltage noise, divided by ``kE`` and the gear
    ratio.
    """
    sensor = getattr(vehicle.sensors, "rotor_speed", None) if vehicle.sensors is not None else None
    volts = DEFAULT_BACK_EMF_NOISE_V if sensor is None else float(sensor.voltage_noise)
    return volts / (float(vehicle.motor.back_emf_constant) * float(vehicle.gear.ratio))


def compare_rotor_speed_feedback(
    vehicle: Vehicle, *, rate_Hz: float = 200.0, control_weights: Sequence[float] = CONTROL_WEIGHTS
) -> RotorSpeedComparison:
    """Design heave-yaw controllers with and without measured rotor speeds, and compare their margins and errors.

    Raises
    ------
    MuflyError
        If the vehicle cannot hover.
    """
    full = linearise_vehicle(vehicle).full
    speed_noise, period = compute_back_emf_speed_noise(vehicle), 1.0 / rate_Hz
    base = heave_yaw_scaling(extract_submodel(full, _HEAVE_YAW_STATES, LINEAR_INPUTS[:2], _HEAVE_YAW_OUTPUTS))
    rows = []
    for measured in (False, True):
        outputs = [*_HEAVE_YAW_OUTPUTS, *(_ROTOR_SPEED_STATES if measured else [])]
        plant = extract_submodel(full, _HEAVE_YAW_STATES, LINEAR_INPUTS[:2], outputs, name="heave_yaw")
        noise = compute_output_noise_std(vehicle, outputs)
        noise[len(_HEAVE_YAW_OUTPUTS) :] = speed_noise
        scaling = SignalScaling((*base.outputs, *[100.0] * (len(outputs) - len(_HEAVE_YAW_OUTPUTS))), base.inputs)
        told = (*HEAVE_YAW_LQG.noise, *(speed_noise / 100.0 for _ in outputs[len(_HEAVE_YAW_OUTPUTS) :]))
        for weight in control_weights:
            weights = replace(HEAVE_YAW_LQG, control=weight, noise=told)
            row = _assess_heave_yaw_loop(plant, scaling, weights, noise, period, measured)
            if row is not None:
                rows.append(row)
    return RotorSpeedComparison(vehicle.name, speed_noise, tuple(rows))


def _assess_heave_yaw_loop(
    plant: control.StateSpace, scaling: SignalScaling, weights: LqgWeights, noise: Array, period: float, measured: bool
) -> HeaveYawRow | None:
    """Return the figures of a loop; None if it is not stable when sampled."""
    G = scale_plant(plant, scaling)
    q = find_largest_ltr_parameter(G, weights, 2.0 * np.pi / period)
    try:
        found = design_lqg(G, (0, 1), weights, recovery=q)
    except MuflyError:
        return None
    so, si = np.array(scaling.outputs), np.array(scaling.inputs)
    discrete = discretise_controller(
        unscale_controller(found.controller, so, si), found.anti_windup_matrix / si, period
    )
    held, K = sample_plant(plant, period, 1), discrete.to_state_space()
    feedback = extract_feedback_controller(K, plant, range(plant.noutputs))
    loop = analyse_loop(held, feedback, output_scale=so)
    if not loop.stable:
        return None
    deviations = _closed_loop_standard_deviations(plant, K, noise, period)
    return HeaveYawRow(
        measured, weights.control, min(loop.crossovers, default=float("nan")), loop.sensitivity_peak_dB,
        disk_margin(held, feedback).margin, *deviations,
    )  # fmt: skip


def _closed_loop_standard_deviations(
    plant: control.StateSpace, K: control.StateSpace, noise: Array, period: float
) -> tuple[float, float, float]:
    """Return the standard deviations of height (m), heading (rad) and the more active motor input.

    Their causes are input disturbances and sensor noise.
    """
    states = list(plant.state_labels)
    held = control.sample_system(plant, period, method="zoh")
    n, m, k, p = plant.nstates, plant.ninputs, K.nstates, len(noise)
    pole = np.exp(-INPUT_DISTURBANCE_CORNER_RAD_S * period)
    A, shocks = np.zeros((n + 2 * m + k,) * 2), np.zeros((n + 2 * m + k, m + p))
    x, d, q, e = slice(0, n), slice(n, n + m), slice(n + m, n + m + k), slice(n + m + k, None)
    A[x, x], A[x, d], A[x, e] = held.A, held.B, held.B
    A[d, x], A[d, q] = -K.D @ plant.C, K.C
    A[q, x], A[q, q] = -K.B @ plant.C, K.A
    A[e, e], shocks[e, :m] = pole * np.eye(m), INPUT_DISTURBANCE_STD * np.sqrt(1.0 - pole**2) * np.eye(m)
    shocks[d, m:], shocks[q, m:] = K.D * noise, K.B * noise
    X = linalg.solve_discrete_lyapunov(A, shocks @ shocks.T)
    spread = np.sqrt(np.maximum(X.diagonal(), 0.0))
    return float(spread[states.index("z")]), float(spread[states.index("psi")]), float(spread[d].max())
