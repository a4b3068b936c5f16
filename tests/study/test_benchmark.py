"""The benchmark of rotors: anybody's data, anybody's code, answers that are kept."""

import json
import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mufly.errors import InputError
from mufly.rotor import format_rotor_toml, load_rotor
from mufly.rotor.measured.uncertainty import fit_student_scale, interval_quantile
from mufly.study.benchmark import (
    draw_scores,
    load_cases,
    make_rotor_description,
    parse_code,
    score_codes,
    score_propellers,
    tabulate_by_family,
    tabulate_by_group,
    tabulate_propeller_scores,
)
from mufly.study.benchmark.prediction_codes import compute_n_crit_from_turbulence
from mufly.study.benchmark.propeller_efficiency import compute_efficiency_curve

STATIC = "RPM CT CP\n3000.0 0.10 0.05\n4000.0 0.11 0.05\n5000.0 0.12 0.05\n"
GEOMETRY = "r/R c/R beta\n0.15 0.15 30.0\n0.50 0.20 20.0\n1.00 0.10 10.0\n"
PROGRAM = """
import csv, json, pathlib, sys
folder = pathlib.Path(sys.argv[1])
told = json.loads((folder / "rotor.json").read_text())
points = list(csv.DictReader((folder / "points.csv").open()))
blade = list(csv.DictReader((folder / "blade.csv").open()))
assert len(blade) == len(told["r_m"]) and (folder / (blade[0]["airfoil"] + ".dat")).exists()
with (folder / "answer.csv").open("w") as file:
    print("thrust_N,torque_Nm", file=file)
    for p in points:
        print(f"{1e-7 * float(p['speed_rpm']) ** 2},1e-3", file=file)
"""


@pytest.fixture
def data(tmp_path):
    folder = tmp_path / "data"
    (folder / "rotors").mkdir(parents=True)
    (folder / "volume-2").mkdir()
    for name in ("gwsdd_5x3", "kpf_96x70"):
        (folder / "volume-2" / f"{name}_geom.txt").write_text(GEOMETRY)
        (folder / "volume-2" / f"{name}_static_0123rd.txt").write_text(STATIC)
    (folder / "rotors" / "mine.toml").write_text(format_rotor_toml(load_rotor("naca0012-r60-c20")))
    (folder / "rotors" / "mine.csv").write_text("pitch_deg,speed_rpm,thrust_N,torque_Nm\n12,5000,0.15,\n")
    return folder


def test_sets_lie_in_folders_below_and_static_runs_are_no_tunnel_runs(data):
    (data / "aero").mkdir()
    (data / "aero" / "thesis_table_3_2.csv").write_text("pitch_deg,rpm,thrust_N,torque_Nm\n12,5000,0.151,0.0015\n")
    (data / "volume-2" / "kpf_96x70_static_0001.txt").write_text(STATIC)
    cases, missing = load_cases(data, "table,kpf")
    assert [c.group for c in cases] == ["Table 3.2", "UIUC micro"]
    assert cases[1].measured.thrust_N.size == 6
    assert cases[1].tunnel_runs == ()
    assert not any("static" in text or "table" in text for text in missing)


def half(question):
    """An outside code: thrust by a law, torque not known."""
    speed = np.array(question["speed_rad_s"])
    return 1e-6 * speed**2 * question["radius_m"] / 0.06, np.full(speed.size, np.nan)


