"""Bench files: headers, units, maps, and what is said of a wrong one."""

import gzip
import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mufly.bench import parse_column_header, read_bench_file, read_bench_files
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
    column = parse_column_header(header)
    assert column is not None
    assert column.name == name
    assert column.factor == pytest.approx(factor)


@pytest.mark.parametrize("header", ["T_laminar", "comment", "P_B(W/kg)", "torque_V", ""])
def test_other_headers_are_no_quantities(header):
    assert parse_column_header(header) is None


def write(tmp_path, text):
    path = tmp_path / "bench.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_file_is_read_in_si(tmp_path):
    path = write(
        tmp_path,
        "# a motor\nvoltage_V,current_mA,speed_rpm,torque_mNm,who\n6, 500, 9000, 1.5, me\n7,,9e3,1,\n",
    )
    table = read_bench_file(path)
    assert_allclose(table["current"], [0.5, np.nan])
    assert_allclose(table["speed"], 9000 * math.pi / 30)
    assert_allclose(table["torque"], [1.5e-3, 1e-3])
    assert table.line_numbers.tolist() == [3, 4]
    assert "columns that are not used: who" in table.notes
    with pytest.raises(InputError, match="line 4, current_mA: is empty"):
        table.require_columns(["current"])


def test_semicolons_and_decimal_commas(tmp_path):
    table = read_bench_file(write(tmp_path, "RPM;T(N);run\n1000,5;0,25;a\n2000;1,0;b\n3000;2;a\n"))
    assert_allclose(table["speed"], np.array([1000.5, 2000, 3000]) * math.pi / 30)
    assert table["run"].tolist() == [0, 1, 0]


def test_the_si_column_is_preferred_and_said(tmp_path):
    table = read_bench_file(write(tmp_path, "RPM,omega,T(gf),T(N)\n1000,104.72,100,0.98\n"))
    assert table.headers["speed"] == "omega"
    assert table.headers["thrust"] == "T(N)"
    assert any("read from 'omega', not from 'RPM'" in n for n in table.notes)


def test_columns_are_mapped(tmp_path):
    path = write(tmp_path, "RPM,T_A(N),RPM_B,T_B(N)\n1000,1,1010,2\n")
    table = read_bench_file(
        path,
        columns=["speed_lower=RPM", "thrust_lower=T_A(N)", "speed_upper=RPM_B(rpm)", "thrust_upper=-T_B(gf)"],
    )
    assert table["thrust_upper"] == pytest.approx(-2.0 * 9.80665e-3)
    assert table["thrust_lower"].tolist() == [1.0]
    assert table["speed_lower"] == pytest.approx(1000.0 * math.pi / 30)
    assert set(table.columns) == {"speed_lower", "thrust_lower", "speed_upper", "thrust_upper"}
    with pytest.raises(InputError, match="T_C: is not among the columns"):
        read_bench_file(path, columns=["thrust=T_C(N)"])
    with pytest.raises(InputError, match="wind: is not a quantity of a bench"):
        read_bench_file(path, columns={"wind": "RPM"})
    with pytest.raises(InputError, match="'mm' is not a known unit of thrust"):
        read_bench_file(path, columns=["thrust=T_A(mm)"])
    with pytest.raises(InputError, match="RPM: does not say which column"):
        read_bench_file(path, columns=["RPM"])
    other = tmp_path / "other.csv"
    other.write_text("RPM,F\n900,3\n", encoding="utf-8")
    lines = [f"speed_upper={path.name}/RPM", "thrust=F(N)"]
    pair, single = read_bench_files([path, other], columns=lines)
    assert (set(pair.columns) >= {"speed_upper"}, set(single.columns)) == (True, {"speed", "thrust"})


def test_a_packed_file_with_a_title_and_a_line_of_units_is_read(tmp_path):
    path = tmp_path / "packed.csv.gz"
    lines = [
        "Test of 3 May",
        "// by me",
        "RPM,thrust,torque",
        "1/min,gf,mNm",
        "1000,1 000,10",
        "2000,3.5,40",
        "3000,7,90",
    ]
    path.write_bytes(gzip.compress("\n".join(lines).encode()))
    table = read_bench_file(path)
    assert table["thrust"] == pytest.approx(9.80665e-3 * np.array([1000.0, 3.5, 7.0]))
    assert table["torque"] == pytest.approx([0.01, 0.04, 0.09])
    assert table.line_numbers.tolist() == [5, 6, 7]
    assert table.headers["thrust"] == "thrust"


