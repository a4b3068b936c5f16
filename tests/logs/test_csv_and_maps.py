"""Tables of text: headers, units, separators, clocks; and the maps that say which column is which signal."""

import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mufly.errors import InputError
from mufly.files.text_table import read_text_table
from mufly.identify.flight_record import read_columns
from mufly.logs import LogWarning, load_column_map, read_log, read_raw_log
from mufly.quantities.units import normalise_unit, split_header, unit_conversion


@pytest.fixture
def table(tmp_path):
    def write(text, name="log.csv"):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return write


def rows(head, n=50, sep=",", step=0.01, columns=2):
    lines = [head]
    lines += [sep.join([f"{step * k:.6g}", *(f"{np.sin(0.1 * k + j):.9g}" for j in range(columns))]) for k in range(n)]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize(
    ("header", "name", "unit"),
    [
        ("roll (deg)", "roll", "deg"),
        ("T [N]", "T", "N"),
        ("speed_rpm", "speed", "rpm"),
        ("gyro_x_deg_s", "gyro_x", "deg/s"),
        ("thrust_mN", "thrust", "mN"),
        ("torque [mNm]", "torque", "mN m"),
        ("measured_position_N", "measured_position_N", ""),  # north
        ("q[0]", "q[0]", ""),  # an index
        ("rate (°/s)", "rate", "deg/s"),
        ("count [widgets]", "count", "widgets"),
        ("phi", "phi", ""),
    ],
)
def test_headers_are_split_into_name_and_unit(header, name, unit):
    assert split_header(header) == (name, unit)


@pytest.mark.parametrize(
    ("unit", "wanted", "one"),
    [
        ("deg", None, np.pi / 180), ("rpm", None, 2 * np.pi / 60), ("mV", "V", 1e-3), ("g", "N", 9.80665e-3),
        ("g", "m/s^2", 9.80665), ("km/h", None, 1 / 3.6), ("degC", None, 274.15), ("mNm", None, 1e-3),
        ("dps", "rad/s", np.pi / 180),
    ],
)  # fmt: skip
def test_units_convert(unit, wanted, one):
    _, factor, offset = unit_conversion(unit, wanted)
    assert factor + offset == pytest.approx(one)


@given(st.sampled_from(["deg", "rpm", "mm", "degC", "mV", "km/h", "%"]), st.floats(-1e6, 1e6))
def test_a_conversion_and_its_reverse_give_the_value_back(unit, x):
    si, factor, offset = unit_conversion(unit)
    _, back, shift = unit_conversion(si, unit)
    assert back * (factor * x + offset) + shift == pytest.approx(x, abs=1e-6)


def test_units_of_another_dimension_are_refused():
    with pytest.raises(InputError, match="cannot become rad"):
        unit_conversion("V", "rad")
    assert normalise_unit("furlong") == ""


@pytest.mark.parametrize(
    ("text", "separator"),
    [
        (rows("t (s),U [V],I [A]"), ","),
        (rows("t (s);U [V];I [A]", sep=";"), ";"),
        (rows("t (s);U [V];I [A]", sep=";").replace(".", ","), ";"),
        (rows("t_s\tU_V\tI_A", sep="\t"), "\t"),
        (rows("t_s U_V I_A", sep=" "), " "),
        ("# bench, spring\n" + rows("t_s,U_V,I_A"), ","),
        (rows("# t_s,U_V,I_A"), ","),
        (rows("t,U,I").replace("t,U,I\n", "t,U,I\ns,V,A\n"), ","),
        ("\ufeff" + rows("t_s,U_V,I_A"), ","),
    ],
)
def test_the_shape_of_a_table_is_recognised(table, text, separator):
    raw = read_raw_log(table(text))
    assert raw.info["separator"] == separator
    one = raw["table"]
    assert one.units == {"U": "V", "I": "A"}
    assert one.time == pytest.approx(0.01 * np.arange(50))
    assert one.fields["I"] == pytest.approx(np.sin(0.1 * np.arange(50) + 1), abs=1e-8)


