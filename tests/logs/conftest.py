"""Logs made for the tests: signals on one clock, and writers of other people's formats by their published layouts."""

import os
import struct
import zlib

os.environ["MAVLINK20"] = "1"

import numpy as np
import pytest
import xarray as xr


def signals(n=400, rate=50.0, seed=0, start=0.0):
    """Attitude, rates, inputs, a scalar of the user's own, text and events, with missing values and odd numbers."""
    rng = np.random.default_rng(seed)
    time = start + np.arange(n) / rate
    attitude = 0.2 * np.column_stack([np.sin(2 * time), np.cos(3 * time), np.sin(time)])
    rates = np.gradient(attitude, time, axis=0) + 0.01 * rng.standard_normal((n, 3))
    rates[n // 3] = np.nan
    units = {"units": "rad", "long_name": "measured attitude"}
    return xr.Dataset(
        {
            "measured_attitude": (("time", "angle"), attitude, units),
            "measured_rates": (
                ("time", "rate"),
                rates,
                {"units": "rad/s", "long_name": "measured body rates"},
            ),
            "motor_input": (
                ("time", "rotor"),
                rng.random((n, 2)),
                {"units": "1", "long_name": "motor input, 0 to 1"},
            ),
            "flap": ("time", rng.standard_normal(n), {"units": "rad", "long_name": "flap angle"}),
            "mission_state": (
                "time",
                np.where(time < time[n // 2], "hover", "landing"),
                {"long_name": "state"},
            ),
            "event_time": ("event", [time[3], time[-1]], {"units": "s", "long_name": "time of the event"}),
            "event_state": ("event", ["hover", "landing"]),
            "event_text": ("event", ["altitude reached", "touch-down, softly"]),
            "event_level": ("event", ["info", "warning"]),
        },
        {
            "time": ("time", time, {"units": "s", "long_name": "time"}),
            "angle": ["roll", "pitch", "yaw"],
            "rate": ["p", "q", "r"],
            "rotor": ["upper", "lower"],
        },
        {
            "vehicle": "mufly-1.1",
            "seed": 3,
            "start_time": "2025-03-01T12:00:00.000+00:00",
            "tags": ["a", "b"],
        },
    )


@pytest.fixture
def data():
    return signals()


def dataflash(messages, units=None):
    """A binary DataFlash log: ``messages`` is a list of (type, name, format, columns, rows).

    Rows stand in the order of the board's clock, TimeUS, TimeMS or T; of a kind without one each row begins with the
    time (ms) at which it is written, and its columns with ``@``.
    """
    codes = {
        "Q": "Q",
        "b": "b",
        "f": "f",
        "c": "h",
        "B": "B",
        "H": "H",
        "I": "I",
        "Z": "64s",
        "N": "16s",
        "h": "h",
        "L": "i",
        "C": "H",
        "e": "i",
    }

    def record(kind, layout, *values):
        return b"\xa3\x95" + bytes([kind]) + struct.pack("<" + layout, *values)

    def definition(kind, name, layout, columns):
        size = 3 + struct.calcsize(
            "<" + "".join(codes.get(c, {"n": "4s", "d": "d", "b": "b"}.get(c, c)) for c in layout)
        )
        return record(128, "BB4s16s64s", kind, size, name.encode(), layout.encode(), columns.encode())

    out = definition(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
    if units:
        out += definition(130, "UNIT", "QbZ", "TimeUS,Id,Label")
        out += definition(131, "MULT", "Qbd", "TimeUS,Id,Mult")
        out += definition(129, "FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds")
        out += b"".join(record(130, "Qb64s", 0, ord(k), v.encode()) for k, v in units["labels"].items())
        out += b"".join(record(131, "Qbd", 0, ord(k), v) for k, v in units.get("factors", {}).items())
    for kind, name, layout, columns, _ in messages:
        out += definition(kind, name, layout, columns.removeprefix("@"))
        if units and name in units["ids"]:
            multipliers = units.get("multipliers", {}).get(name, "-" * len(layout))
            out += record(129, "QB16s16s", 0, kind, units["ids"][name].encode(), multipliers.encode())
    rows = []
    for kind, _, layout, columns, values in messages:
        pack = "".join(codes[c] for c in layout)
        untimed = columns.startswith("@")
        names = columns.split(",")
        clock = 0 if untimed else next(names.index(c) for c in ("TimeUS", "T", "TimeMS") if c in names)
        tick = 1e-3 if names[clock] == "TimeUS" else 1.0
        rows += [(tick * row[clock], record(kind, pack, *row[untimed:])) for row in values]
    return out + b"".join(data for _, data in sorted(rows, key=lambda r: r[0]))


def micro_sd(kinds, events, *, version=2, end=True):
    """A log of the Crazyflie's micro-SD deck by events.

    ``kinds`` is {number: (name, ["acc.x(f)", ...])}, ``events`` a list of (number, time_s, values).
    """
    out = struct.pack("<BHH", 0xBC, version, len(kinds))
    for number, (name, columns) in kinds.items():
        out += struct.pack("<H", number) + name.encode() + b"\0" + struct.pack("<H", len(columns))
        out += b"".join(c.encode() + b"\0" for c in columns)
    for number, time_s, values in events:
        letters = "".join(c[-2] for c in kinds[number][1])
        clock = struct.pack("<I", round(1e3 * time_s)) if version == 1 else struct.pack("<Q", round(1e6 * time_s))
        out += struct.pack("<H", number) + clock + struct.pack(f"<{letters}", *values)
    return out + (struct.pack("<I", zlib.crc32(out)) if end else b"")


def micro_sd_of_2018(columns, rows, *, block=20):
    """The same before 2020: rows of fixed rate, the first column the tick in milliseconds."""

    def sealed(part):
        return part + struct.pack("<I", ~zlib.crc32(part) & 0xFFFFFFFF)

    out = sealed(bytes([len(columns)]) + b"".join(c.encode() + b"," for c in columns))
    letters = "".join(c[-2] for c in columns)
    for start in range(0, len(rows), block):
        part = rows[start : start + block]
        out += sealed(bytes([len(part)]) + b"".join(struct.pack(f"<{letters}", *row) for row in part))
    return out


@pytest.fixture(scope="session")
def make_micro_sd():
    return micro_sd, micro_sd_of_2018


@pytest.fixture(scope="session")
def mavlink():
    from pymavlink.dialects.v20 import ardupilotmega

    return ardupilotmega


@pytest.fixture(scope="session")
def make_signals():
    return signals


@pytest.fixture(scope="session")
def make_dataflash():
    return dataflash
