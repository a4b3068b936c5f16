"""The bracketed root over many cases."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mufly.root_finding import find_rising_root


@given(
    root=st.lists(st.floats(1.0, 1e4), min_size=1, max_size=20),
    power=st.floats(0.3, 4),
    guess=st.floats(0.5, 2e4),
)
def test_powers_are_solved_from_any_guess(root, power, guess) -> None:
    wanted = np.array(root)
    calls = []

    def f(x, case):
        calls.append(case.size)
        return x**power - wanted[case] ** power

    found, good = find_rising_root(f, np.full(wanted.size, guess), lowest=0.1, highest=1e5)
    assert good.all()
    np.testing.assert_allclose(found, wanted, rtol=1e-10)
    assert len(calls) < 80


def test_a_step_is_enclosed() -> None:
    found, good = find_rising_root(lambda x, case: np.where(x > 37.0, 5.0, -1.0), [900.0], lowest=1.0, highest=1e4)
    assert good[0]
    np.testing.assert_allclose(found, 37.0, rtol=1e-10)


def test_no_root_is_said_and_does_not_spoil_the_others() -> None:
    shift = np.array([10.0, 1e9, -5.0, np.nan])
    found, good = find_rising_root(lambda x, case: x - shift[case], np.full(4, 50.0), lowest=1.0, highest=1e3)
    assert good.tolist() == [True, False, False, False]
    assert np.isnan(found[1:]).all()
    np.testing.assert_allclose(found[0], 10.0)


def test_done_cases_are_not_evaluated_again() -> None:
    seen = np.zeros(2, dtype=int)

    def f(x, case):
        seen[case] += 1
        return np.where(case == 0, x - 20.0, np.sign(x - 21.0) * np.abs(x - 21.0) ** 0.2)

    find_rising_root(f, [20.0, 20.0], lowest=1.0, highest=1e3)
    assert seen[0] < 5 < seen[1]
