"""Flight map of a vehicle: pitch settings of its blades in hover, the map, and the greatest level speed with the map.

Pitch settings of the blades give the hover thrusts of the vehicle's own coefficients at its own hover speeds, as in
:mod:`mufly.dynamics.level_flight`. The knee of the edgewise axis is the inflow ratio of hover.

The flap frequency of small blades is seldom known. A map holds for one value; its band of greatest level speed comes
from two further, small maps at the ends of the band. The default is the upper end, a clamped root: the identified
following time of the lower disc, ``swash_plate.time_constant``, is that of a stiff blade.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from mufly.dynamics.level_flight import LevelFlightModel, check_blade_radius
from mufly.dynamics.linearisation import find_trim
from mufly.errors import InputError, MuflyError
from mufly.quantities.units import GRAVITY
from mufly.rotor import Rotor, prepare_blading
from mufly.rotor.coax_maps import hash_bladings
from mufly.rotor.forward import RigidFlapMode, estimate_flap_mode_range, make_flap_mode
from mufly.rotor.forward.edgewise_map import MAX_MAP_ADVANCE_RATIO, compute_flight_map_loads, make_edgewise_axis
from mufly.vehicle import FlightMap, FlightMapTables, Vehicle, replace_parameters
from mufly.vehicle.flight_map import format_flight_table

SPEED_RATIO_FACTORS = (0.8, 1.25)
"""Speed ratios of a map over that of hover."""
CLIMB_VELOCITY_FACTORS = (-0.5, -0.25, 0.0, 0.25, 0.5, 0.75)
"""Climb velocities of a map over the induced velocity of hover, of both rotors as one disc."""
EDGEWISE_SPEED_COUNT = 9
_COARSE_CLIMB_FACTORS, _COARSE_EDGEWISE_COUNT = (-0.25, 0.0, 0.25), 7  # of the maps that give the band of level speeds
_LEVEL_SPEED_TOLERANCE_M_S = 0.02
_LEVEL_SPEED_SEARCH_STEP_M_S = 0.25


def find_max_level_speed(vehicle: Vehicle) -> float:
    """Return the greatest level airspeed (m/s) that the flight model can trim without an input beyond its range.

    With a flight map the search ends at the map's last advance ratio. Speeds above the first one without a trim are
    ignored.

    Parameters
    ----------
    vehicle : Vehicle
    """
    flight_map = vehicle.rotors.flight_map
    edge = 30.0 if flight_map is None else flight_map.velocity_range_m_s[0]

    def has_trim(speed: float) -> bool:
        try:
            find_trim(vehicle, velocity=(speed, 0.0, 0.0))
        except MuflyError:
            return False
        return True

    low = 0.0
    for high in np.arange(
        _LEVEL_SPEED_SEARCH_STEP_M_S, edge + _LEVEL_SPEED_SEARCH_STEP_M_S, _LEVEL_SPEED_SEARCH_STEP_M_S
    ).tolist():
        if not has_trim(high):
            break
        low = high
    else:
        return edge
    while high - low > _LEVEL_SPEED_TOLERANCE_M_S:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if has_trim(middle) else (low, middle)
    return low


def make_flight_map(
    vehicle: Vehicle,
    rotor: Rotor,
    *,
    flap_frequency_ratio: float | None = None,
    name: str = "",
    progress: Callable[[int, int], None] | None = None,
) -> FlightMap:
    """Compute a vehicle's flight map: rotor loads in edgewise flow and at body rates, with the blades at hover pitch.

    Parameters
    ----------
    vehicle : Vehicle
    rotor : Rotor
        Blades of both rotors, with the vehicle's rotor radius.
    flap_frequency_ratio : float, optional
        Flap frequency over rotor speed, of both rotors. Default: the upper ends of their bands.
    name : str
        Name of the map; default: the vehicle's.
    progress : callable, optional
        ``progress(done, total)`` after each point.

    Returns
    -------
    FlightMap

    Raises
    ------
    InputError
        If the radius differs from the vehicle's, or the flap frequency is impossible.
    MuflyError
        If the blades cannot give the hover thrusts.
    """
    check_blade_radius(vehicle, rotor)
    plain = replace_parameters(vehicle, {"rotors.flight_map": None})
    blading = prepare_blading(rotor)
    hover = find_trim(plain, charge=0.5)
    speeds = (float(hover.rotor_speed[0]), float(hover.rotor_speed[1]))
    bands = [estimate_flap_mode_range(rotor, w) for w in speeds]
    ends = [(bands[0][0][k], bands[1][0][k]) for k in range(2)]
    if flap_frequency_ratio is None:
        flaps, basis = ends[1], f"upper end of the {bands[0][1]}"
    else:
        flaps = (make_flap_mode(rotor, flap_frequency_ratio), make_flap_mode(rotor, flap_frequency_ratio))
        basis = "flap frequency as given"
    model = LevelFlightModel(plain, blading, flaps)
    mean, ratio = 0.5 * sum(speeds), speeds[1] / speeds[0]
    radius = float(vehicle.rotors.radius)
    disc = 2.0 * float(vehicle.air.density) * math.pi * radius**2
    weight = float(vehicle.body.mass) * GRAVITY + float(vehicle.body.downwash_drag)
    knee = round(math.sqrt(weight / disc) / (mean * radius), 5)
    spacing = model.heights[0] - model.heights[1]
    counts = (
        len(SPEED_RATIO_FACTORS) * len(CLIMB_VELOCITY_FACTORS) * EDGEWISE_SPEED_COUNT,
        len(_COARSE_CLIMB_FACTORS) * _COARSE_EDGEWISE_COUNT,
    )
    done_before = 0

    def report(done: int, _: int) -> None:
        if progress is not None:
            progress(done_before + done, counts[0] + 2 * counts[1])

    def compute_map_tables(
        modes: tuple[RigidFlapMode, RigidFlapMode], ratios: tuple[float, ...], climbs: tuple[float, ...], count: int
    ) -> tuple[FlightMapTables, int]:
        return compute_flight_map_loads(
            blading, blading, modes, pitch_rad=model.pitch, spacing_m=spacing, mean_speed_rad_s=mean,
            ratio=[ratio * f for f in ratios], climb_ratio=[knee * f for f in climbs], knee=knee,
            edgewise=make_edgewise_axis(knee, count), air=model.air, progress=report,
        )  # fmt: skip

    tables, missing = compute_map_tables(flaps, SPEED_RATIO_FACTORS, CLIMB_VELOCITY_FACTORS, EDGEWISE_SPEED_COUNT)
    thrust_scale = float(vehicle.air.density) * math.pi * radius**4
    made = FlightMap(
        name=name or vehicle.name,
        description=f"{rotor.name} twice on {vehicle.name}, {1e3 * spacing:g} mm apart, flap frequency "
        f"{flaps[0].frequency_ratio:.3g} and {flaps[1].frequency_ratio:.3g}/rev ({basis})"
        + (f"; {missing} points without a solution take the solution of less sink or climb" if missing else ""),
        vehicle=vehicle.name, mass_kg=float(vehicle.body.mass), upper=rotor.name, lower=rotor.name,
        blades=hash_bladings(blading), radius_m=radius, spacing_m=spacing,
        thrust_coefficients=(
            float(hover.thrust_N[0]) / (thrust_scale * speeds[0] ** 2),
            float(hover.thrust_N[1]) / (thrust_scale * speeds[1] ** 2),
        ),
        pitch_deg=(round(math.degrees(model.pitch[0]), 6), round(math.degrees(model.pitch[1]), 6)),
        flap_frequency_ratios=(flaps[0].frequency_ratio, flaps[1].frequency_ratio), flap_basis=basis,
        mean_speed_rad_s=mean, density_kg_m3=float(vehicle.air.density), knee=knee,
        level_speed_m_s=(0.0, 0.0), table=format_flight_table(tables, knee),
    )  # fmt: skip
    found = [_find_max_level_speed_with_map(plain, made)]
    for k, modes in enumerate(ends):
        done_before = counts[0] + k * counts[1]
        coarse, _ = compute_map_tables(modes, (1.0,), _COARSE_CLIMB_FACTORS, _COARSE_EDGEWISE_COUNT)
        end_map = made.model_copy(update={"table": format_flight_table(coarse, knee)})
        found.append(_find_max_level_speed_with_map(plain, end_map))
    return made.model_copy(update={"level_speed_m_s": (round(min(found), 2), round(max(found), 2))})


def _find_max_level_speed_with_map(vehicle: Vehicle, flight_map: FlightMap) -> float:
    rotors = vehicle.rotors.model_copy(update={"flight_map": flight_map})
    return find_max_level_speed(vehicle.model_copy(update={"rotors": rotors}))


def check_map_blades(flight_map: FlightMap, rotor: Rotor) -> None:
    """Raise an error if a flight map was computed with other blades than those of ``rotor``.

    Raises
    ------
    InputError
        If blades or polars differ.
    """
    if hash_bladings(prepare_blading(rotor)) != flight_map.blades:
        raise InputError(
            flight_map.name, "blades", f"is not the hash of the blades {rotor.name}",
            "make the map again: mufly coax flight-map",
        )  # fmt: skip


__all__ = [
    "CLIMB_VELOCITY_FACTORS",
    "EDGEWISE_SPEED_COUNT",
    "MAX_MAP_ADVANCE_RATIO",
    "SPEED_RATIO_FACTORS",
    "check_map_blades",
    "find_max_level_speed",
    "make_flight_map",
]
