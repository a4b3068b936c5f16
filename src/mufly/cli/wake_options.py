"""Options and progress of commands that can use the wake method."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from mufly.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from mufly.rotor.wake import WakeSettings

__all__ = [
    "MethodOption",
    "WakeOption",
    "WakeProgress",
    "WakeSetOption",
    "wake_of",
    "wake_progress",
    "write_history",
]

MethodOption = Annotated[
    str, typer.Option("--method", metavar="NAME", help="'bemt' (blade elements) or 'wake' (vortices, seconds).")
]  # fmt: skip
WakeOption = Annotated[
    str, typer.Option("--wake", metavar="NAME", help="'free', or 'prescribed' (Landgrebe's shape, for slender blades).")
]  # fmt: skip
WakeSetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--wake-set", metavar="NAME=VALUE",
        help="A setting of the wake, as step_deg=10, turns=6, core=0.05, iterations=300; or stations=30 a blade.",
    ),
]  # fmt: skip

_WHOLE = ("phases", "iterations", "stations")


def wake_of(method: str, wake: str, settings: list[str] | None) -> tuple[WakeSettings, int]:
    """Settings of the wake and stations along a blade, from ``--method``, ``--wake`` and ``--wake-set``.

    Raises
    ------
    InputError
        If one of them is unknown or impossible.
    """
    from mufly.rotor.blading import STATIONS
    from mufly.rotor.wake import WakeSettings
    from mufly.study import METHODS

    if method not in METHODS:
        raise InputError("--method", "", f"{method!r} is unknown", f"use one of: {', '.join(METHODS)}")
    if wake not in ("free", "prescribed"):
        raise InputError("--wake", "", f"{wake!r} is unknown", "use free or prescribed")
    if method == "bemt" and wake != "free":
        raise InputError("--wake", "", "there is no wake in blade element theory", "add --method wake")
    known = [f.name for f in fields(WakeSettings) if f.name not in ("model", "inviscid")]
    given: dict[str, Any] = {}
    for text in settings or []:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not equals or name not in (*known, "stations"):
            raise InputError(
                "--wake-set", text, "is no setting", f"use NAME=VALUE with {', '.join(known)}, stations"
            )
        try:
            given[name] = int(value) if name in _WHOLE else float(value)
        except ValueError:
            raise InputError("--wake-set", text, f"{value!r} is no number", "give a number") from None
    stations = given.pop("stations", STATIONS)
    if not 4 <= stations <= 200:
        raise InputError("--wake-set", "stations", f"is {stations}", "give 4 to 200")
    return WakeSettings(model=wake, **given), stations  # type: ignore[arg-type]


class WakeProgress:
    """What the iterations of a wake, or of several in turn, told so far; call it with each."""

    def __init__(self, show: Callable[[str], None] | None = None) -> None:
        self.rows: list[tuple[int, int, float, float]] = []  # wake, iteration, residual, thrust
        self.wakes = 0
        self._show = show

    def __call__(self, iteration: int, residual: float, thrust: float) -> None:
        """Take one iteration in."""
        self.wakes += iteration == 1
        self.rows.append((self.wakes, iteration, residual, thrust))
        if self._show is not None:
            # A residual above 9 marks the first turns of a free wake, held in the prescribed shape.
            miss = "still prescribed" if residual > 9.0 else f"misses the air by {100 * residual:.2g} %"
            self._show(f"wake {self.wakes}, iteration {iteration}: {miss}, thrust {thrust:.4g} N")


@contextmanager
def wake_progress(label: str, shown: bool, folder: Path | None = None) -> Iterator[WakeProgress]:
    """Tell on standard error how a wake gets on. When it is stopped or fails, what it told is left in the folder."""
    try:
        if not shown:
            progress = WakeProgress()
            yield progress
        else:
            from rich.console import Console

            with Console(stderr=True).status(label) as status:
                progress = WakeProgress(lambda text: status.update(f"{label}: {text}"))
                yield progress
    except BaseException:
        if folder is not None and progress.rows:
            rows = np.array(progress.rows, dtype=np.float64)
            write_history(rows, folder, ("wake", "iteration", "residual", "thrust_N"), "progress")
        raise


def write_history(
    history: NDArray[np.float64], folder: Path, heads: tuple[str, ...], name: str = "history"
) -> Path:
    """Write iterations as CSV.

    Raises
    ------
    InputError
        If the folder cannot be written.
    """
    path = folder / f"{name}.csv"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(heads)
            for row in history:
                writer.writerow([f"{x:.9g}" for x in row])
    except OSError as error:
        raise InputError(
            "--out", str(folder), f"cannot be written ({error})", "give another folder"
        ) from error
    return path