def test_data_of_others_and_of_one_s_own(data):
    (data / "volume-2" / "nr640_5_15deg_geom.txt").write_text(GEOMETRY)
    (data / "volume-2" / "nr640_5_15deg_3b_static_0124rd.txt").write_text(STATIC)
    three = load_cases(data, "nr640")[0]
    assert [(c.name, c.rotor.blades, c.section_known, c.rotor.radius_m) for c in three] == [
        ("nr640_5_15deg_3b", 3, True, 0.0635)
    ]
    cases, missing = load_cases(data, "gwsdd,kpf,own")
    assert [(c.name, c.family, c.group) for c in cases] == [
        ("gwsdd_5x3", "GWS", "UIUC micro"), ("kpf_96x70", "KP", "UIUC micro"),
        ("naca0012-r60-c20", "own naca0012-r60-c20", "own"),
    ]  # fmt: skip
    assert_allclose([c.rotor.radius_m for c in cases], [0.0635, 0.048, 0.06])
    assert_allclose(cases[0].measured.thrust_N[0], 0.10 * 1.2 * 50.0**2 * 0.127**4)
    assert any("TM-81232" in line for line in missing)
    assert [c.name for c in load_cases(data, "KPF")[0]] == ["kpf_96x70"]
    with pytest.raises(InputError, match="--only"):
        load_cases(data, "nothing of that name")
    with pytest.raises(InputError, match="not a folder"):
        load_cases(data / "not")


def test_outside_codes_answer_or_say_why_not(data, tmp_path):
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    failing = tmp_path / "failing.py"
    failing.write_text("raise SystemExit('no wind')")
    cases, _ = load_cases(data)
    codes = [
        parse_code(f"mine={__name__}:half"), parse_code(f"run={sys.executable} {program} {{folder}}"),
        parse_code(f"bad={sys.executable} {failing} {{folder}}"),
    ]  # fmt: skip
    scores = score_codes(cases, codes, folder=tmp_path / "out")
    assert_allclose(
        scores[1].case.measured.thrust_N * (1 + scores[1].thrust_error), half(make_rotor_description(cases[1]))[0]
    )
    assert_allclose((1 + scores[3].thrust_error[0]) * cases[0].measured.thrust_N[0], 1e-7 * 3000.0**2)
    assert "no wind" in scores[-1].fault
    rows = tabulate_by_group(scores)
    assert [(r.code, r.group, r.rotors, r.unpredicted) for r in rows[:3]] == [
        ("mine", "UIUC micro", 2, 0), ("mine", "own", 1, 0), ("run", "UIUC micro", 2, 0)
    ]  # fmt: skip
    assert rows[-1].unpredicted == 1
    assert len(tabulate_by_family(scores)) == 9
    assert len(draw_scores(scores).axes) == 2


def test_what_was_answered_is_not_asked_again(data, tmp_path):
    asked = []

    def predict(case):
        asked.append(case.name)
        return parse_code(f"{__name__}:half").predict(case)

    cases, _ = load_cases(data)
    code = parse_code(f"one={__name__}:half")
    mine = type(code)("one", predict)
    first = score_codes(cases, [mine], folder=tmp_path)
    kept = tmp_path / "answers" / "one" / "kpf_96x70.json"
    assert json.loads(kept.read_text())["fault"] == ""
    kept.write_text("{")  # cut off in the middle
    again = score_codes(cases, [mine], folder=tmp_path)
    assert asked == [*(c.name for c in cases), "kpf_96x70"]
    assert_allclose(again[0].thrust_error, first[0].thrust_error)
    score_codes(cases, [mine], points=1, folder=tmp_path)  # another question
    assert len(asked) == 6
    first, second = (score_codes(cases[:1], [parse_code("bemt", n_crit=n)], folder=tmp_path)[0] for n in (0.1, 9.0))
    assert abs(first.thrust_error[0] - second.thrust_error[0]) > 0.01  # nor is another transition taken for the same


@pytest.mark.parametrize("text", ["", "nothing", "no.such.module:f", "mufly.rotor:no_such_name", "a b:c"])
def test_what_is_no_code_is_refused_in_one_line(text):
    with pytest.raises(InputError, match="--code"):
        parse_code(text)


