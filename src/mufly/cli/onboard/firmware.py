"""``mufly firmware``: the control law as C99, exported, and proved equal to the simulation's."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mufly.cli.options import Commands, JsonOption, argument, option
from mufly.cli.present import answer, print_json, print_table, progress_bar, say, tell_files, writing

if TYPE_CHECKING:
    from mufly.firmware import PilResult, SilResult

app = Commands(
    help="The control law as C99 for a board: exported with a vehicle's numbers, flown, proved equal "
    "(docs/firmware.md).",
    no_args_is_help=True,
)

_VehicleOption = Annotated[
    str, option("--vehicle NAME|FILE", "A built-in vehicle, or a vehicle file (TOML).")
]


@app.command()
def export(
    out: Annotated[Path, option("--out DIR", "A new or empty folder, or one of an earlier export.")],
    vehicle: _VehicleOption = "mufly-1.1",
    as_json: JsonOption = False,
) -> None:
    """Write the controllers of a vehicle as C99, with Makefile, CMake file, self-test and a README.

    The algorithms are the same for every vehicle; tables.c holds its numbers.

    Example: mufly firmware export --vehicle mine.toml --out fw, then make -C fw check
    """
    from mufly import firmware
    from mufly.control import design
    from mufly.vehicle import load_vehicle

    controller = design(load_vehicle(vehicle))
    with writing(out):
        files = firmware.export(controller, out)
    if as_json:
        print_json({"files": [str(f) for f in files]})
        return
    tell_files([out])
    say(
        f"{len(files)} files for {controller.vehicle_name}: try `make -C {out} check`, read {out / 'README.md'}."
    )


@app.command()
def sil(
    missions: Annotated[
        list[str] | None,
        argument("[MISSION]...", "Built-in missions or files; both built-in ones by default."),
    ] = None,
    vehicle: _VehicleOption = "mufly-1.1",
    flights: Annotated[int, option("N", "Of each mission, with seeds from 0 on.", min=1)] = 1,
    wind: Annotated[
        float | None, option("--wind M/S", "Steady wind from the south.", min=-5.0, max=5.0)
    ] = None,
    gust: Annotated[float | None, option("--gust M/S", "Gusts.", min=0.0, max=3.0)] = None,
    as_json: JsonOption = False,
) -> None:
    """Fly missions in Python and compare the exported code, bit by bit, in every period (software in the loop).

    Needs a C compiler. Ends with status 1 if a bit differs.
    """
    from mufly.firmware import sil as compare
    from mufly.vehicle import load_vehicle

    names = missions or ["demonstration", "box-on-leg"]
    done = 0
    with progress_bar("flights", not as_json) as progress:

        def flown(_: SilResult) -> None:
            nonlocal done
            done += 1
            if progress is not None:
                progress(done, len(names) * flights)

        results = compare(
            load_vehicle(vehicle), names, flights=flights, wind=wind, gust=gust, on_flight=flown
        )
    answer(as_json, lambda: {"flights": results}, lambda: _print_sil(results))
    if any(r.different for r in results):
        raise typer.Exit(1)


def _print_sil(results: list[SilResult]) -> None:
    print_table(
        ("mission", "seed", "outcome", "periods", "differ", "single precision off by"),
        [
            (r.mission, str(r.seed), r.outcome, str(r.periods), str(r.different), f"{r.worst_single:.1e}")
            for r in results
        ],
        text=(0, 2),
    )
    periods, off = sum(r.periods for r in results), sum(r.different for r in results)
    if off:
        say(f"{off} of {periods} periods differ: the exported code is not what was flown.", style="red")
    else:
        say(
            f"No bit differs in {periods} periods. Single precision: greatest difference over an actuator's range."
        )


@app.command()
def pil(vehicle: _VehicleOption = "mufly-1.1", as_json: JsonOption = False) -> None:
    """Run the self-test on emulated Cortex-M4 processors and compare it with this machine (processor in the loop).

    Needs a C compiler, arm-none-eabi-gcc and qemu-system-arm. Ends with status 1 if a bit differs.
    """
    from mufly.firmware import pil as emulate
    from mufly.vehicle import load_vehicle

    results = emulate(load_vehicle(vehicle))
    answer(as_json, lambda: {"processors": results}, lambda: _print_pil(results))
    if not all(r.same for r in results):
        raise typer.Exit(1)


def _print_pil(results: list[PilResult]) -> None:
    print_table(
        ("emulated", "outputs", "instructions a period", "worst", "flash (B)", "stack (B)"),
        [
            (
                r.machine, "the same" if r.same else "differ", f"{r.mean_instructions:.0f}",
                f"{r.worst_instructions:.0f}", str(r.flash_bytes), str(r.stack_bytes),
            )
            for r in results
        ],
        text=(0, 1),
    )  # fmt: skip
    say("Single precision, gcc -O2. Flash: code and numbers of the controllers; stack: deepest call of them.")
