"""Evaluation of the cases of a study: rotor or pair by blade elements or wake, with an optional drive train.

A case is a dictionary of parameters (SI values); other values come from the rotors and the drive of the study. For a
single rotor (:mod:`mufly.study.study_parameters`) it contains the pitch and one of

* ``speed``: the rotor is evaluated at this speed;
* ``thrust``: the speed that gives this thrust is found;
* ``duty``: the equilibrium speed of rotor and motor is found (eq. 3.18), at ``voltage`` times duty.

With a thrust the gear may be ``"adapted"`` (full voltage gives exactly the thrust, as in the dissertation's Sec. 3.4)
or ``"best"`` (least power at any duty); see :mod:`mufly.drive.gear_ratio`. For a coaxial pair the case contains
spacing, pitch (or the pitch of each rotor) and one of

* ``upper_speed`` with ``lower_speed`` or ``speed_ratio``: the pair is evaluated at these speeds;
* ``upper_speed`` alone: the lower speed is found at which the torques cancel;
* ``thrust``: both speeds are found, torques cancelled.

With ``balance_by = "lower-pitch"`` the lower pitch cancels the torques instead, at the given speeds or, with a thrust,
at the given speed ratio (default 1).

Single rotors by blade elements are solved in batches; wakes and pairs one after the other. A case that cannot be solved
has nan and a reason, and does not affect the others.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.drive import (
    MotorConstants,
    RotorLoad,
    compute_operating_point,
    find_full_voltage_gear_ratio,
    find_least_power_gear_ratio,
    find_speed_at_voltage,
    find_speed_for_thrust,
    make_blade_load,
)
from mufly.errors import InputError, MuflyError
from mufly.results import result
from mufly.rotor import (
    MAX_TIP_SPEED_M_S,
    Air,
    OperatingCondition,
    PolarTable,
    Rotor,
    RotorResult,
    RotorSystem,
    SystemSolution,
    compute_airfoil_polars,
    describe_supersonic_tips,
    prepare_blading,
    solve_rotor,
    solve_rotor_batch,
    solve_system,
)
from mufly.rotor.geometry import Transition
from mufly.rotor.rotor_solver import solve_from_neighbour
from mufly.rotor.wake import WakeSettings, check_rotors
from mufly.study.study_parameters import GEOMETRY_PARAMETERS, ParameterValue
from mufly.study.study_setup import SINGLE_OF_PAIR_OUTPUTS, StudySetup, check_study_parameters, reshape_rotor

Array = NDArray[np.float64]
StudyCase = Mapping[str, ParameterValue]
WakeProgress = Callable[[int, float, float], None]

_MOTOR_FIELDS = {
    "back_emf": "back_emf_V_s",
    "torque_constant": "torque_Nm_A",
    "resistance": "resistance_ohm",
    "friction": "friction_Nm_s",
    "friction_torque": "friction_Nm",
    "gear_efficiency": "gear_efficiency",
    "controller_efficiency": "controller_efficiency",
}


_ROTOR_OUTPUTS = ("thrust_N", "torque_Nm", "power_W", "figure_of_merit", "c_T", "c_Q")


@result(eq=False)
class StudyResults:
    """Results in the order of the cases: ``values[name]`` (n,), nan where ``fault[k]`` is not empty."""

    values: dict[str, Array]
    fault: list[str]


_POLAR_CACHE: dict[tuple[str, Transition, str, str], PolarTable | str] = {}  # most recently used polars
_MAX_CACHED_POLARS = 300  # 0.3 MB each
_POLAR_CACHE_LOCK = threading.Lock()


def load_polar_tables(names: Sequence[str], transition: Transition, setup: StudySetup) -> dict[str, PolarTable | str]:
    """Return the polar table of each airfoil, or the reason of its failure; missing tables are computed together on all
    cores.
    """
    key = {name: (name, transition, setup.polar_engine, setup.polar_model) for name in names}
    with _POLAR_CACHE_LOCK:
        missing = [name for name in names if key[name] not in _POLAR_CACHE]
        if missing:
            faults: dict[str, str] = {}
            found = compute_airfoil_polars(
                missing,
                n_crit=transition.n_crit,
                xtr=transition.xtr,
                model=setup.polar_model,
                faults=faults,
                engine=setup.polar_engine,  # type: ignore[arg-type]
            )
            answer: dict[str, PolarTable | str] = {n: _POLAR_CACHE[key[n]] for n in names if key[n] in _POLAR_CACHE}
            while _POLAR_CACHE and len(_POLAR_CACHE) + len(missing) > _MAX_CACHED_POLARS:
                _POLAR_CACHE.pop(next(iter(_POLAR_CACHE)))
            new = {name: found[name] if name in found else faults[name] for name in missing}
            _POLAR_CACHE.update({key[name]: table for name, table in new.items()})
            return {**answer, **new}
        return {name: _POLAR_CACHE[key[name]] for name in names}


def evaluate_cases(setup: StudySetup, cases: Sequence[StudyCase]) -> StudyResults:
    """Compute the results of cases, each a dictionary of parameters.

    Parameters
    ----------
    setup : StudySetup
    cases : sequence of mappings
        Cases with equal keys; see the module docstring.

    Returns
    -------
    StudyResults
        Results by blade elements do not depend on the grouping of cases into calls, bit for bit. Results of the wake
        method, which starts from the last wake, agree within its tolerance.

    Raises
    ------
    InputError
        If the parameters are inconsistent (see :func:`check_study_parameters`).
    MuflyError
        If the polar engine is not installed.
    """
    check_study_parameters(setup, list(cases[0]) if cases else [])
    out = StudyResults({name: np.full(len(cases), np.nan) for name in setup.output_meanings()}, [""] * len(cases))
    full = [{**setup.fixed_parameters, **case} for case in cases]
    if setup.lower_rotor is not None:
        for k, case in enumerate(full):
            try:
                row = _pair_results(_solve_from_last_wake(setup, partial(solve_case, setup, case)))
            except MuflyError as error:
                out.fault[k] = str(error)
                continue
            for name, value in row.items():
                out.values[name][k] = value
        return out
    rotors: dict[Any, Rotor | str] = {}
    keys = []
    groups: dict[tuple[Transition, float, float], list[int]] = {}
    air = Air()
    for k, case in enumerate(full):
        key = tuple((name, case[name]) for name in GEOMETRY_PARAMETERS if name in case)
        if key not in rotors:
            try:
                rotors[key] = reshape_rotor(setup.rotor, dict(key))
            except MuflyError as error:
                rotors[key] = str(error)
        keys.append(key)
        shape = rotors[key]
        if isinstance(shape, str):
            out.fault[k] = shape
            continue
        conditions = (
            shape.transition_at_n_crit(float(case.get("n_crit", 0.1))),
            float(case.get("density", air.density_kg_m3)),
            float(case.get("viscosity", air.viscosity_Pa_s)),
        )
        groups.setdefault(conditions, []).append(k)
    for (transition, density, viscosity), members in groups.items():
        _evaluate_group(setup, full, members, rotors, keys, transition, Air(density, viscosity), out)
    return out


def _evaluate_group(
    setup: StudySetup,
    full: Sequence[StudyCase],
    members: list[int],
    rotors: Mapping[Any, Rotor | str],
    keys: Sequence[Any],
    transition: Transition,
    air: Air,
    out: StudyResults,
) -> None:
    """Solve cases with equal air and polars."""
    shapes = {keys[k]: rotors[keys[k]] for k in members}
    names = list(dict.fromkeys(n for r in shapes.values() if isinstance(r, Rotor) for n in r.airfoil_names()))
    try:
        tables = load_polar_tables(names, transition, setup)
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
    blading = prepare_blading(
        many,
        {n: t for n, t in tables.items() if isinstance(t, PolarTable)},
        corrections=setup.corrections,
        stations=setup.station_count,
    )
    index = np.array(solved)
    which = np.array([used[keys[k]] for k in solved])

    def parameter_column(name: str, default: float | Array) -> Array:
        values = [full[k].get(name) for k in solved]
        if values and values[0] is None:
            return np.broadcast_to(np.asarray(default, dtype=np.float64), (len(solved),)).copy()
        return np.array([float(v) for v in values if v is not None], dtype=np.float64)

    pitch, climb = parameter_column("pitch", 0.0), parameter_column("climb", 0.0)
    load = make_blade_load(blading, pitch_rad=pitch, which=which, climb_m_s=climb, air=air)
    constants, voltage = _drive_columns(setup, parameter_column)
    radius = blading.radius_m[which]
    first = full[solved[0]]

    def find_speed(what: RotorLoad) -> Array:
        if "thrust" in first:
            return find_speed_for_thrust(what, parameter_column("thrust", 0.0), highest=MAX_TIP_SPEED_M_S / radius)[0]
        assert constants is not None
        return find_speed_at_voltage(constants, what, parameter_column("duty", 1.0) * voltage)[0]

    if "speed" in first:
        speed, why = parameter_column("speed", 0.0), "the speed is not a number above 0"
    elif "thrust" in first:
        speed = find_speed(load)
        why = f"thrust out of reach of this rotor at any tip speed up to {MAX_TIP_SPEED_M_S:g} m/s"
    else:
        speed, why = find_speed(load), "rotor and motor have no common steady speed"
    good = np.isfinite(speed) & (speed > 0)
    faults = [
        describe_supersonic_tips(float(r), float(v), air, float(c)) if ok else ""
        for r, v, c, ok in zip(radius, speed, climb, good, strict=True)
    ]
    good &= [not fault for fault in faults]
    answers = {name: np.full(index.size, np.nan) for name in _ROTOR_OUTPUTS}
    reasons = np.array(["" if ok else fault or why for ok, fault in zip(good, faults, strict=True)], dtype=object)
    share, core = np.full(index.size, np.nan), np.full(index.size, np.nan)
    if setup.method == "wake":
        for k in np.flatnonzero(good).tolist():
            at = OperatingCondition(float(pitch[k]), float(speed[k]), climb_m_s=float(climb[k]), air=air)
            system = RotorSystem.from_single_rotor(blading, which=int(which[k]))
            try:
                now = _solve_by_wake(setup, system, at, load, k, None if "speed" in first else find_speed)
            except MuflyError as error:
                reasons[k] = str(error)
                continue
            r = now.rotors[0]
            speed[k], share[k], core[k] = r.speed_rad_s, r.outside_share, _core_limit(now)
            for name, values in answers.items():
                values[k] = getattr(r, name)
    elif good.any():
        many_points = solve_rotor_batch(
            blading, pitch_rad=pitch[good], speed_rad_s=speed[good], climb_m_s=climb[good], which=which[good], air=air
        )
        for name, values in answers.items():
            values[good] = getattr(many_points, name)
    chord = np.array([float(rotor.chord_m(0.75)) for rotor in many])[which]
    answers["speed_rad_s"] = speed
    answers["reynolds_75"] = 0.75 * speed * radius * chord * air.density_kg_m3 / air.viscosity_Pa_s
    if constants is not None:
        _add_drive_results(first.get("gear"), constants, voltage, answers, reasons)
    if setup.method == "wake":
        answers["core_limit"] = core
    elif setup.with_outside_share:
        for k in np.flatnonzero(reasons == "").tolist():
            at_k = {
                "pitch_rad": pitch[k],
                "speed_rad_s": speed[k],
                "climb_m_s": climb[k],
                "which": int(which[k]),
            }
            share[k] = solve_rotor(blading, air=air, **at_k).outside_share
    if setup.with_outside_share:
        answers["outside_share"] = share
    for name, values in answers.items():
        out.values[name][index] = np.where(reasons == "", values, np.nan)
    for case, reason in zip(solved, reasons, strict=True):
        out.fault[case] = str(reason)


def _drive_columns(setup: StudySetup, column: Any) -> tuple[MotorConstants | None, Array]:
    """Return motor constants and supply voltage with one value per case; None and an empty array without a drive."""
    if setup.drive is None:
        return None, np.zeros(0)
    own = setup.drive.motor_constants()
    values = {key: column(name, float(np.asarray(getattr(own, key)))) for name, key in _MOTOR_FIELDS.items()}
    assert {*values, "gear_ratio"} == {f.name for f in fields(MotorConstants)}
    gear = setup.fixed_parameters.get("gear")
    ratio = (
        column("voltage", 0.0) * 0 + 1.0 if isinstance(gear, str) else column("gear", float(np.asarray(own.gear_ratio)))
    )
    return MotorConstants(gear_ratio=ratio, **values), column("voltage", float(setup.drive.battery.nominal_voltage))


def _add_drive_results(
    gear: ParameterValue | None,
    constants: MotorConstants,
    voltage: Array,
    answers: dict[str, Array],
    reasons: NDArray[Any],
) -> None:
    """Add electrical power, efficiency, gear ratio, duty and current at the rotor's speed and torque to ``answers``."""
    speed, torque = answers["speed_rad_s"], answers["torque_Nm"]
    with np.errstate(invalid="ignore", divide="ignore"):
        if gear in ("adapted", "best"):
            find = find_full_voltage_gear_ratio if gear == "adapted" else find_least_power_gear_ratio
            ratio = find(constants, speed, torque, voltage)
        else:
            ratio = np.asarray(constants.gear_ratio)
        values = {f.name: getattr(constants, f.name) for f in fields(constants)}
        point = compute_operating_point(
            MotorConstants(**{**values, "gear_ratio": ratio}), speed, answers["thrust_N"], torque, voltage
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
                f"the motor cannot deliver the {answers['power_W'][k]:.3g} W that the rotor needs, at any gear ratio"
            )
        elif point.duty[k] > 1.0 + 1e-9:
            reasons[k] = f"the motor needs {point.motor_voltage_V[k]:.3g} V, the supply gives {voltage[k]:.3g} V"


