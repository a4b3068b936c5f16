"""``mufly identify demo``: a known vehicle flown, forgotten and found again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mufly.cli.identify_flight import estimate_row, fit_progress, one_of, print_rest, written_report
from mufly.cli.identify_shared import check_folder
from mufly.cli.options import JsonOption, console, print_json, print_table

if TYPE_CHECKING:
    from mufly.identify import Demo

__all__ = ["add_to"]


def add_to(app: typer.Typer) -> None:
    """Register the command with the group ``mufly identify``."""
    app.command("demo")(demo)


def demo(
    seed: Annotated[int, typer.Option(metavar="K", help="Of pilot, noise and starts.", min=0)] = 0,
    method: Annotated[str, typer.Option(metavar="NAME", help="lm or cma.")] = "lm",
    report: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write report.html with its pictures there.")
    ] = None,
    logs: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write the five flights there (MCAP), for `identify flight`.")
    ] = None,
    as_json: JsonOption = False,
) -> None:  # fmt: skip
    """Fly a known vehicle with pilot support, chirps, noise and radio delay; identify it; compare with the truth.

    Twelve parameters start 50 % off. Example: mufly identify demo --seed 3 --report report
    """
    from mufly.identify import run_demo

    one_of("--method", method, ("lm", "cma"))
    check_folder("--report", report)
    check_folder("--logs", logs)
    if logs is not None:
        _write_flights(logs, seed)
    with fit_progress(not as_json) as on_progress:
        shown = run_demo(seed=seed, method=method, on_progress=on_progress)  # type: ignore[arg-type]
    page = written_report(shown.fit, report, not as_json)
    if as_json:
        print_json(shown.as_dict())
        return
    _print_demo(shown)
    if page is not None:
        console().print(f"Report: {page}", highlight=False)


def _write_flights(folder: Path, seed: int) -> None:
    from mufly.identify.demo_flight import demo_flights
    from mufly.identify.record import dataset_of
    from mufly.logs import write_log
    from mufly.vehicle import load_vehicle

    fit, held = demo_flights(load_vehicle("mufly-1.1"), seed=seed)
    for r in (*fit, *held):
        write_log(dataset_of(r), folder / f"{r.name}.mcap")


def _print_demo(shown: Demo) -> None:
    inside = shown.inside()
    rows = []
    for e in shown.fit.estimates:
        true = shown.truth[e.symbol]
        off = f"{100 * (e.value / true - 1):+.2f} %"
        rows.append(
            (
                *estimate_row(e)[:4],
                f"{true:.5g}",
                off,
                *estimate_row(e)[5:7],
                "" if inside[e.symbol] else "outside",
            )
        )
    heads = ("parameter", "unit", "start", "estimate", "truth", "off", "95 % from", "to", "")
    print_table(heads, rows, title=f"Demonstration, seed {shown.seed}", text=(0, 1, 8))
    print_rest(shown.fit)
    say = console().print
    say(
        f"{sum(inside.values())} of {len(inside)} intervals hold the truth; prediction error of the flight that was "
        f"not fitted is {shown.held_out_over_noise:.3f} of the sensors' noise.",
        highlight=False,
    )