def test_a_table_without_a_header_has_numbered_columns(table):
    text = rows("x").partition("\n")[2]
    data = read_log(table(text), columns={"time": "1", "battery_voltage": "2", "battery_current": "-3(mA)"})
    assert data.battery_voltage.values == pytest.approx(np.sin(0.1 * np.arange(50)), abs=1e-8)
    assert data.battery_current.values == pytest.approx(-1e-3 * np.sin(0.1 * np.arange(50) + 1), abs=1e-8)


def test_a_table_without_a_clock_needs_a_rate(table):
    path = table("U,I\n1,2\n2,3\n3,4\n")
    with pytest.raises(InputError, match="no column for the time among: U, I"):
        read_raw_log(path)
    columns = {"time": {"rate_hz": 50}, "signal": [{"name": "battery_voltage", "columns": ["U"]}]}
    assert read_log(path, columns=columns).time.values == pytest.approx([0, 0.02, 0.04])


@pytest.mark.parametrize(("step", "unit"), [(10, "milli"), (10_000, "micro"), (10_000_000, "nano")])
def test_the_unit_of_a_clock_without_one_is_guessed_and_said(table, step, unit):
    text = "timestamp,U_V\n" + "\n".join(f"{step * k},{k}" for k in range(50))
    with pytest.warns(LogWarning, match=f"taken as {unit}seconds"):
        data = read_log(table(text))
    assert data.time.values == pytest.approx(0.01 * np.arange(50))


def test_times_in_any_unit_are_as_exact_as_they_can_be(table):
    text = "t [min],U_V\n" + "\n".join(f"{k},{k}" for k in range(50))
    assert read_raw_log(table(text))["table"].time.tolist() == [60.0 * k for k in range(50)]
    text = "t_ms,U_V\n" + "\n".join(f"{k},{k}" for k in range(50))
    assert read_raw_log(table(text))["table"].time.tolist() == [k / 1000 for k in range(50)]


def test_units_that_nobody_knows_stay_and_angles_of_a_users_own_keep_their_jumps(table):
    lines = [f"{k},{k},{5.0 * (k % 2)}" for k in range(50)]
    data = read_log(table("t_s,count [widgets],phase [rad]\n" + "\n".join(lines)))
    assert data["count"].attrs["units"] == "widgets"
    assert data.phase.values.tolist() == [5.0 * (k % 2) for k in range(50)]


def test_a_reference_that_tells_nothing_is_in_the_unit_of_its_measurement(table):
    lines = [f"{0.1 * k},{40 * np.sin(0.1 * k)},{0.02 * k}" for k in range(200)]
    with pytest.warns(LogWarning) as said:
        data = read_log(table("t_s,measured_attitude_roll,reference_attitude_roll\n" + "\n".join(lines)))
    words = " ".join(str(w.message) for w in said)
    assert "reference_attitude names no unit and is taken to be in deg (as in measured_attitude)" in words
    assert data.reference_attitude.values[-1, 0] == pytest.approx(np.radians(0.02 * 199))
    with pytest.warns(LogWarning, match="taken to be in rad .not contradicted by the data"):
        read_log(table("t_s,reference_attitude_roll\n" + "\n".join(f"{k},0.01" for k in range(50))))


def test_what_is_not_there_is_answered_with_what_comes_near_or_what_is_there(table):
    path = table(
        "t_s," + ",".join(f"gauge_{k}" for k in range(12)) + "\n" + "\n".join(["0" + ",1" * 12, "1" + ",1" * 12])
    )
    with pytest.raises(InputError, match=r"did you mean gauge_\d+, gauge_\d+, gauge_\d+\?$"):
        read_log(path, signals=["table/gauge_77"])
    with pytest.raises(InputError, match=r"fields are: gauge_0, .*gauge_9 and 2 more$"):
        read_log(path, signals=["table/XYZ"])
    with pytest.raises(InputError, match=r"fields are: U$"):
        read_log(table("t_s,U_V\n0,1\n1,2"), signals=["table/XYZ"])


