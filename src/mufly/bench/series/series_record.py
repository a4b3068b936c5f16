"""Raw record of a series: an append-only file with one line per step.

A line is JSON, a tab, and the CRC-32 of the JSON in hexadecimal. It is flushed to the disk (fsync) before the next
step, so that a crash or power failure loses at most the point in progress. An incomplete line has no valid checksum;
a reader skips it, and a writer continues on a new line.

The first line holds the bench (:class:`mufly.bench.rig.bench_devices.BenchFacts`) and the plan. Every other line is a
``reading`` (zero or point) or an ``event`` (mounted, stopped, resumed, limit).
"""

from __future__ import annotations

import json
import os
import zlib
from pathlib import Path
from typing import Any, TextIO

from mufly.bench.series.block_means import BlockMean
from mufly.errors import InputError, convert_write_errors

RECORD_FILE_NAME = "raw.jsonl"


class SeriesRecord:
    """Record of a series in memory and, with a folder, in a file.

    Parameters
    ----------
    folder : Path, optional
        Folder of ``raw.jsonl``; None keeps the record in memory only.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self.lines: list[dict[str, Any]] = []
        self.broken_lines = 0
        self._file: TextIO | None = None
        if folder is None:
            return
        path = folder / RECORD_FILE_NAME
        if path.is_file():
            self.lines, self.broken_lines = read_valid_lines(path)
        with convert_write_errors(path, "free it"):
            self._file = path.open("a", encoding="utf-8", newline="\n")
            if path.stat().st_size and not path.read_bytes().endswith(b"\n"):
                self._file.write("\n")

    def append_line(self, line: dict[str, Any]) -> None:
        """Append a line and flush it to the disk."""
        self.lines.append(line)
        if self._file is not None:
            text = json.dumps(line, allow_nan=True, separators=(",", ":"))
            self._file.write(f"{text}\t{zlib.crc32(text.encode()):08x}\n")
            self._file.flush()
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
            self._file = None

    @property
    def header_line(self) -> dict[str, Any]:
        """First line of the record; an empty dictionary if the record has no lines."""
        return self.lines[0] if self.lines else {}

    @property
    def readings(self) -> list[dict[str, Any]]:
        """All readings of the series in the order of measurement."""
        return [line for line in self.lines if line["kind"] == "reading"]

    @property
    def completed_steps(self) -> set[tuple[int, int]]:
        """Completed steps of the plan, as pairs of mounting index and step index."""
        return {(x["mounting"], x["step"]) for x in self.lines if x["kind"] in ("reading", "warmed") and x["step"] >= 0}


def read_valid_lines(path: Path) -> tuple[list[dict[str, Any]], int]:
    """Return the lines with valid checksum, and the number of invalid lines.

    Raises
    ------
    InputError
        If the file cannot be read, or its first line is not the header of a record.
    """
    try:
        raw = path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise InputError(str(path), "", f"cannot be read ({error.strerror})", "name a series' folder") from error
    lines, broken = [], 0
    for text in raw.split("\n"):
        if not text:
            continue
        body, _, total = text.rpartition("\t")
        if total != f"{zlib.crc32(body.encode()):08x}":
            broken += 1
            continue
        lines.append(json.loads(body))
    if lines and lines[0].get("kind") != "head":
        raise InputError(
            str(path), "", "does not begin with the record's header", "move the file away and measure again"
        )
    return lines, broken


def read_record(folder: str | Path) -> SeriesRecord:
    """Read the record of a series.

    Raises
    ------
    InputError
        If the folder holds no record.
    """
    path = Path(folder) / RECORD_FILE_NAME
    if not path.is_file():
        raise InputError(str(folder), "", f"contains no {RECORD_FILE_NAME}", "give the folder of `mufly bench run`")
    record = SeriesRecord()
    record.lines, record.broken_lines = read_valid_lines(path)
    if not record.lines:
        raise InputError(str(path), "", "contains no complete line", "measure again")
    return record


def parse_block_mean(values: list[float]) -> BlockMean:
    """Return the block mean stored in a line of the record."""
    value, std, dof, size, spikes, low, high, trend = values
    return BlockMean(value, std, dof, int(size), int(spikes), low, high, trend)
