"""Pictures of an environment: seen from above and from the south."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from numpy.typing import NDArray

from mufly.dynamics import body_to_ned_matrix
from mufly.dynamics.model_state import ATTITUDE_SLICE, NED_POSITION_SLICE
from mufly.gym.episodes import EpisodeArrays
from mufly.gym.tasks import OBSTACLE_WORLD, PILLAR_EAST_INDEX, PILLAR_NORTH_INDEX, PILLAR_RADIUS_INDEX, PILLAR_TOP_INDEX

_HUB_DOWN_M = (-0.03, -0.08)  # drawn discs, body axes
_TILTED_ROTOR_SPAN = np.linspace(-1.0, 1.0, 2)


def draw_episode(episodes: EpisodeArrays, index: int, task: str, radius_m: float, period_s: float) -> NDArray[np.uint8]:
    """Return a picture (360, 720, 3) of an environment.

    Parameters
    ----------
    episodes : EpisodeArrays
    index : int
        Of the environment.
    task : str
    radius_m : float
        Radius of the rotors.
    period_s : float
        Time of a step.
    """
    x, target = episodes.state[index], episodes.target[index]
    figure = Figure(figsize=(7.2, 3.6), dpi=100)
    canvas: Any = FigureCanvasAgg(figure)
    top, side = figure.subplots(1, 2)
    reach = 3.0 if task == "obstacle" else 2.2
    _draw_world(top, side, episodes, index, task)
    n, e, d = x[NED_POSITION_SLICE]
    axes = body_to_ned_matrix(x[ATTITUDE_SLICE])
    top.plot(target[1], target[0], "x", color="tab:red", markersize=10)
    side.plot(target[1], -target[2], "x", color="tab:red", markersize=10)
    top.add_patch(Circle((e, n), radius_m, fill=False, color="tab:blue"))
    nose = axes[:, 0] * 2.0 * radius_m
    top.plot([e, e + nose[1]], [n, n + nose[0]], color="tab:blue")
    for hub in _HUB_DOWN_M:
        middle = x[NED_POSITION_SLICE] + axes[:, 2] * hub
        disc = middle[:, None] + radius_m * axes[:, 1][:, None] * _TILTED_ROTOR_SPAN
        side.plot(disc[1], -disc[2], color="tab:blue", linewidth=2)
    foot = x[NED_POSITION_SLICE] + axes[:, 2] * 0.06
    side.plot([foot[1], e], [-foot[2], -d], color="tab:blue")
    wind = episodes.wind_velocity[index]
    top.annotate("", xytext=(-reach + 0.3, -reach + 0.3), xy=(-reach + 0.3 + wind[1], -reach + 0.3 + wind[0]),
                 arrowprops={"arrowstyle": "->", "color": "tab:gray"})  # fmt: skip
    top.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal", xlabel="E (m)", ylabel="N (m)")
    side.set(xlim=(-reach, reach), ylim=(0.0, 3.0), aspect="equal", xlabel="E (m)", ylabel="height (m)")
    top.set_title(f"{task}, {episodes.step_count[index] * period_s:.2f} s", fontsize=9)
    side.set_title(f"{episodes.distance[index]:.2f} m from the target, wind {np.linalg.norm(wind):.1f} m/s", fontsize=9)
    figure.tight_layout()
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def _draw_world(top: Any, side: Any, episodes: EpisodeArrays, index: int, task: str) -> None:
    side.axhline(0.0, color="black", linewidth=2)
    room = OBSTACLE_WORLD.room
    if task != "obstacle" or room is None:
        return
    (south, north), (west, east) = room.north, room.east
    top.add_patch(Rectangle((west, south), east - west, north - south, fill=False))
    side.add_patch(Rectangle((west, 0.0), east - west, room.height, fill=False))
    for column in episodes.pillars[index]:
        north, east, radius = column[PILLAR_NORTH_INDEX], column[PILLAR_EAST_INDEX], column[PILLAR_RADIUS_INDEX]
        top.add_patch(Circle((east, north), radius, color="tab:brown"))
        height = -column[PILLAR_TOP_INDEX]
        side.add_patch(Rectangle((east - radius, 0.0), 2.0 * radius, height, color="tab:brown", alpha=0.3))
