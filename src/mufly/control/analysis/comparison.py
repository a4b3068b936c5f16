"""Controllers of several methods on one vehicle, in one table: margins, robustness, noise, cost, flights, verdict.

All figures describe the controller that flies: reduced, sampled, with one sample of delay. The verdict applies five
criteria in turn. Each criterion keeps the methods that are as good as its best one, until one method is left:

1. sampled peaks of both loops below 6 dB, and stability proved over the vehicle's parameters (mu below 1);
2. success in flights: the 95 % interval reaches the best share;
3. disk margin of the weaker loop, within 0.05 of the best;
4. tilt in gusts, within a fifth of the best;
5. servo activity.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import control
import numpy as np
import xarray as xr

from mufly.compiled.numba_cache import imported_sources
from mufly.control.analysis.gust_response import compute_gust_tilt_std
from mufly.control.analysis.loop_margins import DiskMargin, compute_input_noise_std, disk_margin
from mufly.control.controller_design import ControllerDesign
from mufly.control.designs import FlightController, design_flight_controller
from mufly.control.linear_systems import Array, LoopAnalysis, analyse_loop, sample_plant
from mufly.control.robust import parameter_robustness
from mufly.control.robust.parameter_robustness import analyse_parameter_robustness
from mufly.control.synthesis.synthesis_methods import SYNTHESIS_METHOD_NAMES, SynthesisMethod
from mufly.control.synthesis.weighting_schemes import DesignSettings
from mufly.dynamics import find_trim, linearise_vehicle
from mufly.errors import MuflyError
from mufly.files.answer_store import hash_inputs, read_stored_result, write_stored_result
from mufly.results import ShownBlock, make_lines_block, make_table_block, result
from mufly.vehicle import Vehicle

ATTITUDE_NOISE_RAD = float(np.radians(0.1))
"""Deviation of the estimated attitude from sample to sample."""
HEIGHT_NOISE_M = 0.003
"""Deviation of the estimated height from sample to sample."""
DEFAULT_GYRO_NOISE_RAD_S = float(np.radians(0.3))
"""Deviation of a gyro's sample on a vehicle without a modelled IMU."""
MAX_SENSITIVITY_PEAK_DB = 6.0
TUNED_METHOD_NAME = "tuned"
"""Name of the first tuned loop of a comparison."""
_EQUAL_DISK_MARGIN_TOLERANCE = 0.05
_EQUAL_GUST_TILT_RATIO = 1.2


@result
class LoopMetrics:
    """Order, norm, margins, input noise and mu of one loop with the sampled controller that flies.

    Attributes
    ----------
    order, multiply_adds : int
        States of the controller, and its multiply-adds in a period in modal form.
    norm : float
        H-infinity norm of the weighted loop (gamma reached).
    sampled : LoopAnalysis
        Margins of the sampled loop.
    disk : DiskMargin
    input_noise : float
        Largest deviation of an input (1) by sensor noise.
    mu_upper, mu_lower : float
        Bounds of mu over the vehicle's parameters.
    """

    order: int
    multiply_adds: int
    norm: float
    sampled: LoopAnalysis
    disk: DiskMargin
    input_noise: float
    mu_upper: float
    mu_lower: float


@result
class FlightMetrics:
    """Results of simulated flights with the controllers of one method.

    Attributes
    ----------
    flights, successes : int
        Number of flights, and of successes.
    low, high : float
        95 % interval of the success rate.
    overshoot_p95_m : float or None
        95th percentile of the worst overshoot beyond a waypoint; None without flights that reach one.
    """

    flights: int
    successes: int
    low: float
    high: float
    overshoot_p95_m: float | None


@result
class ForwardSpeedMetrics:
    """Disk margin and peaks of the sampled roll-pitch loop at one forward speed, with the model linearised there.

    Attributes
    ----------
    speed_m_s : float
    disk_margin, sensitivity_peak_dB, complementary_peak_dB : float
        The margin is zero and the peaks are ``inf`` for an unstable loop.
    """

    speed_m_s: float
    disk_margin: float
    sensitivity_peak_dB: float
    complementary_peak_dB: float


