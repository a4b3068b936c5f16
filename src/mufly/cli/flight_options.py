"""What the commands that fly share: air, seed, and the folder for the results. Loads nothing heavy."""

from __future__ import annotations

import os
from datetime import datetime
from pathlib import Path

from mufly.errors import InputError

__all__ = ["check_air", "check_folder", "dated_folder", "wind_of"]


def wind_of(text: str | None) -> list[float] | None:
    """Wind N, E, D (m/s) from ``--wind``; None without it."""
    if text is None:
        return None
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 3 or not all(abs(n) < 50.0 for n in numbers):
        raise InputError("--wind", "", f"{text!r} is no wind", "give N,E,D in m/s, as in 0.5,0,0")
    return numbers


def check_air(gust: float | None, seed: int) -> None:
    """Refuse gusts and seeds that are none."""
    if gust is not None and not 0.0 <= gust <= 5.0:
        raise InputError("--gust", "", f"{gust:g} m/s is no gust", "give 0 to 5 m/s")
    if not 0 <= seed < 2**63:
        raise InputError("--seed", "", f"{seed} is no seed", "give a whole number from 0 to 2^63 - 1")


def check_folder(folder: Path) -> None:
    """Refuse a folder that cannot be made or written, without making it yet."""
    try:
        nearest = next(p for p in (folder, *folder.absolute().parents) if p.exists())
    except OSError as error:
        shown = str(folder) if len(str(folder)) < 60 else f"{str(folder)[:57]}..."
        raise InputError("--out", "", f"{shown}: {error.strerror}", "name another folder") from None
    if not nearest.is_dir():
        raise InputError("--out", "", f"{nearest} is a file", "name a folder")
    if not os.access(nearest, os.W_OK | os.X_OK):
        raise InputError("--out", "", f"{nearest} cannot be written", "name a folder that can")


def dated_folder() -> Path:
    """``flights/<date-time>``, which does not exist yet."""
    base = Path("flights") / datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
    folder, n = base, 1
    while folder.exists():
        n += 1
        folder = base.with_name(f"{base.name}_{n}")
    return folder
