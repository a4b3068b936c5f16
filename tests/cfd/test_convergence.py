"""Order and grid convergence index."""

from __future__ import annotations

from pathlib import Path

import pytest

from mufly.cfd import convergence, mesh_study
from mufly.errors import InputError


@pytest.mark.parametrize("order", [1.0, 1.7, 2.0])
def test_a_made_up_error_gives_back_its_order_and_limit(order: float) -> None:
    cells = [60_000, 350_000, 135_000]
    values = [0.14 + 2.0 * n ** (-order / 3) for n in cells]
    found = convergence("thrust", cells, values)
    assert found.cells == (350_000, 135_000, 60_000)
    assert found.order == pytest.approx(order, abs=1e-6)
    assert found.limit == pytest.approx(0.14, abs=1e-9)
    assert found.sound
    assert found.index == pytest.approx(1.25 * abs(values[1] - 0.14) / values[1], rel=1e-6)


def test_the_published_example_comes_out() -> None:
    # Celik and others (2008), table 1: N 18000, 8000, 4500 in two dimensions, here as cubes of the same ratios.
    cells = [round(1000 * (n / 4500) ** 1.5) for n in (18000, 8000, 4500)]
    found = convergence("reattachment", cells, [6.063, 5.972, 5.863])
    assert found.order == pytest.approx(1.53, abs=0.02)
    assert found.limit == pytest.approx(6.1685, abs=0.003)
    assert found.index == pytest.approx(0.022, abs=0.001)


def test_answers_that_swing_or_stand_are_marked() -> None:
    assert not convergence("x", [1000, 2000, 4000], [1.0, 1.1, 1.05]).sound
    assert not convergence("x", [1000, 2000, 4000], [1.1, 1.0, 1.0]).sound
    with pytest.raises(InputError, match="three cases of three meshes"):
        convergence("x", [1000, 1000, 4000], [1.0, 1.1, 1.05])
    with pytest.raises(InputError, match="no case of mufly cfd"):
        mesh_study([Path("nowhere")] * 3)
