"""Output of commands: tables, JSON, CSV, pictures, and progress.

Results define meaning and unit of their fields (:mod:`mufly.results`). Here they become JSON, or a table
for reading, with :class:`ResultColumn` for readable units.
"""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import typer

from mufly.errors import InputError, convert_write_errors

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console
    from rich.text import Text

    from mufly.logs.mcap import FlightEvent
    from mufly.results import ResultColumn, ShownBlock
    from mufly.station.page.start_page import Startup

TableRow = Sequence[str]
_MIN_TEXT_WIDTH = 26  # columns: with less width, a last column of text is printed below its row


def make_console(*, stderr: bool = False, width: int | None = None) -> Console:
    """Return a console for tables, as wide as the terminal by default."""
    from rich.console import Console

    return Console(stderr=stderr, width=width)


def print_lines(*lines: str, mark: str = "", style: str | None = None, head: str = "") -> None:
    """Print lines without markup; ``head`` in bold before the first, ``mark`` before each."""
    from rich.text import Text

    out = make_console()
    for k, line in enumerate(lines):
        text = Text(head if k == 0 else "", style="bold").append(
            f"{mark}: {line}" if mark else line, style=style or "not bold"
        )
        out.print(text, highlight=False, soft_wrap=True)


def print_blocks(*blocks: ShownBlock) -> None:
    """Print the lines and tables of a result."""
    from mufly.results import ShownLines

    for block in blocks:
        if isinstance(block, ShownLines):
            print_lines(*block.lines, head=block.head, mark=block.mark, style=block.style)
        elif block.heads:
            print_table(block.heads, block.rows, title=block.title, text=block.text)


def print_json(content: Any) -> None:
    """Print as JSON; results become objects, arrays become lists, and non-finite numbers become null."""
    from mufly.results import to_plain_data

    typer.echo(json.dumps(to_plain_data(content), indent=2, allow_nan=False))


def print_table(heads: Sequence[str], rows: Iterable[TableRow], *, title: str = "", text: Sequence[int] = (0,)) -> None:
    """Print a table; the columns with an index in ``text`` are text, the others numbers.

    If the terminal is too narrow, a last column of text is printed below its row, and heads are folded between words.
    """
    from rich.padding import Padding
    from rich.table import Table
    from rich.text import Text

    marked = [[Text.from_markup(cell) for cell in row] for row in rows]
    # Heads may be folded, numbers and keys not: part of a number is a wrong number.
    words = [max((len(w) for row in marked for w in row[k].plain.split()), default=0) for k in range(len(heads))]
    cells = [max((len(row[k]) for row in marked), default=0) for k in range(len(heads))]
    heading = [max(map(len, head.split()), default=0) for head in heads]
    last = len(heads) - 1
    taken = sum(max(w, h) + 2 for w, h in zip(cells[:last], heading[:last], strict=True))
    below = last in text and make_console().width - _MIN_TEXT_WIDTH < taken <= make_console().width
    shown = last if below else len(heads)
    foldable = [k in text and (k == last or words[k] > _MIN_TEXT_WIDTH) for k in range(len(heads))]
    least = [max(heading[k], 0 if foldable[k] else words[k] if k in text else cells[k]) for k in range(len(heads))]
    natural = [max(c, *map(len, head.split("\n"))) for c, head in zip(cells, heads, strict=True)]
    # A table that does not fit is printed wider than the terminal: rich would cut its numbers.
    width = make_console().width if below else max(make_console().width, sum(least) + 2 * len(heads))
    fitted = [None] * len(heads) if below else _fit_column_widths(natural, least, width - 2 * len(heads))

    def build_table(members: Sequence[Sequence[Text]], *, head: bool) -> Table:
        made = Table(
            box=None, header_style="bold", title=title if head and title else None, title_justify="left",
            title_style="bold", show_header=head and any(heads),
        )  # fmt: skip
        for k, name in enumerate(heads[:shown]):
            made.add_column(
                name, justify="left" if k in text else "right", overflow="fold",
                width=max(cells[k], heading[k]) if below else fitted[k],
                min_width=0 if foldable[k] else words[k],
            )  # fmt: skip
        for row in members:
            made.add_row(*row[:shown])
        return made

    out = make_console(width=width)
    out.print(build_table([] if below else marked, head=True), highlight=False)
    for row in marked if below else ():
        out.print(build_table([row], head=False), Padding(row[last], (0, 0, 0, 5)), highlight=False)


