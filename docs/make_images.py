"""Draw the pictures of README and docs anew: python docs/make_images.py

The step responses stand beside the thesis's Figs 4.4, 6.10 and 6.12, on the same axes.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import mufly
from mufly.control import FlightController
from mufly.dynamics import find_trim, initial_state, simulate_open_loop
from mufly.flight import ControllerReference, draw_flight, fly_mission, simulate_response
from mufly.mission import load_mission
from mufly.vehicle import Vehicle, replace_parameters

IMAGES = Path(__file__).parent / "images"
BLUE, RED, GREEN = "#0072b2", "#d55e00", "#009e73"


def flights(vehicle: Vehicle, controller: FlightController) -> None:
    for name in ("demonstration", "box-on-leg"):
        mission = load_mission(name)
        dataset = fly_mission(vehicle, mission, controller=controller)
        points = [w.position_m for w in mission.waypoint]
        with tempfile.TemporaryDirectory() as folder:
            for picture in draw_flight(dataset, folder, waypoints=points, world=mission.world):
                if picture.stem in ("track", "history") and (name == "demonstration" or picture.stem == "track"):
                    suffix = "" if name == "demonstration" else f"-{name}"
                    (IMAGES / f"{picture.stem}{suffix}.png").write_bytes(picture.read_bytes())


def _axes(figure: Figure, rows: int, labels: list[str]) -> list[Axes]:
    axes = [figure.add_subplot(rows, 1, k + 1) for k in range(rows)]
    for a, label in zip(axes, labels, strict=True):
        a.set_ylabel(label)
        a.grid(alpha=0.3)
    axes[-1].set_xlabel("time (s)")
    return axes


def heave_step(vehicle: Vehicle, controller: FlightController) -> None:
    d = simulate_response(
        vehicle,
        lambda t: ControllerReference(down_m=-0.5 if t >= 1.0 else 0.0),
        duration_s=10.0,
        controller=controller,
        charge=0.5,
    )
    figure = Figure(figsize=(7, 6.5), layout="constrained")
    top, middle, bottom = _axes(figure, 3, ["z (m, down)", "yaw (rad)", "motor input"])
    top.plot(d.time, d.reference_position.sel(axis="D"), "k--", lw=1, label="reference")
    top.plot(d.time, d.truth_position.sel(axis="D"), color=BLUE, label="nonlinear model")
    top.legend()
    middle.plot(d.time, d.truth_attitude.sel(angle="yaw"), color=BLUE)
    middle.set_ylim(-0.06, 0.03)
    bottom.plot(d.time, d.motor_input.sel(rotor="lower"), color=RED, label="lower")
    bottom.plot(d.time, d.motor_input.sel(rotor="upper"), color=BLUE, label="upper")
    bottom.axhline(1.0, color="k", lw=0.8, ls=":")
    bottom.legend()
    top.set_title("Heave step, half-charged battery, inputs saturated (thesis Fig. 6.10)")
    figure.savefig(IMAGES / "heave-step.png", dpi=110)


def pitch_following(vehicle: Vehicle, controller: FlightController) -> None:
    def reference(t: float) -> ControllerReference:
        steps = ((8.5, 0.0), (7.0, -0.06), (5.5, -0.14), (4.0, -0.04), (2.5, -0.10), (1.0, -0.03))
        return ControllerReference(pitch=next((value for begin, value in steps if t >= begin), 0.0))

    d = simulate_response(vehicle, reference, duration_s=10.0, controller=controller)
    figure = Figure(figsize=(7, 4.8), layout="constrained")
    top, bottom = _axes(figure, 2, ["pitch (rad)", "servo 1"])
    top.plot(d.time, d.reference_attitude.sel(angle="pitch"), "k--", lw=1, label="reference")
    top.plot(d.time, d.truth_attitude.sel(angle="pitch"), color=BLUE, label="nonlinear model")
    top.legend()
    bottom.plot(d.time, d.servo_input.sel(servo=1), color=RED)
    top.set_title("Reference following in pitch (like thesis Fig. 6.12)")
    figure.savefig(IMAGES / "pitch-following.png", dpi=110)


def bar_alone(vehicle: Vehicle) -> None:
    figure = Figure(figsize=(7, 3.4), layout="constrained")
    (axes,) = _axes(figure, 1, ["angle (deg)"])
    for seconds, style in ((0.24, "-"), (0.2, "--")):
        v = replace_parameters(vehicle, {"stabiliser_bar.time_constant": seconds})
        hover = find_trim(v)
        tilted = initial_state(
            position=(0, 0, -5),
            attitude=(math.radians(20.0), 0, 0),
            bar_attitude=(0, 0),
            rotor_speed=hover.rotor_speed,
        )
        d = simulate_open_loop(v, tilted, hover.input, duration_s=2.0, sample_s=0.005, voltage=hover.voltage_V)
        angles = np.degrees(d.truth_attitude.values)
        for k, (name, colour) in enumerate((("roll", BLUE), ("pitch", RED), ("yaw", GREEN))):
            axes.plot(d.time, angles[:, k], style, color=colour, label=f"{name}, bar {seconds:g} s")
    axes.legend(ncols=2)
    axes.set_title("20 degrees of roll, righted by the stabiliser bar alone (thesis Fig. 4.4)")
    figure.savefig(IMAGES / "bar-alone.png", dpi=110)


def main() -> None:
    IMAGES.mkdir(exist_ok=True)
    vehicle = mufly.load_vehicle("mufly-1.1")
    controller = mufly.control.design_flight_controller(vehicle)
    flights(vehicle, controller)
    heave_step(vehicle, controller)
    pitch_following(vehicle, controller)
    bar_alone(vehicle)


if __name__ == "__main__":
    main()