def test_a_clock_of_broken_numbers_is_in_seconds(table):
    text = "timestamp,U_V\n" + "\n".join(f"{1.5 * k},{k}" for k in range(50))
    assert read_raw_log(table(text))["table"].time.tolist() == [1.5 * k for k in range(50)]


def test_a_separator_splits_all_lines_and_not_the_last_alone(table):
    lines = ["t_s,U_V,note", *(f"{k},7.4,ok" for k in range(18)), "18,7.4,high; then low"]
    assert list(read_raw_log(table("\n".join(lines)))["table"].fields) == ["U", "note"]


def test_a_short_table_of_decimal_commas_is_read(table):
    raw = read_raw_log(table("t (s);U [V]\n" + "\n".join(f"0,{k};7,{k}" for k in range(8))))
    assert raw["table"].fields["U"] == pytest.approx([7 + 0.1 * k for k in range(8)])


def test_a_comment_of_another_width_is_no_header_and_an_empty_header_has_a_number(table):
    numbers = "\n".join(f"{k},7.4,1" for k in range(20))
    data = read_log(table(f"# spring, bench\n{numbers}"), columns={"time": "1", "battery_voltage": "2"})
    assert data.battery_voltage.values == pytest.approx(7.4)
    assert list(read_raw_log(table(f"t_s,,U_V\n{numbers}"))["table"].fields) == ["column 2", "U"]


def test_a_netcdf_file_without_times_is_refused(tmp_path):
    import xarray as xr

    xr.Dataset({"x": ("time", np.ones(5))}).to_netcdf(tmp_path / "a.nc", engine="scipy")
    with pytest.raises(InputError, match="has no coordinate 'time'"):
        read_raw_log(tmp_path / "a.nc")


@pytest.mark.parametrize(("bad", "refused"), [(20, False), (30, True)])
def test_a_column_of_times_is_one_if_most_of_its_cells_are(table, bad, refused):
    cells = ["?" if k < bad else f"2025-03-01T12:00:{k:02d}Z" for k in range(50)]
    path = table("time,U_V\n" + "\n".join(f"{c},1" for c in cells))
    if refused:
        with pytest.raises(InputError, match=r"'\?' is not a time"):
            read_raw_log(path)
    else:
        assert np.isnan(read_raw_log(path)["table"].time).sum() == bad


def test_times_of_day_are_read(table):
    text = "time,U_V\n" + "\n".join(f"2025-03-01T12:00:{k / 10:04.1f}Z,{k}" for k in range(50))
    raw = read_raw_log(table(text))
    assert raw.start_time.startswith("2025-03-01T12:00:00")
    assert raw["table"].time == pytest.approx(0.1 * np.arange(50))


def test_cells_that_are_no_numbers_are_missing_and_counted(table):
    text = rows("t_s,U_V,I_A").replace("\n0.05,", "\n0.05,oops").replace("\n0.07,", "\n0.07,nan ,0\n0.075,")
    with pytest.warns(LogWarning, match="column U: 1 cell is not a number"):
        data = read_log(table(text))
    assert np.isnan(data.U).sum() == 2


def test_rows_that_end_with_a_separator_are_read(table):
    lines = rows("t_s,U_V,I_A").splitlines()
    text = "\n".join([lines[0], *(s + "," for s in lines[1:])])
    assert list(read_raw_log(table(text))["table"].fields) == ["U", "I"]


def test_rows_longer_than_the_header_are_refused(table):
    with pytest.raises(InputError, match="as many cells as the header"):
        read_raw_log(table(rows("t_s,U_V", columns=2)))


