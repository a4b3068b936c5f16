"""Many cases at once: rotor, polars, blade elements or a wake, and the drive train where there is one.

A case is a dictionary of parameters (``parameters.PARAMETERS``, SI values): what it does not name comes from the
rotor and the drive of the study. It says the pitch and one of

* ``speed``: the rotor is evaluated at it;
* ``thrust``: the speed is found that gives it;
* ``duty``: the speed is found at which rotor and motor settle (eq. 3.18), at ``voltage`` times duty.

With a thrust the gear may be ``"adapted"`` (full voltage gives just the thrust, as in the dissertation's Sec. 3.4) or
``"best"`` (least power at any duty); see ``drive.gear``. A case that cannot be solved gets nan and a reason, and does
not disturb the others.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from mufly.drive import (
    Constants,
    RotorLoad,
    adapted_gear,
    best_gear,
    blade_load,
    speed_at_voltage,
    speed_for_thrust,
    steady,
)
from mufly.errors import InputError, MuflyError
from mufly.rotor import Air, PolarTable, Rotor, hover, polars, prepare
from mufly.rotor.thrust import FASTEST_TIP_M_S
from mufly.study.evaluate_wake import solve_wakes
from mufly.study.parameters import GEOMETRY, Value
from mufly.study.setup import Setup, check_names
from mufly.study.shape import reshape

__all__ = ["Case", "Results", "evaluate", "polar_tables"]

Array = NDArray[np.float64]
Case = Mapping[str, Value]

_CONSTANTS = {
    "back_emf": "back_emf_V_s",
    "torque_constant": "torque_Nm_A",
    "resistance": "resistance_ohm",
    "friction": "friction_Nm_s",
    "gear_efficiency": "gear_efficiency",
    "controller_efficiency": "controller_efficiency",
}


@dataclass(frozen=True, eq=False)
class Results:
    """Answers in the order of the cases: ``values[name]`` (n,), nan where ``fault[k]`` is not empty."""

    values: dict[str, Array]
    fault: list[str]


class PolarSource(Protocol):
    """What says where polars come from: a setup of rotors, or of pairs."""

    @property
    def engine(self) -> str: ...
    @property
    def model(self) -> str: ...


_TABLES: dict[tuple[str, float, str, str], PolarTable | str] = {}  # polars that were used last
_KEPT = 300  # a third of a megabyte each
_LOCK = threading.Lock()


def polar_tables(names: Sequence[str], n_crit: float, setup: PolarSource) -> dict[str, PolarTable | str]:
    """Polars of airfoils, or the reason why there is none; those not at hand are computed together, on all cores."""
    key = {name: (name, n_crit, setup.engine, setup.model) for name in names}
    with _LOCK:
        missing = [name for name in names if key[name] not in _TABLES]
        if missing:
            faults: dict[str, str] = {}
            found = polars(missing, n_crit=n_crit, engine=setup.engine, model=setup.model, faults=faults)  # type: ignore[arg-type]
            answer: dict[str, PolarTable | str] = {n: _TABLES[key[n]] for n in names if key[n] in _TABLES}
            while _TABLES and len(_TABLES) + len(missing) > _KEPT:
                _TABLES.pop(next(iter(_TABLES)))
            new = {name: found[name] if name in found else faults[name] for name in missing}
            _TABLES.update({key[name]: table for name, table in new.items()})
            return {**answer, **new}
        return {name: _TABLES[key[name]] for name in names}


def evaluate(setup: Setup, cases: Sequence[Case]) -> Results:
    """Solve cases.

    Parameters
    ----------
    setup : Setup
    cases : sequence of mappings
        All with the same keys; see the module docstring.

    Returns
    -------
    Results
        By blade elements, bit by bit the same however the cases are grouped into calls; by the wake method, within
        its tolerance (see :mod:`mufly.study.evaluate_wake`).

    Raises
    ------
    InputError
        If the parameters make no sense together (see :func:`check_names`).
    MuflyError
        If the polar engine is not installed.
    """
    check_names(setup, list(cases[0]) if cases else [])
    out = Results({name: np.full(len(cases), np.nan) for name in setup.outputs()}, [""] * len(cases))
    full = [{**setup.fixed, **case} for case in cases]
    rotors: dict[Any, Rotor | str] = {}
    keys = []
    groups: dict[tuple[float, float, float], list[int]] = {}
    air = Air()
    for k, case in enumerate(full):
        key = tuple((name, case[name]) for name in GEOMETRY if name in case)
        if key not in rotors:
            try:
                rotors[key] = reshape(setup.rotor, dict(key))
            except MuflyError as error:
                rotors[key] = str(error)
        keys.append(key)
        shape = rotors[key]
        if isinstance(shape, str):
            out.fault[k] = shape
            continue
        conditions = (
            float(case.get("n_crit", 0.1)),
            float(case.get("density", air.density_kg_m3)),
            float(case.get("viscosity", air.viscosity_Pa_s)),
        )
        groups.setdefault(conditions, []).append(k)
    for (n_crit, density, viscosity), members in groups.items():
        _group(setup, full, members, rotors, keys, n_crit, Air(density, viscosity), out)
    return out


def _group(
    setup: Setup, full: Sequence[Case], members: list[int], rotors: Mapping[Any, Rotor | str], keys: Sequence[Any],
    n_crit: float, air: Air, out: Results,
) -> None:  # fmt: skip
    """Solve the cases that share air and polars."""
    shapes = {keys[k]: rotors[keys[k]] for k in members}
    names = list(dict.fromkeys(n for r in shapes.values() if isinstance(r, Rotor) for n in r.airfoil_names()))
    try:
        tables = polar_tables(names, n_crit, setup)
    except InputError as error:  # an impossible n_crit
        for k in members:
            out.fault[k] = str(error)
        return
    used: dict[Any, int] = {}
    many: list[Rotor] = []
    solved = []
    for k in members:
        rotor = shapes[keys[k]]
        assert isinstance(rotor, Rotor)
        bad = [t for t in (tables[n] for n in rotor.airfoil_names()) if isinstance(t, str)]
        if bad:
            out.fault[k] = bad[0]
            continue
        if keys[k] not in used:
            used[keys[k]] = len(many)
            many.append(rotor)
        solved.append(k)
    if not solved:
        return
    blading = prepare(
        many,
        {n: t for n, t in tables.items() if isinstance(t, PolarTable)},
        corrections=setup.corrections,
        stations=setup.stations,
    )
    index = np.array(solved)
    which = np.array([used[keys[k]] for k in solved])

    def column(name: str, default: float | Array) -> Array:
        values = [full[k].get(name) for k in solved]
        if values and values[0] is None:
            return np.broadcast_to(np.asarray(default, dtype=np.float64), (len(solved),)).copy()
        return np.array([float(v) for v in values if v is not None], dtype=np.float64)

    pitch, climb = column("pitch", 0.0), column("climb", 0.0)
    load = blade_load(blading, pitch_rad=pitch, which=which, climb_m_s=climb, air=air)
    constants, voltage = _drive_columns(setup, column)
    everyone = np.arange(index.size)
    radius = blading.radius_m[which]
    first = full[solved[0]]

    def find(what: RotorLoad) -> Array:
        if "thrust" in first:
            return speed_for_thrust(what, column("thrust", 0.0), highest=FASTEST_TIP_M_S / radius)[0]
        assert constants is not None
        return speed_at_voltage(constants, what, column("duty", 1.0) * voltage)[0]

    if "speed" in first:
        speed, why = column("speed", 0.0), "the speed is not a number above 0"
    elif "thrust" in first:
        speed, why = (
            find(load),
            f"thrust out of reach of this rotor at any tip speed up to {FASTEST_TIP_M_S:g} m/s",
        )
    else:
        speed, why = find(load), "rotor and motor settle at no speed"
    good = np.isfinite(speed) & (speed > 0)
    thrust, torque = np.full(index.size, np.nan), np.full(index.size, np.nan)
    by_wake = None
    if setup.method == "wake":
        by_wake = solve_wakes(
            blading, which, pitch, climb, air, setup.wake, load, speed, None if "speed" in first else find
        )
        thrust, torque, speed = by_wake.thrust_N, by_wake.torque_Nm, by_wake.speed_rad_s
    elif good.any():
        thrust[good], torque[good] = load(speed[good], everyone[good])
    scale = air.density_kg_m3 * np.pi * radius**4 * speed**2
    power = torque * speed
    with np.errstate(invalid="ignore", divide="ignore"):
        merit = thrust * np.sqrt(np.maximum(thrust, 0) / (2 * air.density_kg_m3 * np.pi * radius**2)) / power
    chord = np.array([float(rotor.chord_m(0.75)) for rotor in many])[which]
    answers = {
        "thrust_N": thrust,
        "torque_Nm": torque,
        "power_W": power,
        "speed_rad_s": speed,
        "figure_of_merit": np.where((thrust > 0) & (power > 0), merit, np.nan),
        "c_T": thrust / scale,
        "c_Q": torque / (scale * radius),
        "reynolds_75": 0.75 * speed * radius * chord * air.density_kg_m3 / air.viscosity_Pa_s,
    }
    reasons = np.where(good, "", why).astype(object)
    if by_wake is not None:
        reasons = np.array([r or w for r, w in zip(reasons, by_wake.reason, strict=True)], dtype=object)
    if constants is not None:
        _with_drive(first.get("gear"), constants, voltage, answers, reasons)
    if by_wake is not None:
        answers["core_limit"] = by_wake.core_limit
    if setup.flags and by_wake is not None:
        answers["outside_share"] = by_wake.outside_share
    elif setup.flags:
        share = np.full(index.size, np.nan)
        for k in np.flatnonzero(reasons == "").tolist():
            one = hover(
                blading,
                pitch_rad=pitch[k],
                speed_rad_s=speed[k],
                climb_m_s=climb[k],
                air=air,
                which=int(which[k]),
            )
            share[k] = one.outside_share
        answers["outside_share"] = share
    for name, values in answers.items():
        out.values[name][index] = np.where(reasons == "", values, np.nan)
    for case, reason in zip(solved, reasons, strict=True):
        out.fault[case] = str(reason)


def _drive_columns(setup: Setup, column: Any) -> tuple[Constants | None, Array]:
    """Constants of the drive with what the cases change, as columns, and the supply voltage."""
    if setup.drive is None:
        return None, np.zeros(0)
    own = setup.drive.constants()
    values = {key: column(name, float(np.asarray(getattr(own, key)))) for name, key in _CONSTANTS.items()}
    assert {*values, "gear_ratio"} == {f.name for f in fields(Constants)}
    gear = setup.fixed.get("gear")
    ratio = (
        column("voltage", 0.0) * 0 + 1.0
        if isinstance(gear, str)
        else column("gear", float(np.asarray(own.gear_ratio)))
    )
    return Constants(gear_ratio=ratio, **values), column(
        "voltage", float(setup.drive.battery.nominal_voltage)
    )


def _with_drive(
    gear: Value | None, constants: Constants, voltage: Array, answers: dict[str, Array], reasons: NDArray[Any]
) -> None:  # fmt: skip
    """Add what the drive makes of speed and torque."""
    speed, torque = answers["speed_rad_s"], answers["torque_Nm"]
    with np.errstate(invalid="ignore", divide="ignore"):
        if gear in ("adapted", "best"):
            find = adapted_gear if gear == "adapted" else best_gear
            ratio = find(constants, speed, torque, voltage)
        else:
            ratio = np.asarray(constants.gear_ratio)
        values = {f.name: getattr(constants, f.name) for f in fields(constants)}
        point = steady(
            Constants(**{**values, "gear_ratio": ratio}), speed, answers["thrust_N"], torque, voltage
        )
    answers |= {
        "electrical_power_W": point.input_power_W,
        "thrust_per_power_N_W": point.thrust_per_power_N_W,
        "efficiency": point.efficiency,
        "gear_ratio": ratio,
        "duty": point.duty,
        "motor_current_A": point.motor_current_A,
    }
    for k in np.flatnonzero(reasons == ""):
        if not np.isfinite(ratio[k]):
            reasons[k] = (
                f"the motor has not the {answers['power_W'][k]:.3g} W that the rotor needs, at any gear ratio"
            )
        elif point.duty[k] > 1.0 + 1e-9:
            reasons[k] = (
                f"the motor needs {point.motor_voltage_V[k]:.3g} V, the supply gives {voltage[k]:.3g} V"
            )