@result
class MethodMetrics:
    """Results of one synthesis method: both loops, peak of the position cascade, tilt in gusts; instructions and
    flights are None if not measured.

    ``method`` is a method of synthesis, or the name of a tuned loop (:data:`TUNED_METHOD_NAME`). ``instructions`` are
    those of the whole law in a period on a Cortex-M4, mean over a self-test. ``forward`` is roll-pitch at forward
    speeds.
    """

    method: str
    heave_yaw: LoopMetrics
    roll_pitch: LoopMetrics
    cascade_peak_dB: float
    gust_tilt_rad: float
    flights: FlightMetrics | None = None
    instructions: float | None = None
    forward: tuple[ForwardSpeedMetrics, ...] = ()

    @property
    def method_label(self) -> str:
        """Name of the method, with the order of a tuned controller."""
        name = next((text for key, text in SYNTHESIS_METHOD_NAMES.items() if key == self.method), self.method)
        return (
            f"{name} {self.roll_pitch.order}" if name == self.method or self.method in ("fixed", "scheduled") else name
        )

    @property
    def weaker_disk_margin(self) -> float:
        """Disk margin of the weaker loop."""
        return min(self.heave_yaw.disk.margin, self.roll_pitch.disk.margin)

    @property
    def first_missed_requirement(self) -> str:
        """First requirement that the loops miss; empty if they meet all."""
        for name, loop in (("heave-yaw", self.heave_yaw), ("roll-pitch", self.roll_pitch)):
            peak = max(loop.sampled.sensitivity_peak_dB, loop.sampled.complementary_peak_dB)
            if peak > MAX_SENSITIVITY_PEAK_DB:
                return f"{name} peaks at {peak:.1f} dB"
            if not loop.mu_upper < 1.0:
                return f"{name} has mu up to {loop.mu_upper:.2f}"
        return ""


@result
class ControllerComparison:
    """Comparison of several synthesis methods on one vehicle.

    Attributes
    ----------
    vehicle_name : str
    rate_Hz : float
    methods : tuple of MethodMetrics
    recommended : str
        Method that the verdict chooses.
    verdict : str
        The choice and what decided it.
    """

    vehicle_name: str
    rate_Hz: float
    methods: tuple[MethodMetrics, ...]
    recommended: str
    verdict: str

    def make_printed_blocks(self) -> list[ShownBlock]:
        """Return as printed text a table for each loop, a table of the flights, and the verdict."""
        heads = ("", "gamma", "S_u", "T_u", "GM", "PM", "DM", "disk", "mu", "noise", "gust", "n", "MAC")
        blocks: list[ShownBlock] = []
        for title, part in (("roll-pitch", "roll_pitch"), ("heave-yaw", "heave_yaw")):
            rows: list[tuple[str, ...]] = [("", "", "dB", "dB", "dB", "deg", "ms", "", "", "%", "deg", "", "")]
            for m in self.methods:
                loop: LoopMetrics = getattr(m, part)
                s = loop.sampled
                rows.append(
                    (
                        m.method_label, f"{loop.norm:.3f}",
                        f"{s.sensitivity_peak_dB:.2f}", f"{s.complementary_peak_dB:.2f}",
                        f"{s.gain_margin_dB:.1f}", f"{s.phase_margin_deg:.0f}", f"{1e3 * s.delay_margin_s:.0f}",
                        f"{loop.disk.margin:.2f}", f"{loop.mu_upper:.2f}", f"{100 * loop.input_noise:.2f}",
                        f"{np.degrees(m.gust_tilt_rad):.2f}" if part == "roll_pitch" else "-",
                        f"{loop.order}", f"{loop.multiply_adds}",
                    )
                )  # fmt: skip
            blocks.append(make_table_block(heads, rows, title=f"{self.vehicle_name}, {title}, {self.rate_Hz:g} Hz"))
        if all(m.forward for m in self.methods):
            speeds = (f"{f.speed_m_s:g} m/s" for f in self.methods[0].forward)
            rows = [
                (
                    m.method_label,
                    *(
                        f"{f.disk_margin:.2f}, {f.sensitivity_peak_dB:.2f}, {f.complementary_peak_dB:.2f}"
                        for f in m.forward
                    ),
                )
                for m in self.methods
            ]
            title = "roll-pitch in forward flight: disk margin, peaks of S_u and T_u (dB)"
            blocks.append(make_table_block(("", *speeds), rows, title=title))
        counted = [f"{m.method_label} {m.instructions:.0f}" for m in self.methods if m.instructions is not None]
        if counted:
            blocks.append(make_lines_block(f"Instructions of the law in a period on a Cortex-M4: {', '.join(counted)}"))
        flown = [(m, m.flights) for m in self.methods if m.flights is not None]
        if flown:
            rows = [
                (
                    m.method_label,
                    f"{f.successes} of {f.flights}",
                    f"{100 * f.low:.0f} to {100 * f.high:.0f} %",
                    "-" if f.overshoot_p95_m is None else f"{f.overshoot_p95_m:.3f}",
                )
                for m, f in flown
            ]
            blocks.append(make_table_block(("flights", "succeeded", "95 % interval", "overshoot (m), 95 %"), rows))
        blocks.append(make_lines_block(self.verdict))
        return blocks