def test_rows_of_unequal_length_are_refused(table):
    with pytest.raises(InputError, match="as many cells as the header"):
        read_raw_log(table(rows("t_s,U_V,I_A") + "1,2,3,4,5\n"))


def test_a_map_from_a_file_converts_names_units_signs_and_offsets(table, tmp_path):
    path = table(rows("ms,phi,theta,psi,U", columns=4, step=10))
    (tmp_path / "map.toml").write_text(
        """
        [time]
        column = "ms"
        unit = "ms"

        [[signal]]
        name = "measured_attitude"
        columns = ["phi", "theta", "psi"]
        unit = "deg"
        sign = [1, -1, 1]

        [[signal]]
        name = "battery_voltage"
        columns = ["U"]
        unit = "mV"
        factor = 2
        offset = 100
        """
    )
    data = read_log(path, columns=tmp_path / "map.toml")
    k = 0.1 * np.arange(50)
    assert data.time.values == pytest.approx(0.01 * np.arange(50))
    wanted = np.radians(np.column_stack([np.sin(k), -np.sin(k + 1), np.sin(k + 2)]))
    assert data.measured_attitude.values == pytest.approx(wanted, abs=1e-9)
    assert data.battery_voltage.values == pytest.approx(1e-3 * (2 * np.sin(k + 3) + 100), abs=1e-9)
    assert set(data) == {"measured_attitude", "battery_voltage"}


def test_the_short_form_says_the_same(table):
    path = table(rows("ms,phi,theta,psi", columns=3, step=10))
    short = read_log(
        path,
        columns=["time=ms(ms)", "measured_attitude=phi,theta,psi(deg)", "measured_rates.q=-theta[deg/s]"],
    )
    k = 0.1 * np.arange(50)
    assert short.measured_attitude.sel(angle="yaw").values == pytest.approx(np.radians(np.sin(k + 2)), abs=1e-9)
    assert short.measured_rates.sel(rate="q").values == pytest.approx(-np.radians(np.sin(k + 1)), abs=1e-9)
    assert np.isnan(short.measured_rates.sel(rate="p")).all()


def test_a_quaternion_in_a_table_becomes_angles(table):
    angle = np.linspace(0, 3 * np.pi, 60)  # one and a half turns to the right
    lines = [f"{0.1 * k},{np.cos(a / 2)},0,0,{np.sin(a / 2)}" for k, a in enumerate(angle)]
    path = table("t_s,qw,qx,qy,qz\n" + "\n".join(lines))
    entry = {"name": "measured_attitude", "columns": ["qw", "qx", "qy", "qz"], "quaternion": True}
    data = read_log(path, columns={"signal": [entry]})
    assert data.measured_attitude.sel(angle="yaw").values == pytest.approx(angle, abs=1e-9)


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"battery_voltage": "V0lt"}, "there is no such column"),
        ({"battery_voltage": "U(furlong)"}, "is unknown"),
        ({"battery_voltage": "U(deg)"}, "cannot become V"),
        ({"measured_attitude.rol": "U"}, "is not a component"),
        ({"measured_attitude": "U"}, "give 3"),
        ({"battery voltage": "U"}, "is not a name for a signal"),
        ({"signal": [{"name": "x", "column": "U"}]}, "did you mean 'columns'"),
        (["battery_voltage"], "write NAME=COLUMN"),
        ({"time": "clock", "battery_voltage": "U"}, "is not a column"),
    ],
)
def test_maps_that_do_not_fit_are_refused_in_one_line(table, columns, words):
    path = table(rows("t_s,U_V,I_A"))
    with pytest.raises(InputError, match=words) as caught:
        read_log(path, columns=columns)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["px4", "ardupilot", "mavlink", "crazyflie"])
def test_the_maps_of_the_package_are_sound(name):
    assert len(load_column_map(name).signal) >= 10


