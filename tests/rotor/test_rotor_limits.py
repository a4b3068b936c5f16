"""Rotors outside the range of the methods, and files that a benchmark cannot use: reported, never passed over."""

import math

import numpy as np
import pytest
from typer.testing import CliRunner

from mufly.bench import read_measurements
from mufly.cli import app
from mufly.errors import InputError
from mufly.rotor import (
    Air,
    OperatingCondition,
    RotorSystem,
    calibrate_blading,
    compare_measurements,
    estimate_pitch_offset_prior,
    fit_rotor,
    load_rotor,
    make_rotor,
    prepare_blading,
    solve_rotor_batch,
    solve_system,
)
from mufly.rotor.blades.blade_solid import blade_contours, loft_solid, write_stl
from mufly.rotor.forward import ForwardCondition, solve_forward
from mufly.study.benchmark import load_cases


@pytest.fixture(scope="module")
def blading():
    return prepare_blading(load_rotor("naca4412-r60-c20"))


def test_axial_flow_counts_in_the_mach_number(blading):
    with pytest.raises(InputError, match=r"climb_m_s: 420 m/s is Mach 1\.2"):
        solve_system(RotorSystem.from_single_rotor(blading), OperatingCondition(0.2, 500.0, climb_m_s=420.0))
    with pytest.raises(InputError, match=r"tip Mach number of 1\.0 with -330 m/s"):
        solve_system(RotorSystem.from_single_rotor(blading), OperatingCondition(0.2, 1800.0, climb_m_s=-330.0))
    with pytest.warns(UserWarning, match=r"Mach 0\.88"):
        solve_rotor_batch(blading, pitch_rad=0.2, speed_rad_s=500.0, climb_m_s=300.0)
    with pytest.raises(InputError, match="Mach"):
        solve_forward(blading, ForwardCondition(0.2, 500.0, edgewise_m_s=400.0))


def test_supersonic_tips_are_refused_by_every_method_and_command(blading, tmp_path):
    file, rotor = tmp_path / "b.csv", "naca4412-r60-c20"
    file.write_text("speed_rpm,thrust_N,torque_Nm\n5000,0.3,0.003\n5000000,0.5,0.005\n")
    bench = read_measurements(file)
    for call in (
        lambda: compare_measurements(blading, bench),
        lambda: calibrate_blading(blading, bench, 1),
        lambda: fit_rotor(load_rotor(rotor), bench),
    ):
        with pytest.raises(InputError, match=r"b\.csv: point 2, speed: 5e\+06 rpm .* tip Mach number of 91\.5"):
            call()
    for words in (("hover",), ("forward", "--speed", "3")):
        done = CliRunner().invoke(app, ["rotor", words[0], rotor, "--pitch", "5", "--rpm", "90000", *words[1:]])
        assert str(done.exception).startswith("--rpm: 90000 rpm (9424.78 rad/s) gives a tip Mach number of 1.6; stay")
        assert "not in rpm" not in str(done.exception)
    done = CliRunner().invoke(app, ["rotor", "forward", rotor, "--pitch", "5", "--rpm", "50000", "--speed", "60"])
    assert str(done.exception).startswith("--speed: 60 m/s gives the advancing tip Mach")
    study = ["rotor", "sweep", rotor, "--vary", "speed=5000rpm:90000rpm:85000rpm", "--set", "pitch=5deg", "--json"]
    cases = CliRunner().invoke(app, study).stdout
    assert "90000 rpm (9424.78 rad/s) gives a tip Mach number of 1.6" in cases


@pytest.mark.parametrize("pitch_deg", [-6.0, -5.0, -7.0])
def test_thrust_is_continuous_in_the_climb(blading, pitch_deg):
    climb = np.linspace(-0.01, 0.01, 21)
    out = solve_rotor_batch(blading, pitch_rad=math.radians(pitch_deg), speed_rad_s=480.0, climb_m_s=climb)
    assert np.max(np.abs(np.diff(out.thrust_N))) < 0.003 * np.max(np.abs(out.thrust_N))


def test_thrust_has_no_jumps_over_the_pitch(blading):
    pitch = np.radians(np.arange(-12.0, 12.0, 0.02))
    thrust = solve_rotor_batch(blading, pitch_rad=pitch, speed_rad_s=480.0).thrust_N
    assert np.max(np.abs(np.diff(thrust))) < 0.005 * np.ptp(thrust)


