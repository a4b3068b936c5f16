from __future__ import annotations

import numpy as np
import pytest

from mufly.control import FlightController, hinfsyn, reduce_controller
from mufly.control.synthesis.weighting_schemes import scale_plant
from mufly.errors import MuflyError


def problem(controller: FlightController):
    d = controller.heave_yaw
    result = hinfsyn(d.generalised_plant, 5, 2, relaxation=controller.settings.heave_yaw_relaxation)
    return (
        d.generalised_plant,
        result.controller,
        result.anti_windup_matrix,
        scale_plant(d.plant, d.scaling),
        d.error_inputs,
    )


def test_orders_and_loops_of_the_designs(controller: FlightController) -> None:
    for d, most in ((controller.heave_yaw, 10), (controller.roll_pitch, 8)):
        assert d.reduced.nstates <= most
        assert d.reduction.chosen.meets_tolerance
        assert d.reduced_loop.sensitivity_peak_dB <= d.full_loop.sensitivity_peak_dB + d.reduction.tolerance_dB + 0.02
        assert (
            d.reduced_loop.complementary_peak_dB <= d.full_loop.complementary_peak_dB + d.reduction.tolerance_dB + 0.02
        )
        allowed = {
            0.1: 1.01,
            0.2: 1.05,
            0.5: 1.2,
        }  # dB of the peaks: factor of the norm, as docs/explanation/control.md has them
        assert d.reduction.norm_factor == allowed[d.reduction.tolerance_dB]
        chosen = d.reduction.chosen
        assert chosen.norm <= d.reduction.norm_factor * d.reduction.full_norm
        # Roll-pitch has two whose norms differ in the fifteenth digit: rounding is not to choose among them.
        rivals = [c for c in d.reduction.candidates if c.meets_tolerance and c.order == chosen.order]
        assert chosen.method == next(c.method for c in rivals if c.norm <= chosen.norm * (1.0 + 1e-7))


def test_plain_truncation_ruins_what_matching_keeps(controller: FlightController) -> None:
    G, K, M, plant, rows = problem(controller)
    reduction = reduce_controller(G, K, M, plant, rows, order_min=10, order_max=10, tolerances=((1.0, 2.0),))
    by_method = {c.method: c for c in reduction.candidates if c.kept_modes == 2}
    assert not by_method["open truncate"].norm < 5 * reduction.full_norm
    assert by_method["open match"].norm < 1.1 * reduction.full_norm


def test_slow_modes_are_kept_exactly(controller: FlightController) -> None:
    full, small = controller.heave_yaw.controller.poles(), controller.heave_yaw.reduced.poles()
    slow = np.sort(full[np.abs(full) < 0.1].real)
    np.testing.assert_allclose(np.sort(small[np.abs(small) < 0.1].real), slow, rtol=1e-6)


def test_full_order_reproduces_the_controller(controller: FlightController) -> None:
    G, K, M, plant, rows = problem(controller)
    same = reduce_controller(G, K, M, plant, rows, order_min=K.nstates, order_max=K.nstates)
    frequency = np.geomspace(1e-2, 1e3, 20)
    for w in frequency:
        np.testing.assert_allclose(same.controller(1j * w), K(1j * w), rtol=1e-5, atol=1e-8)


def test_too_small_an_order_says_what_was_nearest(controller: FlightController) -> None:
    G, K, M, plant, rows = problem(controller)
    with pytest.raises(
        MuflyError, match=r"no controller of order 3 or less is within the tolerance \(full order 19.*nearest"
    ):
        reduce_controller(G, K, M, plant, rows, order_max=3)
