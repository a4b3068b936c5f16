"""What recording costs: one row appended, a 60 s flight recorded, read back, drawn.

    python benchmarks/bench_recorder.py [--rate 50] [--duration 60] [--pictures]

Prints the best of five (pictures: of three) on this machine. The rows are random walks: numbers with all their
digits, which is the worst case for the encoder.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from mufly.flight import FlightRecorder
from mufly.logs import make_flight_row_layout, read_recording


def best(work: Callable[[], object], times: int = 5) -> float:
    """Shortest wall time of ``work`` (s)."""
    least = float("inf")
    for _ in range(times):
        start = time.perf_counter()
        work()
        least = min(least, time.perf_counter() - start)
    return least


def main() -> None:
    parser = argparse.ArgumentParser(description="What recording costs.")
    parser.add_argument("--rate", type=float, default=50.0, help="rows a second")
    parser.add_argument("--duration", type=float, default=60.0, help="length of the flight (s)")
    parser.add_argument("--pictures", action="store_true", help="draw the flight as well")
    options = parser.parse_args()
    layout = make_flight_row_layout()
    n = int(options.rate * options.duration)
    rows = 1e-2 * np.cumsum(np.random.default_rng(0).normal(size=(n, layout.column_count)), axis=0)
    rows[:, 0] = np.arange(n) / options.rate
    states = [("hover", "waypoint")[k * 10 // n % 2] for k in range(n)]
    pairs = list(zip(rows, states, strict=True))

    def record(path: Path | None) -> FlightRecorder:
        with FlightRecorder(path, {"vehicle": "mufly-1.1"}) as recorder:
            append = recorder.append_row
            for row, state in pairs:
                append(row, state)
        return recorder

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flight.mcap"
        to_memory, to_disk = best(lambda: record(None)), best(lambda: record(path))
        reading = best(lambda: read_recording(path))
        size = path.stat().st_size
        print(f"{n} rows of {layout.column_count} columns, {options.rate:g} rows/s, {options.duration:g} s")
        print(f"append, to memory     {1e6 * to_memory / n:8.2f} us a row")
        print(f"append, to disk       {1e6 * to_disk / n:8.2f} us a row")
        print(f"the whole flight      {to_disk:8.3f} s   ({options.duration / to_disk:.0f} times real time)")
        print(f"read back             {reading:8.3f} s")
        print(f"file                  {size / 1e6:8.2f} MB ({size / n:.0f} bytes a row)")
        if options.pictures:
            from mufly.flight import draw_flight_pictures

            data = record(path).to_dataset()
            print(f"pictures              {best(lambda: draw_flight_pictures(data, folder), 3):8.3f} s")


if __name__ == "__main__":
    main()