# ----------------------------------------------------------------------------
# One case at a time: a wake, or a pair.
#
# Neighbouring cases start from each other's wake. The result agrees with that of a fresh start within the tolerance of
# convergence, not bit for bit. A case that does not converge is repeated from a fresh start before it fails. A wake
# that converged only with thicker cores is not used as a start, because other cases would inherit the cores.
#
# The wake method uses all cores, and Numba's default threading layer serves one caller at a time.
_LAST_WAKES_LOCK = threading.Lock()
_LAST_WAKES: dict[int, tuple[WakeSettings, SystemSolution]] = {}  # by number of rotors: the last converged wake
_SPEED_ROOT_TOLERANCE = 5e-4  # of the speed: 0.1 % of the thrust
_MAX_WAKE_SOLUTIONS = 8


def _core_limit(result: SystemSolution) -> float:
    limit = None if result.settings is None else result.settings.core_limit
    return np.nan if limit is None else limit


def _solve_from_last_wake(setup: StudySetup, solved: Callable[..., SystemSolution]) -> SystemSolution:
    """Solve by the wake method from the last solved wake, or without it if that does not converge.

    Blade elements are solved without a start.

    Raises
    ------
    MuflyError
        If the fresh start does not converge either.
    """
    if setup.method != "wake":
        return solved(start=None)
    kind = len(setup.rotors)
    with _LAST_WAKES_LOCK:
        settings, known = _LAST_WAKES.get(kind, (None, None))
        known = known if settings == setup.wake_settings else None
        now = solve_from_neighbour(solved, known)
        if not now.converged:
            raise MuflyError(f"wake {now.message}")
        if known is None or np.nan_to_num(_core_limit(now)) <= np.nan_to_num(_core_limit(known)):
            _LAST_WAKES[kind] = (setup.wake_settings, now)
        return now