@pytest.mark.parametrize("pitch_deg", [0.0, -3.0])
def test_a_pair_without_load_settles_by_tubes(pitch_deg):
    case = prepare_blading(load_rotor("naca0012-r60-c20"))
    pair = RotorSystem.from_coaxial_pair(case, case, spacing_m=0.03)
    both = solve_system(pair, OperatingCondition(math.radians(pitch_deg), (450.0, 470.0)), "tubes")
    assert both.converged
    assert abs(both.thrust_N) < 0.05
    assert set(both.lower_over_upper) == {"speed", "thrust", "torque", "power"}


def test_a_pair_that_does_not_settle_suggests_a_remedy():
    case = prepare_blading(load_rotor("naca0012-r60-c20"))
    pair = RotorSystem.from_coaxial_pair(case, case, spacing_m=0.03)
    with pytest.raises(Exception, match="raise the pitch, bring the speeds together, or use the method bemt or wake"):
        solve_system(pair, OperatingCondition(math.radians(-8.0), (500.0, 500.0), climb_m_s=1.0), "tubes")


def test_impossible_air_and_chord_are_refused():
    with pytest.raises(InputError, match="density_kg_m3: is 998"):
        Air(density_kg_m3=998.0)
    with pytest.raises(InputError, match="viscosity_Pa_s"):
        Air(viscosity_Pa_s=0.0181)
    with pytest.raises(InputError, match="chord"):
        make_rotor(name="thin", radius_m=0.08, chord_m=3e-5)


def test_grams_of_a_light_rotor_are_not_taken_as_newtons(tmp_path):
    file = tmp_path / "light.csv"  # c_T 0.0004 in grams-force, 0.04 in newtons
    rows = [(n, 0.0004 * 1.2 * math.pi * 0.06**4 * (n * math.pi / 30) ** 2 / 9.80665e-3) for n in (4000, 6000, 8000)]
    file.write_text("rpm,thrust\n" + "\n".join(f"{n},{t:.4f}" for n, t in rows))
    with pytest.raises(InputError, match="N or gf"):
        read_measurements(file, diameter_m=0.12)


def test_a_guessed_unit_is_noted_once(tmp_path):
    file = tmp_path / "grams.csv"
    file.write_text("rpm,thrust\n3100,5.6\n5200,15.9\n")
    notes = read_measurements(file, diameter_m=0.12).notes
    assert [n for n in notes if "no unit" in n] == ["thrust: no unit is written, taken as gf (c_T near 0.011)"]


def test_files_of_uiuc_with_titles_and_without_sizes(tmp_path):
    blade = "r/R c/R beta\n" + "".join(f"{x:.2f} 0.15 {14 - 6 * x:.1f}\n" for x in np.linspace(0.15, 1.0, 8))
    static = "RPM CT CP\n3000 0.11 0.05\n4000 0.11 0.05\n"
    for name in ("maker_5x4", "maker_plain", "maker_6x3"):
        (tmp_path / f"{name}_geom.txt").write_text("MAKER prop blade\n" + blade)
        (tmp_path / f"{name}_static_1.txt").write_text("MAKER 5x4 static\n" + static)
    (tmp_path / "maker_5x4_run_4004.txt").write_text(
        "MAKER 5x4 tunnel 4004\nJ CT CP eta\n0.2 0.1 0.05 0.4\n0.4 0.08 0.05 0.6\n"
    )
    (tmp_path / "maker_6x3_run_4001.txt").write_text("J CT CP eta\n0.2 0.1 oops 0.4\n")
    (tmp_path / "maker_9x5_geom.txt").write_text(blade)
    cases, left_out = load_cases(tmp_path)
    assert [c.name for c in cases] == ["maker_5x4", "maker_6x3"]
    assert cases[0].tunnel_runs[0].thrust_N.size == 2
    said = "\n".join(left_out)
    assert "maker_plain_geom.txt: the file name states no size" in said
    assert "maker_6x3_run_4001.txt" in said
    assert "oops" in said
    assert "maker_9x5_geom.txt: there is no NAME_static_RUN.txt" in said


