"""Battery functions against closed forms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mufly.drive import interpolate_table, terminal_voltage


@given(
    table=st.lists(st.floats(0, 10), min_size=2, max_size=20),
    fraction=st.floats(-0.5, 1.5),
)
def test_interpolation_is_linear_and_holds_its_ends(table, fraction) -> None:
    values = np.array(table)
    expected = np.interp(fraction, np.linspace(0, 1, len(values)), values)
    assert interpolate_table(values, fraction) == pytest.approx(expected, abs=1e-9)


def test_no_load_no_sag() -> None:
    assert terminal_voltage(8.0, 0.35, 0.0, 0.0, 0.0) == 8.0


def test_constant_current_sags_by_ohms_law() -> None:
    assert terminal_voltage(8.0, 0.35, 0.0, 0.0, 2.0) == pytest.approx(8.0 - 0.7)


def test_a_resistor_divides_the_voltage() -> None:
    assert terminal_voltage(8.0, 0.5, 1 / 1.5, 0.0, 0.0) == pytest.approx(6.0)


@given(
    open_circuit=st.floats(5, 9),
    resistance=st.floats(0, 1),
    conductance=st.floats(0, 2),
    source=st.floats(0, 3),
    electronics=st.floats(0, 1),
)
def test_the_voltage_closes_the_circuit(open_circuit, resistance, conductance, source, electronics) -> None:
    u = terminal_voltage(open_circuit, resistance, conductance, source, electronics)
    current = electronics + conductance * u - source
    assert u == pytest.approx(open_circuit - resistance * current, abs=1e-9)


def test_a_short_circuit_does_not_turn_the_voltage_round() -> None:
    assert terminal_voltage(7.0, 10.0, 0.0, 0.0, 5.0) == 0.0
