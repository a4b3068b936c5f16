"""Fly the fixed-point law and compare the flights with those in double precision."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from mufly.control import FlightController, design_flight_controller
from mufly.firmware.compiled_software import GenericFirmwareSoftware
from mufly.firmware.fixed_point.fixed_point_design import FixedPointLaw, quantise_law
from mufly.firmware.fixed_point.fixed_point_law import FixedPointFirmwareControllers
from mufly.firmware.proof.proof_flights import draw_wind_and_fault, resume_flights
from mufly.flight import fly_mission
from mufly.mission import load_mission
from mufly.results import ResultColumn, ShownBlock, result, tabulate_results
from mufly.vehicle import Vehicle


@result
class FixedPointFlightComparison:
    """Comparison of two flights of a mission: one with the exported fixed-point law, the other in double precision.

    Attributes
    ----------
    mission : str
    seed : int
    outcome : str
    periods : int
    overflows : int
        Number of 32-bit overflows.
    max_distance_m : float
        Largest distance of the two flights at the same time (m).
    """

    mission: str
    seed: int
    outcome: str
    periods: int
    overflows: int
    max_distance_m: float


@result
class FixedPointFlights:
    """Flights with the fixed-point law, compared with those in double precision.

    Attributes
    ----------
    flights : list of FixedPointFlightComparison
    """

    flights: list[FixedPointFlightComparison]

    def make_printed_blocks(self) -> list[ShownBlock]:
        """Return the flights as printed text."""
        distance = ResultColumn("max_distance_m", "mm", ".1f", "distance from double precision")
        return [tabulate_results(self.flights, ("mission", "seed", "outcome", "periods", "overflows", distance))]


def compare_fixed_point_flights(
    vehicle: Vehicle,
    missions: Sequence[str],
    *,
    flights: int = 1,
    law: FixedPointLaw | None = None,
    keep: Path | None = None,
    on_flight: Callable[[FixedPointFlightComparison], None] | None = None,
) -> FixedPointFlights:
    """Fly missions with the fixed-point C code, and again in double precision.

    Parameters
    ----------
    vehicle : Vehicle
    missions : sequence of str
    flights : int
        Number of flights of each mission, with seeds from 0; all but the first in random wind and gusts.
    law : FixedPointLaw, optional
    keep : path, optional
        File of results; stored flights are not repeated.
    on_flight : callable, optional
        Called with every result.

    Raises
    ------
    MuflyError
        If there is no C compiler.
    """
    controller = design_flight_controller(vehicle)
    numbers = law or quantise_law(controller)

    def fly_both_precisions(name: str, seed: int) -> FixedPointFlightComparison:
        mission = load_mission(name)
        kept: list[FixedPointFirmwareControllers] = []

        def make_controllers(c: FlightController) -> FixedPointFirmwareControllers:
            kept.append(FixedPointFirmwareControllers(c, numbers))
            return kept[-1]

        met = draw_wind_and_fault(seed)
        wind, gust = ([met.wind, 0.0, 0.0], met.gust) if seed else (None, None)

        def fly_with(by: Any) -> xr.Dataset:
            return fly_mission(vehicle, mission, controller=controller, seed=seed, wind=wind, gust=gust, controllers=by)

        record, other = fly_with(make_controllers), fly_with(GenericFirmwareSoftware)
        n = min(record.sizes["time"], other.sizes["time"])
        gap = record.truth_position.values[:n] - other.truth_position.values[:n]
        return FixedPointFlightComparison(
            mission=mission.name or name, seed=seed, outcome=record.attrs["outcome"],
            periods=int(record.sizes["time"]), overflows=sum(c.overflow_count for c in kept),
            max_distance_m=float(np.sqrt((gap**2).sum(1)).max()),
        )  # fmt: skip

    asked = [(name, seed) for seed in range(flights) for name in missions]
    return FixedPointFlights(resume_flights(FixedPointFlightComparison, keep, asked, fly_both_precisions, on_flight))