def test_a_makers_file_and_a_scan_are_preferred_to_photographs(tmp_path):
    blade = "r/R c/R beta\n" + "".join(f"{x:.2f} 0.15 {14 - 6 * x:.1f}\n" for x in np.linspace(0.15, 1.0, 8))
    rows = "".join(f"  {r:.2f} {0.4 - 0.08 * r:.3f} 0.12 {25 - 5 * r:.1f}\n" for r in (0.5, 1.0, 1.5, 2.0, 2.5))
    for name in ("maker_5x4", "maker_5x3", "maker_5x2"):
        (tmp_path / f"{name}_geom.txt").write_text(blade)
        (tmp_path / f"{name}_static_1.txt").write_text("RPM CT CP\n3000 0.11 0.05\n4000 0.11 0.05\n")
    (tmp_path / "maker_5x3.PE0").write_text(f"STATION CHORD THICKNESS TWIST\n{rows}\nRADIUS: 2.50\nBLADES: 2\n")
    scanned = make_rotor(name="s", radius_m=0.0635, chord_m=0.011, twist_rad=0.3, hub_cutout=0.2)
    write_stl(tmp_path / "maker_5x2.stl", loft_solid(blade_contours(scanned, along=20)), "s")
    two, three, four = (c.rotor for c in sorted(load_cases(tmp_path)[0], key=lambda c: c.name))
    assert [r.blade.geometry for r in (two, three, four)] == ["scan", "maker", "photograph"]
    assert float(two.chord_m(0.6)) == pytest.approx(0.011, rel=0.02)
    assert float(two.twist_rad(0.6)) == pytest.approx(0.3, abs=0.01)
    assert float(three.twist_rad(0.8)) == pytest.approx(math.radians(15.0))
    assert estimate_pitch_offset_prior(four).offset_std_rad > 2.0 * estimate_pitch_offset_prior(two).offset_std_rad


def test_apcs_own_files_are_found_by_size_and_series(tmp_path):
    """APC leaves out the point of a size: 42x4 is 4.2x4. A file that fits two propellers is not used."""
    blade = "r/R c/R beta\n" + "".join(f"{x:.2f} 0.15 {14 - 6 * x:.1f}\n" for x in np.linspace(0.15, 1.0, 8))

    def write_apc_file(name, radius_in):
        rows = "".join(f"  {radius_in * x:.3f} {0.3 * radius_in * (1 - 0.5 * x):.3f} 0.12 {25 - 10 * x:.1f}\n"
                       for x in (0.2, 0.4, 0.6, 0.8, 1.0))  # fmt: skip
        (tmp_path / name).write_text(f"STATION CHORD THICKNESS TWIST\n{rows}\nRADIUS: {radius_in}\nBLADES: 2\n")

    for name in ("apcff_4.2x4", "apce_10x5", "apcsf_10x5", "apcsf_10x4.7", "apce_11x5", "apcsp_9x6", "gws_8x4"):
        (tmp_path / f"{name}_geom.txt").write_text(blade)
        (tmp_path / f"{name}_static_1.txt").write_text("RPM CT CP\n3000 0.11 0.05\n4000 0.11 0.05\n")
    for name, radius_in in (
        ("42x4-PERF.PE0", 2.1), ("10x5-PERF.PE0", 5.0), ("10x5E-PERF.PE0", 5.0), ("10x47SF-PERF.PE0", 5.0),
        ("11x5SF-PERF.PE0", 5.5), ("9x6-PERF.PE0", 2.0), ("8x4-PERF.PE0", 4.0),
    ):  # fmt: skip
        write_apc_file(name, radius_in)
    cases, left_out = load_cases(tmp_path)
    assert {c.name: c.rotor.blade.geometry for c in cases} == {
        "apcff_4.2x4": "maker", "apce_10x5": "maker", "apcsf_10x5": "photograph", "apcsf_10x4.7": "maker",
        "apce_11x5": "photograph", "apcsp_9x6": "photograph", "gws_8x4": "photograph",
    }  # fmt: skip
    said = "\n".join(left_out)
    for words in ("apcff_4.2x4: geometry from 42x4-PERF.PE0", "10x5-PERF.PE0: fits apcsf_10x5 and apce_10x5",
                  "11x5SF-PERF.PE0: is of another series", "9x6-PERF.PE0: has a radius of 50.8 mm"):  # fmt: skip
        assert words in said
