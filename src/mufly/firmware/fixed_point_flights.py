"""Does the law in whole numbers hold what is promised? Flown beside the one in double precision."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import xarray as xr

from mufly.control import FlightController, design_flight_controller
from mufly.firmware.compiled_software import GenericFirmwareSoftware
from mufly.firmware.fixed_point_design import FixedPointLaw, quantise_law
from mufly.firmware.fixed_point_law import FixedPointFirmwareControllers
from mufly.firmware.proof_flights import draw_conditions, resume_flights
from mufly.flight import fly_mission
from mufly.mission import load_mission
from mufly.results import result
from mufly.vehicle import Vehicle


@result
class FixedPointFlight:
    """A flight by the exported law in whole numbers, beside the one in double precision.

    Attributes
    ----------
    mission : str
    seed : int
    outcome : str
    periods : int
    overflows : int
        Numbers that did not fit 32 bits.
    apart_m : float
        Greatest distance of the two flights at the same time.
    """

    mission: str
    seed: int
    outcome: str
    periods: int
    overflows: int
    apart_m: float


def fly_fixed_point(
    vehicle: Vehicle,
    missions: Sequence[str],
    *,
    flights: int = 1,
    law: FixedPointLaw | None = None,
    sensors: Literal["ideal", "fitted"] = "ideal",
    keep: Path | None = None,
    on_flight: Callable[[FixedPointFlight], None] | None = None,
) -> list[FixedPointFlight]:
    """Fly missions by the C code in whole numbers, and again by Python in double precision.

    Parameters
    ----------
    vehicle : Vehicle
    missions : sequence of str
    flights : int
        Of each, with seeds from 0 on; in wind and gusts by the seed from the second on.
    law : FixedLaw, optional
    sensors : str
        ``"ideal"`` or ``"fitted"``.
    keep : path, optional
        Where results are kept; what is there is not flown again.
    on_flight : callable, optional
        Told every result.

    Raises
    ------
    MuflyError
        If there is no C compiler.
    """
    controller = design_flight_controller(vehicle)
    numbers = law or quantise_law(controller)

    def fly_pair(name: str, seed: int) -> FixedPointFlight:
        mission = load_mission(name)
        kept: list[FixedPointFirmwareControllers] = []

        def make(c: FlightController) -> FixedPointFirmwareControllers:
            kept.append(FixedPointFirmwareControllers(c, numbers))
            return kept[-1]

        met = draw_conditions(seed)
        wind, gust = ([met.wind, 0.0, 0.0], met.gust) if seed else (None, None)

        def flown(by: Any) -> xr.Dataset:
            return fly_mission(
                vehicle, mission, controller=controller, seed=seed, wind=wind, gust=gust, sensors=sensors,
                controllers=by,
            )  # fmt: skip

        record, other = flown(make), flown(GenericFirmwareSoftware)
        n = min(record.sizes["time"], other.sizes["time"])
        gap = record.truth_position.values[:n] - other.truth_position.values[:n]
        return FixedPointFlight(
            mission=mission.name or name, seed=seed, outcome=record.attrs["outcome"],
            periods=int(record.sizes["time"]), overflows=sum(c.overflow_count for c in kept),
            apart_m=float(np.sqrt((gap**2).sum(1)).max()),
        )  # fmt: skip

    asked = [(name, seed) for seed in range(flights) for name in missions]
    return resume_flights(FixedPointFlight, keep, asked, fly_pair, on_flight)
