"""Sets of airfoils, ranking, pictures."""

from pathlib import Path

import numpy as np
import pytest

from mufly.errors import InputError
from mufly.rotor import draw_blade, list_database_airfoils, load_airfoil
from mufly.study import (
    TABLE_3_3_AIRFOILS,
    StudySetup,
    draw_parameter_sweep,
    draw_ranking_extremes,
    expand_airfoil_names,
    list_thesis_airfoils,
    rank_airfoils,
    sweep_parameters,
)


def test_the_247_contain_the_eight_once_and_are_sound() -> None:
    names = list_thesis_airfoils()
    assert len(names) == len(set(names)) == 247
    assert names[:8] == list(TABLE_3_3_AIRFOILS.values())
    for name in names:
        assert 0.0 < load_airfoil(name).thickness_ratio < 1.0


def test_the_rule_looks_at_the_alphabet_only() -> None:
    places = [list_database_airfoils().index(name) for name in list_thesis_airfoils()[8:]]
    assert np.all(np.diff(places) > 0)
    assert np.diff(places).max() < 15


def test_sets_can_be_mixed(tmp_path) -> None:
    folder, empty = tmp_path / "some", tmp_path / "empty"
    folder.mkdir()
    empty.mkdir()
    files = [str(folder / f"{name}.dat") for name in "ab"]
    for file in files[::-1]:
        Path(file).write_text("x", encoding="utf-8")
    assert expand_airfoil_names(f"naca0012,{folder},naca0012") == ["naca0012", *files]
    assert len(expand_airfoil_names("database")) == len(list_database_airfoils())
    with pytest.raises(InputError, match="no airfoil file"):
        expand_airfoil_names(str(empty))
    with pytest.raises(InputError, match="none is named"):
        expand_airfoil_names(" , ")


def table(path, drag: float) -> str:
    alpha = np.arange(-20.0, 20.1, 1.0)
    cl = 2 * np.pi * np.sin(np.radians(alpha))
    rows = [f"{a},{c},{drag}" for a, c in zip(alpha, cl, strict=True)]
    path.write_text("\n".join(["alpha_deg,cl,cd", *rows]), encoding="utf-8")
    return str(path)


def test_less_drag_ranks_higher_and_failures_come_last(setup: StudySetup, tmp_path) -> None:
    names = [table(tmp_path / f"drag{int(1000 * d)}.csv", d) for d in (0.05, 0.02, 0.03)]
    free = StudySetup(setup.rotor, setup.drive, {"thrust": 0.4, "gear": "adapted"}, with_outside_share=False)
    ranking = rank_airfoils(free, [names[0], "nonsense", *names[1:]], [0.15, 0.2, 0.25])
    assert ranking.airfoil.values.tolist() == [names[1], names[2], names[0], "nonsense"]
    assert ranking["rank"].values.tolist() == [1, 2, 3, 4]
    assert np.isnan(ranking.thrust_per_power_N_W.values[-1])
    assert "no such airfoil" in ranking.fault.values[-1]
    one = sweep_parameters(free, {"airfoil": [names[1]], "pitch": [0.15, 0.2, 0.25]})
    assert ranking.thrust_per_power_N_W.values[0] == one.thrust_per_power_N_W.values.max()
    assert ranking.pitch.values[0] == one.pitch.values[one.thrust_per_power_N_W.values[0].argmax()]
    assert len(draw_ranking_extremes(ranking).axes) == 1
    with pytest.raises(InputError, match="is not a result"):
        rank_airfoils(free, names, [0.2], by="beauty")


def test_pictures_label_their_axes(setup: StudySetup) -> None:
    data = sweep_parameters(setup, {"chord": [0.015, 0.02], "pitch": [0.1, 0.2, 0.3]})
    axes = draw_parameter_sweep(data, "thrust_per_power_N_W").axes[0]
    assert axes.get_xlabel() == "Pitch setting, added to the twist (deg)"
    assert axes.get_ylabel() == "Thrust per electrical power (N/W)"
    assert [t.get_text() for t in axes.get_legend().get_texts()] == ["15 mm", "20 mm"]
    np.testing.assert_allclose(axes.lines[0].get_xdata(), np.degrees([0.1, 0.2, 0.3]), atol=1e-6)
    with pytest.raises(InputError, match="cannot be drawn"):
        draw_parameter_sweep(data, "beauty")
    many = sweep_parameters(setup, {"chord": np.linspace(0.01, 0.03, 14).tolist(), "pitch": [0.2]})
    with pytest.raises(InputError, match="14 lines"):
        draw_parameter_sweep(many, "power_W")


def test_a_blade_is_drawn_in_millimetres(setup: StudySetup) -> None:
    plan, twist, section = draw_blade(setup.rotor).axes
    assert twist.get_xlabel() == "Radius (mm)"
    assert plan.get_xlim()[1] > 60
    assert section.lines
