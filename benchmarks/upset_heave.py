"""How hard a vertical blow a hover survives: python benchmarks/upset_heave.py [--vehicle mufly-1.1]

The helicopter hovers at 3 m; its vertical speed is changed at once by so much. Fifteen seconds later it either stands
where it stood, or swings between full and no thrust for good. With ``--slack`` the reference waits for the height from
another distance (docs/explanation/control.md), or never: ``--slack inf``.
"""

from __future__ import annotations

import argparse

import numpy as np

from mufly.control import DesignSettings, FlightController, design_flight_controller
from mufly.flight import Flight
from mufly.mission import Mission
from mufly.vehicle import Vehicle, load_vehicle

HEIGHT_M, WATCH_S = 3.0, 15.0
DOWN_SPEED = 5  # of the state of the flight model (mufly.dynamics.model_state)


def blow(vehicle: Vehicle, controller: FlightController, sink_m_s: float) -> tuple[float, float]:
    """Return the least and the greatest height in the last three of fifteen seconds (m)."""
    flight = Flight(vehicle, Mission(), controller=controller, keep=False)
    flight.step_period()
    assert flight.autopilot.arm()
    assert flight.autopilot.take_off(HEIGHT_M)
    while flight.autopilot.status.state != "hover":
        flight.step_period()
    for _ in range(round(2.0 / flight.period_s)):
        flight.step_period()
    flight.plant.state[DOWN_SPEED] += sink_m_s
    heights = []
    for _ in range(round(WATCH_S / flight.period_s)):
        flight.step_period()
        heights.append(-float(flight.status.truth.position[2]))
    last = np.array(heights[-round(3.0 / flight.period_s) :])
    return float(last.min()), float(last.max())


def main() -> None:
    parser = argparse.ArgumentParser(description="How hard a vertical blow a hover survives.")
    parser.add_argument("--vehicle", default="mufly-1.1", help="vehicle file, or a built-in vehicle")
    parser.add_argument("--slack", type=float, default=DesignSettings().heave_slack, help="m; inf: never waits")
    options = parser.parse_args()
    vehicle = load_vehicle(options.vehicle)
    controller = design_flight_controller(vehicle, settings=DesignSettings(heave_slack=options.slack))
    print("blow, downwards   height 12 to 15 s later, from a hover at 3 m")
    for sink in (-6.0, -4.0, -3.0, -2.0, -1.25, -1.0, 1.0, 1.25, 2.0, 2.5, 3.5):
        least, greatest = blow(vehicle, controller, sink)
        print(f"{sink:+8.2f} m/s      {least:6.2f} to {greatest:.2f} m   {'' if greatest - least < 0.1 else 'LOST'}")


if __name__ == "__main__":
    main()