def test_signals_are_chosen_by_name_component_and_pattern(tmp_path, data):
    from mufly.logs import write_log

    path = write_log(data, tmp_path / "log.csv")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LogWarning)
        assert set(read_log(path, signals=["measured_*"])) == {"measured_attitude", "measured_rates"}
        one = read_log(path, signals=["measured_attitude.pitch"]).measured_attitude
        assert np.isnan(one.sel(angle="roll")).all()
        assert np.array_equal(one.sel(angle="pitch"), data.measured_attitude.sel(angle="pitch"))
        assert list(read_log(path, signals=["table/flap"])) == ["table_flap"]
    with pytest.raises(InputError, match="there is no such signal"):
        read_log(path, signals=["measured_altitude"])


@pytest.mark.parametrize(
    ("text", "rpm"),
    [
        ("sep=;\ntime;rpm\n0,00;1.234,5\n0,01;987,5\n0,02;12.345,0\n", [1234.5, 987.5, 12345.0]),
        ("time;rpm\n0,00;1.234\n0,01;987\n0,02;12.345\n", [1234, 987, 12345]),
        ("time;rpm\n0,00;1\u00a0234,5\n0,01;987,5\n0,02;12\u00a0345,0\n", [1234.5, 987.5, 12345.0]),
        ('time,rpm\n0.00,"1,234.5"\n0.01,987.5\n0.02,"12,345.0"\n', [1234.5, 987.5, 12345.0]),
        ("time;rpm\n0,00;0.234\n0,01;1.987\n0,02;2.345\n", [0.234, 1.987, 2.345]),
    ],
    ids=["point and comma", "whole thousands", "blank", "comma and point", "points that are decimal"],
)
def test_thousands_in_groups_are_numbers(tmp_path, text, rpm):
    """Before: such a column was text and left out without a word, or 1.234 was one and a bit."""
    path = tmp_path / "excel.csv"
    path.write_text("\ufeff" + text, encoding="utf-8")
    assert read_raw_log(path)["table"].fields["rpm"].tolist() == rpm


COMMA, POINT = ("0,00", "1.234,5", "-0,25"), ("0.00", "1,234.5", "-0.25")
FRENCH = tuple(c.replace(".", "\u202f") for c in COMMA)


@pytest.mark.parametrize("header", [True, False])
@pytest.mark.parametrize(
    ("separator", "cells", "encoding", "mark"),
    [
        (";", COMMA, "utf-8-sig", ""),
        (";", FRENCH, "utf-8-sig", ""),
        (";", tuple(c.replace("\u202f", "\u00a0") for c in FRENCH), "cp1252", "sep=;\r\n"),
        (";", ("0.00", "1\u2019234.5", "-0.25"), "utf-8-sig", ""),
        ("\t", COMMA, "utf-16", ""),
        ("\t", FRENCH, "utf-16-be", "\ufeff"),
        ("\t", POINT, "utf-16", ""),
        ("\t", COMMA, "cp1252", ""),
        ("  ", tuple(c.replace(".", "") for c in COMMA), "utf-8", ""),
        (",", tuple(f'"{c}"' for c in COMMA), "utf-8", ""),
        (",", tuple(f'"{c}"' for c in POINT), "utf-8", ""),
    ],
    ids=["German", "French", "French Windows", "Swiss", "Unicode text", "French, big end first", "English Unicode text",
         "tabs", "blanks", "quoted commas", "quoted points"],
)  # fmt: skip
def test_a_table_as_a_spreadsheet_of_that_country_writes_it(tmp_path, separator, cells, encoding, mark, header):
    """Before: tabs and blanks with decimal commas had no clock, UTF-16 was no log, a Swiss 1234.5 text, and with names
    for the columns one with thousands was dropped."""
    time, speed, rate = cells
    rows = [(time.replace("00", f"{k:02d}"), speed, rate.replace("25", f"{25 + k}")) for k in range(30)]
    head = [("Zeit (s)", "Drehzahl (rpm)", "q (deg/s)")] if header else []
    path = tmp_path / "excel.csv"
    path.write_bytes((mark + "\r\n".join(separator.join(r) for r in [*head, *rows]) + "\r\n").encode(encoding))
    named = read_columns(path, columns=() if header else ("time=1(s)", "w=2", "q=3"))
    expected = -0.25 - 0.01 * np.arange(30)
    assert named.columns["q"] == pytest.approx(np.radians(expected) if header else expected)
    assert named.time_s == pytest.approx(0.01 * np.arange(30))
    if header:
        table = read_raw_log(path)["table"]
        assert table.fields["Drehzahl"].tolist() == [1234.5] * 30
        assert [read_text_table(path).read_texts(k)[3] for k in range(3)] == ["0.03", "1234.5", "-0.28"]


