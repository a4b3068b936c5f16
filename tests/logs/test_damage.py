"""Whatever bytes a file holds: it is read as far as it is sound, or refused in one line. No other exception."""

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mufly.errors import InputError
from mufly.logs import FORMATS, LogWarning, examine, read_log, write_log


def survives(path):
    """Read and examine; True if it worked, False if it was refused in one line."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LogWarning)
        worked = True
        for look in (read_log, examine):
            try:
                look(path)
            except InputError as error:
                assert "\n" not in str(error)  # noqa: PT017
                worked = False
    return worked


@pytest.fixture(scope="session")
def samples(tmp_path_factory, make_signals, make_dataflash, make_micro_sd, mavlink):
    folder = tmp_path_factory.mktemp("samples")
    out = {e: write_log(make_signals(n=60), folder / f"log{e}").read_bytes() for e in FORMATS}
    rows = [(20_000 * k, 100 * k, -50, 9000, 0.1 * k) for k in range(1, 60)]
    units = {"labels": {"d": "deg", "s": "s"}, "ids": {"ATT": "sddd-"}}
    out[".bin"] = make_dataflash(
        [(10, "ATT", "QcccF".replace("F", "f"), "TimeUS,Roll,Pitch,Yaw,X", rows)], units
    )
    link = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    out[".tlog"] = b"".join(
        int(1.7e15 + 1e5 * k).to_bytes(8, "big")
        + link.attitude_encode(100 * k + 5, 0.01 * k, 0, 0, 0, 0, 0).pack(link)
        for k in range(60)
    )
    by_events, of_2018 = make_micro_sd
    kinds = {0: ("fixedFrequency", ["gyro.x(f)", "gyro.y(f)", "gyro.z(f)"]), 3: ("estTDOA", ["id(B)"])}
    out[".usd"] = by_events(kinds, [(0, 0.01 * k, (k, 1, 2)) for k in range(60)] + [(3, 0.6, (1,))])
    out[".usd of 2018"] = of_2018(["tick(I)", "pm.vbat(f)"], [(10 * k, 0.05 * k) for k in range(60)])
    return folder, out


KINDS = [*FORMATS, ".bin", ".tlog", ".usd", ".usd of 2018"]


@pytest.mark.parametrize("kind", KINDS)
def test_the_samples_are_sound(samples, kind):
    folder, contents = samples
    path = folder / "whole"
    path.write_bytes(contents[kind])
    assert survives(path)


@settings(max_examples=150)
@given(st.sampled_from(KINDS), st.data())
def test_damaged_files_are_read_or_refused(samples, kind, draw):
    folder, contents = samples
    content = bytearray(contents[kind])
    for _ in range(draw.draw(st.integers(1, 6))):
        content[draw.draw(st.integers(0, len(content) - 1))] = draw.draw(st.integers(0, 255))
    path = folder / "damaged"
    path.write_bytes(content[: draw.draw(st.integers(len(content) // 3, len(content)))])
    survives(path)


HEADS = [b"", b"ULog\x01\x12\x35\x01", b"\xa3\x95\x80\x59", b"PAR1", b"CDF\x01", b"\x89MCAP0\r\n", b"FMT, "]
HEADS += [b"\xbc\x02\x00\x01\x00\x00\x00a\x00\x01\x00x(f)\x00", b"\x02tick(I),x(f),", b"\x1f\x8b\x08"]


@settings(max_examples=40)
@given(st.binary(min_size=1, max_size=300), st.sampled_from(HEADS))
def test_noise_is_read_or_refused(tmp_path_factory, content, head):
    path = tmp_path_factory.mktemp("noise") / "noise"
    path.write_bytes(head + content)
    survives(path)


def test_text_of_any_kind_is_read_or_refused(tmp_path):
    rng = np.random.default_rng(3)
    letters = list("0123456789.,;:\t -eE#%[]()\"'\nabtNü")
    path = tmp_path / "text.csv"
    for _ in range(150):
        path.write_text("".join(rng.choice(letters, size=rng.integers(3, 200))))
        survives(path)
