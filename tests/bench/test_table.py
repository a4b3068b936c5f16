"""Bench files: headers, units, maps, and what is said of a wrong one."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mufly.bench import parse_header, read_bench
from mufly.errors import InputError


@pytest.mark.parametrize(
    ("header", "name", "factor"),
    [
        ("torque_mNm", "torque", 1e-3),
        ("T(N)", "thrust", 1.0),
        ("T(gf)", "thrust", 9.80665e-3),
        ("Current [mA]", "current", 1e-3),
        ("RPM", "speed", math.pi / 30),
        ("omega", "speed", 1.0),
        ("speed_rad_s", "speed", 1.0),
        ("speed_upper_rpm", "speed_upper", math.pi / 30),
        ("thrust_raw_mV", "thrust_raw", 1.0),
        ("T_up (mN)", "thrust_upper", 1e-3),
        ("Q dw [N mm]", "torque_lower", 1e-3),
        ("duty_%", "duty", 1e-2),
        ("duty", "duty", 1.0),
        ("pitch_deg", "pitch", math.pi / 180),
        ("supply_current_A", "supply_current", 1.0),
    ],
)
def test_headers(header, name, factor):
    column = parse_header(header)
    assert column is not None
    assert column.name == name
    assert column.factor == pytest.approx(factor)


@pytest.mark.parametrize("header", ["T_laminar", "comment", "P_B(W/kg)", "torque_V", ""])
def test_other_headers_are_no_quantities(header):
    assert parse_header(header) is None


def write(tmp_path, text):
    path = tmp_path / "bench.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_file_is_read_in_si(tmp_path):
    path = write(
        tmp_path,
        "# a motor\nvoltage_V,current_mA,speed_rpm,torque_mNm,who\n6, 500, 9000, 1.5, me\n7,,9e3,1,\n",
    )
    table = read_bench(path)
    assert_allclose(table["current"], [0.5, np.nan])
    assert_allclose(table["speed"], 9000 * math.pi / 30)
    assert_allclose(table["torque"], [1.5e-3, 1e-3])
    assert table.line.tolist() == [3, 4]
    assert "columns that are not used: who" in table.notes
    with pytest.raises(InputError, match="line 4, current_mA: is empty"):
        table.require(["current"])


def test_semicolons_and_decimal_commas(tmp_path):
    table = read_bench(write(tmp_path, "RPM;T(N);run\n1000,5;0,25;a\n2000;1,0;b\n3000;2;a\n"))
    assert_allclose(table["speed"], np.array([1000.5, 2000, 3000]) * math.pi / 30)
    assert table["run"].tolist() == [0, 1, 0]


def test_the_si_column_is_preferred_and_said(tmp_path):
    table = read_bench(write(tmp_path, "RPM,omega,T(gf),T(N)\n1000,104.72,100,0.98\n"))
    assert table.headers["speed"] == "omega"
    assert table.headers["thrust"] == "T(N)"
    assert any("read from 'omega', not from 'RPM'" in n for n in table.notes)


def test_columns_are_mapped(tmp_path):
    path = write(tmp_path, "RPM,T_A(N),RPM_B,T_B(N)\n1000,1,1010,2\n")
    table = read_bench(
        path,
        columns="RPM=speed_lower_rpm, T_A(N)=thrust_lower_N, RPM_B=speed_upper_rpm, T_B(N)=thrust_upper_N",
    )
    assert table["thrust_upper"].tolist() == [2.0]
    assert set(table.columns) == {"speed_lower", "thrust_lower", "speed_upper", "thrust_upper"}
    with pytest.raises(InputError, match="T_C: is not among the columns"):
        read_bench(path, columns="T_C=thrust_N")
    with pytest.raises(InputError, match="wind: is no quantity"):
        read_bench(path, columns="RPM=wind")
    with pytest.raises(InputError, match="is no OLD=NEW"):
        read_bench(path, columns="RPM")


def test_a_last_line_that_is_cut_is_left_out_and_told(tmp_path):
    with pytest.warns(match="line 3, the last, is cut short"):
        table = read_bench(write(tmp_path, "RPM,T(N),Q(Nm)\n1000,0.1,0.01\n2000,0.2"))
    assert table["thrust"].tolist() == [0.1]
    assert any("line 3" in note for note in table.notes)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("RPM,T(N)\n", "holds no measurements"),
        ("a,b\n1,2\n", "no column is understood"),
        ("RPM,T(N)\n1000,x\n", "line 2, T.N.: 'x' is not a number"),
        ("RPM,T(N)\n1000,inf\n", "line 2, T.N.: is inf"),
    ],
)
def test_wrong_files(tmp_path, text, what):
    with pytest.raises(InputError, match=what):
        read_bench(write(tmp_path, text))


def test_unknown_units_are_remembered_and_can_be_set(tmp_path):
    table = read_bench(write(tmp_path, "speed,torque,T(N)\n5000,1,2\n"))
    assert table.unitless == ("speed", "torque")
    assert any("torque: no unit" in n for n in table.notes)
    again = table.rescaled("speed", math.pi / 30, "taken as rpm")
    assert again["speed"][0] == pytest.approx(523.6, abs=0.1)
    assert again.unitless == ("torque",)
    assert "taken as rpm" in again.notes


def test_headers_of_a_thrust_stands_maker():
    heads = [
        "Torque (N·m)",
        "Thrust (N)",
        "Voltage (V)",
        "Current (A)",
        "Motor Electrical Speed (RPM)",
        "Humidity (%)",
    ]
    assert [parse_header(h).name for h in heads] == [
        "torque",
        "thrust",
        "voltage",
        "current",
        "speed",
        "humidity",
    ]
    assert parse_header(heads[4]).factor == pytest.approx(np.pi / 30)
