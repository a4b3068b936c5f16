"""The motion at the start of a whole record, with the parameters held: horizons that grow.

A record that begins while inputs move starts from rotor speeds, a bar and velocities that nobody measured. The guess
(speeds at which the motors would settle, a bar square to the mast, slopes of the smoothed measurement) is then off by
several per cent, and over a whole record that error does not stay small: height and yaw integrate the rotors' forces
twice, place and attitude are unstable in hover. After ten seconds the flight has left the region in which residuals are
linear in the start (it may have turned over), and least squares on the whole record end in a minimum that has nothing
to do with the flight. Over a second the same residuals are all but linear. So starts are sought over a horizon of 1 s
first, and each solution starts the search over a horizon 2.5 times as long (continuation in the horizon; the same
reason as for the windows that grow in :mod:`mufly.identify.flight.flight_fit`): by then the start is known to the noise
of the shorter horizon, and an unstable mode of rate ``a`` grows by ``exp(1.5 a h)`` over the step, not by ``exp(a T)``.

Each search is Gauss and Newton's, with the part of a step that lowers the cost most. It has converged where a linear
step promises no more than a hundredth of cost, a tenth of a standard deviation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mufly.identify.flight.output_error_problem import ACTUATOR_STATES, MOTION_STATES, OutputErrorProblem

_Array = NDArray[np.float64]

MIN_COST_DECREASE = 0.01  # of cost: a tenth of a standard deviation
_FIRST_HORIZON_S, _HORIZON_GROWTH = 1.0, 2.5
_MAX_STEPS_PER_HORIZON = 25  # at most, a horizon
_STEP_FRACTIONS = np.array([1.0, 0.5, 0.2, 0.05, 0.01])  # of a step, tried at once
_MAX_STATE_STEP = 0.25  # of the spread, a step at most
_CONTINUOUS_STATES = np.isin(
    np.array(MOTION_STATES + ACTUATOR_STATES),
    ("v_north", "v_east", "speed_up", "speed_dw", "bar_roll", "bar_pitch"),
)


@dataclass(frozen=True, eq=False)
class InitialStates:
    """What :func:`find_initial_states` returns, one entry a record.

    Attributes
    ----------
    initial_states : list of (1, k) array
    converged : tuple of bool
        Whether the search over the whole record ended in a minimum.
    simulation_count : int
        Flights simulated, in whole records.
    """

    initial_states: list[_Array]
    converged: tuple[bool, ...]
    simulation_count: int


def find_initial_states(problem: OutputErrorProblem, theta: _Array) -> InitialStates:
    """Seek the start of every record at ``theta`` (t,); the problem's records are one window each."""
    states, converged, flown = [], [], 0.0
    for i, r in enumerate(problem.records):
        state, horizon, whole = (
            problem.zero_initial_states()[i],
            _FIRST_HORIZON_S,
            float(r.time_s[-1] - r.time_s[0]),
        )
        while True:
            last = horizon > 0.8 * whole
            state, ended, count = _find_record_start(
                problem if last else problem.truncate_records(horizon), i, theta, state
            )
            flown += count * min(1.0, horizon / whole)
            if last:
                break
            horizon *= _HORIZON_GROWTH
        states.append(state)
        converged.append(ended)
    return InitialStates(states, tuple(converged), round(flown))


def find_initial_offsets(problem: OutputErrorProblem, theta: _Array) -> list[_Array]:
    """Return the rotors' speeds, the bars and the drift with which records begin, for windows:
    ``PreparedRecord.begin``.

    In windows these are not sought (rotors, bar and horizontal velocity run through from one window to the next), but
    where a record begins in motion the speeds at which the motors would settle are wrong for its first second or two.
    """
    whole = len(MOTION_STATES) + len(ACTUATOR_STATES)
    opening = problem.truncate_records(_FIRST_HORIZON_S * _HORIZON_GROWTH).with_initial_offset(
        [np.zeros(whole)] * len(problem.prepared_records)
    )
    found, begin = find_initial_states(opening.with_windows(None), theta), []
    for f, s in zip(opening.with_windows(None).prepared_records, found.initial_states, strict=True):
        sought = np.zeros(whole)
        sought[f.sought_states] = s[0]
        # The rest of the motion is sought in every window; charges are set by the voltage of the whole record.
        begin.append(np.where(_CONTINUOUS_STATES, sought, 0.0))
    return begin


def _find_record_start(problem: OutputErrorProblem, i: int, theta: _Array, state: _Array) -> tuple[_Array, bool, int]:
    """Return the start (1, k) of record ``i`` that fits best, whether it is a minimum, and the flights it took."""
    spread, flown = problem.initial_state_std(i), 0

    def start_costs(states: _Array) -> _Array:
        thetas = np.repeat(theta[None], len(states), axis=0)
        e = problem.record_residual(i, thetas, states)
        return 0.5 * np.einsum("bnm,bnm->b", e, e) + 0.5 * np.sum((states / spread) ** 2, axis=(1, 2))

    cost = float(start_costs(state[None])[0])
    for _ in range(_MAX_STEPS_PER_HORIZON):
        e, slope = problem.initial_state_jacobian(i, theta, state)
        flown += 1 + state.shape[1] + len(_STEP_FRACTIONS)
        rows = np.vstack([slope.reshape(-1, len(spread)), np.diag(1.0 / spread)])
        q, r = np.linalg.qr(rows)
        target = q.T @ np.concatenate([e.ravel(), (state / spread).ravel()])
        if 0.5 * float(target @ target) < MIN_COST_DECREASE:
            return state, True, flown
        step = -np.linalg.solve(r, target)
        step *= min(1.0, _MAX_STATE_STEP / float(np.max(np.abs(step / spread))))
        trials = state + _STEP_FRACTIONS[:, None, None] * step
        found = start_costs(trials)
        k = int(np.argmin(found))
        if not found[k] < cost:
            return state, False, flown
        state, cost = trials[k], float(found[k])
    return state, False, flown