def _solve_by_wake(
    setup: StudySetup,
    system: RotorSystem,
    at: OperatingCondition,
    load: RotorLoad,
    k: int,
    find: Callable[[RotorLoad], Array] | None,
) -> SystemSolution:
    """Solve case ``k`` by the wake method; if ``find`` is given, search for the rotor speed.

    The unknown speed is found by blade element theory (``load``), scaled to the wake at the last speed, until it
    converges.
    """
    omega = float(np.asarray(at.speed_rad_s))
    for _ in range(_MAX_WAKE_SOLUTIONS):
        point = replace(at, speed_rad_s=omega)
        now = _solve_from_last_wake(setup, partial(solve_system, system, point, "wake", settings=setup.wake_settings))
        if find is None:
            return now
        thrust, torque = load(np.array([omega]), np.array([k]))
        r = now.rotors[0]
        by_thrust, by_torque = float(r.thrust_N / thrust[0]), float(r.torque_Nm / torque[0])
        if not (0.1 < by_thrust < 10.0 and 0.1 < by_torque < 10.0):
            raise MuflyError("wake and blade element theory differ too much to search for a speed")

        def scaled_load_of(
            speed: Array, index: NDArray[np.int64], f: tuple[float, float] = (by_thrust, by_torque)
        ) -> tuple[Array, Array]:
            thrust, torque = load(speed, index)
            return thrust * f[0], torque * f[1]

        following = float(find(scaled_load_of)[k])
        if not np.isfinite(following):
            raise MuflyError("the wake method finds no speed for this thrust")
        if abs(following / omega - 1.0) <= max(_SPEED_ROOT_TOLERANCE, 0.5 * setup.wake_settings.tolerance):
            return now
        omega = following
    raise MuflyError(f"the speed does not converge within {_MAX_WAKE_SOLUTIONS} wake solutions")


