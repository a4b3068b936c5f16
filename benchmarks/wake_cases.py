"""What validate_wake.py, validate_wake_pairs.py and wake_study.py share: solved wakes that are kept, and tables.

With a folder, every solved case is written there and read again by the next run, so that a stopped run loses nothing.
The folder knows the question, not the program: empty it after the wake method has changed.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from figure_record import RECORD_HELP
from rotor_cases import blading_of

from mufly.answer_store import hash_question, read_answer, write_answer
from mufly.errors import MuflyError
from mufly.rotor import (
    Air,
    Blading,
    OperatingCondition,
    RotorSystem,
    SystemSolution,
    compute_polars,
    prepare_blading,
    replace_rotor,
    solve_system,
)
from mufly.rotor.wake import WakeSettings
from mufly.study.benchmark import RotorCase

RPM = np.pi / 30


@dataclass(frozen=True)
class Answer:
    """A solved case: thrust (N), torque (N m) and speed (rad/s) of each rotor, and how the solution went.

    ``wobble`` is half the range of the loads over the last iterations, over their mean; ``core_limit`` the core of old
    wakes over R, which the solver raises where a wake does not settle.
    """

    thrust: tuple[float, ...]
    torque: tuple[float, ...]
    speed: tuple[float, ...]
    converged: bool
    iterations: int
    residual: float
    seconds: float
    wobble: float = np.nan
    core_limit: float = np.nan

    def mark(self) -> str:
        """Return (*) for a solution that did not converge, (c) for one that needed thicker cores than the first."""
        if not self.converged:
            return " (*)"
        return " (c)" if self.core_limit > (0.15 if len(self.thrust) == 1 else 0.2) else ""


FAILED = Answer((np.nan,) * 2, (np.nan,) * 2, (np.nan,) * 2, False, 0, np.nan, 0.0)


class Solver:
    """Solves cases, each from the last wake of the same family; keeps the answers."""

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = folder
        self.wakes: dict[str, SystemSolution] = {}
        self.broken: list[str] = []

    def _kept(self, question: object, family: str, solved: Callable[[], SystemSolution]) -> Answer:
        key = hash_question(question)
        path = self.folder and self.folder / f"{key[:24]}.json"
        kept = read_answer(path, key) if path else None
        if kept is not None:
            return Answer(**{k: tuple(v) if isinstance(v, list) else v for k, v in kept.items()})
        begin = time.perf_counter()
        try:
            found = solved()
        except MuflyError as error:
            self.broken.append(f"{question}: {error}")
            return FAILED
        rotors = found.rotors
        assert found.settings is not None
        answer = Answer(
            tuple(r.thrust_N for r in rotors), tuple(r.torque_Nm for r in rotors),
            tuple(r.speed_rad_s for r in rotors), found.converged, found.iterations, found.residual,
            time.perf_counter() - begin, _wobble(found), float(found.settings.core_limit or 0.0),
        )  # fmt: skip
        if found.converged:
            self.wakes[family] = found
        else:
            self.broken.append(f"{question}: {found.message}")
        if path:
            write_answer(path, key, asdict(answer))
        print(f"  {family} {answer.iterations} iterations, {answer.seconds:.1f} s", file=sys.stderr)
        return answer

    def single(
        self,
        case: RotorCase,
        pitch: float,
        speed: float,
        *,
        n_crit: float = 0.1,
        cutout: float | None = None,
        panels: int | None = None,
        settings: WakeSettings | None = None,
        warm: bool = False,
    ) -> Answer:
        """One measured rotor; rad, rad/s; from nothing unless ``warm``: no order of cases matters."""
        how = settings or WakeSettings()
        question = ("single", case.name, pitch, speed, n_crit, cutout, panels, asdict(how), asdict(case.air))

        def solved() -> SystemSolution:
            rotor = laid_out(case, n_crit, cutout, panels)
            start = self.wakes.get(case.name) if warm else None
            point = OperatingCondition(pitch, speed, air=case.air)
            return solve_system(RotorSystem.single_rotor(rotor), point, "wake", settings=how, start=start)

        return self._kept(question, case.name, solved)

    def pair(
        self,
        name: str,
        rotor: Blading,
        *,
        spacing: float,
        pitch: tuple[float, float],
        speed: tuple[float, float],
        air: Air,
        n_crit: float = 0.1,
        settings: WakeSettings | None = None,
        warm: bool = True,
    ) -> Answer:
        """Two rotors alike; (upper, lower), rad and rad/s."""
        how = settings or WakeSettings()
        question = ("pair", name, spacing, pitch, speed, asdict(air), n_crit, asdict(how))

        def solved() -> SystemSolution:
            both = RotorSystem.coaxial_pair(rotor, rotor, spacing_m=spacing)
            start = self.wakes.get(name) if warm else None
            return solve_system(both, OperatingCondition(pitch, speed, air=air), "wake", settings=how, start=start)

        return self._kept(question, name, solved)

    def balanced(
        self,
        name: str,
        rotor: Blading,
        *,
        spacing: float,
        pitch: tuple[float, float],
        upper_speed: float,
        air: Air,
    ) -> Answer:
        """Two rotors alike at the lower speed that balances the torques."""
        question = ("balanced", name, spacing, pitch, upper_speed, asdict(air))

        def solved() -> SystemSolution:
            both = RotorSystem.coaxial_pair(rotor, rotor, spacing_m=spacing)
            return solve_system(
                both,
                OperatingCondition(pitch, (upper_speed, None), air=air),
                "wake",
                start=self.wakes.get(name),
            )

        return self._kept(question, name, solved)


def _wobble(found: SystemSolution, last: int = 60) -> float:
    loads = found.history[-min(last, max(10, len(found.history) // 2)) :, 1:]
    return float(np.max(np.ptp(loads, axis=0) / 2 / np.abs(loads.mean(axis=0))))


def laid_out(case: RotorCase, n_crit: float, cutout: float | None, panels: int | None) -> Blading:
    """A case with another hub cut-out or another number of panels."""
    rotor = case.rotor if cutout is None else replace_rotor(case.rotor, {"hub_cutout": cutout})
    tables = compute_polars(list(rotor.airfoil_names()), n_crit=n_crit)
    return prepare_blading(rotor, tables, stations=panels or case_stations(case))


def case_stations(case: RotorCase) -> int:
    """Stations that a case is laid out with by default."""
    return int(blading_of(case).r_m.shape[1])


def percent(ours: float, theirs: float) -> str:
    """Return the deviation of ours from theirs."""
    return f"{100 * (ours / theirs - 1):+.1f}"


def table(title: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a Markdown table."""
    print(f"**{title}**\n")
    print("| " + " | ".join(head) + " |")
    print("|" + "---|" * len(head))
    for row in rows:
        print("| " + " | ".join(row) + " |")
    print(flush=True)


def arguments(doc: str | None, parts: Sequence[str]) -> argparse.Namespace:
    """Read the command line that the scripts share."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(parts)}; default: all")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep solved cases there, and read them again")
    parser.add_argument("--record", action="store_true", help=RECORD_HELP)
    args = parser.parse_args()
    unknown = sorted(set(args.parts) - set(parts))
    if unknown:
        parser.error(f"{', '.join(unknown)}: no part; use {', '.join(parts)}")
    args.parts = args.parts or list(parts)
    return args


def farewell(solver: Solver) -> None:
    """Say what did not converge."""
    print("(c): converged with a thicker core of old wakes than the default's first.")
    print("Every case converged." if not solver.broken else "(*) not converged:")
    for line in solver.broken:
        print("  " + line[-300:])
