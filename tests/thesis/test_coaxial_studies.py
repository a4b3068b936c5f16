"""Studies of Sec. 3.4.7: what is asked of both methods at once, on coarse wakes; verdicts; faults; pictures."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from mufly.rotor.wake import WakeSettings
from mufly.thesis import coaxial_studies, list_studies, rotor_figures
from mufly.thesis import coaxial_studies as coaxial_verdicts
from mufly.thesis.claims import TABLE_3_4_VALUES

COARSE = WakeSettings(chord_deg=15, turns=2, far_turns=5, phases=2, core_limit=0.4)


@pytest.fixture(scope="module")
def pairs() -> dict[str, xr.Dataset]:
    return {m: coaxial_studies.compute_equal_speeds(m, (4000, 6000), COARSE) for m in coaxial_studies.COAXIAL_MODELS}


def test_the_studies_of_the_section_are_listed() -> None:
    assert [s.name for s in list_studies() if s.section == "3.4.7"] == [
        "fig-3.43", "fig-3.44", "fig-3.45", "table-3.4",
    ]  # fmt: skip


def test_both_methods_give_the_lower_rotor_about_half_the_thrust(pairs: dict[str, xr.Dataset]) -> None:
    for data in pairs.values():
        assert (data.fault == "").all()
        share = data.lower_thrust_N / data.upper_thrust_N
        assert ((share > 0.4) & (share < 0.65)).all()
        assert (data.lower_torque_Nm < data.upper_torque_Nm).all()
        # One speed for the whole pair: coefficients move with the Reynolds number only.
        np.testing.assert_allclose(data.lower_c_T[0], data.lower_c_T[1], rtol=0.1)
        np.testing.assert_allclose(data.upper_power_W, data.upper_torque_Nm * data.rpm * np.pi / 30, rtol=1e-9)


def test_verdicts_follow_from_the_numbers(pairs: dict[str, xr.Dataset]) -> None:
    data = pairs["wake"].copy(deep=True)
    data["lower_thrust_N"][:] = 0.55 * data.upper_thrust_N.values
    data["lower_torque_Nm"][:] = 0.80 * data.upper_torque_Nm.values
    assert [v.agrees for v in coaxial_verdicts.judge_equal_speeds("wake", data)[:2]] == [True, True]
    data["lower_thrust_N"][0] = 0.65 * data.upper_thrust_N.values[0]
    data["lower_torque_Nm"][0] = np.nan
    data["fault"][0] = "not converged"
    thrust, torque = coaxial_verdicts.judge_equal_speeds("wake", data)[:2]
    assert not thrust.agrees
    assert not torque.agrees
    assert "1 of 2 cases not converged" in thrust.ours


def test_balance_is_a_balance_and_is_judged_by_table_3_4() -> None:
    data = coaxial_studies.compute_equal_torques("full", (14, 16, 18))
    np.testing.assert_allclose(data.lower_torque_Nm, data.upper_torque_Nm, rtol=1e-6)
    assert (np.diff(data.lower_rpm) < 0).all()
    verdicts = {v.claim.text: v for v in coaxial_verdicts.judge_balance("full", data)}
    assert len(verdicts) == 6
    for field, column in (("lower_rpm", 0), ("lower_thrust_N", 1), ("lower_power_W", 2)):
        data[field][:] = [TABLE_3_4_VALUES[p][column] for p in (14, 16, 18)]
    agrees = [v.agrees for v in coaxial_verdicts.judge_balance("full", data)]
    assert agrees[0]
    assert all(agrees[3:])


def test_a_faster_upper_rotor_takes_lift_from_the_lower_one() -> None:
    # In steps of 30 degrees the wakes of 5200 rpm swing by 0.4 % and never settle.
    data = coaxial_studies.compute_one_speed_fixed("wake", (5200, 6000), replace(COARSE, step_deg=24.0))
    c_T = data.lower_c_T
    assert c_T.sel(varied="upper", rpm=5200) > c_T.sel(varied="upper", rpm=6000)
    assert c_T.sel(varied="lower", rpm=5200) < c_T.sel(varied="lower", rpm=6000)
    # Both sweeps pass through the same case, from different wakes.
    first, second = (c_T.sel(varied=v, rpm=6000) for v in ("upper", "lower"))
    np.testing.assert_allclose(first, second, rtol=5e-3)


def test_a_case_that_does_not_converge_says_so() -> None:
    data = coaxial_studies.compute_rotor_spacing(
        "wake", (20,), (6000,), WakeSettings(step_deg=30, turns=2, iterations=3, core_limit=0.4)
    )
    assert "not converged in 3 iterations" in str(data.fault.values[0, 0])
    assert np.isnan(data.lower_thrust_N).all()
    assert not coaxial_verdicts.judge_rotor_spacing("wake", data)[0].agrees


def test_pictures_have_units_and_a_line_for_each_method(pairs: dict[str, xr.Dataset]) -> None:
    figure = rotor_figures.draw_equal_speeds(pairs, "title")
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels[:2] == ["Thrust (N)", "Torque (mN m)"]
    assert all(axes.get_xlabel() == "Speed of both rotors (rev/min)" for axes in figure.axes)
    assert len(figure.axes[2].lines) == 2