def compute_output_noise_std(vehicle: Vehicle, outputs: Sequence[str]) -> Array:
    """Return the standard deviation of the noise of each measured output per sample (SI): gyroscopes, attitude,
    height.
    """
    imu = getattr(vehicle.sensors, "imu", None) if vehicle.sensors is not None else None
    gyro = DEFAULT_GYRO_NOISE_RAD_S
    if imu is not None:  # white noise behind a filter of first order
        bandwidth_Hz = float(imu.bandwidth) / (2 * np.pi)
        gyro = float(imu.gyro_noise_density) * float(np.sqrt(bandwidth_Hz * np.pi / 2))
    kinds = {"p": gyro, "q": gyro, "r": gyro, "z": HEIGHT_NOISE_M}
    return np.array([kinds.get(name, ATTITUDE_NOISE_RAD) for name in outputs])


def compute_loop_metrics(
    vehicle: Vehicle, design: ControllerDesign, mu: tuple[float, float], *, scheduled: bool = False
) -> LoopMetrics:
    """Return order, norm, margins, input noise and mu of a loop at hover; ``mu`` holds upper and lower bound of mu."""
    plant = sample_plant(design.plant, design.discrete.period_s, 1)
    feedback = design.feedback_controller(design.discrete.to_state_space())
    n, (outputs, inputs) = design.discrete.order, design.discrete.D.shape
    noise = compute_output_noise_std(vehicle, design.plant.output_labels)
    return LoopMetrics(
        order=n,
        multiply_adds=n * (inputs + outputs) + 2 * n + inputs * outputs + (outputs * (n + inputs) if scheduled else 0),
        norm=design.reduction.chosen.norm,
        sampled=design.sampled_loop,
        disk=disk_margin(plant, feedback),
        input_noise=float(compute_input_noise_std(plant, feedback, noise).max()),
        mu_upper=mu[0],
        mu_lower=mu[1],
    )


