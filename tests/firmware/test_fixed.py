"""The law in whole numbers: bounded by proof, no margin lost, the same in both languages, and it flies."""

from __future__ import annotations

import math
import shutil
from dataclasses import replace

import numpy as np
import pytest
from fixed_law_reference import FixedPointControllers, sine_cosine_fixed

from mufly.control import design_flight_controller
from mufly.control.implementation import DiscreteController
from mufly.errors import MuflyError
from mufly.estimate import Estimate
from mufly.firmware.fixed_point.fixed_point_design import measure_cascade_margin_loss, quantise_controller, quantise_law
from mufly.firmware.fixed_point.fixed_point_flights import compare_fixed_point_flights
from mufly.firmware.fixed_point.fixed_point_law import FixedPointFirmwareControllers
from mufly.firmware.proof.sil_pil import describe_missing_tools, run_pil
from mufly.flight.controllers import Controllers, copy_record
from mufly.vehicle import load_vehicle

COMPILERS = [name for name in ("gcc", "clang") if shutil.which(name)]
needs_cc = pytest.mark.skipif(not COMPILERS, reason="there is no C compiler on this machine")


@pytest.fixture(scope="module", params=["mufly-1.1", "mufly-2.0"])
def made(request):
    vehicle = load_vehicle(request.param)
    controller = design_flight_controller(vehicle)
    return vehicle, controller, quantise_law(controller)


def test_whole_numbers_cost_no_margin_and_cannot_overflow(made) -> None:
    vehicle, controller, law = made
    assert {one.loop for one in law.chosen_losses} == {"heave-yaw", "roll-pitch", "velocity"}
    for one in (*law.chosen_losses, measure_cascade_margin_loss(vehicle, controller, law)):
        assert one.worst_dB < 0.1, one
    for c in law.controllers:
        assert c.proof.is_overflow_free
        assert 0.0 < c.proof.max_pole_magnitude < 1.0
        assert np.abs(c.update_rows.coefficients).max() <= 32767


def _worst(controller, c):
    """Inputs that drive each state of the stable form as far as inputs within the limits can, one after another."""
    n, m = len(c.state_fraction_bits), len(c.output_rows.coefficients[0]) - len(c.state_fraction_bits)
    A = c.update_rows.quantised_values[:, :n] + np.eye(n) * c.is_delta_form
    B, M = c.update_rows.quantised_values[:, n : n + m], c.update_rows.quantised_values[:, n + m :]
    C, D = c.output_rows.quantised_values[:, :n], c.output_rows.quantised_values[:, n:]
    inputs, power, found = np.hstack([B - M @ D, M]), np.eye(n), []
    F = A - M @ C
    for _ in range(3000):
        found.append(power @ inputs)
        power = power @ F
    return np.array(found)[::-1]


def test_the_bound_is_reached_nearly_and_never_passed(made) -> None:
    """The worst inputs, made from the impulse responses, fill the bound of a state to most of it."""
    from mufly.firmware.fixed_point.fixed_point_design import ACTUATION_LIMITS, ERROR_LIMITS

    _, controller, law = made
    c = law.roll_pitch
    most = np.array([*ERROR_LIMITS["roll_pitch"], *[ACTUATION_LIMITS["roll_pitch"]] * 2])
    responses = _worst(controller, c)
    reached = np.sum(np.abs(responses) * most, axis=(0, 2))
    bound = c.proof.state_bound_shares * 2.0 ** (31 - np.array(c.state_fraction_bits))
    assert np.all(reached < bound)
    # The rest is rounding and the state it engages with.
    assert np.all(reached > 0.2 * bound)


def test_what_has_no_bound_is_refused(made) -> None:
    """Without an anti-windup the integrators' states grow for ever while the actuators saturate."""
    _, controller, _ = made
    gains = copy_record(controller.heave_yaw_gains)
    gains["F"][0, 0] = 0.0
    gains["M"][:] = 0.0
    with pytest.raises(MuflyError, match="no bound"):
        quantise_controller("heave_yaw", gains)


def _estimate(rng, size) -> Estimate:
    position, velocity, attitude, rates = rng.normal(0.0, size, (4, 3))
    return Estimate(0.0, position, velocity, attitude, rates, np.zeros(8), float(rng.uniform(5.0, 9.0)))