def build_rotor_system(setup: StudySetup, case: StudyCase | None = None) -> RotorSystem:
    """Return the rotor system of a case with its changes of geometry.

    Raises
    ------
    MuflyError
        If a geometry is impossible or an airfoil has no polar.
    """
    every = {**setup.fixed_parameters, **(case or {})}
    if setup.lower_rotor is None:
        shapes = [reshape_rotor(setup.rotor, {n: every[n] for n in GEOMETRY_PARAMETERS if n in every})]
    else:
        shapes = [
            reshape_rotor(r, {n: every[f"{side}_{n}"] for n in ("chord", "taper", "twist") if f"{side}_{n}" in every})
            for side, r in zip(("upper", "lower"), setup.rotors, strict=True)
        ]
    laid = []
    for shape in shapes:
        tables = {}
        transition = shape.transition_at_n_crit(float(every.get("n_crit", 0.1)))
        for name, table in load_polar_tables(shape.airfoil_names(), transition, setup).items():
            if isinstance(table, str):
                raise MuflyError(table)
            tables[name] = table
        laid.append(prepare_blading(shape, tables, corrections=setup.corrections, stations=setup.station_count))
    return (
        RotorSystem.from_single_rotor(laid[0])
        if setup.lower_rotor is None
        else RotorSystem.from_coaxial_pair(*laid, spacing_m=float(every["spacing"]))
    )


