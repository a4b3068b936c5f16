"""A mission no faster than its helicopter.

A reference that is quicker than the helicopter is caught up with on the run and then overshot: what matters is not
the speed itself but that the reference can brake no harder than the helicopter. So each limit of the mission is
brought down to a share of what the controllers can follow, before the flight.
"""

from __future__ import annotations

import math

from mufly.mission.schema import Mission
from mufly.mission.trajectory import Limits

__all__ = ["slowed"]

SHARE = 0.8
"""Of what the controllers can follow; the rest is for catching up."""


def slowed(mission: Mission, able: Limits) -> tuple[Mission, str]:
    """Bring a mission's limits down to what the helicopter can follow.

    Parameters
    ----------
    mission : Mission
        As asked for.
    able : Limits
        What the controllers can follow, SI units.

    Returns
    -------
    mission : Mission
        The same one, where nothing has to be slower.
    changes : str
        What was changed, in words: ``"climb_m_s 0.8 in place of 2"``; empty if nothing was.
    """
    can = {
        "speed_m_s": able.speed,
        "climb_m_s": able.climb,
        "descent_m_s": able.descent,
        "acceleration_m_s2": able.acceleration,
        "climb_acceleration_m_s2": able.climb_acceleration,
        "yaw_rate_deg_s": math.degrees(able.yaw_rate),
        "yaw_acceleration_deg_s2": math.degrees(able.yaw_acceleration),
    }
    most = SHARE * able.speed
    hasty = [k for k, w in enumerate(mission.waypoint) if w.speed_m_s is not None and w.speed_m_s > most]
    slower = {key: SHARE * most for key, most in can.items() if SHARE * most < getattr(mission.limits, key)}
    if not slower and not hasty:
        return mission, ""
    words = [
        f"{key} {value:.2g} in place of {getattr(mission.limits, key):g}" for key, value in slower.items()
    ]
    words += [
        f"waypoint[{k + 1}].speed_m_s {most:.2g} in place of {mission.waypoint[k].speed_m_s:g}" for k in hasty
    ]
    # Made anew: a copy would keep what was derived from the old limits.
    parts = {name: getattr(mission, name) for name in Mission.model_fields}
    parts["limits"] = mission.limits.model_copy(update=slower)
    parts["waypoint"] = tuple(
        w.model_copy(update={"speed_m_s": most}) if k in hasty else w for k, w in enumerate(mission.waypoint)
    )
    return Mission(**parts), ", ".join(words)