def test_what_a_comma_means_is_told_by_the_whole_table(table):
    """A log that begins at rest has whole numbers only in its first rows, and 1,234 alone says nothing."""
    rest = "\n".join(f"{k}\t0\t7" for k in range(40))
    assert read_raw_log(table(f"t_s\ta\tb\n{rest}\n40\t0,5\t7"))["table"].fields["a"][-1] == 0.5
    assert read_raw_log(table("t_s\ta\tb\n0\t1,234\t0.5\n1\t2,345\t0.5"))["table"].fields["a"].tolist() == [
        1234,
        2345,
    ]
    assert read_raw_log(table("t_s\ta\n0\t1,234\n1\t2,345"))["table"].fields["a"].tolist() == [1.234, 2.345]
    with pytest.raises(InputError, match="is not text"):
        read_text_table(table("\0\1\2,3\n4,5"))


@pytest.mark.parametrize(
    ("header", "name", "unit"),
    [
        ("ay [g]", "ay", "gee"), ("acc_z_g", "acc_z", "gee"), ("thrust_g", "thrust", "gf"),
        ("battery mass (g)", "battery mass", "g"),
        ("T [kg]", "T", "kgf"), ("load (lb)", "load", "lbf"), ("acc_x (mG)", "acc_x", "mgee"),
        ("mag_x (mG)", "mag_x", "mgauss"),
        ("RPM_A", "RPM_A", ""), ("gain_K", "gain_K", ""), ("Kp_s", "Kp_s", ""), ("roll_m", "roll_m", ""),
        ("C_N", "C_N", ""),
        ("wind_W", "wind_W", ""), ("delta_V", "delta_V", ""), ("flags_s", "flags_s", ""), ("RPM (A)", "RPM (A)", ""),
        ("motor2_A", "motor2", "A"), ("escTemp_C", "escTemp", "degC"), ("T_K", "T", "K"), ("T_s", "T", "s"),
        ("P_W", "P", "W"),
        ("thrust_raw_V", "thrust_raw", "V"), ("alt_m", "alt", "m"), ("speed_ms", "speed", "m/s"),
        ("time_ms", "time", "ms"),
        ("n [1/s]", "n", "rps"), ("n [1/min]", "n", "rpm"), ("rotor speed (Hz)", "rotor speed", "rps"),
        ("loop rate (Hz)", "loop rate", "Hz"), ("decay [1/s]", "decay", "1/s"), ("roll (rads)", "roll", "rad"),
        ("gyro (rads)", "gyro", "rad/s"), ("signal_in", "signal_in", ""), ("radius_in", "radius", "in"),
        ("Hdg(@)", "Hdg", "deg"),
        ("x (g)", "x (g)", ""), ("Alt [M]", "Alt", "m"), ("torque (kg-cm)", "torque", "kgf cm"),
    ],
)  # fmt: skip
def test_a_unit_agrees_with_the_quantity_or_is_none(header, name, unit):
    assert split_header(header) == (name, unit)


