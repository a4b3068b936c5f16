"""Does the law in whole numbers hold what is promised? Flown, and on emulated processors without a floating unit."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import xarray as xr

from mufly.control import FlightController, design
from mufly.errors import MuflyError
from mufly.firmware.campaign import kept_flights
from mufly.firmware.checks import (
    PilResult,
    built,
    deepest_stack,
    emulated,
    missing_tools,
    outputs_of,
    run_program,
    size_of,
)
from mufly.firmware.fixed import FixedLaw, fixed_law
from mufly.firmware.integer_law import FixedFirmwareControllers, export_fixed
from mufly.firmware.tables import export
from mufly.flight import fly
from mufly.flight.controllers import Controllers
from mufly.mission import load_mission
from mufly.results import result
from mufly.toolchain import compiler
from mufly.vehicle import Vehicle

BOARDS = {
    "mps2-an385": ("cortex-m3", 40.0),
    "mps2-an386": ("cortex-m4", 40.0),
    "microbit": ("cortex-m0", 62.5),
}
"""Emulated boards: processor, and instructions between two ticks of their clocks (25, 25 and 16 MHz)."""

_FLAGS = ("-std=c99", "-O2", "-mthumb", "-ffreestanding", "-nostdlib", "-Ifixed", "-Icheck")


@result
class FixedFlight:
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


def fly_fixed(
    vehicle: Vehicle,
    missions: Sequence[str],
    *,
    flights: int = 1,
    law: FixedLaw | None = None,
    sensors: Literal["ideal", "fitted"] = "ideal",
    keep: Path | None = None,
    on_flight: Callable[[FixedFlight], None] | None = None,
) -> list[FixedFlight]:
    """Fly missions by the C code in whole numbers, and again by Python in double precision.

    Parameters
    ----------
    vehicle : Vehicle
    missions : sequence of str
    flights : int
        Of each, with seeds from 0 on; gusts of 0.3 m/s from the second on.
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
    controller = design(vehicle)
    numbers = law or fixed_law(controller)

    def one(name: str, seed: int) -> FixedFlight:
        mission = load_mission(name)
        kept: list[FixedFirmwareControllers] = []

        def make(c: FlightController) -> FixedFirmwareControllers:
            kept.append(FixedFirmwareControllers(c, numbers))
            return kept[-1]

        def flown(by: Callable[[FlightController], Controllers] | None) -> xr.Dataset:
            return fly(
                vehicle, mission, controller=controller, seed=seed, gust=0.3 if seed else None, sensors=sensors,
                controllers=by,
            )  # fmt: skip

        record, other = flown(make), flown(None)
        n = min(record.sizes["time"], other.sizes["time"])
        gap = record.truth_position.values[:n] - other.truth_position.values[:n]
        return FixedFlight(
            mission=mission.name or name, seed=seed, outcome=record.attrs["outcome"],
            periods=int(record.sizes["time"]), overflows=sum(c.overflows for c in kept),
            apart_m=float(np.sqrt((gap**2).sum(1)).max()),
        )  # fmt: skip

    asked = [(name, seed) for seed in range(flights) for name in missions]
    return kept_flights(FixedFlight, keep, asked, one, on_flight)


def pil_fixed(vehicle: Vehicle, *, timeout_s: float = 120.0) -> list[PilResult]:
    """Run the self-test of the law in whole numbers on this machine and on :data:`BOARDS`.

    Raises
    ------
    MuflyError
        If a tool is missing, or an emulated processor does not end.
    """
    absent = missing_tools()
    if absent:
        raise MuflyError(f"processor in the loop: {absent}")
    with tempfile.TemporaryDirectory(prefix="mufly-pil-") as temporary:
        folder = Path(temporary) / "fw"
        controller = design(vehicle)
        export(controller, folder)
        export_fixed(controller, folder)
        sources = sorted(str(p.relative_to(folder)) for p in (folder / "fixed").glob("*.c"))
        test = "check/selftest_fixed.c"
        built(
            [
                compiler(),
                "-std=c99",
                "-O2",
                "-Ifixed",
                "-Icheck",
                *sources,
                test,
                "check/platform_host.c",
                "-o",
                "selftest",
            ],
            folder,
        )
        right = outputs_of(run_program([str(folder / "selftest")], timeout_s))
        # The smallest of the boards has 16 kB; the others do with as much.
        script = (folder / "check" / "cortex_m4.ld").read_text().replace("LENGTH = 64K", "LENGTH = 16K")
        (folder / "check" / "small.ld").write_text(script)
        found = []
        for machine, (cpu, per_tick) in BOARDS.items():
            cc = ["arm-none-eabi-gcc", *_FLAGS, f"-mcpu={cpu}"]
            objects = folder / cpu
            objects.mkdir()
            for source in sources:
                name = Path(source).stem
                built(
                    [*cc, "-fstack-usage", "-fdump-rtl-expand", "-c", source, "-o", f"{cpu}/{name}.o",
                     "-dumpbase", name, "-dumpdir", f"{cpu}/"],
                    folder,
                )  # fmt: skip
            parts = sorted(str(p.relative_to(folder)) for p in objects.glob("*.o"))
            built(
                [
                    *cc,
                    *parts,
                    test,
                    "check/platform_cortex_m4.c",
                    "-T",
                    "check/small.ld",
                    "-o",
                    f"{cpu}.elf",
                    "-lgcc",
                ],
                folder,
            )
            flash, ram = size_of(objects)
            found.append(
                PilResult(
                    what="law",
                    machine=f"{machine} ({cpu})",
                    **emulated(machine, per_tick, folder / f"{cpu}.elf", right, timeout_s),
                    flash_bytes=flash, ram_bytes=ram, stack_bytes=deepest_stack(objects, "fixed_"),
                )
            )  # fmt: skip
    return found
