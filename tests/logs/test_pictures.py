"""Signals in pictures, spectra, and what a recording's messages carry."""

import numpy as np
import orjson
import pytest
import xarray as xr

from mufly.errors import InputError
from mufly.logs import (
    Channel,
    draw_channels,
    group_channels_by_picture,
    read_mcap,
    read_raw_log,
    read_recording_summary,
    write_log,
)
from mufly.logs.log_report import compute_power_spectrum

TIME = 0.01 * np.arange(1000)
WAVE = 0.3 * np.sin(2 * np.pi * TIME)


def channel(name, values=WAVE, units="rad", time=TIME):
    return Channel(name, units, time, values)


def test_what_belongs_together_shares_a_picture_and_a_component_a_panel():
    channels = [
        channel("flap"),
        channel("battery_voltage", units="V"),
        *(channel(f"motor_input.{r}", units="1") for r in ("upper", "lower")),
        *(channel(f"{s}_attitude.{a}") for s in ("measured", "reference") for a in ("roll", "pitch")),
        channel("imu/gyro.x", units="rad/s"),
    ]
    pictures = group_channels_by_picture(channels)
    assert list(pictures) == ["attitude", "inputs", "battery", "others", "imu"]
    axes = draw_channels(pictures["attitude"], title="Hop").axes
    assert [ax.get_ylabel() for ax in axes] == ["Roll\n(deg)", "Pitch\n(deg)"]
    assert axes[0].get_title(loc="left") == "Hop"
    measured, reference = axes[0].get_lines()
    assert measured.get_ydata() == pytest.approx(np.degrees(WAVE))
    assert (measured.get_linestyle(), reference.get_linestyle()) == ("-", "--")
    # Who is who is said once, for all panels.
    (legend,) = [ax.get_legend() for ax in axes if ax.get_legend()]
    assert [t.get_text() for t in legend.get_texts()] == ["measured", "reference"]
    (motors,) = draw_channels(pictures["inputs"]).axes
    assert {line.get_drawstyle() for line in motors.get_lines()} == {"steps-post"}  # held in between
    assert [t.get_text() for t in motors.get_legend().get_texts()] == ["upper", "lower"]
    assert len({line.get_color() for line in motors.get_lines()}) == 2
    (one,) = draw_channels([channel("reference_attitude.roll")]).axes  # alone it looks as it does among others
    assert [t.get_text() for t in one.get_legend().get_texts()] == ["reference"]
    assert (one.get_lines()[0].get_linestyle(), one.get_lines()[0].get_color()) == (
        "--",
        reference.get_color(),
    )
    (alone,) = draw_channels(pictures["others"]).axes
    assert alone.get_legend() is None  # its axis says it already


def test_gaps_stay_open_and_a_spike_among_many_points_is_seen():
    kept = np.delete(np.arange(1000), slice(300, 400))
    (line,) = draw_channels([channel("flap", WAVE[kept], time=TIME[kept])]).axes[0].get_lines()
    x, y = line.get_data()
    (hole,) = np.flatnonzero(np.isnan(y))
    assert (x[hole - 1], x[hole + 1]) == (pytest.approx(2.99), pytest.approx(4.0))
    long = 0.001 * np.arange(50_000)
    values = np.sin(long)
    values[31_234], values[40_000:40_200] = 5.0, np.nan
    (line,) = draw_channels([channel("flap", values, "m", long)]).axes[0].get_lines()
    x, y = line.get_data()
    assert len(x) < 10_000
    assert np.nanmax(y) == 5.0
    assert x[np.nanargmax(y)] == pytest.approx(31.234, abs=0.02)
    assert np.nanmin(y) == pytest.approx(-1.0, abs=1e-4)
    assert np.isnan(y[(x > 40.02) & (x < 40.18)]).all()


