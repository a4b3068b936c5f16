"""Studies of the low-level controllers: singular values (Figs 6.3, 6.5, 6.7, 6.8), steps, tracking (Figs 6.10 to
6.13)."""

from __future__ import annotations

import functools
import math

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from mufly.control import (
    ControllerDesign,
    FlightController,
    design_flight_controller,
    frequency_response,
    singular_values,
)
from mufly.control.analysis.plots import draw_loop, draw_plant_singular_values
from mufly.errors import MuflyError
from mufly.flight import ControllerReference, Flight, simulate_controller_response
from mufly.flight.mission_flight import await_estimate_and_start
from mufly.mission import parse_mission
from mufly.results.result_figure import blank_figure
from mufly.thesis.claims import CLAIMS, ProgressCallback, Study, StudyFindings, judge, make_item_judge
from mufly.vehicle import load_vehicle

Array = NDArray[np.float64]
_BODY_RATE_OUTPUTS = slice(2, 4)  # p and q among the outputs of the roll-pitch plant
_NOMINAL_VOLTAGE_V, _HALF_CHARGED_VOLTAGE_V = 7.2, 6.4


@functools.lru_cache(maxsize=2)
def _design_controller(voltage: float = _NOMINAL_VOLTAGE_V) -> FlightController:
    return design_flight_controller(load_vehicle("mufly-1.1"), voltage=voltage)


def _singular_value_curves(one: ControllerDesign) -> xr.Dataset:
    frequency = np.geomspace(1e-4, 1e4, 400)
    values = singular_values(one.plant, frequency)
    return xr.Dataset({"plant": (("frequency", "which"), values)}, coords={"frequency": frequency})


def study_heave_yaw_plant(progress: ProgressCallback | None = None) -> StudyFindings:
    """Fig. 6.3: singular values of the heave-yaw plant, at the nominal voltage and with a half-charged battery.

    The second voltage fits the crossovers that the dissertation prints.
    """
    verdicts = []
    for volt in (_NOMINAL_VOLTAGE_V, _HALF_CHARGED_VOLTAGE_V):
        found = _design_controller(volt).heave_yaw.plant_crossovers
        for k, name in enumerate(("first", "second")):
            key = f"fig-6.3/{name}-crossing"
            change = 100 * (found[k] / CLAIMS[key].value - 1)
            ours = f"{found[k]:.4g} rad/s ({change:+.1f} %)"
            verdicts.append(judge(key, f"{volt:g} V", ours, crossing=found[k]))
    one = _design_controller().heave_yaw
    low = singular_values(one.plant, np.array([1e-4, 1e-3]))[:, 0]
    slope = 20 * math.log10(low[0] / low[1])
    verdicts.append(
        judge(
            "fig-6.3/the-plant-integrates",
            "7.2 V",
            f"its gain falls by {slope:.0f} dB a decade at 0.001 rad/s",
            slope=slope,
        )
    )
    return StudyFindings(verdicts, draw_plant_singular_values(one), {"heave-yaw": _singular_value_curves(one)})


def study_heave_yaw_loop(progress: ProgressCallback | None = None) -> StudyFindings:
    """Fig. 6.5: H-infinity level, crossover and peaks of both sensitivities of the heave-yaw loop."""
    one = _design_controller().heave_yaw
    loop = one.full_loop
    near = min(loop.crossovers, key=lambda w: abs(w - 3.26))
    assess = make_item_judge("fig-6.5", "continuous, full order")
    verdicts = [
        assess("gamma-is-1.38", f"{one.norm:.3f}", norm=one.norm),
        assess("the-crossover-is-at-3.26-rad-s", f"{', '.join(f'{w:.2f}' for w in loop.crossovers)} rad/s", near=near),
        assess(
            "the-peak-of-s-u-is-3.74",
            f"{loop.sensitivity_peak_dB:.2f} dB",
            sensitivity_peak_db=loop.sensitivity_peak_dB,
        ),
        assess(
            "the-peak-of-t-u-is-3.93",
            f"{loop.complementary_peak_dB:.2f} dB",
            complementary_peak_db=loop.complementary_peak_dB,
        ),
        judge(
            "fig-6.5/the-controller-on-board-is-of",
            "reduced, sampled",
            f"order {one.discrete.order}",
            order=one.discrete.order,
        ),
    ]
    return StudyFindings(verdicts, draw_loop(one), {"heave-yaw": _singular_value_curves(one)})