def _both(one, other, seed, periods, size):
    rng = np.random.default_rng(seed)
    start, motors = _estimate(rng, size), rng.uniform(0.0, 1.0, 2)
    for c in (one, other):
        c.engage_heave_yaw(start, motors)
        c.engage_roll_pitch(start)
    tilt = np.zeros(2)
    for k in range(periods):
        now, wanted = _estimate(rng, size), rng.normal(0.0, size, 4)
        if k % 4 == 0:
            path = rng.normal(0.0, size, (3, 3))
            tilts = [c.compute_tilt_command(now, *path) for c in (one, other)]
            yield tilts
            tilt = tilts[0]
        yield [c.step(now, wanted, tilt if k > 3 else None).input_array for c in (one, other)]


@needs_cc
@pytest.mark.parametrize("cc", COMPILERS)
def test_c_is_python_bit_for_bit_whatever_is_asked(made, cc) -> None:
    """Inputs up to the end of 32 bits, where Python would raise if a sum passed 64."""
    _, controller, law = made
    for seed, size in enumerate((1e-3, 0.1, 3.0, 1e3, 1e7)):
        one, two = (
            FixedPointControllers(controller, law),
            FixedPointFirmwareControllers(controller, law, cc=cc),
        )
        if size == 3.0:  # and with numbers changed in flight
            gains = copy_record(controller.heave_yaw_gains)
            gains["heave_acceleration"] *= 1.5
            for c in (one, two):
                c.retune_gains(replace(controller, heave_yaw_gains=gains))
        for a, b in _both(one, two, seed, 120, size):
            assert a.tobytes() == b.tobytes()
            assert np.abs(a).max() <= 1.0
        assert one.overflow_count == two.overflow_count == 0


def test_it_computes_what_the_law_does(made) -> None:
    """Beside the law in double precision, for a second of small errors: within 2e-4 of the full range."""
    _, controller, law = made
    off = [
        np.abs(a - b).max()
        for a, b in _both(Controllers(controller), FixedPointControllers(controller, law), 0, 200, 0.01)
    ]
    assert 0.0 < max(off) < 2e-4


def test_sine_and_cosine_of_whole_angles() -> None:
    for angle in [
        0,
        1,
        -1,
        2**31 - 1,
        -(2**31),
        *np.random.default_rng(0).integers(-(2**31), 2**31, 500).tolist(),
    ]:
        s, c = sine_cosine_fixed(angle)
        assert abs(s / 2**30 - math.sin(angle / 2**20)) < 5e-9
        assert abs(c / 2**30 - math.cos(angle / 2**20)) < 5e-9


def test_rounded_numbers_are_those_analysed(made) -> None:
    """The system put into the loop is the whole numbers over their powers of two, in coordinates of the states."""
    _, controller, law = made
    c = law.roll_pitch
    exact: DiscreteController = controller.roll_pitch.discrete
    system = c.to_state_space(exact)
    n = len(c.state_fraction_bits)
    for rows, value, bits in (
        (c.update_rows, c.update_rows.quantised_values, np.array(c.state_fraction_bits)),
        (c.output_rows, c.output_rows.quantised_values, np.full(2, 20)),
    ):
        fractions = np.concatenate([c.state_fraction_bits, np.full(4, 20), [16, 16]])[: rows.coefficients.shape[1]]
        told = rows.coefficients * 2.0**rows.left_shift * 2.0 ** -rows.right_shift[:, None].astype(float)
        told = told * 2.0 ** (fractions[None, :] - bits[:, None])
        assert np.allclose(told, value, rtol=1e-12)
    assert system.A.shape == (n, n)


@pytest.mark.skipif(bool(describe_missing_tools()) or not COMPILERS, reason=describe_missing_tools() or "no C compiler")
def test_processors_without_a_floating_unit_compute_the_same() -> None:
    results = run_pil(load_vehicle("mufly-1.1"), fixed_point=True).processors
    assert [r.machine for r in results] == [
        "mps2-an385 (cortex-m3)", "mps2-an386 (cortex-m4)", "microbit (cortex-m0)"
    ]  # fmt: skip
    for r in results:
        assert r.same
        assert 3000 < r.mean_instructions < r.worst_instructions < 50_000
        assert r.flash_bytes < 16_000
        assert r.ram_bytes == 0
        assert 100 < r.stack_bytes < 1000


@needs_cc
def test_it_flies_the_mission_and_nothing_overflows() -> None:
    (one,) = compare_fixed_point_flights(load_vehicle("mufly-1.1"), ["box-on-leg"]).flights
    assert one.outcome == "succeeded"
    assert one.overflows == 0
    assert one.periods > 5000
    assert 0.0 < one.max_distance_m < 0.01
