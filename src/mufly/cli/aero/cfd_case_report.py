"""Reports of solved cases: printed answers, and files and pictures in the case."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from mufly.cli.output import print_answer, save_figure, write_csv, write_records

if TYPE_CHECKING:
    from mufly.cfd import CfdSolution, PairSolution, SolutionReport
    from mufly.rotor import Rotor
    from mufly.rotor.structure.coupled_rounds import AeroelasticSolution


def report_case(folder: Path, rotor: Rotor | None, as_json: bool, rounds: AeroelasticSolution | None = None) -> bool:
    """Print a solution, and write its tables and pictures into the case; return whether the solution has settled.

    ``rounds`` are the rounds of solver and beam of an elastic blade; None for a rigid blade.
    """
    from mufly import cfd

    found = cfd.build_solution_report(folder, rotor, rounds)
    print_answer(as_json, found, files=_write_report_files(found, folder))
    return found.settled


def report_pair(folder: Path, rotor: Rotor | None, pair: PairSolution, as_json: bool) -> bool:
    """Print both rotors of a pair and their ratios, by CFD and by other methods; return whether the solution has
    settled.
    """
    from mufly import cfd

    found = cfd.build_pair_report(folder, rotor, pair)
    files = [
        save_figure(cfd.draw_pair_span_loads(pair), folder, "pair"),
        *_write_report_files(found.upper, folder / "upper"),
        *_write_report_files(found.lower, folder / "lower"),
    ]
    print_answer(as_json, found, files=files)
    return pair.settled


def report_climb_thrust(folder: Path, rotor: Rotor | None, solutions: list[CfdSolution], as_json: bool) -> None:
    """Print, write and draw the thrust over the climb velocity."""
    from mufly.cfd import compare_climbs, draw_climb_comparison
    from mufly.vehicle import load_coefficient_map

    found = compare_climbs(solutions, rotor, load_coefficient_map("walkera-5g6-bemt"))
    table = write_records(folder / "inflow.csv", found.tabulate_points())
    print_answer(as_json, found, files=[table, save_figure(draw_climb_comparison(found), folder, "inflow")])


def _write_report_files(found: SolutionReport, case: Path) -> list[Path]:
    """Write the tables, pictures and surfaces of a report into the results of its case."""
    place = case / "results"
    return [
        *(write_csv(place / f"{name}.csv", heads, rows) for name, heads, rows in found.list_tables()),
        *(save_figure(picture, place, name) for name, picture in found.draw_pictures()),
        *found.write_surfaces(place),
    ]