def build_operating_condition(setup: StudySetup, case: StudyCase | None = None) -> OperatingCondition:
    """Return the operating condition of a case; unknowns are None.

    Raises
    ------
    InputError
        If the parameters are inconsistent, or the case contains a duty, which only :func:`evaluate_cases` supports.
    """
    every = {**setup.fixed_parameters, **(case or {})}
    check_study_parameters(setup, every)
    number = {k: float(v) for k, v in every.items() if not isinstance(v, str)}
    still = Air()
    air = Air(number.get("density", still.density_kg_m3), number.get("viscosity", still.viscosity_Pa_s))
    thrust, climb = number.get("thrust"), number.get("climb", 0.0)
    if setup.lower_rotor is None:
        if "duty" in number:
            raise InputError("study", "duty", "is not a condition of the rotor alone", "give a speed or a thrust")
        return OperatingCondition(number["pitch"], number.get("speed"), thrust, climb, air)
    above = number.get("upper_pitch", number.get("pitch"))
    below = None if setup.balance_by == "lower-pitch" else number.get("lower_pitch", number.get("pitch", above))
    first = number.get("upper_speed")
    if setup.balance_by == "lower-pitch" or "lower_speed" in number or "speed_ratio" in number:
        start = 300.0 if first is None else first
        second = number.get("lower_speed", start * number.get("speed_ratio", 1.0))
        return OperatingCondition((above, below), (start, second), thrust, climb, air)
    return OperatingCondition((above, below), None if first is None else (first, None), thrust, climb, air)


