"""Free and held parameters of a flight fit: scaling, priors, bounds, and their effect on the model equations.

Every coefficient of the equations is a product of powers of vehicle parameters (``thrust_up = cT_up pi rho R^4``). A
batch of parameter sets therefore follows from one record of :data:`mufly.dynamics.PARAMETER_DTYPE` by multiplication
of its fields. The powers are found by changing each free parameter once and evaluating
:func:`mufly.dynamics.model_parameters`. Vehicle parameters are fitted as ``theta = ln(value / start)``, which keeps
their signs and gives a factor of two the same step for each. Delays, biases and parameters of either sign, such as
the phase of the swash plate, may be zero. They are fitted as ``theta = (value - start) / scale``.

The provenance of a parameter sets the standard deviation of its prior (of ``ln value``) and the factor that bounds it.
The priors are wide: they matter only where the data do not determine a parameter. Held parameters are uncertain, too
(:func:`list_held_parameters`). Their uncertainty is the ``std`` of the vehicle file, or else the third number of their
provenance, which for "identified" and "estimated" is narrower than the prior.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from mufly.dynamics import PARAMETER_DTYPE, model_parameters
from mufly.errors import ArgumentError, InputError, suggest_name
from mufly.identify.flight_record import OUTPUT_UNITS
from mufly.vehicle import Vehicle, list_parameters, replace_parameters

_Array = NDArray[np.float64]

# source -> (free: standard deviation of the prior of ln(value), factor to either bound; held: standard deviation of
# ln(value) if the vehicle file states none)
PROVENANCE_DOUBT: dict[str, tuple[float, float, float]] = {
    "measured": (0.02, 1.2, 0.02),
    "specified": (0.02, 1.2, 0.02),
    "datasheet": (0.10, 1.5, 0.10),
    "CAD": (0.15, 2.0, 0.15),
    "identified": (0.50, 4.0, 0.05),
    "estimated": (1.00, 6.0, 0.20),
}
# Parameters that act on heave and yaw only, and on roll and pitch only (thesis Sec. 5.3.3).
HEAVE_YAW_SYMBOLS = ("cT_up", "cT_dw", "cQ_up", "cQ_dw", "Jdrive_up", "Jdrive_dw", "Jrot_up", "Jrot_dw", "Izz", "Whub",
             "cDAz", "m", "kE", "kM", "dR", "Mf", "Rohm", "igear", "eta_gear", "Ubat", "Rbat", "C", "Iel")  # fmt: skip
ROLL_PITCH_SYMBOLS = ("Ixx", "Iyy", "z_up", "z_dw", "Tf_up", "Tf_dw", "l_up", "l_dw", "theta_SP_max", "cH", "cDAx",
              "cDAy", "phi_SP")  # fmt: skip
# Groups of the vehicle file that the equations of free flight may depend on.
_FLIGHT_PARAMETER_GROUPS = ("body", "air", "rotors", "swash_plate", "stabiliser_bar", "motor", "gear", "battery")
_MAX_DELAY_S = 0.2  # s
_SIGNED_THETA_SCALE = 0.1  # rad a step of a parameter that may have either sign
_BIAS_BOUNDS = {"m": 1.0, "m/s": 1.0, "rad": 0.3, "rad/s": 0.5, "V": 1.0}  # bound by unit; the prior is a tenth of it


@dataclass(frozen=True)
class FieldChanges:
    """Effect of the free parameters on the fields of the flight model's record.

    A field becomes ``field * exp(powers @ theta) + shifts @ theta``.

    Attributes
    ----------
    powers, shifts : dict of str to (n,) array
        Field of the record -> number for every free parameter; fields without effect are absent.
    """

    powers: dict[str, _Array]
    shifts: dict[str, _Array]


@dataclass(frozen=True)
class FreeParameter:
    """Parameter that a fit may change, with its scaled value ``theta``.

    Attributes
    ----------
    symbol, key, unit : str
        As in :class:`mufly.identify.ParameterEstimate`.
    start_value : float
        Start value of the fit and centre of the prior (SI).
    scale : float
        0: ``theta = ln(value / start)``; otherwise ``theta = (value - start) / scale``.
    theta_low, theta_high : float
        Bounds of ``theta``.
    prior_std : float
        Prior standard deviation of ``theta``.
    provenance : str
        Provenance of the start value.
    """

    symbol: str
    key: str
    unit: str
    start_value: float
    scale: float
    theta_low: float
    theta_high: float
    prior_std: float
    provenance: str

    def value_to_theta(self, value: float) -> float:
        """Return the scaled value ``theta`` of an SI value."""
        return math.log(value / self.start_value) if self.scale == 0.0 else (value - self.start_value) / self.scale


def choose_free_parameters(
    vehicle: Vehicle, symbols: Sequence[str], outputs: Sequence[str], *, delay_s: float = 0.0
) -> tuple[FreeParameter, ...]:
    """Create the free parameters with these symbols.

    Parameters
    ----------
    vehicle : Vehicle
        Start values, and provenance for priors and bounds.
    symbols : sequence of str
        Symbols as printed by ``mufly vehicle show``, ``"delay"`` (from the recorded input to the vehicle), or
        ``"bias_<output>"`` for a measured output, for example ``"bias_p"``.
    outputs : sequence of str
        Measured outputs.
    delay_s : float
        Start value of the delay (s).

    Raises
    ------
    InputError
        For an unknown symbol (with suggestions), a repeated symbol, or a start value of zero where the sign is fixed;
        for a vehicle whose rotor coefficients come from a map, which the fit cannot change.
    """
    if vehicle.rotors.coefficient_map is not None:
        raise InputError(
            vehicle.name, "rotors.coefficient_map", "replaces the coefficients that are fitted",
            "remove it from the vehicle file for the fit",
        )  # fmt: skip
    if not symbols:
        raise ArgumentError("symbols", "", "no parameter is free", "name some, as in symbols=cT_dw,Izz")
    rows = {r.symbol: r for r in list_parameters(vehicle)}
    limits = _schema_limits(vehicle)
    chosen: list[FreeParameter] = []
    for symbol in symbols:
        if any(f.symbol == symbol for f in chosen):
            raise ArgumentError("symbols", symbol, "is named twice", "name it once")
        if symbol == "delay":
            top = (_MAX_DELAY_S - delay_s) / 0.01
            chosen.append(FreeParameter("delay", "", "s", delay_s, 0.01, -delay_s / 0.01, top, 10.0, "estimated"))
            continue
        if symbol.startswith("bias_"):
            name = symbol.removeprefix("bias_")
            if name not in outputs:
                remedy = f"use a measured output: {', '.join(f'bias_{o}' for o in outputs)}"
                raise ArgumentError("symbols", symbol, "is not the bias of a measured output", remedy)
            scale = 0.1 * _BIAS_BOUNDS[OUTPUT_UNITS[name]]
            chosen.append(FreeParameter(symbol, "", OUTPUT_UNITS[name], 0.0, scale, -10.0, 10.0, 1.0, "estimated"))
            continue
        row = rows.get(symbol)
        if row is None or not isinstance(row.value, float):
            known = [s for s, r in rows.items() if isinstance(r.value, float)]
            remedy = suggest_name(symbol, [*known, "delay"], "use symbols of `mufly vehicle show`")
            raise ArgumentError("symbols", symbol, "is not a parameter of a vehicle that can be fitted", remedy)
        bounds = limits.get(row.key, [])
        if _has_either_sign(bounds):
            low, high = ((limit - row.value) / _SIGNED_THETA_SCALE for limit in (min(bounds), max(bounds)))
            std = (PROVENANCE_DOUBT[row.source][0] if row.std is None else row.std) / _SIGNED_THETA_SCALE
            chosen.append(
                FreeParameter(symbol, row.key, row.unit, row.value, _SIGNED_THETA_SCALE, low, high, std, row.source)
            )
            continue
        if row.value == 0.0:
            raise InputError(vehicle.name, row.key, "starts at 0", "give a start value of the right order of magnitude")
        std, factor, _ = PROVENANCE_DOUBT[row.source]
        low, high = -math.log(factor), math.log(factor)
        for limit in bounds:
            t = math.log(limit / row.value) if limit / row.value > 0 else math.inf
            low, high = (max(low, t), high) if t <= 0 else (low, min(high, t))
        chosen.append(FreeParameter(symbol, row.key, row.unit, row.value, 0.0, low, high, std, row.source))
    return tuple(chosen)


def list_held_parameters(
    vehicle: Vehicle, free: Sequence[FreeParameter], delay_s: float, voltage: float | None
) -> tuple[FreeParameter, ...]:
    """Return the held parameters that act on the flight; ``prior_std`` is their uncertainty.

    They are the scalars of the vehicle file that the flight equations depend on (without floor contact and curves),
    and the delay, whose provenance counts as estimated.
    """
    chosen, found = {f.symbol for f in free}, []
    limits = _schema_limits(vehicle)
    for row in list_parameters(vehicle):
        if row.symbol in chosen or not isinstance(row.value, float):
            continue
        if row.key.partition(".")[0] not in _FLIGHT_PARAMETER_GROUPS:
            continue
        added = _has_either_sign(limits.get(row.key, []))
        if not added and row.value == 0.0:
            continue
        if added:
            scale, doubt = _SIGNED_THETA_SCALE, (row.std or 0.0) / _SIGNED_THETA_SCALE
        else:
            scale, doubt = 0.0, PROVENANCE_DOUBT[row.source][2] if row.std is None else row.std / abs(row.value)
        one = FreeParameter(row.symbol, row.key, row.unit, row.value, scale, -np.inf, np.inf, doubt, row.source)
        if doubt > 0.0 and _find_field_sensitivities(vehicle, one, voltage):
            found.append(one)
    if "delay" not in chosen and delay_s > 0.0:
        doubt = PROVENANCE_DOUBT["estimated"][2] * delay_s / 0.01
        found.append(FreeParameter("delay", "", "s", delay_s, 0.01, -np.inf, np.inf, doubt, "estimated"))
    return tuple(found)


def theta_to_values(free: Sequence[FreeParameter], theta: _Array) -> _Array:
    """Return the SI values (..., n) at the scaled values ``theta`` (..., n)."""
    log = np.array([f.scale == 0.0 for f in free])
    start, scale = np.array([f.start_value for f in free]), np.array([f.scale for f in free])
    t = np.asarray(theta, dtype=np.float64)
    return np.where(log, start * np.exp(np.where(log, t, 0.0)), start + scale * t)


def find_field_changes(
    vehicle: Vehicle, free: Sequence[FreeParameter], voltage: float | None
) -> tuple[NDArray[np.void], FieldChanges]:
    """Return the start record and the effect of the free parameters on its fields, for :func:`parameters_at_theta`.

    Parameters
    ----------
    vehicle : Vehicle
    free : sequence of FreeParameter
    voltage : float or None
        Constant battery voltage (V), or None for the vehicle's own battery model.

    Returns
    -------
    base : () structured array of type ``PARAMETER_DTYPE``
        Model parameters at the start values, without floor contact.
    changes : FieldChanges
    """
    base = np.array(model_parameters(vehicle, voltage), dtype=PARAMETER_DTYPE)
    changes = FieldChanges({}, {})
    for j, f in enumerate(free):
        into = changes.powers if f.scale == 0.0 else changes.shifts
        for name, effect in _find_field_sensitivities(vehicle, f, voltage).items():
            into.setdefault(name, np.zeros(len(free)))[j] = effect
    base["contact_reach"] = -1e9
    base["ground_effect"] = 0.0
    return base, changes


def _has_either_sign(bounds: Sequence[float]) -> bool:
    return bool(bounds) and min(bounds) < 0.0 < max(bounds)


def _find_field_sensitivities(vehicle: Vehicle, f: FreeParameter, voltage: float | None) -> dict[str, float]:
    """Return the fields of the flight model's record that a parameter changes, each with its sensitivity.

    The sensitivity is the exponent of the parameter in the field if ``f.scale`` is 0, else the change of the field per
    unit of ``theta``.
    """
    if not f.key:
        return {}
    base = np.array(model_parameters(vehicle, voltage), dtype=PARAMETER_DTYPE)
    changed, step = _perturb_parameter(vehicle, f, voltage)
    effects: dict[str, float] = {}
    for name in PARAMETER_DTYPE.names or ():
        if name in ("contact_points", "contact_count", "contact_reach", "contact_friction_damping_limit"):
            continue
        old, new = float(np.ravel(base[name])[-1]), float(np.ravel(changed[name])[-1])
        if old != new:
            power = f.scale == 0.0
            effects[name] = round(math.log(new / old) / math.log(step), 9) if power else (new - old) / step
    return effects


def _perturb_parameter(vehicle: Vehicle, f: FreeParameter, voltage: float | None) -> tuple[Any, float]:
    """Return the model parameters with one parameter changed in a valid direction, and the step.

    The step is a factor of 0.1 %, or 0.001 of ``theta`` for a parameter that is added.
    """

    def parameters_at_value(value: float) -> Any:
        return model_parameters(replace_parameters(vehicle, {f.key: value}), voltage)

    if f.scale != 0.0:
        step = -1e-3 if f.start_value > 0.0 else 1e-3
        return parameters_at_value(f.start_value + step * f.scale), step
    try:
        return parameters_at_value(0.999 * f.start_value), 0.999
    except InputError:  # the decrease violates a relation between two parameters
        return parameters_at_value(1.001 * f.start_value), 1.001


def parameters_at_theta(base: NDArray[np.void], changes: FieldChanges, theta: _Array) -> NDArray[np.void]:
    """Return the records (b,) of type ``PARAMETER_DTYPE`` at the scaled values ``theta`` (b, n)."""
    p = np.full(len(theta), base, dtype=PARAMETER_DTYPE)
    for name, exponent in changes.powers.items():
        factor = np.exp(theta @ exponent)
        p[name] = p[name] * (factor if p[name].ndim == 1 else factor[:, None])
    for name, slope in changes.shifts.items():
        p[name] = p[name] + theta @ slope
    return p


def _schema_limits(vehicle: BaseModel, prefix: str = "") -> dict[str, list[float]]:
    """Return the limits other than 0 that the vehicle file's schema sets for each value, by the value's dotted key."""
    found: dict[str, list[float]] = {}
    for name, spec in type(vehicle).model_fields.items():
        value, extra = getattr(vehicle, name), spec.json_schema_extra
        if isinstance(extra, dict) and "unit" in extra:
            bounds = [extra.get(k) for k in ("above", "at_least", "below", "at_most")]
            found[prefix + name] = [float(b) for b in bounds if isinstance(b, int | float) and b != 0]
        elif isinstance(value, BaseModel):
            found.update(_schema_limits(value, f"{prefix}{name}."))
    return found