def compare_methods(
    vehicle: Vehicle,
    methods: Sequence[SynthesisMethod],
    *,
    settings: DesignSettings | None = None,
    tuned: Sequence[DesignSettings] = (),
    points: int = 30,
    speeds_m_s: Sequence[float] = (),
    folder: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[ControllerComparison, dict[str, FlightController]]:
    """Design controllers by several methods and compare them, without flights.

    Parameters
    ----------
    vehicle : Vehicle
    methods : sequence of str
        Methods of synthesis.
    settings : DesignSettings, optional
        Settings but for the method.
    tuned : sequence of DesignSettings
        Settings with tuned loops (``mufly control tune``), further rows of the comparison.
    points : int
        Frequencies of the bounds of mu.
    speeds_m_s : sequence of float
        Forward speeds at which roll-pitch is assessed; those without steady flight are left out.
    folder : Path, optional
        Folder that keeps the bounds of every method, for an interrupted comparison to resume.
    progress : callable, optional
        Called with (methods done, all methods).

    Returns
    -------
    comparison : ControllerComparison
    controllers : dict
        Controllers by method or name of tuned loop, to fly them.

    Raises
    ------
    MuflyError
        If a design fails.
    """
    base = DesignSettings() if settings is None else settings
    wanted: dict[str, DesignSettings] = {method: replace(base, method=method) for method in methods}
    wanted |= {f"{TUNED_METHOD_NAME}-{k}" if k > 1 else TUNED_METHOD_NAME: given for k, given in enumerate(tuned, 1)}
    rows: list[MethodMetrics] = []
    controllers: dict[str, FlightController] = {}
    plants: dict[float, control.StateSpace] | None = None
    for k, (method, chosen) in enumerate(wanted.items()):
        if progress is not None:
            progress(k, len(wanted))
        c = design_flight_controller(vehicle, settings=chosen)
        linear = linearise_vehicle(vehicle, voltage=c.voltage_V)
        if plants is None:
            plants = linearise_roll_pitch_by_speed(vehicle, speeds_m_s, c.voltage_V)
        bounds = load_or_compute_mu_bounds(vehicle, c, points, None if folder is None else folder / f"mu-{method}.json")
        rows.append(
            MethodMetrics(
                method,
                compute_loop_metrics(vehicle, c.heave_yaw, bounds[0]),
                compute_loop_metrics(vehicle, c.roll_pitch, bounds[1], scheduled=c.schedule is not None),
                c.cascade_loop.sensitivity_peak_dB,
                compute_gust_tilt_std(linear, c),
                forward=compute_forward_speed_metrics(c, plants),
            )
        )
        controllers[method] = c
        if progress is not None:
            progress(k + 1, len(wanted))
    rate = next(iter(controllers.values())).rate_Hz
    return recommend_method(vehicle.name, rate, rows), controllers


def linearise_roll_pitch_by_speed(
    vehicle: Vehicle, speeds_m_s: Sequence[float], voltage: float
) -> dict[float, control.StateSpace]:
    """Return the plants of roll-pitch by forward speed; speeds without steady flight are left out."""
    found: dict[float, control.StateSpace] = {}
    for speed in speeds_m_s:
        try:
            at = find_trim(vehicle, velocity=(speed, 0.0, 0.0), voltage=voltage)
        except MuflyError:
            continue
        found[float(speed)] = linearise_vehicle(vehicle, at).roll_pitch
    return found


def compute_forward_speed_metrics(
    c: FlightController, plants: Mapping[float, control.StateSpace]
) -> tuple[ForwardSpeedMetrics, ...]:
    """Return disk margin and peaks of the roll-pitch loop at each forward speed; a scheduled controller follows the
    speed.
    """
    found = []
    for speed, plant in plants.items():
        K = c.roll_pitch.discrete.to_state_space()
        if c.schedule is not None:
            K = c.schedule.blend_controller(c.roll_pitch.discrete, c.schedule.forward_share_at(speed))
        feedback, held = c.roll_pitch.feedback_controller(K), sample_plant(plant, c.period_s, 1)
        loop, disk = analyse_loop(held, feedback), disk_margin(held, feedback).margin
        peaks = (loop.sensitivity_peak_dB, loop.complementary_peak_dB) if loop.stable else (np.inf, np.inf)
        found.append(ForwardSpeedMetrics(speed, disk, *peaks))
    return tuple(found)


def load_or_compute_mu_bounds(
    vehicle: Vehicle, c: FlightController, points: int, path: Path | None
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the upper and lower bound of mu of heave-yaw and of roll-pitch; ``path`` stores them for later calls."""
    sources = [path.read_bytes() for path in imported_sources(Path(parameter_robustness.__file__))]
    gains = [np.ascontiguousarray(g).tobytes() for g in (c.heave_yaw_gains, c.roll_pitch_gains)]
    question = hash_inputs(vehicle.model_dump_json(), c.rate_Hz, c.voltage_V, points, *gains, *sources)
    kept = None if path is None else read_stored_result(path, question)
    if kept is None:
        robust = analyse_parameter_robustness(vehicle, c, points=points)
        kept = {loop.name: [loop.peak, loop.peak_lower_bound] for loop in robust.loop_results}
        if path is not None:
            write_stored_result(path, question, kept)
    heave_yaw, roll_pitch = ((float(kept[name][0]), float(kept[name][1])) for name in ("heave-yaw", "roll-pitch"))
    return heave_yaw, roll_pitch


def comparison_dataset(comparison: ControllerComparison) -> xr.Dataset:
    """Return the comparison as a dataset: margins and norms over controller and loop, other values over controller."""
    loops = ("roll-pitch", "heave-yaw")

    def loop_metric_array(figure: Callable[[LoopMetrics], float]) -> tuple[tuple[str, str], list[list[float]]]:
        return ("controller", "loop"), [
            [float(figure(x)) for x in (m.roll_pitch, m.heave_yaw)] for m in comparison.methods
        ]

    variables: dict[str, Any] = {
        "gamma": loop_metric_array(lambda x: x.norm),
        "sensitivity_peak_dB": loop_metric_array(lambda x: x.sampled.sensitivity_peak_dB),
        "complementary_peak_dB": loop_metric_array(lambda x: x.sampled.complementary_peak_dB),
        "gain_margin_dB": loop_metric_array(lambda x: x.sampled.gain_margin_dB),
        "phase_margin_deg": loop_metric_array(lambda x: x.sampled.phase_margin_deg),
        "delay_margin_s": loop_metric_array(lambda x: x.sampled.delay_margin_s),
        "disk_margin": loop_metric_array(lambda x: x.disk.margin),
        "mu_upper": loop_metric_array(lambda x: x.mu_upper),
        "mu_lower": loop_metric_array(lambda x: x.mu_lower),
        "input_noise": loop_metric_array(lambda x: x.input_noise),
        "order": loop_metric_array(lambda x: x.order),
        "multiply_adds": loop_metric_array(lambda x: x.multiply_adds),
        "cascade_peak_dB": ("controller", [m.cascade_peak_dB for m in comparison.methods]),
        "gust_tilt_rad": ("controller", [m.gust_tilt_rad for m in comparison.methods]),
        "instructions": (
            "controller",
            [np.nan if m.instructions is None else m.instructions for m in comparison.methods],
        ),
    }
    coordinates: dict[str, Any] = {"controller": [m.method for m in comparison.methods], "loop": list(loops)}
    if all(m.forward for m in comparison.methods):
        coordinates["speed_m_s"] = [f.speed_m_s for f in comparison.methods[0].forward]
        for name in ("disk_margin", "sensitivity_peak_dB", "complementary_peak_dB"):
            over_speed = [[float(getattr(f, name)) for f in m.forward] for m in comparison.methods]
            variables[f"forward_{name}"] = ("controller", "speed_m_s"), over_speed
    flown = [m.flights for m in comparison.methods]
    if any(f is not None for f in flown):
        variables["flights"] = "controller", [0.0 if f is None else float(f.flights) for f in flown]
        variables["successes"] = "controller", [0.0 if f is None else float(f.successes) for f in flown]
        variables["overshoot_p95_m"] = (
            "controller",
            [np.nan if f is None or f.overshoot_p95_m is None else f.overshoot_p95_m for f in flown],
        )
    return xr.Dataset(
        variables,
        coordinates,
        {
            "vehicle": comparison.vehicle_name, "rate_Hz": comparison.rate_Hz,
            "recommended": comparison.recommended, "verdict": comparison.verdict,
        },
    )  # fmt: skip


def recommend_method(vehicle_name: str, rate_Hz: float, rows: Sequence[MethodMetrics]) -> ControllerComparison:
    """Rank the methods by the criteria of the module's docstring; return the comparison with its verdict."""
    reasons = [
        f"{m.method_label} is excluded: {m.first_missed_requirement}" for m in rows if m.first_missed_requirement
    ]
    left = [m for m in rows if not m.first_missed_requirement]
    if not left:
        reasons.append("no method meets all requirements, so all are compared")
        left = list(rows)
    decided = "the only one that meets the requirements"
    if len(left) > 1 and all(m.flights is not None for m in left):
        best = max(m.flights.successes / m.flights.flights for m in left if m.flights is not None)
        kept = [m for m in left if m.flights is not None and m.flights.high >= best]
        if len(kept) < len(left):
            reasons += [f"{m.method_label} succeeds in fewer flights" for m in left if m not in kept]
            decided = "success in flights"
        left = kept
    if len(left) > 1:
        widest = max(m.weaker_disk_margin for m in left)
        kept = [m for m in left if m.weaker_disk_margin >= widest - _EQUAL_DISK_MARGIN_TOLERANCE]
        if len(kept) < len(left):
            decided = f"the disk margin of its weaker loop, {widest:.2f}"
        left = kept
    if len(left) > 1:
        stiffest = min(m.gust_tilt_rad for m in left)
        kept = [m for m in left if m.gust_tilt_rad <= _EQUAL_GUST_TILT_RATIO * stiffest]
        if len(kept) < len(left):
            decided = f"tilt of {np.degrees(stiffest):.2f} degrees in gusts"
        left = kept
    if len(left) > 1:
        left = [min(left, key=lambda m: m.roll_pitch.input_noise)]
        decided = f"servo activity of {100 * left[0].roll_pitch.input_noise:.2f} % by sensor noise"
    chosen = left[0]
    verdict = f"Recommended: {chosen.method_label}; decided by {decided}." + (
        f" {'; '.join(reasons)}." if reasons else ""
    )
    return ControllerComparison(vehicle_name, rate_Hz, tuple(rows), chosen.method, verdict)
