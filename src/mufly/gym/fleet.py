"""Random vehicles and winds, from which the episodes of an environment draw.

Vehicles and winds are drawn once, with the seed ``fleet_seed``, with the variations of a campaign
(:mod:`mufly.flight.monte_carlo.variation`) and the Dryden turbulence of flights. Each episode takes a vehicle, and a
wind at a random instant, by its own random numbers. Episodes are therefore independent of the other environments of a
vector.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mufly.dynamics import (
    DEFAULT_STEP_S,
    PARAMETER_DTYPE,
    STATE_SIZE,
    DrydenWind,
    find_longest_stable_step,
    find_step_limiting_parameter,
    find_trim,
    model_parameters,
)
from mufly.errors import InputError, MuflyError
from mufly.flight.monte_carlo.variation import parse_variations
from mufly.vehicle import Vehicle, replace_parameters

_Array = NDArray[np.float64]

TRIM_CHARGE_FRACTION = 0.8
"""Charge of the battery at which the inputs of hover are computed."""

MIN_START_CHARGE = 0.5
"""Least charge of the battery at the start of an episode."""

MAX_TRIM_MOTOR_INPUT = 0.95
"""Greatest motor input of a drawn vehicle in hover at the least charge; others are drawn again."""

_WIND_SERIES_DURATION_S = 60.0
_MAX_DRAW_ATTEMPTS = 20  # for each vehicle of the fleet


@dataclass(frozen=True, eq=False)
class Fleet:
    """Vehicles from which episodes draw, each with its hover state.

    Attributes
    ----------
    parameters : (k,) structured array of type :data:`~mufly.dynamics.PARAMETER_DTYPE`
    hover_states : (k, 21) array
        State of each vehicle in hover at the origin.
    hover_inputs : (k, 4) array
        Inputs of each vehicle in hover.
    nominal_hover_inputs : (4,) array
        Inputs of the nominal vehicle in hover.
    nominal_voltage_V : float
        Battery voltage of the nominal vehicle.
    vehicles : tuple of Vehicle
        The vehicles.
    wind_series_index : (k,) array
        Index of the wind that episodes of a vehicle have; -1: any.
    """

    parameters: NDArray[np.void]
    hover_states: _Array
    hover_inputs: _Array
    nominal_hover_inputs: _Array
    nominal_voltage_V: float
    vehicles: tuple[Vehicle, ...]
    wind_series_index: NDArray[np.int64]


def draw_random_fleet(vehicle: Vehicle, vary: Sequence[str], count: int, seed: int) -> Fleet:
    """Return ``count`` vehicles drawn around a vehicle; without ``vary`` the vehicle alone.

    Parameters
    ----------
    vehicle : Vehicle
    vary : sequence of str
        Variations as ``mufly monte-carlo --vary`` takes them, such as ``"parameters=10%"`` or ``"parameters=std"``.
    count : int
    seed : int

    Raises
    ------
    InputError
        If a variation cannot be read.
    MuflyError
        If nearly all drawn vehicles cannot hover.
    """
    variations, rng = parse_variations(vary, vehicle), np.random.default_rng(seed)
    nominal = find_trim(vehicle, charge=TRIM_CHARGE_FRACTION)
    made: list[tuple[np.void, _Array, _Array]] = []
    vehicles: list[Vehicle] = []
    refused = ""
    for _ in range(_MAX_DRAW_ATTEMPTS * count if variations else 1):
        try:
            drawn = vehicle
            for variation in variations:
                drawn = replace_parameters(drawn, variation.parameter_values(variation.draw_normalised_variables(rng)))
            hover = find_trim(drawn, charge=TRIM_CHARGE_FRACTION)
            weak = find_trim(drawn, charge=MIN_START_CHARGE)
        except (InputError, MuflyError) as error:
            refused = str(error)
            continue
        if variations and weak.motor_input.max() > MAX_TRIM_MOTOR_INPUT:
            refused = f"hover at half charge takes a motor input of {weak.motor_input.max():.2f}"
            continue
        made.append((model_parameters(drawn), hover.state, hover.input))
        vehicles.append(drawn)
        if len(made) == count or not variations:
            break
    else:
        raise MuflyError(f"only {len(made)} of {count} drawn vehicles can hover ({refused}); vary less")
    parameters = np.zeros(len(made), dtype=PARAMETER_DTYPE)
    states, inputs = np.zeros((len(made), STATE_SIZE)), np.zeros((len(made), 4))
    for k, (record, state, trim) in enumerate(made):
        parameters[k], states[k], inputs[k] = record, state, trim
    voltage = float(vehicle.battery.nominal_voltage)
    anyone = np.full(len(made), -1, dtype=np.int64)
    trim = np.asarray(nominal.input, dtype=np.float64)
    return Fleet(parameters, states, inputs, trim, voltage, tuple(vehicles), anyone)


def common_integration_step(fleet: Fleet, period_s: float) -> tuple[float, int]:
    """Return the longest step (s) that divides a period and is stable for all vehicles, and the steps per period.

    Raises
    ------
    MuflyError
        If a vehicle needs steps below a fiftieth of the default.
    """
    steps = [find_longest_stable_step(p) for p in fleet.parameters]
    longest = min(DEFAULT_STEP_S, *steps)
    if longest < DEFAULT_STEP_S / 50.0:
        slowest = fleet.parameters[int(np.argmin(steps))]
        raise MuflyError(f"a vehicle needs steps of {longest * 1e6:.2g} us because of its fastest mode, "
        f"{find_step_limiting_parameter(slowest)}")  # fmt: skip
    count = int(np.ceil(period_s / longest - 1e-9))
    return period_s / count, count


def draw_random_winds(wind_m_s: float, gust_m_s: float, period_s: float, count: int, seed: int) -> _Array:
    """Return ``count`` series of the air's velocity (count, samples, 3; N-E-D, m/s), one sample a period.

    Each has a steady level wind of random direction, at most ``wind_m_s``, and gusts of a standard deviation of at most
    ``gust_m_s``. Without both there is one series of still air.
    """
    samples = max(1, round(_WIND_SERIES_DURATION_S / period_s))
    if wind_m_s == 0.0 and gust_m_s == 0.0:
        return np.zeros((1, samples, 3))
    rng = np.random.default_rng([seed, 1])
    series = np.empty((count, samples, 3))
    for k in range(count):
        speed, direction, gust = wind_m_s * rng.random(), 2.0 * np.pi * rng.random(), gust_m_s * rng.random()
        steady = (speed * np.cos(direction), speed * np.sin(direction), 0.0)
        air = DrydenWind(steady, gust, step_s=period_s, seed=int(rng.integers(2**31)))
        series[k] = air.draw_wind_samples(samples)
    return series