def test_letters_in_a_row_of_columns_are_no_units_and_it_is_said(table):
    head = "t_s,phase_A,phase_B,phase_C,i_U,i_V,i_W,motor_A,motor_V,pos_N,pos_E,gain_K"
    rows = "\n".join(f"{0.1 * k:.1f}" + ",1" * 11 for k in range(40))
    raw = read_raw_log(table(f"{head}\n{rows}"))
    assert raw["table"].units == {"motor": "A", "motor (9)": "V"}
    assert raw.notes == (
        "phase_A, phase_C, i_V, i_W, gain_K: read without a unit, because the unit at the end of the name "
        "does not suit the quantity; "
        "give the unit in a column map",
    )


def test_revolutions_a_second_and_other_frequencies(table):
    lines = "\n".join(f"{0.1 * k:.1f},10,600,400,2" for k in range(40))
    data = read_log(table(f"t_s,n [1/s],m_rpm [1/min],loop_rate [Hz],decay [1/s]\n{lines}"))
    assert data["n"].values == pytest.approx(20 * np.pi)
    assert data["m_rpm"].values == pytest.approx(20 * np.pi)
    assert (data["loop_rate"].values[0], data["loop_rate"].attrs["units"]) == (400, "Hz")
    assert (data["decay"].values[0], data["decay"].attrs["units"]) == (2, "1/s")


@pytest.mark.parametrize("separator", [",", ";", "\t", " "])
def test_a_short_row_is_left_out_with_its_line_and_shifts_nothing(table, separator):
    """Before: the cells behind the missing one stood in each other's columns."""
    lines = [f"{0.1 * k:.1f},{k},7.4,{100 + k}" for k in range(60)]
    lines[20] = "2.0,7.4,120"
    text = "\n".join(["# a comment", "t_s,a,U_V,b", *lines]).replace(",", separator)
    raw = read_raw_log(table(text))
    assert raw["table"].fields["b"].tolist() == [100 + k for k in range(60) if k != 20]
    assert raw["table"].fields["U"] == pytest.approx(7.4)
    assert raw.notes == ("line 23 has 3 cells, the header 4; the line is skipped",)
    lines[40:43], lines[-1] = ["4.0,7"] * 3, "5.9,59"
    notes = read_raw_log(table("\n".join(["t_s,a,U_V,b", *lines]).replace(",", separator))).notes
    assert notes == (
        "5 rows have fewer cells than the header's 4 and are skipped, the first in line 22, the last in line 61",
    )
    with pytest.raises(InputError, match=r"line 22: has 3 cells, the header 4 \(and 4 more rows\); give every row"):
        read_text_table(table("\n".join(["t_s,a,U_V,b", *lines]).replace(",", separator)))


def test_rows_that_fit_no_header_are_refused_with_their_line(table):
    many = "\n".join(["t_s,a,b,c", *(f"{k},1,2" for k in range(30))])
    with pytest.raises(InputError, match=r"line 2: has 3 cells, the header 4 \(and 29 more rows\)"):
        read_raw_log(table(many))
    long = "\n".join(["t_s,a", *(f"{k},1" for k in range(30)), "30,1,2", "31,1"])
    with pytest.raises(InputError, match="line 32: has 3 cells, the header 2"):
        read_raw_log(table(long))
    with pytest.raises(InputError, match="line 32: has 3 cells, the header 2"):
        read_text_table(table(long))
    assert len(read_raw_log(table(long.replace("30,1,2", "30,1,,"))).tables_by_topic["table"].time) == 32


@pytest.mark.parametrize(
    "cell", ['"hover, then land"', '"hover\nthen land"', '"a ""quoted"" word, twice"', '3" propeller']
)
def test_a_cell_in_quotes_holds_separators_line_breaks_and_quotes(table, cell):
    lines = [f"{k},{cell if k == 3 else 'ok'},{k}" for k in range(30)]
    lines[25] = "25,1"
    raw = read_raw_log(table("t_s,note,x_m\n" + "\n".join(lines)))
    assert raw["table"].fields["x"].tolist() == [k for k in range(30) if k != 25]
    assert raw.notes == (f"line {27 + cell.count(chr(10))} has 2 cells, the header 3; the line is skipped",)
    assert read_text_table(table("t_s,note,x_m\n" + "\n".join(lines[:25]))).cells[4] == ["4", "ok", "4"]