def test_scales_of_intervals_hold_what_they_state():
    rng = np.random.default_rng(41)
    errors = 0.7 * rng.standard_t(3, 4000)
    scale = fit_student_scale(list(errors[:, None]))
    assert scale == pytest.approx(0.7, rel=0.04)
    for level in (0.5, 0.9, 0.95):
        assert np.mean(np.abs(errors) < interval_quantile(level) * scale) == pytest.approx(level, abs=0.015)
    few = [np.array([e]) for e in (0.2, -0.5, 1.1, -1.6)]
    copied = [np.repeat(few[0], 4), np.append(few[1], np.nan), *few[2:], np.array([np.nan])]
    assert fit_student_scale(copied) == fit_student_scale(few)  # a rotor counts once
    many = list(errors[:20, None])
    assert fit_student_scale([*many, np.array([1e3])]) < 1.3 * fit_student_scale(many)  # nor does one rotor decide
    assert fit_student_scale([]) == 1.0


def falling(question):
    """An outside code: c_T = 0.1 (1 - J / 0.7), c_P = 0.05, of propellers, in air of 1.2 kg/m3."""
    n, d = np.array(question["speed_rad_s"]) / (2 * np.pi), 2 * question["radius_m"]
    j = np.array(question["climb_m_s"]) / (n * d)
    return 0.12 * (1 - j / 0.7) * n**2 * d**4, 0.06 * n**2 * d**5 / (2 * np.pi)


def test_runs_in_a_tunnel(data):
    rows = "".join(f"{j:.3f} {0.1 * (1 - j / 0.6):.5f} 0.05 0.5\n" for j in np.linspace(0.1, 0.65, 12))
    (data / "volume-2" / "kpf_96x70_0124rd_8043.txt").write_text("J CT CP eta\n" + rows)
    (data / "volume-2" / "kpf_96x70_static_0124rd.txt").write_text(STATIC)
    cases, _ = load_cases(data, "kpf,gwsdd")
    assert [len(c.tunnel_runs) for c in cases] == [0, 1]
    assert_allclose(cases[1].tunnel_runs[0].speed_rad_s, 8043 * np.pi / 30)
    sys.modules["falling_code"] = type(sys)("falling_code")
    vars(sys.modules["falling_code"])["falling"] = falling
    (score,) = score_propellers(cases, [parse_code("falling_code:falling")])
    # Thrust ends at 0.6 and at 0.7; eta = 2 J (1 - J / J0) has its greatest value, J0 / 2, at J0 / 2.
    assert_allclose(
        [score.measured.zero_thrust_advance_ratio, score.predicted.zero_thrust_advance_ratio],
        [0.6, 0.7],
        rtol=1e-3,
    )
    assert_allclose([score.measured.max_efficiency, score.predicted.max_efficiency], [0.3, 0.35], rtol=1e-3)
    assert_allclose([score.measured.best_advance_ratio, score.predicted.best_advance_ratio], [0.3, 0.35], rtol=2e-2)
    # A tunnel has air of its own; 3 % of turbulence leave no laminar layer.
    assert_allclose(
        [compute_n_crit_from_turbulence(0.001), compute_n_crit_from_turbulence(0.0298)], [8.15, 0.0], atol=0.01
    )
    codes = [
        parse_code("bemt"),
        parse_code("bemt", n_crit=compute_n_crit_from_turbulence(0.001)),
        parse_code("bemt", n_crit=0.1),
    ]
    own, calm, hovering = (s.predicted.zero_thrust_advance_ratio for s in score_propellers(cases, codes))
    assert own == calm != hovering
    (row,) = tabulate_propeller_scores([score])
    assert_allclose(row.size, [1 / 6] * 3, rtol=2e-2)
    # A run that ends before its greatest efficiency says nothing of it.
    j = np.linspace(0.1, 0.2, 5)
    short = compute_efficiency_curve(j, 1 - j / 0.6, np.ones(5), j)
    assert np.isnan([short.max_efficiency, short.best_advance_ratio, short.zero_thrust_advance_ratio]).all()


