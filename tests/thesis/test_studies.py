"""Studies of the dissertation: which there are, what they claim, what is known to come out."""

import json

import numpy as np
import pytest

from mufly.errors import InputError
from mufly.thesis import CLAIMS, run_study, studies
from mufly.thesis.claims import TABLE_3_3_VALUES
from mufly.thesis.single import SWEEPS

SINGLE_ROTOR = [f"fig-3.{n}" for n in (7, 25, 26, 27, 28, 29, 30, 31, 32, 33, 34, 35, 36)] + ["table-3.3"]


def test_every_study_of_the_sections_is_there() -> None:
    assert {s.name for s in studies()} == {*SINGLE_ROTOR, "fig-3.43", "fig-3.44", "fig-3.45", "table-3.4"}
    sections = [s.section for s in studies()]
    assert sections == sorted(sections)


def test_unknown_study_is_named() -> None:
    with pytest.raises(InputError, match=r"fig-9\.9: is no study; use one of: fig-3\.7"):
        run_study("fig-9.9")


def test_gear_study_agrees_at_the_voltage_of_the_linear_model() -> None:
    outcome = run_study("fig-3.7")
    at = {(v.claim.text, v.model[-5:]): v.agrees for v in outcome.verdicts}
    thrust = CLAIMS["gear-thrust"].text
    assert all(agrees for (text, volt), agrees in at.items() if volt == "6.4 V")
    assert not at[(thrust, "7.2 V")]


@pytest.mark.parametrize("name", ["fig-3.28", "fig-3.31", "fig-3.36"])
def test_sweeps_have_the_dissertations_axes(name: str, tmp_path) -> None:
    outcome = run_study(name)
    left, right = outcome.figure.axes
    assert left.get_xlim() == (6, 20)
    assert left.get_ylabel() == "Thrust / electrical power (N/W)"
    assert [t.get_text() for t in left.get_legend().get_texts()] == list(SWEEPS[name].labels)
    assert len(right.lines) == len(SWEEPS[name].values)
    for data in outcome.data.values():
        assert (data.fault == "").all()
        np.testing.assert_allclose(data.thrust_N, 0.4, rtol=1e-9)
    files = {f.name for f in outcome.write(tmp_path)}
    assert {f"{name}.png", f"{name}.json", f"{name}-full.csv", f"{name}-thesis.nc"} <= files
    note = json.loads((tmp_path / f"{name}.json").read_text())
    assert len(note["verdicts"]) == len(outcome.verdicts)


def test_every_claim_of_a_number_is_judged_with_numbers() -> None:
    for name in ("fig-3.26", "fig-3.30", "fig-3.35"):
        for verdict in run_study(name).verdicts:
            assert any(c.isdigit() for c in verdict.ours)
            assert verdict.line().startswith(("agrees", "DIFFERS"))


def test_table_3_3_is_consistent_with_its_thrust() -> None:
    # Thrust per power times power is the desired thrust of Sec. 3.4, to the digits printed.
    for _, per_power, power in TABLE_3_3_VALUES.values():
        assert per_power * power == pytest.approx(0.4, rel=5e-3)


def test_the_dissertations_own_theory_gives_its_four_best_airfoils() -> None:
    from mufly.study import TABLE_3_3, sweep
    from mufly.thesis.single import PITCH_DEG, standard_setup

    best = list(TABLE_3_3_VALUES)[:4]
    pitch = [float(p) for p in np.radians(PITCH_DEG)]
    data = sweep(standard_setup("thesis"), {"airfoil": [TABLE_3_3[n] for n in best], "pitch": pitch})
    ours = data.thrust_per_power_N_W.max("pitch").values
    np.testing.assert_allclose(ours, [TABLE_3_3_VALUES[n][1] for n in best], rtol=0.03)