def test_a_spectrum_has_the_power_of_its_wave_where_that_is():
    time = 0.01 * np.arange(4000)
    values = 3.0 + 0.2 * time + 0.7 * np.sin(2 * np.pi * 5.0 * time)
    values[1000:1003] = np.nan
    frequency, density = compute_power_spectrum(time, values)
    assert frequency[density.argmax()] == pytest.approx(5.0, abs=0.1)
    assert np.sum(density) * (frequency[1] - frequency[0]) == pytest.approx(0.7**2 / 2, rel=0.02)
    # Of a record with a long hole the longest stretch counts: here the one with another wave.
    time = np.r_[time[:500], time[1500:]]
    values = np.where(time < 10.0, np.sin(2 * np.pi * 20.0 * time), np.sin(2 * np.pi * 5.0 * time))
    frequency, density = compute_power_spectrum(time, values)
    assert density[np.abs(frequency - 20.0) < 1.0].max() < 1e-3 * density.max()
    line, faint = draw_channels(
        [
            channel("measured_rates.p", values, "rad/s", time),
            channel("measured_rates.q", 0 * values, "rad/s", time),
        ],
        spectra=True,
    ).axes
    assert line.get_ylabel() == "p\n((deg/s)²/Hz)"
    assert len(line.get_lines()) == 1
    assert not faint.get_lines()  # what stands still has no power
    with pytest.raises(InputError, match="no channel is long enough"):
        draw_channels([channel("flap", WAVE[:20], time=TIME[:20])], spectra=True)
    with pytest.raises(InputError, match="31 samples"):
        compute_power_spectrum(TIME[:31], WAVE[:31])


def test_messages_of_a_recording_stand_at_their_wall_time_in_its_blocks(tmp_path):
    """A long log is written in blocks; every message, events too, has the wall time of its instant."""
    n, start = 2500, "2025-03-01T12:00:00.000+00:00"
    data = xr.Dataset(
        {
            "measured_velocity": (
                ("time", "axis"),
                np.zeros((n, 3)),
                {"units": "m/s", "long_name": "velocity"},
            ),
            "range": (("time", "beam"), np.ones((n, 8)), {"units": "m", "long_name": "range"}),
            "mission_state": ("time", np.full(n, "hover")),
            "event_time": ("event", [5.0, 25.2]),  # the last one behind the last row
            "event_state": ("event", ["hover", "hover"]),
            "event_text": ("event", ["first", "last"]),
            "event_level": ("event", ["info", "warning"]),
        },
        {
            "time": ("time", 0.01 * np.arange(n), {"units": "s"}),
            "axis": ["N", "E", "D"],
            "beam": np.arange(8),
        },
        {"start_time": start},
    )
    path = write_log(data, tmp_path / "log.mcap")
    contents = read_mcap(path)
    zero = int(np.datetime64(start[:-6], "ns").astype(np.int64))
    stamps = np.array([t for t, _ in contents.messages_by_topic["/mission"]])
    assert stamps == pytest.approx(zero + np.rint(1e7 * np.arange(n)), abs=1)
    said = [(t - zero, orjson.loads(d)["message"]) for t, d in contents.messages_by_topic["/events"]]
    assert said == [(5_000_000_000, "first"), (25_200_000_000, "last")]
    ring = next(d for topic, m in contents.messages_by_topic.items() for _, d in m if b'"range"' in d)
    assert orjson.loads(ring)["range"] == [1.0] * 8
    facts = read_recording_summary(path)
    assert facts["complete"]
    assert facts["duration_s"] == pytest.approx(25.2)
    assert facts["start_time_ns"] == zero
    assert set(read_raw_log(path)) == {"/measured", "/ranges", "/mission"}  # drawings and words are no signals
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    cut = read_recording_summary(path)
    assert not cut["complete"]
    assert 5.0 < cut["duration_s"] < 24.0


def test_lists_that_are_pictures_are_no_signals(tmp_path):
    from mcap.writer import Writer

    path = tmp_path / "robot.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema(name="x", encoding="jsonschema", data=b"{}")
        topic = writer.register_channel(topic="/events", message_encoding="json", schema_id=schema)
        for k in range(30):
            message = orjson.dumps({"few": [1.5] * 4, "cloud": [0.0] * 1000, "said": "a"})
            writer.add_message(topic, log_time=10**15 + k * 10**7, publish_time=0, data=message)
        writer.finish()
    table = read_raw_log(path)["/events"]  # of somebody else: with us it holds words
    assert set(table.fields) == {*(f"few[{k}]" for k in range(4)), "said"}