@pytest.mark.parametrize(
    "text",
    [
        "My bench\nspeed_rpm,thrust_g\n6000,20\n",
        "My bench\n3 May\nspeed_rpm,thrust_g,torque_mNm\n6000,20,2\n",
        "My bench\nspeed_rpm;thrust_g\n6000;20,0\n",
        "My bench\nspeed_rpm\tthrust_g\n6000\t20\n",
    ],
)
def test_one_point_below_a_title_is_read(tmp_path, text):
    assert read_bench_file(write(tmp_path, text))["thrust"] == pytest.approx([0.1961], rel=1e-3)


def test_a_last_line_that_is_cut_is_left_out_and_told(tmp_path):
    with pytest.warns(match="line 3, the last, is incomplete"):
        table = read_bench_file(write(tmp_path, "RPM,T(N),Q(Nm)\n1000,0.1,0.01\n2000,0.2"))
    assert table["thrust"].tolist() == [0.1]
    assert any("line 3" in note for note in table.notes)


@pytest.mark.parametrize("separator", [",", ";", "\t", " "])
def test_a_short_line_shifts_nothing_and_is_named(tmp_path, separator):
    text = "RPM,T(N),Q(Nm)\n1000,0.1,0.01\n2000,0.02\n3000,0.9,0.09\n".replace(",", separator)
    with pytest.raises(InputError, match="line 3: has 2 cells, the header 3"):
        read_bench_file(write(tmp_path, text))
    with pytest.raises(InputError, match="line 3: has 4 cells, the header 3"):
        read_bench_file(write(tmp_path, text.replace("0.02", separator.join(("0.2", "0.02", "7")))))


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("RPM,T(N)\n", "contains no measurements"),
        ("a,b\n1,2\n", "no column is understood"),
        ("RPM,T(N)\n1000,x\n", "line 2, T.N.: 'x' is not a number"),
        ("RPM,T(N)\n1000,inf\n", "line 2, T.N.: is inf"),
    ],
)
def test_wrong_files(tmp_path, text, what):
    with pytest.raises(InputError, match=what):
        read_bench_file(write(tmp_path, text))


def test_unknown_units_are_remembered_and_can_be_set(tmp_path):
    table = read_bench_file(write(tmp_path, "speed,torque,T(N)\n5000,1,2\n"))
    assert table.columns_without_unit == ("speed", "torque")
    assert any("torque: no unit" in n for n in table.notes)
    again = table.rescale_column("speed", math.pi / 30, "taken as rpm")
    assert again["speed"][0] == pytest.approx(523.6, abs=0.1)
    assert again.columns_without_unit == ("torque",)
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
    assert [parse_column_header(h).name for h in heads] == [
        "torque",
        "thrust",
        "voltage",
        "current",
        "speed",
        "humidity",
    ]
    assert parse_column_header(heads[4]).factor == pytest.approx(np.pi / 30)


@pytest.mark.parametrize(
    ("header", "factor"),
    [
        ("Thrust (lbf)", 4.4482216152605), ("Thrust (ozf)", 0.27801385), ("T_gf", 9.80665e-3), ("thrust_N", 1.0),
        ("Thrust (g)", 9.80665e-3), ("Thrust (kgf)", 9.80665), ("Torque (lbf·in)", 0.112984829),
        ("Torque (in-lbf)", 0.112984829),
        ("torque (kg-cm)", 0.0980665), ("Torque (ozf·in)", 7.0615518e-3), ("Rotation speed (rev/s)", 2 * math.pi),
        ("RPM", math.pi / 30), ("voltage_mV", 1e-3), ("Air speed (m/s)", 1.0), ("V (mph)", 0.44704),
        ("ESC signal (µs)", 1e-3), ("throttle_%", 1e-2),
    ],
)  # fmt: skip
def test_units_and_names_of_thrust_stands(header, factor):
    assert parse_column_header(header).factor == pytest.approx(factor, rel=1e-6)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("RPM,Thrust (bananas)\n1000,1\n", r"Thrust \(bananas\): 'bananas' is not a known unit of thrust"),
        ("RPM,T [lbx],Q(Nm)\n1000,1,2\n", r"T \[lbx\]: 'lbx' is not a known unit of thrust"),
        ("RPM,thrust_V\n1000,1\n", "thrust_V: 'V' is not a known unit of thrust"),
        ("Speed (furlongs),T(N)\n1000,1\n", r"Speed \(furlongs\): 'furlongs' is not a known unit of speed"),
    ],
)
def test_an_unknown_unit_is_blamed_with_its_column(tmp_path, text, what):
    table = read_bench_file(write(tmp_path, text))
    with pytest.raises(InputError, match=what):
        table.require_columns(("speed", "thrust"))
    with pytest.raises(InputError, match="'bananas' is not a known unit of thrust"):
        read_bench_file(write(tmp_path, "Thrust (bananas)\n1\n"))


