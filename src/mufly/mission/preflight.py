"""Can this vehicle fly this mission? Asked before anything runs, by the command line and by `mufly.flight.fly`."""

from __future__ import annotations

from mufly.dynamics import hover_performance
from mufly.errors import InputError
from mufly.mission.check import Estimate, check_mission
from mufly.mission.schema import Mission
from mufly.mission.state import prepare
from mufly.vehicle import Vehicle

__all__ = ["preflight"]


def preflight(
    vehicle: Vehicle, mission: Mission, *, vehicle_file: str = "", mission_file: str = ""
) -> Estimate:
    """Check that the vehicle hovers, that the mission suits it and that its battery lasts.

    Parameters
    ----------
    vehicle : Vehicle
    mission : Mission
        Checked, as `load_mission` returns it.
    vehicle_file, mission_file : str
        What an error calls them; their names by default.

    Returns
    -------
    Estimate
        Time, length and charge.

    Raises
    ------
    InputError
        Naming file, key, value and remedy.
    """
    try:
        hover = hover_performance(vehicle)
    except InputError as error:
        raise error.at(vehicle_file or vehicle.name) from None
    where = mission_file or mission.name
    try:
        prepare(mission, vehicle)
    except InputError as error:
        raise error.at(where) from None
    capacity_Ah = float(vehicle.battery.capacity) / 3600.0
    return check_mission(mission, hover_current_A=hover.current_A, capacity_Ah=capacity_Ah, where=where)