def study_roll_pitch_plant(progress: ProgressCallback | None = None) -> StudyFindings:
    """Fig. 6.7: the resonance due to the stabiliser bar."""
    one = _design_controller().roll_pitch
    poles = one.plant.poles()
    damped = sorted({round(abs(float(p.imag)), 2) for p in poles if p.imag > 1.0})
    frequency = np.geomspace(5, 30, 1500)
    rates = np.abs(frequency_response(one.plant, frequency)[:, _BODY_RATE_OUTPUTS, :]).max(
        axis=2
    )  # of the larger input
    peaks = [float(frequency[k]) for k in rates.argmax(axis=0)]
    verdicts = [
        judge(
            "fig-6.7/the-bar-leads-to-a-resonance",
            "7.2 V",
            f"rates peak at {peaks[0]:.1f} rad/s (roll) and {peaks[1]:.1f} (pitch); poles turn at "
            f"{', '.join(f'{d:.1f}' for d in damped)} rad/s",
            peaks=max(peaks),
        ),
    ]
    return StudyFindings(verdicts, draw_plant_singular_values(one), {"roll-pitch": _singular_value_curves(one)})


def study_roll_pitch_loop(progress: ProgressCallback | None = None) -> StudyFindings:
    """Fig. 6.8: crossover and peak of the roll-pitch loop."""
    one = _design_controller().roll_pitch
    loop = one.full_loop
    near = min(loop.crossovers, key=lambda w: abs(w - 36))
    assess = make_item_judge("fig-6.8", "continuous, full order")
    verdicts = [
        assess("the-crossover-is-at-36-rad-s", f"{', '.join(f'{w:.1f}' for w in loop.crossovers)} rad/s", near=near),
        assess(
            "the-peak-of-t-u-is-1.9",
            f"{loop.complementary_peak_dB:.2f} dB",
            complementary_peak_db=loop.complementary_peak_dB,
        ),
        judge(
            "fig-6.8/the-controller-on-board-is-of",
            "reduced, sampled",
            f"order {one.discrete.order}",
            order=one.discrete.order,
        ),
    ]
    return StudyFindings(verdicts, draw_loop(one), {"roll-pitch": _singular_value_curves(one)})


def study_heave_step(progress: ProgressCallback | None = None) -> StudyFindings:
    """Fig. 6.10: a step of 0.5 m upwards on the nonlinear model, battery half charged, inputs saturated.

    Thesis: Fig. 6.10.
    """
    d = simulate_controller_response(
        load_vehicle("mufly-1.1"),
        lambda t: ControllerReference(down_m=-0.5 if t >= 1.0 else 0.0),
        duration_s=10.0,
        controller=_design_controller(),
        charge=0.5,
    )
    time = d.time.values
    z, yaw = d.truth_position.sel(axis="D").values, d.truth_attitude.sel(angle="yaw").values
    motor = d.motor_input.values
    overshoot = 100 * max(0.0, float(-z.min() - 0.5) / 0.5)
    late = np.flatnonzero(np.abs(z + 0.5) > 0.01)
    settled = float(time[late[-1]] - 1.0)
    assess = make_item_judge("fig-6.10", "nonlinear model")
    verdicts = [
        assess("the-step-is-followed-without-overshoot", f"{overshoot:.2f} %", overshoot=overshoot),
        assess("it-has-settled-after-about-2", f"within 2 % after {settled:.2f} s", settled=settled),
        assess(
            "yaw-stays-between-0.06-and-0.03",
            f"{1e3 * yaw.min():.1f} to {1e3 * yaw.max():.1f} mrad",
            yaw_min=yaw.min(),
            yaw_max=yaw.max(),
        ),
        assess("motor-inputs-are-asked-for-up", f"at most {motor.max():.2f}", motor_max=motor.max()),
    ]
    drawn = blank_figure(7.0, 6.8)
    top, middle, bottom = drawn.subplots(3, 1, sharex=True)
    top.plot(time, d.reference_position.sel(axis="D"), "k--", linewidth=1, label="reference")
    top.plot(time, z, label="nonlinear model")
    top.set(ylabel="z (m, down)", ylim=(-0.6, 0.1))
    middle.plot(time, yaw)
    middle.set(ylabel="Yaw (rad)", ylim=(-0.06, 0.03))
    for k, name in enumerate(("upper", "lower")):
        bottom.plot(time, d.motor_input.sel(rotor=name), color=f"C{k}", label=name)
    bottom.axhline(1.0, color="k", linewidth=0.8, linestyle=":")
    bottom.set(ylabel="Motor input", ylim=(0.2, 1.6), xlabel="Time (s)", xlim=(0, 10))
    _add_grid_legend_title(drawn, "Fig. 6.10: step in heave, simulated (axes as printed)")
    return StudyFindings(verdicts, drawn, {"run": _select_plotted_signals(d)})