def _fit_column_widths(natural: Sequence[int], least: Sequence[int], room: int) -> list[int | None]:
    """Return column widths with the sum ``room``, at least ``least``; None for each if all columns fit."""
    if room >= sum(natural):
        return [None] * len(natural)
    widths = list(natural)
    for _ in range(sum(natural) - room):
        widths[max(range(len(widths)), key=lambda k: widths[k] - least[k])] -= 1
    return list(widths)


def print_result_table(
    items: Sequence[Any], columns: Iterable[ResultColumn | str], *, title: str = "", names: Sequence[str] = ()
) -> None:
    """Print results as a table, one in each row; see :func:`mufly.results.tabulate_results`."""
    from mufly.results import tabulate_results

    print_blocks(tabulate_results(items, columns, title=title, names=names))


# --- files ------------------------------------------------------------------------------------------------------------


def print_answer(
    as_json: bool,
    content: Any,
    show: Callable[[], object] | Iterable[ShownBlock] | None = None,
    files: Sequence[Path] | None = (),
) -> None:
    """Print the answer of a command: as JSON with the files written, or as text with a line for each file.

    Parameters
    ----------
    as_json : bool
    content : result, table or list
        Content of the JSON answer: :func:`mufly.results.to_plain_data`.
    show : blocks or callable, optional
        The text, or the function that prints it; default: the result's own blocks, else its text.
    files : sequence of Path or None
        Files written. None: a command that writes no files, whose JSON has no key for them.
    """
    from mufly.results import to_plain_data

    if as_json:
        return print_json(content if files is None else {**to_plain_data(content), "files": [str(f) for f in files]})
    if callable(show):
        show()
    elif show is not None:
        print_blocks(*show)
    elif hasattr(content, "make_printed_blocks"):
        print_blocks(*content.make_printed_blocks())
    else:
        print_lines(str(content))
    print_files(files or ())


def print_files(files: Iterable[Path], label: str = "Written") -> None:
    """Print the names of the written files."""
    for file in files:
        make_console().print(f"{label}: {file}", highlight=False, markup=False, soft_wrap=True)


def write_text_file(path: Path, text: str, remedy: str = "give another folder", option: str = "--out") -> Path:
    """Write a text and return its path; an InputError names the option if it cannot be written."""
    with convert_write_errors(option, remedy, str(path)):
        path.write_text(text, encoding="utf-8")
    return path


def save_figure(figure: Figure, folder: Path, name: str) -> Path:
    """Write a picture (PNG) into a folder, which is created if needed; return the file.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    with convert_write_errors("--out", key=str(folder)):
        folder.mkdir(parents=True, exist_ok=True)
        figure.savefig(folder / f"{name}.png", dpi=150)
    return folder / f"{name}.png"


def write_csv(path: Path, heads: Sequence[str], rows: Iterable[Iterable[float | str]], first: str = "") -> Path:
    """Write a table as CSV, numbers with nine digits; a comment ``first`` precedes it.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    with convert_write_errors("--out", key=str(path.parent)):
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("w", newline="", encoding="utf-8") as file:
            file.write(f"# {first}\n" if first else "")
            writer = csv.writer(file)
            writer.writerow(heads)
            writer.writerows([x if isinstance(x, str) else f"{x:.9g}" for x in row] for row in rows)
    return path


def write_records(path: Path, records: Sequence[Mapping[str, Any]]) -> Path:
    """Write records with the same keys as CSV, one in each line, as :func:`write_csv` does."""
    return write_csv(path, list(records[0]), [record.values() for record in records])


