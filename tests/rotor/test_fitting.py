"""A bench run makes a rotor: the truth is found again, said where it cannot be, kept in the file."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from mufly.errors import InputError, MuflyError
from mufly.rotor import (
    Corrections,
    RotorMeasurements,
    compute_polar,
    draw_rotor_fit,
    fit_rotor,
    format_rotor_toml,
    load_rotor,
    make_rotor,
    predict_interval,
    prepare_blading,
    replace_rotor,
    solve_rotor,
    solve_rotor_batch,
)
from mufly.rotor.blading import apply_section_fit
from mufly.rotor.geometry import SectionCandidate
from mufly.study.study_setup import reshape_rotor

RPM = math.pi / 30


def made_by(rotor, rpm, pitch_deg=0.0, noise=0.0, seed=0, torque=True) -> RotorMeasurements:
    """What a bench would say of a rotor."""
    rng, speed = np.random.default_rng(seed), np.array(rpm) * RPM
    pitch = np.radians(np.broadcast_to(pitch_deg, speed.shape))
    out = solve_rotor_batch(prepare_blading(rotor), pitch_rad=pitch, speed_rad_s=speed)
    t, q = (v * (1 + noise * rng.standard_normal(v.shape)) for v in (out.thrust_N, out.torque_Nm))
    return RotorMeasurements(pitch, speed, t, q if torque else np.full(q.shape, np.nan), "made up")


def a_propeller(airfoil):
    return make_rotor(
        name="p", radius_m=0.06, chord_m=[0.008, 0.014, 0.008], twist_rad=np.radians([30.0, 18.0, 9.0]),
        r_over_R=[0.2, 0.5, 1.0], airfoils=airfoil,
    )  # fmt: skip


@pytest.fixture(scope="module")
def swept():
    """A sweep of a rotor with bent plates, fitted by someone who takes them for Clark Y."""
    bench = made_by(a_propeller("naca6503"), np.linspace(3000, 9000, 9), noise=0.01)
    return fit_rotor(a_propeller("clarky"), bench)


def test_bent_plates_come_out_as_bent_plates(swept):
    assert np.abs(swept.scaled_errors_before[0]).mean() > 0.05  # Clark Y will not do
    assert np.abs(swept.scaled_errors_after).max() < 0.03
    assert np.all(swept.held_out < 0.02)
    shares = dict(swept.section_fit.list_sections())
    assert sum(p for name, p in shares.items() if name.endswith(("03", "06"))) > 0.8
    assert sum(p for name, p in shares.items() if name[4] in "468") > 0.9
    assert next(iter(shares)).endswith(("03", "06"))
    assert_allclose(sum(shares.values()), 1.0)
    assert swept.undecided  # nine speeds at one pitch do not tell seven numbers


def test_the_file_says_what_the_fit_said(swept, tmp_path):
    path = tmp_path / "fitted.toml"
    path.write_text(format_rotor_toml(swept.rotor))
    again, m = load_rotor(path), swept.measured
    assert again.fit == swept.section_fit
    out = solve_rotor_batch(prepare_blading(again), pitch_rad=m.pitch_rad, speed_rad_s=m.speed_rad_s)
    assert_allclose(out.thrust_N / m.thrust_N - 1, swept.scaled_errors_after[0], atol=1e-12)
    assert solve_rotor(again, pitch_rad=0.0, speed_rad_s=600.0).calibrated
    with pytest.raises(InputError, match="n_crit"):
        prepare_blading(again, n_crit=9.0)
    # Another section is another rotor: what was said of the first does not hold for it.
    assert replace_rotor(again, {"blade.airfoils": "clarky"}).fit is None
    assert reshape_rotor(again, {"airfoil": "clarky"}).fit is None
    assert reshape_rotor(again, {"radius": 0.07}).fit == replace_rotor(again, {"radius": 0.07}).fit == again.fit


def test_intervals_shrink_with_the_bench_and_widen_away_from_it(swept):
    at = {"pitch_rad": np.radians([0.0, 0.0, 6.0]), "speed_rad_s": np.array([6000, 24000, 6000]) * RPM}
    known, guess = predict_interval(swept.rotor, **at), predict_interval(a_propeller("clarky"), **at)
    half = (known.thrust_high_N - known.thrust_N) / known.thrust_N
    assert half[0] < 0.5 * ((guess.thrust_high_N - guess.thrust_N) / guess.thrust_N)[0]
    assert np.all(half[1:] > 1.5 * half[0])
    assert set(known.thrust_relative_std_by_cause) == {"fit", "section", "scatter", "method"}
    assert known.thrust_relative_std_by_cause["method"][0] == 0.0


def test_truths_lie_inside_the_intervals():
    """Four rotors with sections of their own, one point each: another speed is told with its interval."""
    rng, inside = np.random.default_rng(5), []
    for k in range(4):
        rotor = a_propeller(f"naca{rng.integers(2, 7)}4{rng.integers(6, 13):02d}")
        # What the prior says of engine and method, drawn
        truth = made_by(rotor, [4000.0, 6000.0, 8000.0], pitch_deg=rng.normal(0, 0.5))
        bench = RotorMeasurements(
            np.zeros(1), truth.speed_rad_s[1:2], truth.thrust_N[1:2] * rng.normal(1, 0.01),
            truth.torque_Nm[1:2] * rng.normal(1, 0.01), f"{k}",
        )  # fmt: skip
        fitted = fit_rotor(a_propeller("clarky"), bench).rotor
        band = predict_interval(fitted, pitch_rad=0.0, speed_rad_s=truth.speed_rad_s[[0, 2]])
        t, q = truth.thrust_N[[0, 2]], truth.torque_Nm[[0, 2]]
        inside += [*(np.abs(t - band.thrust_N) < band.thrust_high_N - band.thrust_N)]
        inside += [*(np.abs(q - band.torque_Nm) < band.torque_high_Nm - band.torque_Nm)]
    assert np.sum(inside) >= 13  # of 16


def test_thrust_alone_will_do_and_a_known_section_is_left():
    rotor = load_rotor("naca0012-r60-c20")
    bench = made_by(rotor, [4000.0, 6000.0], pitch_deg=12.0, torque=False)
    found = fit_rotor(rotor, replace(bench, thrust_N=1.05 * bench.thrust_N), section="known")
    assert [name for name, _ in found.section_fit.list_sections()] == ["naca0012"]
    assert np.abs(found.scaled_errors_after[0]).max() < 0.01
    assert np.isnan(found.held_out[1])
    assert "the bench data hardly determine drag" in found.undecided


def test_what_cannot_be_is_said():
    rotor = load_rotor("naca0012-r60-c20")
    bench = made_by(rotor, [4000.0], pitch_deg=12.0)
    with pytest.raises(MuflyError, match="units, pitch, radius"):
        fit_rotor(rotor, replace(bench, thrust_N=30 * bench.thrust_N), section="known")
    # Four times the torque at half the thrust takes more than 4.5 times the drag.
    draggy = replace(bench, thrust_N=0.5 * bench.thrust_N, torque_Nm=4 * bench.torque_Nm)
    with pytest.raises(MuflyError, match="no section with plausible corrections"):
        fit_rotor(rotor, draggy, section="known")
    with pytest.raises(InputError, match="section"):
        fit_rotor(rotor, bench, section="maybe")


def test_a_point_far_from_every_list_is_met():
    """30 % more torque and 20 % less thrust than the known section has: priors do not hold the fit off the point."""
    rotor = load_rotor("naca0012-r60-c20")
    bench = made_by(rotor, [3000.0, 5000.0, 7000.0], pitch_deg=12.0)
    one = replace(bench, thrust_N=0.8 * bench.thrust_N, torque_Nm=1.3 * bench.torque_Nm).select_points(np.array([1]))
    found = fit_rotor(rotor, one, section="known")
    assert np.abs(found.scaled_errors_after).max() < 0.02
    # What drag has more than the polar is the same at every Reynolds number.
    table = compute_polar("naca0012")
    more = apply_section_fit(table, (0.0, 0.0, 0.3, 0.0, 0.0), float(table.reynolds[10])).cd - table.cd
    assert_allclose(more, np.broadcast_to(np.expm1(0.3) * table.cd[10], more.shape), atol=1e-12)


def test_one_speed_says_nothing_of_the_law_over_the_reynolds_number():
    """However far a point is from the prediction, the fit leaves exponents and curvatures as their prior has them."""
    rotor = load_rotor("naca0012-r60-c20")
    bench = made_by(rotor, [5000.0], pitch_deg=12.0)
    one = replace(bench, thrust_N=0.85 * bench.thrust_N, torque_Nm=1.3 * bench.torque_Nm)
    found = fit_rotor(rotor, one, section="known")
    assert np.abs(found.scaled_errors_after).max() < 0.02
    # 30 % more torque, yet the law moves drag by 3 % at most at half and at twice the Reynolds number.
    law, ratio = found.change[3:], np.log(2.0)
    bend = ratio**2 / (1.0 + 0.25 * ratio**2)
    assert max(abs(s * law[1] * ratio + law[3] * bend) for s in (-1.0, 1.0)) < 0.03
    assert max(abs(s * law[0] * ratio + law[2] * bend) for s in (-1.0, 1.0)) < 0.01
    # Lift and drag hold the loads in the middle as the law over the Reynolds number changes.
    there, away = (predict_interval(found.rotor, pitch_rad=bench.pitch_rad, speed_rad_s=n * RPM) for n in (5e3, 1e4))
    parts = [b.torque_relative_std_by_cause["fit"][0] for b in (there, away)]
    assert parts[1] > 1.5 * parts[0]


def test_a_sweep_tells_how_drag_bends_over_the_reynolds_number():
    """Drag that grows to both sides of a Reynolds number, as with a separation bubble: unseen points are met."""
    rotor = load_rotor("naca0012-r60-c20")
    table = compute_polar("naca0012")
    ratio = np.log(table.reynolds / 3e4)
    bent = replace(table, cd=table.cd * np.exp(0.3 * np.minimum(ratio**2, 2.0))[:, None])
    speed, pitch = np.linspace(1500.0, 9000.0, 11) * RPM, np.full(11, math.radians(10.0))
    out = solve_rotor_batch(prepare_blading(rotor, {"naca0012": bent}), pitch_rad=pitch, speed_rad_s=speed)
    bench = RotorMeasurements(pitch, speed, out.thrust_N, out.torque_Nm, "bent drag")
    found = fit_rotor(rotor, bench.select_points(np.arange(0, 11, 2)), section="known")
    rest = bench.select_points(np.arange(1, 11, 2))
    again = solve_rotor_batch(prepare_blading(found.rotor), pitch_rad=rest.pitch_rad, speed_rad_s=rest.speed_rad_s)
    assert np.abs(again.torque_Nm / rest.torque_Nm - 1.0).max() < 0.015
    assert found.change[6] > 2.0 * found.std[6]


def test_a_file_of_five_changes_is_read_as_before():
    """Files without curvatures predict what they predicted; a covariance of another size is refused."""
    fit = fit_rotor(load_rotor("naca0012-r60-c20"), made_by(load_rotor("naca0012-r60-c20"), [5000.0], 12.0)).section_fit
    whole = fit.candidates[0].model_dump()
    short = {**whole, "change": whole["change"][:5], "covariance": [row[:5] for row in whole["covariance"][:5]]}
    candidate = SectionCandidate.model_validate(short)
    table = compute_polar("naca0012")
    with_zeros = apply_section_fit(table, (*candidate.change, 0.0, 0.0), fit.reynolds)
    assert_allclose(apply_section_fit(table, candidate.change, fit.reynolds).cd, with_zeros.cd, rtol=0.0)
    for wrong in ({**short, "covariance": whole["covariance"]}, {**whole, "change": whole["change"][:6]}):
        with pytest.raises(ValueError, match="size of change"):
            SectionCandidate.model_validate(wrong)


def test_a_tunnel_tells_the_angle_from_the_lift_and_what_hover_is():
    """A blade set 1.5 degrees steeper with 15 % less lift: in hover alike, not in a tunnel, where thrust ends."""
    rotor, true = a_propeller("clarky"), Corrections(lift_factor=0.85, drag_factor=1.1)
    speed, turn = 6000.0 * RPM, math.radians(1.5)
    climb = np.linspace(2.0, 11.0, 12)
    out = solve_rotor_batch(
        prepare_blading(rotor, corrections=true), pitch_rad=turn, speed_rad_s=speed, climb_m_s=climb
    )
    assert out.thrust_N[0] > 0.0 > out.thrust_N[-1]
    run = RotorMeasurements(np.zeros(12), np.full(12, speed), out.thrust_N, out.torque_Nm, "tunnel", climb)
    found = fit_rotor(rotor, run, section="known")
    assert np.abs(found.scaled_errors_after).max() < 0.03 < np.abs(found.scaled_errors_before).max()
    assert np.all(found.held_out < 0.03)
    assert abs(found.change[0] - turn) < 2 * found.std[0] < 0.7 * found.prior_std[0]
    assert_allclose(found.section_fit.climb_ratio, climb[[0, -1]] / (0.06 * speed))
    hovering = solve_rotor(prepare_blading(rotor, corrections=true), pitch_rad=turn, speed_rad_s=speed)
    again = solve_rotor(found.rotor, pitch_rad=0.0, speed_rad_s=speed)
    assert_allclose([again.thrust_N / hovering.thrust_N, again.torque_Nm / hovering.torque_Nm], 1.0, atol=0.05)
    at = {"pitch_rad": 0.0, "speed_rad_s": speed}
    inside, outside = (predict_interval(found.rotor, climb_m_s=v, **at) for v in (5.0, 0.0))
    assert outside.thrust_relative_std_by_cause["method"][0] > inside.thrust_relative_std_by_cause["method"][0] == 0.0
    assert draw_rotor_fit(found).axes[0].get_xlabel().startswith("Advance")