def _add_grid_legend_title(drawn: object, title: str) -> None:
    for axes in drawn.axes:  # type: ignore[attr-defined]
        axes.grid(alpha=0.3)
        if axes.get_legend_handles_labels()[0]:
            axes.legend(fontsize="small")
    drawn.suptitle(title)  # type: ignore[attr-defined]


def _select_plotted_signals(d: xr.Dataset) -> xr.Dataset:
    """Return the signals that are drawn."""
    names = (
        "truth_position",
        "truth_attitude",
        "reference_position",
        "reference_attitude",
        "motor_input",
        "servo_input",
    )
    return d[[n for n in names if n in d]]


_PITCH_REFERENCE_STEPS = ((8.5, 0.0), (7.0, -0.06), (5.5, -0.14), (4.0, -0.04), (2.5, -0.10), (1.0, -0.03))


def _pitch_reference(t: float) -> float:
    return next((value for begin, value in _PITCH_REFERENCE_STEPS if t >= begin), 0.0)


def study_pitch_tracking(progress: ProgressCallback | None = None) -> StudyFindings:
    """Fig. 6.12: steps of pitch between 0 and -0.14 rad; the text does not state the steps of the figure.

    Thesis: Fig. 6.12.
    """
    d = simulate_controller_response(
        load_vehicle("mufly-1.1"),
        lambda t: ControllerReference(pitch=_pitch_reference(t)),
        duration_s=10.0,
        controller=_design_controller(),
    )
    time, pitch = d.time.values, d.truth_attitude.sel(angle="pitch").values
    wanted = np.array([_pitch_reference(float(t)) for t in time])
    servo = d.servo_input.sel(servo=1).values
    ends = [t for t, _ in _PITCH_REFERENCE_STEPS[:-1]] + [10.0]
    rest = max(float(np.abs((pitch - wanted)[(time > e - 0.3) & (time < e - 0.01)]).max()) for e in ends)
    begin = time >= 2.5
    half = time[begin][np.argmax(pitch[begin] < -0.03 - 0.9 * 0.07)] - 2.5
    railed = float(np.sum(np.abs(servo) > 1 - 1e-9) * (time[1] - time[0]))
    assess = make_item_judge("fig-6.12", "nonlinear model")
    verdicts = [
        assess(
            "the-reference-in-pitch-is-followed",
            f"90 % of a step after {half:.2f} s; within {1e3 * rest:.1f} mrad at the end of each step",
            half=half,
            rest=rest,
        ),
        assess(
            "the-servo-stays-between-0.8-and",
            f"{servo.min():.2f} to {servo.max():.2f}, railed for {1e3 * railed:.0f} ms in all",
            servo_min=servo.min(),
            servo_max=servo.max(),
        ),
    ]
    drawn = blank_figure(7.0, 5.0)
    top, bottom = drawn.subplots(2, 1, sharex=True)
    top.plot(time, wanted, "k--", linewidth=1, label="reference")
    top.plot(time, pitch, label="nonlinear model")
    top.set(ylabel="Pitch (rad)", ylim=(-0.16, 0.02))
    bottom.plot(time, servo, "C1", label="servo 1")
    for limit in (-0.8, 0.6):
        bottom.axhline(limit, color="0.5", linestyle=":", linewidth=0.9)
    bottom.set(ylabel="Servo input", xlabel="Time (s)", xlim=(0, 10))
    _add_grid_legend_title(drawn, "Fig. 6.12: following in pitch, simulated (dotted: printed axis)")
    return StudyFindings(verdicts, drawn, {"run": _select_plotted_signals(d)})


