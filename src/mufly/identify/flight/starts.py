"""The motion at the start of a whole record, with the parameters held: horizons that grow.

A record that begins while inputs move starts from rotor speeds, a bar and velocities that nobody measured. The guess
(speeds at which the motors would settle, a bar square to the mast, slopes of the smoothed measurement) is then off by
several per cent, and over a whole record that error does not stay small: height and yaw integrate the rotors' forces
twice, place and attitude are unstable in hover. After ten seconds the flight has left the region in which residuals are
linear in the start (it may have turned over), and least squares on the whole record end in a minimum that has nothing
to do with the flight. Over a second the same residuals are all but linear. So starts are sought over a horizon of 1 s
first, and each solution starts the search over a horizon 2.5 times as long (continuation in the horizon; the same
reason as for the windows that grow in :mod:`mufly.identify.flight.fit`): by then the start is known to the noise of the
shorter horizon, and an unstable mode of rate ``a`` grows by ``exp(1.5 a h)`` over the step, not by ``exp(a T)``.

Each search is Gauss and Newton's, with the part of a step that lowers the cost most. It has converged where a linear
step promises no more than a hundredth of cost, a tenth of a standard deviation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mufly.identify.flight.problem import ACTUATOR, MOTION, Problem

_Array = NDArray[np.float64]

LEAST_GAIN = 0.01  # of cost: a tenth of a standard deviation
_FIRST_S, _GROWTH = 1.0, 2.5
_STEPS = 25  # at most, a horizon
_PARTS = np.array([1.0, 0.5, 0.2, 0.05, 0.01])  # of a step, tried at once
_REACH = 0.25  # of the spread, a step at most
_RUNS_THROUGH = np.isin(
    np.array(MOTION + ACTUATOR), ("v_north", "v_east", "speed_up", "speed_dw", "bar_roll", "bar_pitch")
)


@dataclass(frozen=True, eq=False)
class Starts:
    """What :func:`settled` returns, one entry a record.

    Attributes
    ----------
    states : list of (1, k) array
    converged : tuple of bool
        Whether the search over the whole record ended in a minimum.
    simulations : int
        Flights simulated, in whole records.
    """

    states: list[_Array]
    converged: tuple[bool, ...]
    simulations: int


def settled(problem: Problem, theta: _Array) -> Starts:
    """Seek the start of every record at ``theta`` (t,); the problem's records are one window each."""
    states, converged, flown = [], [], 0.0
    for i, r in enumerate(problem.records):
        state, horizon, whole = problem.rest()[i], _FIRST_S, float(r.time_s[-1] - r.time_s[0])
        while True:
            last = horizon > 0.8 * whole
            state, ended, count = _sought(problem if last else problem.first(horizon), i, theta, state)
            flown += count * min(1.0, horizon / whole)
            if last:
                break
            horizon *= _GROWTH
        states.append(state)
        converged.append(ended)
    return Starts(states, tuple(converged), round(flown))


def beginnings(problem: Problem, theta: _Array) -> list[_Array]:
    """Return the rotors' speeds, the bars and the drift with which records begin, for windows: ``Prepared.begin``.

    In windows these are not sought (rotors, bar and horizontal velocity run through from one window to the next), but
    where a record begins in motion the speeds at which the motors would settle are wrong for its first second or two.
    """
    whole = len(MOTION) + len(ACTUATOR)
    opening = problem.first(_FIRST_S * _GROWTH).begun([np.zeros(whole)] * len(problem.flights))
    found, begin = settled(opening.in_windows(None), theta), []
    for f, s in zip(opening.in_windows(None).flights, found.states, strict=True):
        sought = np.zeros(whole)
        sought[f.sought] = s[0]
        # The rest of the motion is sought in every window; charges are set by the voltage of the whole record.
        begin.append(np.where(_RUNS_THROUGH, sought, 0.0))
    return begin


def _sought(problem: Problem, i: int, theta: _Array, state: _Array) -> tuple[_Array, bool, int]:
    """Return the start (1, k) of record ``i`` that fits best, whether it is a minimum, and the flights it took."""
    spread, flown = problem.spread(i), 0

    def costs(states: _Array) -> _Array:
        thetas = np.repeat(theta[None], len(states), axis=0)
        e = problem.residual(i, thetas, states)
        return 0.5 * np.einsum("bnm,bnm->b", e, e) + 0.5 * np.sum((states / spread) ** 2, axis=(1, 2))

    cost = float(costs(state[None])[0])
    for _ in range(_STEPS):
        e, slope = problem.by_start(i, theta, state)
        flown += 1 + state.shape[1] + len(_PARTS)
        rows = np.vstack([slope.reshape(-1, len(spread)), np.diag(1.0 / spread)])
        q, r = np.linalg.qr(rows)
        target = q.T @ np.concatenate([e.ravel(), (state / spread).ravel()])
        if 0.5 * float(target @ target) < LEAST_GAIN:
            return state, True, flown
        step = -np.linalg.solve(r, target)
        step *= min(1.0, _REACH / float(np.max(np.abs(step / spread))))
        trials = state + _PARTS[:, None, None] * step
        found = costs(trials)
        k = int(np.argmin(found))
        if not found[k] < cost:
            return state, False, flown
        state, cost = trials[k], float(found[k])
    return state, False, flown
