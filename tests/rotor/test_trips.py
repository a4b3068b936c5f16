"""Turbulators and rough surfaces: from the rotor file to the polars, and their errors."""

import numpy as np
import pytest

from mufly.errors import InputError
from mufly.rotor import (
    compute_polar,
    format_rotor_toml,
    load_rotor,
    prepare_blading,
    replace_rotor,
    rotor_from_tables,
    solve_rotor,
)
from mufly.study import StudySetup, evaluate_cases

POINT = {"pitch_rad": 0.28, "speed_rad_s": 628.0}


def tripped(**blade):
    tables = load_rotor("naca4412-r60-c20").toml_tables()
    tables["blade"] |= blade
    return rotor_from_tables(tables, "blade.toml")


def place(value):
    return {"value": value, "unit": "1", "source": "measured"}


@pytest.mark.parametrize(
    ("blade", "n_crit", "xtr", "at"),
    [
        ({}, 9.0, (1.0, 1.0), 9.0),
        ({"trip_upper": place(0.5)}, 9.0, (0.5, 1.0), 9.0),
        ({"trip_upper": place(0.5), "trip_lower": place(0.3)}, 0.1, (0.5, 0.3), 0.1),
        ({"surface": "rough"}, 9.0, (0.05, 0.05), 0.1),
        ({"surface": "smooth", "trip_lower": place(0.2)}, 9.0, (1.0, 0.2), 9.0),
    ],
)
def test_keys_reach_the_polars(blade, n_crit, xtr, at):
    rotor = tripped(**blade)
    assert rotor.transition_at_n_crit(n_crit) == (at, xtr)
    table = compute_polar("naca4412", n_crit=at, xtr=xtr)
    by_hand = prepare_blading(tripped(), {"naca4412": table})
    assert np.array_equal(prepare_blading(rotor, n_crit=n_crit).polars.grid, by_hand.polars.grid)
    expected = solve_rotor(by_hand, **POINT).thrust_N
    assert solve_rotor(prepare_blading(rotor, n_crit=n_crit), **POINT).thrust_N == expected


def test_rotors_of_one_batch_keep_their_own_trips():
    clean, trip = tripped(), tripped(trip_upper=place(0.2))
    both = prepare_blading([clean, trip], n_crit=9.0)
    alone = [solve_rotor(prepare_blading(r, n_crit=9.0), **POINT).torque_Nm for r in (clean, trip)]
    assert [solve_rotor(both, which=k, **POINT).torque_Nm for k in (0, 1)] == alone
    assert abs(alone[1] / alone[0] - 1.0) > 0.05


def test_trip_helps_in_quiet_air_and_not_in_a_wake():
    setup = StudySetup(load_rotor("naca4412-r60-c20"), fixed_parameters={"pitch": 0.28, "speed": 628.0})
    cases = [{"trip_upper": x, "n_crit": n} for n in (0.1, 9.0) for x in (1.0, 0.5)]
    merit = evaluate_cases(setup, cases).values["figure_of_merit"]
    assert abs(merit[1] / merit[0] - 1.0) < 0.01
    assert merit[3] / merit[2] - 1.0 > 0.2


def test_trips_survive_a_rotor_file(tmp_path):
    rotor = replace_rotor(load_rotor("naca4412-r60-c20"), {"blade.trip_upper": 0.4, "blade.surface": "rough"})
    file = tmp_path / "r.toml"
    file.write_text(format_rotor_toml(rotor), encoding="utf-8")
    assert load_rotor(file).transition_at_n_crit(9.0) == rotor.transition_at_n_crit(9.0) == (0.1, (0.05, 0.05))
    assert "surface" not in load_rotor("naca4412-r60-c20").toml_tables()["blade"]


@pytest.mark.parametrize(
    ("blade", "words"),
    [
        ({"trip_upper": place(1.5)}, ("blade.trip_upper", "1.5", "at most 1")),
        ({"trip_lower": 0.5}, ("blade.trip_lower", "unit")),
        ({"surface": "sanded"}, ("blade.surface", "sanded")),
    ],
)
def test_faults_are_one_line(blade, words):
    with pytest.raises(InputError) as error:
        tripped(**blade)
    assert "\n" not in str(error.value)
    assert all(word in str(error.value) for word in words)


def test_a_table_of_coefficients_has_no_transition_to_move(tmp_path):
    file = tmp_path / "own.csv"
    file.write_text("alpha_deg,cl,cd\n-10,-0.5,0.05\n0,0.3,0.02\n10,1.1,0.05\n", encoding="utf-8")
    rotor = tripped(airfoils=[str(file)], trip_upper=place(0.5))
    with pytest.raises(InputError, match=r"blade\.trip_upper: cannot move the transition.*delete it"):
        prepare_blading(rotor)