def check_output_place(
    option: str, place: Path | None, kind: Literal["folder", "file"] = "folder", *, make: bool = True
) -> None:
    """Check that results can be written to a place, before their computation.

    Parameters
    ----------
    option : str
        Option that names the place.
    place : Path or None
        Place; None: nothing is written.
    kind : str
        Kind of the place: file or folder.
    make : bool
        Whether a folder is created if it does not exist.

    Raises
    ------
    InputError
        If the place cannot be created or written.
    """
    if place is None:
        return
    shown = str(place) if len(str(place)) < 60 else f"{str(place)[:57]}..."
    try:
        if kind == "folder" and make:
            place.mkdir(parents=True, exist_ok=True)
        nearest = next(p for p in (place, *place.absolute().parents) if p.exists())
    except OSError as error:
        raise InputError(option, shown, f"cannot be created ({error.strerror})", f"give another {kind}") from error
    if kind == "file" and place.is_dir():
        raise InputError(option, shown, "is a folder", "give the name of a file")
    if kind == "file" and not place.parent.is_dir():
        raise InputError(option, shown, "its folder does not exist", "create it, or give another file")
    if kind == "folder" and not nearest.is_dir():
        raise InputError(option, str(nearest), "is a file", "give a folder")
    if not os.access(nearest, os.W_OK | os.X_OK if nearest.is_dir() else os.W_OK):
        raise InputError(option, str(nearest), "cannot be written", f"give another {kind}")


# --- progress ---------------------------------------------------------------------------------------------------------


@contextmanager
def progress_bar(label: str, shown: bool) -> Iterator[Callable[[int, int], None] | None]:
    """Show a bar on standard error while cases are computed; yield the function that advances it."""
    if not shown:
        yield None
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn(label), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=make_console(stderr=True), transient=True) as bar:
        task = bar.add_task(label, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total or None)


# Display of a flight in the terminal: events as lines, and on a terminal a live line below them.


class LiveDisplay:
    """Display of events and notices as lines, with a live line below them while it is open.

    Parameters
    ----------
    console : Console
        Console; without a terminal there is no live line.
    """

    def __init__(self, console: Console) -> None:
        from rich.live import Live

        self._console = console
        self._startup: Startup | None = None
        self._live = Live(console=console, refresh_per_second=10) if console.is_terminal else None

    def __enter__(self) -> LiveDisplay:
        if self._live is not None:
            self._live.__enter__()
        return self

    def __exit__(self, *exc: object) -> None:
        if self._live is not None:
            self._live.update("")
            self._live.__exit__(None, None, None)

    def show_event(self, e: FlightEvent) -> None:
        """Show an event of the flight."""
        from rich.text import Text

        colour = {"error": "red", "warning": "yellow"}.get(e.level, "default")
        line = Text(f"{e.time_s:7.1f} s  ").append(f"{e.state:<9}  ", style="bold")
        self._console.print(line.append(e.text, style=colour), highlight=False)

    def show_notice(self, text: str) -> None:
        """Show a notice on something other than the flight, such as a port."""
        from rich.text import Text

        self._console.print(Text(text, style="dim"), highlight=False)

    def follow_startup(self, startup: Startup) -> None:
        """Show the stages of a start: in the live line with the elapsed seconds, or each as a line."""
        self._startup = startup
        startup.on_change = self._on_stage_change
        if startup.stages and not startup.is_done:
            self._on_stage_change(startup.stages[-1].text)

    def _on_stage_change(self, stage: str) -> None:
        startup = self._startup
        if startup is None:
            return
        if not stage:
            self.set_live_line("")
            if not startup.fault:
                self.show_notice(f"Started within {startup.describe_duration()}")
        elif self._live is None:
            self.show_notice(f"Starting: {stage}")
        else:
            self._live.update(_StartupLine(startup))

    def set_live_line(self, line: str) -> None:
        """Set the text of the live line."""
        if self._live is not None:
            from rich.text import Text

            self._live.update(Text(line, no_wrap=True, overflow="ellipsis"))


@dataclass(frozen=True)
class _StartupLine:
    """Live line with the present stage of a start and the elapsed seconds."""

    startup: Startup

    def __rich__(self) -> Text:
        from rich.text import Text

        page = f"   page: {self.startup.url}" if self.startup.url else ""
        return Text(f"Starting: {self.startup.describe_stage()}{page}", no_wrap=True, overflow="ellipsis", style="dim")