def test_lines_before_the_header_are_no_rows(table):
    """Blackbox Explorer writes keys and values first; a header that stands again is none of the rows."""
    keys = [
        '"Product","Blackbox flight data recorder"',
        '"gyro_scale","0x40000000"',
        '"acc_1G","512"',
        '"note","a, b"',
    ]
    head = '"time","gyroADC[0]","accSmooth[2]","motor[0]"'
    rows = [f"{4_000_000 + 1000 * k},{k % 50},512,1200" for k in range(80)]
    raw = read_raw_log(table("\n".join([*keys, head, *rows[:40], head, *rows[40:]])))
    one = raw["table"]
    assert one.time == pytest.approx(4.0 + 0.001 * np.arange(80))
    assert one.fields["gyroADC[0]"][49] == pytest.approx(98)
    assert one.units == {"gyroADC[0]": "deg/s", "accSmooth[2]": "gee"}
    assert one.fields["accSmooth[2]"] == pytest.approx(1.0)
    assert raw.info["preamble"]["acc_1G"] == "512"
    assert raw.notes[0].startswith("4 lines before the header are no rows of the table (Product, gyro_scale, acc_1G")
    assert raw.notes[1] == "the header stands again once among the rows"
    titled = "\n".join(["Test of 3 May", "operator: me", "t (s);U (V);I (A)", *(f"{k};7;1" for k in range(30))])
    assert read_raw_log(table(titled))["table"].units == {"U": "V", "I": "A"}


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=8, max_size=60))
def test_numbers_come_back_to_the_bit(tmp_path_factory, values):
    path = tmp_path_factory.mktemp("bits") / "log.csv"
    path.write_text("t_s,x_m\n" + "\n".join(f"{k},{v!r}" for k, v in enumerate(values)))
    assert read_raw_log(path)["table"].fields["x"].tolist() == values


def test_a_second_column_of_times_stays_beside_the_clock(table):
    """Before: xarray's ValueError, since the clock has that name."""
    data = read_log(table("t_s,time,x_m\n" + "\n".join(f"{0.1 * k:.1f},{20 * k},1" for k in range(40))))
    assert data["time_column"].values.tolist() == [20 * k for k in range(40)]
    assert data["time"].values == pytest.approx(0.1 * np.arange(40))


def test_a_row_of_a_table_without_a_header_is_refused_with_its_line(table):
    with pytest.raises(InputError, match="line 4: has 2 cells, the header 1"):
        read_raw_log(table("65000\n65040\n65080\n65280,x"))


@pytest.mark.parametrize("motors", [2, 4])
def test_two_motors_of_px4_are_those_of_a_coaxial_helicopter(motors):
    from mufly.logs import RawLog, RawTable
    from mufly.logs.log_io import extract_log_channels

    time = np.arange(20) * 0.1
    held = {f"control[{k}]": np.full(20, 0.1 * (k + 1) if k < motors else np.nan) for k in range(8)}
    tables = {name: RawTable(name, time, dict(held)) for name in ("actuator_motors", "actuator_servos")}
    channels, _ = extract_log_channels(RawLog("a.ulg", "ULog", tables))
    found = {c.name: c.values[0] for c in channels}
    assert found["actuator_command.1"] == 0.1
    if motors == 2:
        assert found["motor_input.lower"] == found["servo_input.1"] == 0.1
        assert found["motor_input.upper"] == found["servo_input.2"] == 0.2
    else:
        assert not [name for name in found if name.startswith(("motor_input", "servo_input"))]
