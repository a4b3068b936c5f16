"""Reading a table: exact at its points, smooth between, clamped beyond, the same alone and in a stack."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mufly.errors import MuflyError
from mufly.rotor import PolarTable, extrapolation_flags, lookup_lift_drag, stack_polars
from mufly.rotor.sections.polar_table import (
    ALPHA_GRID,
    OUTSIDE_ALPHA_BIT,
    OUTSIDE_REYNOLDS_BIT,
    interpolate_polar_stack,
    lookup_moment,
)


def table(name="wave", n_re=9, low=2e3, high=3e5, shift=0.0, alpha=ALPHA_GRID):
    """Smooth and periodic: c_l = sin(2 a - shift) (1 + x), c_d = 1.2 - cos(2 a) + x/10 with x = ln(Re/1e4)/10."""
    re = np.geomspace(low, high, n_re)
    x = np.log(re / 1e4)[:, None] / 10
    valid = np.deg2rad(np.column_stack((np.linspace(-12, -10, n_re), np.linspace(14, 16, n_re))))
    return PolarTable(
        name, alpha, re, np.sin(2 * alpha - shift) * (1 + x), 1.2 - np.cos(2 * alpha) + x / 10,
        -0.05 * np.cos(alpha) * (1 + x), valid, "formula",
    )  # fmt: skip


WAVE = table()
ANGLES = st.floats(-20.0, 20.0)
REYNOLDS = st.floats(2.0e3, 3.0e5)


def test_table_points_are_returned_exactly():
    for j, re in enumerate(WAVE.reynolds):
        cl, cd = lookup_lift_drag(WAVE, WAVE.alpha_rad, re)
        assert np.allclose(cl, WAVE.cl[j], atol=1e-12)
        assert np.allclose(cd, WAVE.cd[j], atol=1e-12)


@given(ANGLES, REYNOLDS)
def test_between_points_the_error_is_that_of_the_cubic(alpha, re):
    """The function is linear in ln Re, so only the cubic errs: below h^3 |c'''| with h half a degree."""
    x = math.log(re / 1e4) / 10
    cl, cd = lookup_lift_drag(WAVE, alpha, re)
    assert cl == pytest.approx(math.sin(2 * alpha) * (1 + x), abs=1e-6)
    assert cd == pytest.approx(1.2 - math.cos(2 * alpha) + x / 10, abs=1e-6)
    assert lookup_moment(WAVE, alpha, re) == pytest.approx(-0.05 * math.cos(alpha) * (1 + x), abs=1e-6)


@given(ANGLES, st.integers(-3, 3), REYNOLDS)
def test_whole_turns_do_not_matter(alpha, turns, re):
    assert np.allclose(
        lookup_lift_drag(WAVE, alpha, re), lookup_lift_drag(WAVE, alpha + 2 * math.pi * turns, re), atol=1e-10
    )


@given(st.integers(0, 719), REYNOLDS)
def test_slope_is_continuous_at_table_points(i, re):
    rough = PolarTable(
        "rough", ALPHA_GRID, WAVE.reynolds, np.abs(WAVE.cl), WAVE.cd, WAVE.cm, WAVE.alpha_valid_rad, "kinked"
    )
    a, h = ALPHA_GRID[i], 1e-6
    (left, here, right), _ = lookup_lift_drag(rough, a + np.array([-h, 0.0, h]), re)
    assert right - here == pytest.approx(here - left, abs=5e-9)  # a kink would show as 4e-6


def test_beyond_its_reynolds_numbers_a_table_is_clamped_and_says_so():
    a = np.deg2rad([-5.0, 5.0, 40.0])
    assert np.allclose(lookup_lift_drag(WAVE, a, 10.0), lookup_lift_drag(WAVE, a, 2e3))
    assert np.allclose(lookup_lift_drag(WAVE, a, 1e7), lookup_lift_drag(WAVE, a, 3e5))
    both = OUTSIDE_ALPHA_BIT | OUTSIDE_REYNOLDS_BIT
    assert extrapolation_flags(WAVE, a, 10.0).tolist() == [OUTSIDE_REYNOLDS_BIT, OUTSIDE_REYNOLDS_BIT, both]
    assert extrapolation_flags(WAVE, a, 1e4).tolist() == [0, 0, OUTSIDE_ALPHA_BIT]
    assert extrapolation_flags(WAVE, np.deg2rad([14.0, 16.0]), [2e3, 3e5]).tolist() == [0, 0]
    assert extrapolation_flags(WAVE, np.deg2rad([15.0, 15.0]), [2e3, 3e5]).tolist() == [OUTSIDE_ALPHA_BIT, 0]
    assert extrapolation_flags(WAVE, 2 * math.pi, 1e4) == 0


def test_stack_reads_like_its_tables():
    tables = [WAVE, table("shifted", shift=0.3), table("coarse", n_re=3, low=1e4, high=1e5)]
    stack = stack_polars(tables)
    rng = np.random.default_rng(0)
    for k, t in enumerate(tables):
        for a, re in zip(rng.uniform(-4, 4, 50), np.exp(rng.uniform(math.log(2e3), math.log(3e5), 50)), strict=True):
            got = interpolate_polar_stack(stack, k, a, math.log(re))
            # Where a table of another range is clamped, its edge falls between the points of the common grid.
            assert np.allclose(got, lookup_lift_drag(t, a, re), atol=1e-9 if k < 2 else 0.02)
    assert np.allclose(stack.log_reynolds_limits[2], np.log([1e4, 1e5]))


def test_arrays_read_like_numbers():
    a, re = np.linspace(-3, 3, 7)[:, None], np.array([1e3, 5e3, 1e5])
    cl, cd = lookup_lift_drag(WAVE, a, re)
    assert cl.shape == cd.shape == (7, 3)
    for i in range(7):
        for j in range(3):
            assert np.allclose((cl[i, j], cd[i, j]), lookup_lift_drag(WAVE, a[i, 0], re[j]), atol=0)


def test_one_reynolds_number_is_a_table_too():
    single = table(n_re=2)
    one = PolarTable(
        "one", ALPHA_GRID, single.reynolds[:1], single.cl[:1], single.cd[:1], single.cm[:1],
        single.alpha_valid_rad[:1], "",
    )  # fmt: skip
    assert np.allclose(lookup_lift_drag(one, 0.1, [1e2, 1e6])[0], lookup_lift_drag(single, 0.1, 2e3)[0])
    assert stack_polars([one]).rows_per_log_reynolds == 0.0


def test_unsound_tables_are_refused():
    with pytest.raises(MuflyError, match="grid of half a degree"):
        table(alpha=np.linspace(-1, 1, 721))
    with pytest.raises(MuflyError, match="geometric progression"):
        PolarTable("x", ALPHA_GRID, np.linspace(1, 9, 9), WAVE.cl, WAVE.cd, WAVE.cm, WAVE.alpha_valid_rad, "")
    with pytest.raises(MuflyError, match="finite arrays"):
        PolarTable("x", ALPHA_GRID, WAVE.reynolds, WAVE.cl * np.nan, WAVE.cd, WAVE.cm, WAVE.alpha_valid_rad, "")
    with pytest.raises(MuflyError, match="has to be finite"):
        lookup_lift_drag(WAVE, math.nan, 1e4)
    with pytest.raises(MuflyError, match="no polar given"):
        stack_polars([])