def solve_case(
    setup: StudySetup,
    case: StudyCase | None = None,
    *,
    system: RotorSystem | None = None,
    start: SystemSolution | None = None,
    progress: WakeProgress | None = None,
) -> SystemSolution:
    """Solve one case and return the complete solution of :func:`mufly.rotor.solve_system`.

    Parameters
    ----------
    setup : StudySetup
    case : mapping, optional
        Changes from the fixed parameters of ``setup``; see the module docstring.
    system : RotorSystem, optional
        System of the case from :func:`build_rotor_system`.
    start : SystemSolution, optional
        Similar result to start from.
    progress : callable, optional
        Called by the wake method with iteration, residual and thrust (N).

    Raises
    ------
    InputError
        If parameters are inconsistent, or the blades would collide.
    MuflyError
        If no balance is found. A single wake that does not converge is returned with ``converged`` false.
    """
    condition = build_operating_condition(setup, case)
    system = system or build_rotor_system(setup, case)
    if setup.lower_rotor is not None:
        above, below = condition.pitch_rad  # type: ignore[misc]
        first, second = condition.speed_rad_s or (300.0, None)  # type: ignore[misc]
        pitches = (above, above if below is None else below)
        speeds = (first, first if second is None else second)
        check_rotors(system.place_rotors(pitches, speeds), condition.climb_m_s)  # type: ignore[arg-type]
    method = setup.method
    return solve_system(system, condition, method, settings=setup.wake_settings, start=start, progress=progress)  # type: ignore[arg-type]


def solve_isolated_rotors(
    setup: StudySetup, point: SystemSolution, progress: WakeProgress | None = None
) -> tuple[RotorResult, ...]:
    """Solve each rotor of a solution in isolation at the same pitch, speed and climb.

    Raises
    ------
    MuflyError
        If a wake does not converge.
    """
    out: list[RotorResult] = []
    keys: list[Any] = []
    for k, (r, placed) in enumerate(zip(point.rotors, point.placed, strict=True)):
        blading = placed.blading
        key = (blading.rotors, r.pitch_rad, r.speed_rad_s)
        if key in keys:
            out.append(out[keys.index(key)])
        else:
            at = OperatingCondition(r.pitch_rad, r.speed_rad_s, climb_m_s=r.climb_m_s, air=point.air)
            now = solve_system(
                RotorSystem.from_single_rotor(blading),
                at,
                point.method,
                settings=setup.wake_settings,
                progress=progress,
            )
            if not now.converged:
                raise MuflyError(f"coaxial: the wake of the {('upper', 'lower')[k]} rotor alone is {now.message}")
            out.append(now.rotors[0])
        keys.append(key)
    return tuple(out)


def _pair_results(point: SystemSolution) -> dict[str, float]:
    """Return the output variables of a study for a solved pair, by name."""
    up, low = point.upper, point.lower
    row = {
        "thrust_N": point.thrust_N,
        "power_W": point.power_W,
        "yaw_torque_Nm": point.yaw_torque_Nm,
        "figure_of_merit": point.figure_of_merit,
        "thrust_ratio": low.thrust_N / up.thrust_N,
        "torque_ratio": low.torque_Nm / up.torque_Nm,
        "iterations": float(point.iterations) if point.wakes else np.nan,
        "core_limit": _core_limit(point),
    }
    for side, r in (("upper", up), ("lower", low)):
        row |= {f"{side}_{key}": float(getattr(r, key)) for key in SINGLE_OF_PAIR_OUTPUTS}
    return row
