"""Fully connected network of a learned policy, equal bit for bit to its exported C code.

    y = clip((x - mean) / scale, -limit, limit),   y <- act(W y + b) for each layer,   action = clip(y, -1, 1)

Sums begin with the bias and run over the inputs in order, without fused multiply-add. With ``e = exp(-2 |x|)`` from
:func:`mufly.compiled.portable_math.exp_decay`, ``tanh x`` is ``(1 - e) / (1 + e)`` with the sign of x; its error is
below 3e-16. All numbers are in double precision.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mufly.compiled.numba_cache import cached_njit
from mufly.compiled.portable_math import exp_decay
from mufly.flight.policy.observation import ACTION_SIZE, observation_limits

_Array = NDArray[np.float64]

ACTIVATIONS = ("linear", "tanh", "relu")
"""Activations of a layer; C and compiled code use the index."""


@dataclass(frozen=True, eq=False)
class PolicyLayer:
    """Layer ``act(W x + b)`` of a network.

    Attributes
    ----------
    weights : (outputs, inputs) array
    bias : (outputs,) array
    activation : {"linear", "tanh", "relu"}
    """

    weights: _Array
    bias: _Array
    activation: str


class PackedPolicy(NamedTuple):
    """Weights, biases and limits of a policy as arrays for compiled code.

    Attributes
    ----------
    layer_sizes : (layers + 1,) array
        Number of inputs, then of the outputs of each layer.
    activations : (layers,) array
        Indices in :data:`ACTIVATIONS`.
    observation_low, observation_high, observation_mean, observation_scale : (inputs,) array
        Bounds of the observation, and its normalisation.
    observation_limit : float
        Largest magnitude of a normalised observation.
    weights, biases : (m,) array
        All layers after each other, weights by rows.
    """

    layer_sizes: NDArray[np.int64]
    activations: NDArray[np.int64]
    observation_low: _Array
    observation_high: _Array
    observation_mean: _Array
    observation_scale: _Array
    observation_limit: float
    weights: _Array
    biases: _Array


@dataclass(frozen=True, eq=False)
class LearnedPolicy:
    """Policy that a learner has trained in an environment of :mod:`mufly.gym`.

    Attributes
    ----------
    task : str
        Task of the environment, such as ``"hover"``.
    vehicle_name : str
        Name of the vehicle that it was trained for.
    period_s : float
        Time between two actions.
    trim_inputs : (4,) array
        Inputs of the flight model for an action of zero: motors upper, lower (0..1), servos 1, 2 (-1..1).
    nominal_voltage_V : float
        Battery voltage at which the observed supply is zero.
    observation_mean, observation_scale : (inputs,) array
        Normalisation of the observation.
    observation_limit : float
        Largest magnitude of a normalised observation.
    layers : tuple of PolicyLayer
    training : mapping
        Description of the training, for readers.
    """

    task: str
    vehicle_name: str
    period_s: float
    trim_inputs: _Array
    nominal_voltage_V: float
    observation_mean: _Array
    observation_scale: _Array
    observation_limit: float
    layers: tuple[PolicyLayer, ...]
    training: Mapping[str, str | float] = field(default_factory=dict)

    @property
    def input_count(self) -> int:
        """Number of values in an observation."""
        return int(self.observation_mean.size)

    @functools.cached_property
    def packed_arrays(self) -> PackedPolicy:
        """Weights and limits as arrays for the compiled :func:`evaluate_policy`."""
        low, high = observation_limits(self.task)
        return PackedPolicy(
            np.array([self.input_count, *(layer.bias.size for layer in self.layers)], dtype=np.int64),
            np.array([ACTIVATIONS.index(layer.activation) for layer in self.layers], dtype=np.int64),
            low, high, self.observation_mean, self.observation_scale, self.observation_limit,
            np.concatenate([layer.weights.ravel() for layer in self.layers]),
            np.concatenate([layer.bias for layer in self.layers]),
        )  # fmt: skip

    def find_action(self, observation: ArrayLike) -> _Array:
        """Return the action (4,) for an observation (m,), or the actions (n, 4) for observations (n, m)."""
        seen = np.asarray(observation, dtype=np.float64)
        out = np.empty((*seen.shape[:-1], ACTION_SIZE))
        for row, action in zip(np.atleast_2d(seen), np.atleast_2d(out), strict=True):
            evaluate_policy(self.packed_arrays, row, action)
        return out


@cached_njit(error_model="numpy")
def evaluate_policy(p: PackedPolicy, observation: _Array, action: _Array) -> None:
    """Compute the action (4,) for an observation (m,) and write it into ``action``; NaN in an observation counts as
    zero.
    """
    widest = 0
    for n in p.layer_sizes:
        widest = max(widest, n)
    x, y = np.zeros(widest), np.zeros(widest)
    for i in range(p.layer_sizes[0]):
        v = observation[i]
        v = min(max(v, p.observation_low[i]), p.observation_high[i]) if v == v else 0.0
        x[i] = min(max((v - p.observation_mean[i]) / p.observation_scale[i], -p.observation_limit), p.observation_limit)
    place, row = 0, 0
    for k in range(p.activations.size):
        for j in range(p.layer_sizes[k + 1]):
            total = p.biases[row]
            for i in range(p.layer_sizes[k]):
                total = total + p.weights[place] * x[i]
                place += 1
            row += 1
            if p.activations[k] == 1:
                e = exp_decay(2.0 * abs(total))
                size = (1.0 - e) / (1.0 + e)
                total = -size if total < 0.0 else size
            elif p.activations[k] == 2 and not total > 0.0:
                total = 0.0
            y[j] = total
        x, y = y, x
    for i in range(action.size):
        action[i] = min(max(x[i], -1.0), 1.0)
