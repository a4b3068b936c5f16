"""Two ways to a linear model without a search: equation error, and predictor-based subspace identification.

Both serve as a cross-check of the structured fit: they share neither its search nor (subspace) its structure.

**Equation error** (Klein and Morelli, ch. 5): the derivative of each rate, of low-passed signals, regressed on the
rates and inputs. Biased by noise in the regressors, but has no local minima.

**Subspace** (PBSIDopt; Chiuso 2007, Automatica 43, 1034-1048; van der Veen, van Wingerden, Bergamasco, Lovera and
Verhaegen 2013, IET Control Theory Appl. 7(10)). The innovation form ``x+ = A x + B u + K e, y = C x + D u + e`` is
``x+ = Ac x + Bc z`` with ``z = (u, y)``, ``Ac = A - K C``, so after ``p`` samples ``x ~ [Ac^(p-1) Bc ... Bc] Z_p``.
A long ARX model gives the products ``C Ac^i Bc``; stacked over a future window they make ``Gamma K``; the directions of
the largest singular values of ``Gamma K Z`` are the states, and A, B, C, D follow by least squares. It holds for data
from a closed loop.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError

__all__ = ["Subspace", "equation_error", "subspace"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Subspace:
    """A discrete linear model of unlabelled states.

    Attributes
    ----------
    a, b, c, d, k : array
        (n, n), (n, inputs), (outputs, n), (outputs, inputs), (n, outputs).
    singular : array
        Singular values, largest first: a gap says how many states the data show.
    u_mean, y_mean : array
        Taken off before the fit.
    dt : float
        Sample time (s).
    """

    a: Array
    b: Array
    c: Array
    d: Array
    k: Array
    singular: Array
    u_mean: Array
    y_mean: Array
    dt: float

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Continuous poles (rad/s), slowest first."""
        e = np.log(np.linalg.eigvals(self.a).astype(complex)) / self.dt
        return np.asarray(e[np.argsort(np.abs(e))], dtype=np.complex128)

    def simulate(self, u: Array, x0: Array | None = None) -> Array:
        """Simulate outputs (n, outputs) from inputs (n, inputs)."""
        x = np.zeros(len(self.a)) if x0 is None else x0
        y = np.empty((len(u), len(self.c)))
        for i, v in enumerate(u - self.u_mean):
            y[i] = self.c @ x + self.d @ v
            x = self.a @ x + self.b @ v
        return y + self.y_mean

    def initial_state(self, u: Array, y: Array) -> Array:
        """Return the initial state that fits outputs best when simulated."""
        n = len(self.a)
        power, rows = np.eye(n), []
        for _ in range(len(u)):
            rows.append(self.c @ power)
            power = self.a @ power
        missed = (y - self.simulate(u)).ravel()
        return np.asarray(np.linalg.lstsq(np.concatenate(rows), missed, rcond=1e-8)[0])


def subspace(
    u: Array, y: Array, dt: float, *, order: int, past: int = 20, future: int | None = None
) -> Subspace:
    """Identify a model of given order.

    Parameters
    ----------
    u, y : (n, inputs), (n, outputs) array
        Without gaps. Slow vehicles in fast records are better decimated first: ``past`` has to span their memory.
    dt : float
        Sample time (s).
    order : int
        Number of states.
    past, future : int
        Windows (samples); ``future`` at most ``past``, default equal.

    Raises
    ------
    InputError
        If the record is too short for the windows, or the order does not fit them.
    """
    f = past if future is None else future
    m, l = u.shape[1], y.shape[1]
    n = len(u) - past
    if n < 3 * past * (m + l) or not 1 <= order <= f * l or f > past:
        raise InputError(
            "subspace", "", f"order {order} with windows of {past} and {f} does not fit {len(u)} samples",
            "give a longer record, a smaller order or a shorter window",
        )  # fmt: skip
    u_mean, y_mean = u.mean(0), y.mean(0)
    u, y = u - u_mean, y - y_mean
    z = np.column_stack([u, y])
    # Columns: Z_p at each time, oldest first; then the direct input.
    history = np.concatenate([z[i : i + n].T for i in range(past)])
    now_u, now_y = u[past:].T, y[past:].T
    regressor = np.concatenate([history, now_u])
    scale = np.sqrt((regressor**2).mean(1))
    scale[scale == 0.0] = 1.0
    gram = (regressor / scale[:, None]) @ (regressor / scale[:, None]).T
    ridge = 1e-9 * np.trace(gram) / len(gram)
    theta = (
        np.linalg.solve(gram + ridge * np.eye(len(gram)), (regressor / scale[:, None]) @ now_y.T).T / scale
    )
    markov = theta[:, : past * (m + l)]
    w = m + l
    gamma = np.zeros((f * l, past * w))
    for i in range(f):
        gamma[i * l : (i + 1) * l, i * w :] = markov[:, : (past - i) * w]
    _, singular, vt = np.linalg.svd(gamma @ history, full_matrices=False)
    x = np.sqrt(singular[:order])[:, None] * vt[:order]
    cd = np.linalg.lstsq(np.concatenate([x, now_u]).T, now_y.T, rcond=None)[0].T
    e = now_y - cd @ np.concatenate([x, now_u])
    abk = np.linalg.lstsq(np.concatenate([x, now_u, e])[:, :-1].T, x[:, 1:].T, rcond=None)[0].T
    return Subspace(
        abk[:, :order], abk[:, order : order + m], cd[:, :order], cd[:, order:], abk[:, order + m :],
        singular, u_mean, y_mean, dt,
    )  # fmt: skip


def equation_error(
    rates: Array,
    u: Array,
    dt: float,
    *,
    rate_names: tuple[str, ...],
    input_names: tuple[str, ...],
    cut_hz: float,
) -> dict[str, tuple[float, float]]:
    """Regress each rate's derivative on all rates and inputs.

    Parameters
    ----------
    rates, u : (n, k), (n, m) array
    dt : float
    rate_names, input_names : tuple of str
        ``("p", "q")``, ``("lat", "lon")``; p, q, r give symbols L_, M_, N_.
    cut_hz : float
        Low-pass applied to everything first.

    Returns
    -------
    dict of symbol to (value, standard deviation)
        ``{"L_p": (-3.1, 0.2), "L_lat": ...}``; the deviations are corrected for coloured residuals.
    """
    from mufly.identify.linear_columns import lowpassed
    from mufly.identify.uncertainty import coloured_covariance

    used = u.std(axis=0) > 0.0
    names = rate_names + tuple(n for n, k in zip(input_names, used, strict=True) if k)
    smooth = lowpassed(np.column_stack([rates, u[:, used]]), dt, cut_hz)
    slope = np.gradient(smooth[:, : rates.shape[1]], dt, axis=0)
    rows = np.column_stack([smooth, np.ones(len(smooth))])
    found = {}
    for j, rate in enumerate(rate_names):
        theta = np.linalg.lstsq(rows, slope[:, j], rcond=None)[0]
        missed = slope[:, j] - rows @ theta
        cov = coloured_covariance(rows[:, None, :], missed[:, None], np.array([1.0 / missed.var()]))[0]
        for k, name in enumerate(names):
            symbol = f"{ {'p': 'L', 'q': 'M', 'r': 'N'}.get(rate, rate) }_{name}"
            found[symbol] = (float(theta[k]), float(np.sqrt(cov[k, k])))
    return found
