"""Order and grid convergence index; thrust over the climb."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest

from mufly.cfd import (
    CfdSolution,
    OperatingPoint,
    compare_climbs,
    draw_climb_comparison,
    estimate_grid_convergence,
    estimate_load_grid_convergence,
    sweep_climb,
)
from mufly.errors import InputError
from mufly.rotor import load_rotor
from mufly.vehicle import load_coefficient_map


@pytest.mark.parametrize("order", [1.0, 1.7, 2.0])
def test_a_made_up_error_gives_back_its_order_and_limit(order: float) -> None:
    cells = [60_000, 350_000, 135_000]
    values = [0.14 + 2.0 * n ** (-order / 3) for n in cells]
    found = estimate_grid_convergence("thrust", cells, values)
    assert found.cells == (350_000, 135_000, 60_000)
    assert found.order == pytest.approx(order, abs=1e-6)
    assert found.extrapolated_value == pytest.approx(0.14, abs=1e-9)
    assert found.sound
    assert found.index == pytest.approx(1.25 * abs(values[1] - 0.14) / values[1], rel=1e-6)


def test_the_published_example_comes_out() -> None:
    # Celik and others (2008), table 1: N 18000, 8000, 4500 in two dimensions, here as cubes of the same ratios.
    cells = [round(1000 * (n / 4500) ** 1.5) for n in (18000, 8000, 4500)]
    found = estimate_grid_convergence("reattachment", cells, [6.063, 5.972, 5.863])
    assert found.order == pytest.approx(1.53, abs=0.02)
    assert found.extrapolated_value == pytest.approx(6.1685, abs=0.003)
    assert found.index == pytest.approx(0.022, abs=0.001)


def test_answers_that_swing_or_stand_are_marked() -> None:
    assert not estimate_grid_convergence("x", [1000, 2000, 4000], [1.0, 1.1, 1.05]).sound
    assert not estimate_grid_convergence("x", [1000, 2000, 4000], [1.1, 1.0, 1.0]).sound
    with pytest.raises(InputError, match="three cases with different meshes"):
        estimate_grid_convergence("x", [1000, 1000, 4000], [1.0, 1.1, 1.05])
    with pytest.raises(InputError, match="not a case of mufly cfd"):
        estimate_load_grid_convergence([Path("nowhere")] * 3)


def solved(climb: float, thrust: float) -> CfdSolution:
    """What a solved case would say of its point and thrust."""
    point = OperatingPoint(
        "naca0012-r60-c20", 2, 0.06, math.radians(12), 500.0, climb, "laminar", "tiny", 1.2, 1.81e-5, 2.3
    )
    return cast(CfdSolution, SimpleNamespace(point=point, verdict=SimpleNamespace(thrust_N=thrust, settled=True)))


def test_thrust_over_the_climb_is_laid_beside_the_flight_models_map() -> None:
    flight = load_coefficient_map("walkera-5g6-bemt")
    found = compare_climbs([solved(1.0, 0.12), solved(-1.0, 0.16), solved(0.0, 0.15), solved(90.0, 0.01)], None, flight)
    assert found.climb_m_s.tolist() == [-1.0, 0.0, 1.0, 90.0]
    assert found.c_T[1] == pytest.approx(0.15 / (1.2 * math.pi * 0.06**2 * (500.0 * 0.06) ** 2))
    assert found.thrust_slope(found.c_T, 1.0) == pytest.approx(-0.04 / 0.15 / 2.0)
    assert math.isnan(found.thrust_slope(found.c_T, 0.5))
    less, hover, more, beyond = found.map_thrust_ratio
    assert less > hover == 1.0 > more
    assert math.isnan(beyond)
    assert draw_climb_comparison(found).axes[0].get_xlabel().startswith("climb")
    faster = replace(solved(1.0, 0.2).point, speed_rad_s=600.0)
    other = cast(CfdSolution, SimpleNamespace(point=faster, verdict=None))
    with pytest.raises(InputError, match="speed_rad_s: differs"):
        compare_climbs([solved(0.0, 0.15), other], None, flight)


def test_a_descent_that_is_too_fast_is_refused_before_anything_is_solved(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="climb: is -5 m/s"):
        sweep_climb(
            tmp_path,
            load_rotor("naca0012-r60-c20"),
            [0.0, -5.0],
            pitch_rad=0.2,
            speed_rad_s=500.0,
            level="tiny",
        )
    assert not list(tmp_path.iterdir())
