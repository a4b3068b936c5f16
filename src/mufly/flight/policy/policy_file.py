"""File of a learned policy: readable JSON with a checksum.

========================  ==========================================================================================
key                       meaning
========================  ==========================================================================================
``format``, ``version``   ``"mufly-policy"``, 1
``task``                  task of the environment
``vehicle``               name of the vehicle that it was trained for
``period_s``              time between two actions
``nominal_voltage_V``     battery voltage at which the observed supply is zero
``observation``           a list: ``name``, ``unit``, ``mean`` and ``scale`` of each input
``normalised_limit``      largest magnitude of a normalised input
``action``                a list: ``name`` of each output (-1..1)
``trim``                  inputs for an action of zero: motors upper, lower (0..1), servos 1, 2 (-1..1)
``layers``                a list: ``inputs``, ``outputs``, ``activation``, ``weights`` (a row for each output), ``bias``
``training``              description of the training, for readers
``sha256``                checksum of all other keys: SHA-256 of their JSON with sorted keys and no spaces
========================  ==========================================================================================

Numbers are in double precision and are read back bit for bit. :mod:`mufly.flight.policy.policy_network` has the
equations.
"""

from __future__ import annotations

import hashlib
import json
import math
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from mufly.errors import InputError, convert_write_errors
from mufly.files.input_files import validate_model
from mufly.flight.policy.observation import ACTION_NAMES, observation_units
from mufly.flight.policy.policy_network import LearnedPolicy, PolicyLayer

POLICY_FORMAT, POLICY_VERSION = "mufly-policy", 1
MAX_LAYER_COUNT, MAX_LAYER_WIDTH = 8, 256
"""Largest number of layers, and of inputs and outputs of a layer."""
_WRITE_POLICY_REMEDY = "write it with mufly.flight.policy.save_policy"


class _PolicyFileRecord(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, strict=True)


class _ObservedQuantity(_PolicyFileRecord):
    name: str
    unit: str
    mean: float
    scale: float = Field(gt=0.0)


class _CommandedQuantity(_PolicyFileRecord):
    name: str


class _NetworkLayer(_PolicyFileRecord):
    inputs: int = Field(ge=1, le=MAX_LAYER_WIDTH)
    outputs: int = Field(ge=1, le=MAX_LAYER_WIDTH)
    activation: Literal["linear", "tanh", "relu"]
    weights: list[list[float]]
    bias: list[float]


class _PolicyFile(_PolicyFileRecord):
    format: Literal["mufly-policy"]
    version: Literal[1]
    task: Literal["hover", "waypoint", "obstacle", "land"]
    vehicle: str
    period_s: float = Field(gt=0.0, le=0.1)
    nominal_voltage_V: float = Field(gt=0.0)
    observation: list[_ObservedQuantity]
    normalised_limit: float = Field(gt=0.0)
    action: list[_CommandedQuantity]
    trim: list[float] = Field(min_length=4, max_length=4)
    layers: list[_NetworkLayer] = Field(min_length=1, max_length=MAX_LAYER_COUNT)
    training: dict[str, str | float]
    sha256: str


def save_policy(policy: LearnedPolicy, path: str | Path) -> None:
    """Write a learned policy to a JSON file with a checksum.

    Raises
    ------
    InputError
        If the policy is not consistent, or the file cannot be written.
    """
    names = observation_units(policy.task)
    content: dict[str, Any] = {
        "format": POLICY_FORMAT,
        "version": POLICY_VERSION,
        "task": policy.task,
        "vehicle": policy.vehicle_name,
        "period_s": float(policy.period_s),
        "nominal_voltage_V": float(policy.nominal_voltage_V),
        "observation": [
            {"name": name, "unit": unit, "mean": float(mean), "scale": float(scale)}
            for (name, unit), mean, scale in zip(
                names.items(), policy.observation_mean, policy.observation_scale, strict=False
            )
        ],
        "normalised_limit": float(policy.observation_limit),
        "action": [{"name": name} for name in ACTION_NAMES],
        "trim": policy.trim_inputs.tolist(),
        "layers": [
            {
                "inputs": int(layer.weights.shape[1]),
                "outputs": int(layer.weights.shape[0]),
                "activation": layer.activation,
                "weights": np.asarray(layer.weights, dtype=np.float64).tolist(),
                "bias": np.asarray(layer.bias, dtype=np.float64).tolist(),
            }
            for layer in policy.layers
        ],
        "training": dict(policy.training),
    }
    content["sha256"] = _checksum(content)
    _check_content(str(path), content)
    rows = json.dumps(content, indent=1)
    with convert_write_errors(path, "give another file"):
        Path(path).write_text(rows + "\n", encoding="utf-8")