@pytest.mark.parametrize(
    ("heads", "rows", "speed", "words"),
    [
        (
            "Motor Electrical Speed (RPM),Motor Optical Speed (RPM)",
            "0,3000;0,4000",
            (3000, 4000),
            "0 or empty in 2",
        ),
        (
            "Motor Electrical Speed (RPM),Motor Optical Speed (RPM)",
            "3000,0;4000,0",
            (3000, 4000),
            "0 or empty in 2",
        ),
        (
            "Motor Electrical Speed (RPM),Motor Optical Speed (RPM)",
            "0,3000;4000,4010",
            (3000, 4010),
            "0 or empty in 1",
        ),
        ("motor electrical speed (rpm),rpm", "21000,3000;28070,4000", (3000, 4000), "of 7 pole pairs"),
        ("RPM,Electrical speed (RPM)", "3000,21000;4000,28000", (3000, 4000), "of 7 pole pairs"),
        (
            "Motor Electrical Speed (RPM),Motor Optical Speed (RPM)",
            "3600,3000;4800,4000",
            (3000, 4000),
            "by 20 %",
        ),
        (
            "Motor Electrical Speed (RPM),Motor Optical Speed (RPM)",
            "0,0;4000,4010",
            (0, 4000),
            "is read from",
        ),
    ],
)
def test_of_two_speeds_the_shaft_s_is_read(tmp_path, heads, rows, speed, words):
    table = read_bench_file(write(tmp_path, f"{heads},T(N)\n" + "\n".join(f"{r},1" for r in rows.split(";"))))
    assert_allclose(table["speed"] * 30 / math.pi, speed)
    assert any(words in n for n in table.notes)


def test_electrical_revolutions_alone_are_no_speed(tmp_path):
    table = read_bench_file(write(tmp_path, "eRPM,T(N)\n21000,1\n"))
    with pytest.raises(InputError, match="divide eRPM by the number of pole pairs"):
        table.require_columns(("speed",))


@pytest.mark.parametrize(
    ("head", "cells", "words"),
    [
        ("ESC signal (µs)", "1000,1500,2000", "pulse"), ("ESC throttle (us)", "980,1500,2000", "1 pulses below"),
        ("throttle (ms)", "1.0,1.5,2.0", "pulse"), ("throttle", "1000,1500,2000", "pulse"),
        ("throttle", "0,50,100", "per cent"), ("Throttle", "0%,50%,100%", ""), ("throttle (%)", "0,50,100", ""),
        ("throttle", "0,0.5,1", ""), ("throttle", "-1,0,1", "-1 taken as duty 0"), ("duty_%", "0,50%,100", ""),
    ],
)  # fmt: skip
def test_throttles_of_all_kinds(tmp_path, head, cells, words):
    lines = [f"{c};{s}" for c, s in zip(cells.split(","), (0, 3000, 5000), strict=True)]
    table = read_bench_file(write(tmp_path, f"{head};speed_rpm\n" + "\n".join(lines) + "\n"))
    assert_allclose(table["duty"], [0.0, 0.5, 1.0], atol=1e-12)
    assert any(words in n for n in table.notes) or not words


def test_a_throttle_that_reverses_is_asked_for(tmp_path):
    with pytest.raises(InputError, match="throttle: goes from -1 to 1: the speed does not show"):
        read_bench_file(write(tmp_path, "throttle,RPM\n-1,5000\n0,0\n1,5000\n"))


