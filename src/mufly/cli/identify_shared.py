"""What the commands of identification share: options, numbers with a doubt, tables, vehicle files, places to write."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mufly.cli.options import console, print_table

if TYPE_CHECKING:
    from mufly.identify import Estimate
    from mufly.vehicle import Vehicle

__all__ = [
    "ColumnsOption",
    "PictureOption",
    "VehicleOption",
    "WriteOption",
    "check_file",
    "check_folder",
    "print_estimates",
    "say",
    "start_vehicle",
    "today",
    "with_doubt",
    "write_vehicle",
]

ColumnsOption = Annotated[
    str | None,
    typer.Option(
        "--columns", metavar="OLD=NEW,...", help="What headers mean, as 'RPM=speed_upper_rpm,T_B(N)=thrust_upper_N'."
    ),
]  # fmt: skip
VehicleOption = Annotated[
    str | None,
    typer.Option("--vehicle", metavar="NAME|FILE", help="Vehicle to start from and to compare with."),
]
WriteOption = Annotated[
    Path | None,
    typer.Option(
        "--write", metavar="FILE", help="Write --vehicle with what was found, source 'identified', as a new file."
    ),
]  # fmt: skip


PictureOption = Annotated[
    Path | None, typer.Option("--out", metavar="DIR", help="Write a picture (PNG) of points and fit there.")
]


def check_folder(option: str, folder: Path | None) -> None:
    """Make a folder that results will go to, so that a long fit does not end without a place for them.

    Raises
    ------
    InputError
        If it cannot be made or written to.
    """
    from mufly.errors import InputError

    if folder is None:
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            option, str(folder), f"cannot be made ({error.strerror})", "give another folder"
        ) from error
    if not os.access(folder, os.W_OK):
        raise InputError(option, str(folder), "cannot be written to", "give another folder")


def check_file(option: str, file: Path | None) -> None:
    """Look whether a file can be written, before the work that fills it.

    Raises
    ------
    InputError
        If its folder is not there, or either may not be written.
    """
    from mufly.errors import InputError

    if file is None:
        return
    if file.is_dir():
        raise InputError(option, str(file), "is a folder", "give the name of a file")
    if not file.parent.is_dir():
        raise InputError(option, str(file), "its folder is not there", "make it, or give another place")
    if not os.access(file if file.exists() else file.parent, os.W_OK):
        raise InputError(option, str(file), "cannot be written", "give another place")


def with_doubt(option: str, text: str | None, *, above: float = 0.0) -> tuple[float | None, float]:
    """Return value and standard deviation of ``"0.84"`` or ``"0.84+-0.02"``; None for None or ``"free"``.

    Raises
    ------
    InputError
        If the text is no number above the limit.
    """
    from mufly.errors import InputError

    if text is None or text == "free":
        return None, 0.0
    first, _, second = text.replace("±", "+-").partition("+-")
    try:
        value, std = float(first), float(second or 0.0)
    except ValueError:
        raise InputError(option, "", f"{text!r} is no number", "write 0.84 or 0.84+-0.02") from None
    if not (math.isfinite(value) and value > above and math.isfinite(std) and std >= 0):
        raise InputError(option, "", f"{text} is not possible", f"give a number above {above:g}")
    return value, std


def print_estimates(
    estimates: Iterable[Estimate], title: str, shares: dict[str, float] | None = None
) -> None:
    """Print a table of estimates with intervals."""
    rows = []
    for e in estimates:
        start = "-" if math.isnan(e.start) else f"{e.start:.4g}"
        if math.isinf(e.std):
            value, interval, doubt = "not seen", "-", "-"
        elif e.at_bound:
            value, interval, doubt = f"{e.value:.5g}", "at its bound", "-"
        else:
            value, interval = f"{e.value:.5g}", f"{e.low:.4g} to {e.high:.4g}"
            doubt = f"{100 * e.std / abs(e.value):.2g} %" if e.value else "-"
        row = [e.symbol, value, doubt, interval, e.unit if e.unit != "1" else "", start]
        rows.append(row if shares is None else [*row, f"{100 * shares.get(e.symbol, 0.0):.0f} %"])
    heads = ["symbol", "value", "std", "95 % interval", "unit", "start"]
    print_table(heads if shares is None else [*heads, "systematic"], rows, title=title)


def say(lines: Iterable[str], *, mark: str = "") -> None:
    """Print lines without markup."""
    out = console()
    for line in lines:
        out.print(f"{mark}: {line}" if mark else line, highlight=False, markup=False)


def start_vehicle(name: str | None, write: Path | None) -> Vehicle | None:
    """Return the vehicle of ``--vehicle``; InputError for ``--write`` without it."""
    from mufly.errors import InputError
    from mufly.vehicle import load_vehicle

    if name is None and write is not None:
        raise InputError(
            "--write", str(write), "needs a vehicle to start from", "add --vehicle mufly-1.1 or a file"
        )
    check_file("--write", write)
    return None if name is None else load_vehicle(name)


def write_vehicle(
    start: Vehicle | None, estimates: Iterable[Estimate], write: Path | None, note: str
) -> list[Path]:
    """Write the vehicle with its estimates where ``--write`` says; return the files written."""
    from mufly.errors import InputError
    from mufly.identify.written import with_estimates
    from mufly.vehicle import vehicle_toml

    if write is None or start is None:
        return []
    text = vehicle_toml(with_estimates(start, estimates, note))
    try:
        write.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(
            "--write", str(write), f"cannot be written ({error})", "give another place"
        ) from error
    return [write]


def today() -> str:
    """Return the date, for notes in vehicle files."""
    return time.strftime("%Y-%m-%d")