def load_policy(path: str | Path) -> LearnedPolicy:
    """Read a learned policy from a JSON file, and check its checksum.

    Raises
    ------
    InputError
        If the file cannot be read, is damaged, or its shapes and names do not fit together.
    """
    where = str(path)
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(where, "", f"cannot be read ({error.strerror})", "give a policy file") from None
    except ValueError as error:
        raise InputError(where, "", f"is not JSON ({error})", _WRITE_POLICY_REMEDY) from None
    if not isinstance(content, dict):
        raise InputError(where, "", "is not a policy file", _WRITE_POLICY_REMEDY)
    checked = _check_content(where, content)
    return LearnedPolicy(
        task=checked.task,
        vehicle_name=checked.vehicle,
        period_s=checked.period_s,
        trim_inputs=np.array(checked.trim),
        nominal_voltage_V=checked.nominal_voltage_V,
        observation_mean=np.array([one.mean for one in checked.observation]),
        observation_scale=np.array([one.scale for one in checked.observation]),
        observation_limit=checked.normalised_limit,
        layers=tuple(PolicyLayer(np.array(x.weights), np.array(x.bias), x.activation) for x in checked.layers),
        training=checked.training,
    )


def _check_content(where: str, content: dict[str, Any]) -> _PolicyFile:
    """Return the checked content of a file."""
    checked = validate_model(_PolicyFile, content, where)
    names = observation_units(checked.task)
    got = {one.name: one.unit for one in checked.observation}
    if len(checked.observation) != len(names):
        raise InputError(
            where, "observation",
            f"has {len(checked.observation)} inputs, but the task {checked.task} has {len(names)}",
            "train the policy in this version's environment",
        )  # fmt: skip
    if got != names or list(got) != list(names):
        wrong = next(b for a, b in zip(names.items(), got.items(), strict=False) if a != b)
        raise InputError(
            where, "observation",
            f"has the input {wrong[0]} ({wrong[1]}), which the task {checked.task} does not have at this place",
            f"give {', '.join(names)}",
        )  # fmt: skip
    if tuple(one.name for one in checked.action) != ACTION_NAMES:
        raise InputError(where, "action", "has unknown or reordered outputs", f"give {', '.join(ACTION_NAMES)}")
    before = len(names)
    for k, layer in enumerate(checked.layers):
        shape = {len(row) for row in layer.weights}
        if layer.inputs != before or shape != {before} or {len(layer.weights), len(layer.bias)} != {layer.outputs}:
            raise InputError(
                where,
                f"layers[{k + 1}]",
                f"weights or bias do not fit {before} inputs and {layer.outputs} outputs",
                _WRITE_POLICY_REMEDY,
            )
        before = layer.outputs
    if before != len(ACTION_NAMES):
        raise InputError(where, f"layers[{len(checked.layers)}]", f"has {before} outputs, not 4", _WRITE_POLICY_REMEDY)
    if not all(math.isfinite(x) and -1.0 <= x <= 1.0 for x in checked.trim):
        raise InputError(where, "trim", f"{checked.trim}", "give numbers from -1 to 1")
    if checked.sha256 != _checksum(content):
        raise InputError(
            where, "sha256", "is not the checksum of the content: the file is damaged or edited", _WRITE_POLICY_REMEDY
        )
    return checked


def _checksum(content: dict[str, Any]) -> str:
    rest = {key: value for key, value in content.items() if key != "sha256"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
