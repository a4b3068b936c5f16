"""Solved cases beside a table of measurements and of others' computations."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path

from mufly.cfd.case import Point, read_point
from mufly.cfd.run import Verdict, judge
from mufly.errors import InputError
from mufly.results import result
from mufly.units import RPM


@result
class Compared:
    """One case beside its row of a table.

    Attributes
    ----------
    case : str
    point : Point
    verdict : Verdict
    thrust, torque : dict of str to float
        Ours over the table's, less 1, by the column's name without ``T_`` or ``Q_`` and unit.
    """

    case: str
    point: Point
    verdict: Verdict
    thrust: dict[str, float]
    torque: dict[str, float]


def compare(table: Path, cases: Sequence[Path]) -> list[Compared]:
    """Lay cases beside the rows of a table with the same pitch (to 0.05 degrees) and speed (to 0.5 %).

    Parameters
    ----------
    table : Path
        CSV with ``pitch_deg``, ``rpm`` and columns ``T_...`` (N) and ``Q_...`` (N m); # begins a note.
    cases : sequence of Path

    Raises
    ------
    InputError
        If the table cannot be read or lacks a column, a case is none, or no row is at a case's point.
    """
    try:
        lines = [
            x for x in table.read_text(encoding="utf-8").splitlines() if x.strip() and not x.startswith("#")
        ]
    except OSError as error:
        raise InputError(str(table), "", f"cannot be read ({error.strerror})", "give a CSV file") from error
    rows = list(csv.DictReader(lines))
    for key in ("pitch_deg", "rpm"):
        if not rows or key not in rows[0]:
            raise InputError(str(table), key, "is missing", "give columns pitch_deg, rpm, T_... and Q_...")
    out = []
    for case in cases:
        point = read_point(case)
        pitch, rpm = math.degrees(point.pitch_rad), point.speed_rad_s / RPM
        verdict = judge(case)
        for i, row in enumerate(rows):
            try:
                values = {k: float(v) for k, v in row.items() if k and v}
            except ValueError as error:
                raise InputError(str(table), f"row {i + 1}", str(error), "give numbers") from error
            if abs(values["pitch_deg"] - pitch) < 0.05 and abs(values["rpm"] / rpm - 1.0) < 5e-3:
                break
        else:
            raise InputError(
                str(table), "", f"has no row at {pitch:.3g} degrees and {rpm:.0f} rpm", f"leave {case} out"
            )
        beside = [
            {
                k.removeprefix(letter).removesuffix(unit): ours / v - 1.0
                for k, v in values.items()
                if k.startswith(letter)
            }
            for letter, unit, ours in (("T_", "_N", verdict.thrust_N), ("Q_", "_Nm", verdict.torque_Nm))
        ]
        out.append(Compared(str(case), point, verdict, beside[0], beside[1]))
    return out