def test_the_current_beside_an_esc_is_the_supply_s(tmp_path):
    table = read_bench_file(write(tmp_path, "ESC signal (µs),Current (A),Voltage (V)\n1200,0.1,8\n1500,1,8\n"))
    assert set(table.columns) == {"duty", "supply_current", "voltage"}
    own = read_bench_file(write(tmp_path, "ESC signal (µs),Motor current (A)\n1200,0.1\n1500,1\n"))
    assert "current" in own


def test_a_pitch_without_unit_is_taken_as_degrees_or_asked_for(tmp_path):
    table = read_bench_file(write(tmp_path, "pitch,RPM,T(N)\n12,3000,1\n"))
    assert_allclose(table["pitch"], math.radians(12))
    assert any("taken as degrees" in n for n in table.notes)
    with pytest.raises(InputError, match=r"pitch: goes up to 0.2 without a unit"):
        read_bench_file(write(tmp_path, "pitch,RPM,T(N)\n0.2,3000,1\n"))


PERFORMANCE = """
         9x4.5E              (9x45E.dat)

         PROP RPM =       {rpm}

         V          J           Pe         Ct          Cp          PWR         Torque      Thrust{more}
       (mph)     (Adv_Ratio)     -          -           -          (Hp)      (In-Lbf)      (Lbf){units}

"""
D = 9 * 0.0254


def performance(new=True, rpms=(2000, 4000)):
    """A file in the layout of APC's, old or new; its numbers come from made-up coefficients in air of 1.225 kg/m3."""
    text = ""
    for rpm in rpms:
        n = rpm / 60.0
        more = "      PWR         Torque      Thrust      THR/PWR" if new else ""
        text += PERFORMANCE.format(rpm=rpm, more=more, units="       (W)         (N-m)        (N)        (g/W)" * new)
        for j in (0.0, 0.2, 0.4):
            ct, cp = 0.1 - 0.1 * j, 0.04 - 0.02 * j
            thrust, power = ct * 1.225 * n**2 * D**4, cp * 1.225 * n**3 * D**5
            torque = power / (2 * math.pi * n)
            row = [
                j * n * D / 0.44704,
                j,
                ct / cp * j,
                ct,
                cp,
                power / 745.699872,
                torque / 0.112984829,
                thrust / 4.448221615,
            ]
            row += [power, torque, thrust, 1.0] if new else []
            text += "  ".join(f"{v:10.6f}" for v in row) + "\n"
    return (
        text + "        50.0      0.9000       -NaN       -NaN      0.01  0.0  0.0  0.0" + "  0 0 0 -NaN" * new + "\n"
    )


@pytest.mark.parametrize("new", [True, False])
@pytest.mark.parametrize("code", ["utf-8", "utf-16"])
def test_a_makers_performance_file(tmp_path, new, code):
    path = tmp_path / "PER3_9x45E.dat"
    path.write_bytes(performance(new).replace("\n", "\r\n").encode(code))
    table = read_bench_file(path)
    assert len(table) == 6
    assert_allclose(table["speed"] * 30 / math.pi, [2000] * 3 + [4000] * 3)
    n = table["speed"] / (2 * math.pi)
    ct, cp = np.tile([0.1, 0.08, 0.06], 2), np.tile([0.04, 0.036, 0.032], 2)
    assert_allclose(table["thrust"], ct * 1.225 * n**2 * D**4, rtol=2e-4)
    assert_allclose(table["torque"] * table["speed"], cp * 1.225 * n**3 * D**5, rtol=2e-3)
    assert_allclose(table["airspeed"], np.tile([0, 0.2, 0.4], 2) * n * D, rtol=1e-4)
    assert_allclose([table.diameter_m, table["density"][0]], [D, 1.225])
    assert any("computed performance, not a measurement" in note for note in table.notes)
    assert any("1 lines without numbers" in note for note in table.notes)


def test_a_short_line_of_a_performance_file_is_named(tmp_path):
    text = performance()
    line = next(k for k, t in enumerate(text.splitlines(), 1) if "0.080000" in t)
    path = tmp_path / "PER3.dat"
    path.write_text(text.replace("  0.080000", "", 1))
    with pytest.raises(InputError, match=f"line {line}: has 11 cells, but the header has 12"):
        read_bench_file(path)