_INDEX = "name,diameter_m,blades,geometry\ngood_5x3,0.127,2,good_5x3_geom.csv\nodd_5x3,0.127,2,odd_5x3_geom.csv\n"
_ROWS, _RUN = ("0.15,0.15,30", "0.5,0.20,20", "1.0,0.10,10"), "rpm,CT,CP\n3000,0.10,0.05\n4000,0.11,0.05\n"


@pytest.mark.parametrize(
    ("file", "old", "new", "reason"),
    [
        ("odd_5x3_geom.csv", "0.20", "-0.20", "odd_5x3_geom.csv: blade.chord"),
        ("odd_5x3_geom.csv", "0.5,", "0.15,", "odd_5x3_geom.csv: blade.r_over_R: station 2"),
        ("odd_5x3_geom.csv", "0.15,0.15,30", "0.6,0.15,30", "odd_5x3_geom.csv: blade.r_over_R: station 2"),
        ("odd_5x3_geom.csv", "30", "nan", "odd_5x3_geom.csv: line 2, beta: is nan"),
        ("odd_5x3_geom.csv", None, "", "odd_5x3_geom.csv: is empty"),
        ("odd_5x3_static.csv", "4000", "4000x", "line 3, rpm: '4000x' is not a number"),
        ("odd_5x3_static.csv", "0.11", "-0.11", "odd_5x3_static.csv: line 3, CT: is -0.11"),
        ("odd_5x3_static.csv", None, "rpm,CT,CP\n", "odd_5x3_static.csv: contains no measurements"),
        ("index.csv", "2,odd", "2,none", "none_5x3_geom.csv: cannot be read"),
        ("index.csv", "odd_5x3,0.127", "odd_5x3,-0.127", "index.csv: line 3, diameter_m: is -0.127"),
        ("index.csv", "2,odd", "2.5,odd", "index.csv: line 3, blades: is 2.5"),
        ("index.csv", "odd_5x3,0.127", "odd_5x3,5in", "'5in' is not a number"),
    ],
)
def test_an_indexed_rotor_with_a_fault_is_skipped_with_the_reason(tmp_path, file, old, new, reason):
    home = tmp_path / "uiuc_micro"
    home.mkdir()
    (home / "index.csv").write_text(_INDEX)
    for name in ("good_5x3", "odd_5x3"):
        (home / f"{name}_geom.csv").write_text("\n".join(("r/R,c/R,beta", *_ROWS, "")))
        (home / f"{name}_static.csv").write_text(_RUN)
    text = (home / file).read_text()
    (home / file).write_text(new if old is None else text.replace(old, new))
    cases, left_out = load_cases(tmp_path)
    assert [c.name for c in cases] == ["good_5x3"]
    assert [reason in line for line in left_out if line.startswith("odd_5x3")] == [True]
    with pytest.raises(InputError, match=r"--only.*odd_5x3"):
        load_cases(tmp_path, "odd_5x3")


def test_a_folder_without_a_usable_file_gives_the_reasons(tmp_path):
    (tmp_path / "thesis_table_3_2.csv").write_text("pitch_deg,rpm\n12,5000\n")
    for name in ("maker_plain", "maker_0x5", "maker_5x4", "maker_5x3"):
        (tmp_path / f"{name}_geom.txt").write_text(GEOMETRY)
        (tmp_path / f"{name}_static_1.txt").write_text(STATIC)
    (tmp_path / "maker_5x4_geom.txt").write_text("")
    (tmp_path / "maker_5x3_geom.txt").write_text(GEOMETRY.replace("0.50 ", "0.15 "))
    with pytest.raises(InputError) as caught:
        load_cases(tmp_path)
    said = str(caught.value)
    for reason in (
        "thesis_table_3_2.csv: has 2 columns", "maker_plain_geom.txt: the file name states no size",
        "maker_0x5_geom.txt: the file name states no size", "maker_5x4_geom.txt: is empty",
        "maker_5x3_geom.txt: blade.r_over_R",
    ):  # fmt: skip
        assert reason in said
    assert "\n" not in said
