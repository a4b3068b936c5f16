"""Uncertain parameters of a vehicle: their spreads, and the linear model as an affine function of them.

The parameters are ``p = p0 + S z`` with every component of z within -1 to 1. The linear model at z is taken as affine,
``[A B] = [A0 B0] + sum z_i E_i``, with ``E_i`` by central differences of the linearised vehicle. A singular value
decomposition ``E_i = L_i R_i`` makes every z_i a scalar that is repeated as often as E_i has rank.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from mufly.control.linear_systems import Array
from mufly.dynamics import linearise_vehicle
from mufly.errors import InputError, MuflyError
from mufly.vehicle import Vehicle, list_parameters, replace_parameters

DEFAULT_SPREADS: Mapping[str, float] = {
    "body.inertia_xx": 0.2,
    "body.inertia_yy": 0.2,
    "rotors.upper.thrust_coefficient": 0.1,
    "swash_plate.linkage": 0.3,
    "stabiliser_bar.linkage": 0.3,
    "stabiliser_bar.time_constant": 0.3,
    "rotors.inplane_drag": 0.5,
}
"""Relative spreads of parameters for which a vehicle file states no standard deviation."""

STANDARD_DEVIATIONS_PER_SPREAD = 2.0
"""Size of a stated standard deviation's range."""

_RANK_TOLERANCE = 1e-4


def default_spreads(vehicle: Vehicle) -> dict[str, float]:
    """Return the spread (SI) of each uncertain parameter of a vehicle, the half width of its range, by key.

    A spread is two standard deviations if the vehicle file states one, else it follows from :data:`DEFAULT_SPREADS`.
    """
    parameters = {p.key: p for p in list_parameters(vehicle) if isinstance(p.value, float)}
    left_out = ("mass_budget.", "range_ring.", "sensors.")
    spreads = {
        key: STANDARD_DEVIATIONS_PER_SPREAD * float(p.std)
        for key, p in parameters.items()
        if p.std and not key.startswith(left_out)
    }
    for key, share in DEFAULT_SPREADS.items():
        if key in parameters and key not in spreads and parameters[key].value:
            spreads[key] = share * abs(float(parameters[key].value))
    return spreads


def parameter_values(vehicle: Vehicle, keys: Sequence[str]) -> Array:
    """Return the values (SI) of a vehicle's parameters by key."""
    known = {p.key: float(p.value) for p in list_parameters(vehicle) if isinstance(p.value, float)}
    return np.array([known[key] for key in keys])


def differentiate_plants_by_parameters(
    vehicle: Vehicle, voltage_V: float, keys: Sequence[str], spread_matrix: Array
) -> dict[str, list[Array]]:
    """Return the derivatives ``[dA dB]`` of the plants ``heave-yaw`` and ``roll-pitch`` by every uncertain parameter.

    Parameters
    ----------
    vehicle : Vehicle
    voltage_V : float
        Battery voltage of the linear model.
    keys : sequence of str
        Parameters.
    spread_matrix : array, shape (keys, directions)
        The parameters move by ``spread_matrix @ z``.
    """
    centre = parameter_values(vehicle, keys)
    linear: dict[str, list[Array]] = {"heave-yaw": [], "roll-pitch": []}
    nominal = linearise_vehicle(vehicle, voltage=voltage_V)
    for column in spread_matrix.T:
        ends, width = [], 0.0
        for sign in (1.0, -1.0):
            try:
                moved = replace_parameters(vehicle, dict(zip(keys, (centre + sign * column).tolist(), strict=True)))
                ends.append(linearise_vehicle(moved, voltage=voltage_V))
                width += 1.0
            except (InputError, MuflyError):  # an impossible vehicle on one side: the other side's difference
                ends.append(nominal)
        for name, part in (("heave-yaw", "heave_yaw"), ("roll-pitch", "roll_pitch")):
            high, low = (getattr(end, part) for end in ends)
            linear[name].append(np.hstack([high.A - low.A, high.B - low.B]) / max(width, 1.0))
    return linear


def factor_derivatives(derivatives: Sequence[Array], scale: float) -> list[tuple[Array, Array]]:
    """Factor every derivative E into a balanced product ``L R`` of lowest rank; a negligible derivative has empty
    factors.

    Parameters
    ----------
    derivatives : sequence of array
        Derivatives E of the plant's matrix.
    scale : float
        Norm of the plant's matrix; a derivative below 1e-9 of it is negligible.
    """
    found = []
    for E in derivatives:
        U, s, Vt = np.linalg.svd(E)
        rank = int((s > max(_RANK_TOLERANCE * s[0], 1e-9 * scale)).sum())
        root = np.sqrt(s[:rank])
        found.append((U[:, :rank] * root, Vt[:rank] * root[:, None]))
    return found
