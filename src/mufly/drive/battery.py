"""Battery: open-circuit voltage over charge, internal resistance, and the loads that hang on it.

Loads are the electronics (constant current ``I_el``) and motors that draw ``duty * I_A`` (see ``motor.py``). The
supply current is linear in the terminal voltage, so voltage and current follow in closed form (own derivation)::

    I = I_el + G U - S,   G = sum(duty^2) / R,   S = sum(duty * kE * i * Omega) / R
    U = U_oc - R_bat I    =>   U = (U_oc + R_bat (S - I_el)) / (1 + R_bat G)
"""

from __future__ import annotations

from numba import njit

__all__ = ["interpolate", "terminal_voltage"]


@njit(cache=True, error_model="numpy")
def interpolate(table, fraction):  # type: ignore[no-untyped-def]
    """Interpolate ``table`` (n values at equal steps from 0 to 1) linearly; the ends hold outside."""
    last = table.shape[0] - 1
    position = min(max(fraction, 0.0), 1.0) * last
    k = min(int(position), last - 1)
    return table[k] + (position - k) * (table[k + 1] - table[k])


@njit(cache=True, error_model="numpy")
def terminal_voltage(open_circuit, resistance, conductance, source_current, electronics_current):  # type: ignore[no-untyped-def]
    """Return the terminal voltage (V) under load; never below zero (equation above)."""
    voltage = (open_circuit + resistance * (source_current - electronics_current)) / (
        1.0 + resistance * conductance
    )
    return max(voltage, 0.0)