_CLIMB_MISSION = {
    "description": "climb of 0.5 m, then wait",
    "take_off": {"height_m": 1.0, "wait_s": 8.0},
    "waypoint": [{"position_m": [0.0, 0.0, -1.5], "wait_s": 30.0}],
}
_HOVER_DURATION_S, _STICK_DURATION_S = 8.0, 8.0


@functools.lru_cache(maxsize=1)
def _fly_on_sensors() -> tuple[xr.Dataset, float, float]:
    """Fly on sensors: climb by 0.5 m, hover, pitch by stick; return recording, and start of climb and of stick (s)."""
    climb = stick = math.nan
    with Flight(
        "mufly-1.1", parse_mission(_CLIMB_MISSION), controller=_design_controller(), seed=7, sensors="fitted"
    ) as flight:
        pilot = flight.autopilot
        refused = await_estimate_and_start(flight)
        if refused:
            raise MuflyError(refused)
        while flight.time_s < 120.0:
            flight.advance_until(flight.plant.period_count + 1)
            state, now = str(pilot.software.state), flight.time_s
            if math.isnan(climb) and state == "waypoint":
                climb = now
            elif math.isnan(stick) and state == "hover" and now > climb + 6.0 + _HOVER_DURATION_S:
                stick = now
            if now >= stick:
                pilot.set_sticks(0.0, _compute_pitch_stick_input(now - stick), 0.0, 0.0)
            if now > stick + _STICK_DURATION_S or flight.plant.crash_cause:
                break
        flight.close("failed" if flight.plant.crash_cause else "succeeded")
    return flight.recorder.to_dataset(), climb, stick


_STICK_STEPS = ((6.5, 0.0), (5.5, -0.06), (4.5, 0.08), (3.5, -0.10), (2.5, 0.10), (1.5, -0.08), (0.5, 0.05))


def _compute_pitch_stick_input(t: float) -> float:
    """Return a pilot's pitch command, smoothed over 0.2 s like a movement of the hand."""

    def step_level(s: float) -> float:
        return next((v for begin, v in _STICK_STEPS if s >= begin), 0.0)

    return sum(step_level(t - 0.02 * k) for k in range(10)) / 10


def _select_time_span(d: xr.Dataset, begin: float, end: float) -> xr.Dataset:
    return d.sel(time=slice(begin, end))


def study_heave_step_flown(progress: ProgressCallback | None = None) -> StudyFindings:
    """Fig. 6.11, a measured climb of 0.5 m in the dissertation: here flown on simulated sensors with the filter.

    The mission commands a smooth climb instead of a step; sensor errors are typical, air is calm.

    Thesis: Fig. 6.11.
    """
    d, climb, _ = _fly_on_sensors()
    part = _select_time_span(d, climb - 2.0, climb + 10.0)
    time = part.time.values - climb
    z = part.truth_position.sel(axis="D").values
    believed = part.estimated_position.sel(axis="D").values
    goal = part.reference_position.sel(axis="D").values
    start = float(goal[time < -0.5].mean())
    after = z[time > 0] - (start - 0.5)
    overshoot = 100 * max(0.0, -float(after.min()))
    wanted = part.reference_attitude.sel(angle="yaw").values
    yaw = part.truth_attitude.sel(angle="yaw").values - wanted
    still = np.abs(np.gradient(wanted, time)) < 1e-3
    worst = float(np.abs(yaw[still]).max())
    motor = part.motor_input.values
    assess = make_item_judge("fig-6.11", "flown on sensors")
    verdicts = [
        assess(
            "in-flight-it-overshoots-by-less", f"{overshoot:.1f} cm above the new height, of truth", overshoot=overshoot
        ),
        assess(
            "yaw-is-not-held-as-tightly",
            f"off the reference by up to {1e3 * worst:.0f} mrad while that stands still; 3 mrad in fig-6.10",
            worst=worst,
        ),
        assess(
            "motor-inputs-of-simulation-and-flight",
            f"mean of the motors in the wait {motor[time < -0.5].mean():.2f}, at most {motor.max():.2f}; hover of the "
            "model at this battery is 0.6 to 0.8",
            motor_mean=motor[time < -0.5].mean(),
        ),
    ]
    drawn = blank_figure(7.0, 6.8)
    top, middle, bottom = drawn.subplots(3, 1, sharex=True)
    top.plot(time, goal, "k--", linewidth=1, label="reference")
    top.plot(time, z, label="true")
    top.plot(time, believed, color="0.5", linewidth=0.8, label="believed")
    top.set(ylabel="z (m, down)")
    middle.plot(time, yaw)
    middle.set(ylabel="Yaw off its reference (rad)", ylim=(-0.1, 0.1))
    for k, name in enumerate(("upper", "lower")):
        bottom.plot(time, part.motor_input.sel(rotor=name), color=f"C{k}", linewidth=0.8, label=name)
    bottom.set(ylabel="Motor input", xlabel="Time after the climb began (s)", xlim=(-2, 10))
    _add_grid_legend_title(drawn, "Fig. 6.11: climb of 0.5 m, flown on sensors")
    return StudyFindings(verdicts, drawn, {"run": _select_plotted_signals(part)})


