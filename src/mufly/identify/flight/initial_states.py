"""Estimation of the initial state of whole records with fixed parameters, over horizons that grow step by step.

A record that begins in motion starts from unmeasured rotor speeds, bar tilt and velocities. The first guess uses
steady motor speeds, a bar normal to the mast and slopes of the smoothed measurement, and is wrong by several per cent.
This error grows over a whole record: height and yaw integrate the rotor forces twice, and position and attitude are
unstable in hover. After 10 s the residuals are no longer linear in the initial state, and least squares on the whole
record end in a wrong minimum. Over 1 s the same residuals are nearly linear. The initial state is therefore fitted
over a horizon of 1 s first. Each solution starts the search over a horizon ``h`` that is 2.5 times as long. An
unstable mode of rate ``a`` then amplifies the remaining error by ``exp(1.5 a h)`` only, not by ``exp(a T)`` over the
record length ``T``. The growing windows of :mod:`mufly.identify.flight.staged_search` have the same reason.

Each search is a Gauss-Newton iteration with the step fraction that lowers the cost most. It has converged if a linear
step predicts a cost decrease below 0.01, a tenth of a standard deviation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mufly.identify.flight.output_error_problem import ACTUATOR_STATES, MOTION_STATES, OutputErrorProblem

_Array = NDArray[np.float64]

MIN_COST_DECREASE = 0.01  # least predicted cost decrease of a step: a tenth of a standard deviation
_FIRST_HORIZON_S, _HORIZON_GROWTH_FACTOR = 1.0, 2.5
_MAX_STEPS_PER_HORIZON = 25
_LINE_SEARCH_FRACTIONS = np.array([1.0, 0.5, 0.2, 0.05, 0.01])  # fractions of a step, evaluated in one batch
_MAX_STATE_STEP_SIGMAS = 0.25  # largest step over the prior standard deviation
_INITIAL_OFFSET_STATES = np.isin(
    np.array(MOTION_STATES + ACTUATOR_STATES),
    ("v_north", "v_east", "speed_up", "speed_dw", "bar_roll", "bar_pitch"),
)


@dataclass(frozen=True, eq=False)
class InitialStates:
    """Initial states found by :func:`find_initial_states`, one entry per record.

    Attributes
    ----------
    initial_states : list of (1, k) array
        Unknown initial states of each record (SI).
    converged : tuple of bool
        Whether the search over the whole record ended in a minimum.
    simulation_count : int
        Number of simulations, in whole records.
    """

    initial_states: list[_Array]
    converged: tuple[bool, ...]
    simulation_count: int


def find_initial_states(problem: OutputErrorProblem, theta: _Array) -> InitialStates:
    """Fit the initial state of every record at ``theta`` (t,); every record must be a single window."""
    states, converged, flown = [], [], 0.0
    for i, r in enumerate(problem.records):
        state = problem.make_zero_initial_states()[i]
        horizon = _FIRST_HORIZON_S
        whole = float(r.time_s[-1] - r.time_s[0])
        while True:
            last = horizon > 0.8 * whole
            state, ended, count = _find_record_initial_state(
                problem if last else problem.truncate_records(horizon), i, theta, state
            )
            flown += count * min(1.0, horizon / whole)
            if last:
                break
            horizon *= _HORIZON_GROWTH_FACTOR
        states.append(state)
        converged.append(ended)
    return InitialStates(states, tuple(converged), round(flown))


def find_initial_offsets(problem: OutputErrorProblem, theta: _Array) -> list[_Array]:
    """Return every record's initial rotor speeds, bar tilts and horizontal velocities
    (``PreparedRecord.initial_state_offset``).

    Windows do not fit these states, because rotors, bar and horizontal velocity continue from one window to the next.
    In a record that begins in motion the steady motor speeds are wrong for the first one or two seconds.
    """
    whole = len(MOTION_STATES) + len(ACTUATOR_STATES)
    opening = problem.truncate_records(_FIRST_HORIZON_S * _HORIZON_GROWTH_FACTOR).with_initial_offset(
        [np.zeros(whole)] * len(problem.prepared_records)
    )
    found, begin = find_initial_states(opening.with_windows(None), theta), []
    for f, s in zip(opening.with_windows(None).prepared_records, found.initial_states, strict=True):
        sought = np.zeros(whole)
        sought[f.sought_state_indices] = s[0]
        # Every window fits the rest of the motion; the voltage of the whole record sets the charge.
        begin.append(np.where(_INITIAL_OFFSET_STATES, sought, 0.0))
    return begin


def _find_record_initial_state(
    problem: OutputErrorProblem, i: int, theta: _Array, state: _Array
) -> tuple[_Array, bool, int]:
    """Return the best initial state (1, k) of record ``i``, whether it is a minimum, and the simulation count."""
    spread, flown = problem.initial_state_std(i), 0

    def start_costs(states: _Array) -> _Array:
        thetas = np.repeat(theta[None], len(states), axis=0)
        e = problem.record_residual(i, thetas, states)
        return 0.5 * np.einsum("bnm,bnm->b", e, e) + 0.5 * np.sum((states / spread) ** 2, axis=(1, 2))

    cost = float(start_costs(state[None])[0])
    for _ in range(_MAX_STEPS_PER_HORIZON):
        e, slope = problem.initial_state_jacobian(i, theta, state)
        flown += 1 + state.shape[1] + len(_LINE_SEARCH_FRACTIONS)
        rows = np.vstack([slope.reshape(-1, len(spread)), np.diag(1.0 / spread)])
        q, r = np.linalg.qr(rows)
        target = q.T @ np.concatenate([e.ravel(), (state / spread).ravel()])
        if 0.5 * float(target @ target) < MIN_COST_DECREASE:
            return state, True, flown
        step = -np.linalg.solve(r, target)
        step *= min(1.0, _MAX_STATE_STEP_SIGMAS / float(np.max(np.abs(step / spread))))
        trials = state + _LINE_SEARCH_FRACTIONS[:, None, None] * step
        found = start_costs(trials)
        k = int(np.argmin(found))
        if not found[k] < cost:
            return state, False, flown
        state, cost = trials[k], float(found[k])
    return state, False, flown