def study_pitch_tracking_flown(progress: ProgressCallback | None = None) -> StudyFindings:
    """Fig. 6.13, a measured flight with pitch commanded by stick: here flown on simulated sensors.

    Thesis: Fig. 6.13.
    """
    d, _, stick = _fly_on_sensors()
    part = _select_time_span(d, stick, stick + _STICK_DURATION_S)
    time = part.time.values - stick
    pitch = part.truth_attitude.sel(angle="pitch").values
    wanted = np.array([_compute_pitch_stick_input(float(t)) for t in time])
    servo = part.servo_input.sel(servo=1).values
    # Delay of the best fit, and the residual after it.
    step = float(np.median(np.diff(time)))
    shifts = np.arange(0, round(0.4 / step))
    left = [float(np.sqrt(np.mean((pitch[s:] - wanted[: wanted.size - s]) ** 2))) for s in shifts]
    best = int(np.argmin(left))
    assess = make_item_judge("fig-6.13", "flown on sensors")
    verdicts = [
        assess(
            "the-reference-is-followed-in-flight",
            f"{best * step:.2f} s late, off by {1e3 * left[best]:.0f} mrad then (root mean square; the reference has "
            f"{1e3 * wanted.std():.0f})",
            best=best * step,
            holds=left[best] < 0.5 * wanted.std(),
        ),
        assess(
            "the-servo-stays-between-0.3-and",
            f"{servo.min():.2f} to {servo.max():.2f}",
            servo_min=servo.min(),
            servo_max=servo.max(),
        ),
    ]
    drawn = blank_figure(7.0, 5.0)
    top, bottom = drawn.subplots(2, 1, sharex=True)
    top.plot(time, wanted, "k--", linewidth=1, label="stick")
    top.plot(time, pitch, label="true")
    top.set(ylabel="Pitch (rad)", ylim=(-0.2, 0.25))
    bottom.plot(time, servo, "C1", linewidth=0.8, label="servo 1")
    for limit in (-0.3, 0.5):
        bottom.axhline(limit, color="0.5", linestyle=":", linewidth=0.9)
    bottom.set(ylabel="Servo input", xlabel="Time (s)", xlim=(0, _STICK_DURATION_S))
    _add_grid_legend_title(drawn, "Fig. 6.13: pitch by stick, flown on sensors (dotted: printed axis)")
    return StudyFindings(verdicts, drawn, {"run": _select_plotted_signals(part)})


STUDIES: dict[str, Study] = {
    "fig-6.3": Study(study_heave_yaw_plant, 3),
    "fig-6.5": Study(study_heave_yaw_loop, 3),
    "fig-6.7": Study(study_roll_pitch_plant, 2),
    "fig-6.8": Study(study_roll_pitch_loop, 2),
    "fig-6.10": Study(study_heave_step, 4),
    "fig-6.12": Study(study_pitch_tracking, 4),
    "fig-6.11": Study(study_heave_step_flown, 20),
    "fig-6.13": Study(study_pitch_tracking_flown, 20),
}
