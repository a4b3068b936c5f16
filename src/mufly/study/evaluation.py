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

import math
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Literal, Protocol

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
from mufly.rotor import (
    Air,
    Blading,
    Corrections,
    PolarTable,
    Rotor,
    RotorResult,
    balance_torque,
    coaxial,
    hover,
    polars,
    prepare,
)
from mufly.rotor.blading import STATIONS
from mufly.rotor.system import (
    FASTEST_TIP_M_S,
    balance_pitch,
    balance_pitch_wake,
    balance_torque_wake,
    coaxial_wake,
    hover_wake,
)
from mufly.rotor.wake import Placed, WakeSettings, WakeSolution
from mufly.rotor.wake.result import check_rotors
from mufly.study.parameters import GEOMETRY, PAIR, Value
from mufly.study.setup import METHODS, Setup, check_names, reshape

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
        its tolerance (see :mod:`mufly.study.evaluation`).

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


# ----------------------------------------------------------------------------
# Cases of a study of single rotors by the wake method: one wake a case, and a search where a thrust or duty is given.
#
# The speed that gives a thrust, or at which a motor settles, is found with blade element momentum theory scaled to
# the
# wake at the last speed (as in :mod:`mufly.rotor.measurements`), until the speed stands still.
#
# Neighbouring cases start from each other's wake. A wake so begun agrees with one begun afresh within the tolerance
# of convergence, not bit by bit; a case that does not converge that way is begun afresh before it is called failed. A
# wake that settled only with thicker cores than the one remembered is no start for others: they would inherit them.


# The wake's sums run on all cores by themselves, and Numba's plain threading layer serves one caller at a time.
WAKE_LOCK = threading.Lock()

_STILL = 5e-4  # of the speed: 0.1 % of the thrust
_TRIES = 8
_LAST: dict[WakeSettings, WakeSolution] = {}  # the last converged wake, for the next case


@dataclass(frozen=True, eq=False)
class WakeAnswers:
    """(n,) arrays, nan where ``reason`` is not empty."""

    speed_rad_s: Array
    thrust_N: Array
    torque_Nm: Array
    outside_share: Array
    core_limit: Array
    reason: list[str]


def remember(last: dict[WakeSettings, WakeSolution], settings: WakeSettings, now: WakeSolution) -> None:
    """Keep a converged wake as the start of the next case, unless its cores are thicker than those of the one kept."""
    known = last.get(settings)
    if known is None or (now.settings.core_limit or 0.0) <= (known.settings.core_limit or 0.0):
        last.clear()
        last[settings] = now


def _one(
    blading: Blading, which: int, pitch: float, speed: float, climb: float, air: Air, settings: WakeSettings
) -> WakeSolution:
    known = _LAST.get(settings)
    now: WakeSolution | None = None
    for start in [known, None] if known is not None else [None]:
        now = hover_wake(
            blading, pitch_rad=pitch, speed_rad_s=speed, climb_m_s=climb, air=air, which=which, settings=settings,
            start=start,
        )  # fmt: skip
        if now.converged:
            remember(_LAST, settings, now)
            return now
    assert now is not None
    return now


def solve_wakes(
    blading: Blading,
    which: NDArray[np.int64],
    pitch_rad: Array,
    climb_m_s: Array,
    air: Air,
    settings: WakeSettings,
    load: RotorLoad,
    speed_rad_s: Array,
    find: Callable[[RotorLoad], Array] | None,
) -> WakeAnswers:
    """Solve cases by the wake method.

    Parameters
    ----------
    blading : Blading
    which, pitch_rad, climb_m_s : (n,) arrays
        Rotor, pitch and axial speed of each case.
    air : Air
    settings : WakeSettings
    load : RotorLoad
        Of blade element theory.
    speed_rad_s : (n,) array
        Speeds, or what blade element theory takes for them; nan where it finds none.
    find : callable, optional
        Speeds of all cases for a load, if they are sought.
    """
    n = pitch_rad.size
    speed_, thrust_, torque_, share_, core_ = (np.full(n, np.nan) for _ in range(5))
    out = WakeAnswers(speed_, thrust_, torque_, share_, core_, [""] * n)
    factors = np.ones((2, n))
    speed, todo = (
        speed_rad_s.copy(),
        [k for k in range(n) if np.isfinite(speed_rad_s[k]) and speed_rad_s[k] > 0],
    )

    def scaled(omega: Array, index: NDArray[np.int64]) -> tuple[Array, Array]:
        thrust, torque = load(omega, index)
        return thrust * factors[0, index], torque * factors[1, index]

    for _ in range(_TRIES):
        for k in list(todo):
            try:
                with WAKE_LOCK:
                    now = _one(blading, int(which[k]), pitch_rad[k], speed[k], climb_m_s[k], air, settings)
            except InputError as error:
                out.reason[k] = str(error)
                todo.remove(k)
                continue
            r = now.rotors[0]
            if not now.converged:
                out.reason[k] = f"wake {now.message}"
                todo.remove(k)
                continue
            out.speed_rad_s[k], out.thrust_N[k], out.torque_Nm[k] = speed[k], r.thrust_N, r.torque_Nm
            out.outside_share[k] = r.outside_share
            out.core_limit[k] = now.settings.core_limit if now.settings.core_limit is not None else np.nan
            if find is None:
                todo.remove(k)
                continue
            thrust, torque = load(speed[k : k + 1], np.array([k]))
            factors[:, k] = r.thrust_N / thrust[0], r.torque_Nm / torque[0]
            if not np.all((factors[:, k] > 0.1) & (factors[:, k] < 10.0)):
                out.reason[k] = "wake and blade element theory are too far apart to look for a speed"
                todo.remove(k)
        if not todo or find is None:
            break
        following = find(scaled)
        for k in list(todo):
            if not np.isfinite(following[k]):
                out.reason[k] = "the wake method finds no speed for it"
                todo.remove(k)
            elif abs(following[k] / speed[k] - 1.0) <= max(_STILL, 0.5 * settings.tolerance):
                todo.remove(k)
            else:
                speed[k] = following[k]
    for k in todo:
        out.reason[k] = f"the speed does not stand still in {_TRIES} wakes"
    return out


# ----------------------------------------------------------------------------
# One coaxial pair at one point, by either method: what is given, what is found, what the pair costs.
#
# A case is a dictionary of parameters (``parameters.PAIR``, SI values). It says spacing, pitch (or the pitch of each
# rotor) and one of
#
# * ``upper_speed`` with ``lower_speed`` or ``speed_ratio``: the pair is evaluated at these speeds;
# * ``upper_speed`` alone: the lower speed is found at which the torques cancel;
# * ``thrust``: both speeds are found, torques cancelled.
#
# With ``free = "lower-pitch"`` the lower pitch cancels the torques instead, at the speeds given, or, with a thrust,
# at
# speeds of the ratio given (1 if none is).


Free = Literal["lower-speed", "lower-pitch"]
Progress = Callable[[int, float, float], None]


@dataclass(frozen=True)
class PairSetup:
    """What all cases of a pair share.

    Attributes
    ----------
    upper, lower : Rotor
    fixed : mapping
        Parameters that hold in every case unless it names them itself.
    method : 'bemt' or 'wake'
    wake : WakeSettings
    corrections : Corrections
    engine, model : str
        Of the polars.
    stations : int
        Along each blade.
    free : 'lower-speed' or 'lower-pitch'
        What cancels the torques.
    """

    upper: Rotor
    lower: Rotor
    fixed: Mapping[str, Value] = field(default_factory=dict)
    method: str = "wake"
    wake: WakeSettings = field(default_factory=WakeSettings)
    corrections: Corrections = field(default_factory=Corrections)
    engine: str = "neuralfoil"
    model: str = "xlarge"
    stations: int = STATIONS
    free: Free = "lower-speed"

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise InputError(
                "coaxial", "method", f"{self.method!r} is unknown", f"use one of: {', '.join(METHODS)}"
            )
        if self.free not in ("lower-speed", "lower-pitch"):
            raise InputError(
                "coaxial",
                "free",
                f"{self.free!r} cannot balance the torques",
                "use lower-speed or lower-pitch",
            )


@dataclass(frozen=True, eq=False)
class PairPoint:
    """A pair at a point.

    Attributes
    ----------
    upper, lower : RotorResult
        Each rotor in the presence of the other.
    spacing_m, disc_m2 : float
        Distance of the discs, and the area of the larger one.
    air : Air
    solution : WakeSolution or None
        The wake, if that was the method.
    converged : bool
    message : str
        How it converged, or why not.
    """

    upper: RotorResult
    lower: RotorResult
    spacing_m: float
    disc_m2: float
    air: Air
    solution: WakeSolution | None
    converged: bool
    message: str

    @property
    def thrust_N(self) -> float:
        return self.upper.thrust_N + self.lower.thrust_N

    @property
    def power_W(self) -> float:
        return self.upper.power_W + self.lower.power_W

    @property
    def yaw_torque_Nm(self) -> float:
        """Torque of the lower less that of the upper rotor; 0 in trim."""
        return self.lower.torque_Nm - self.upper.torque_Nm

    @property
    def figure_of_merit(self) -> float:
        """T sqrt(T / (2 rho A)) / P with one disc, the larger; nan unless thrust and power are positive."""
        if not (self.thrust_N > 0.0 and self.power_W > 0.0):
            return math.nan
        return (
            self.thrust_N
            * math.sqrt(self.thrust_N / (2.0 * self.air.density_kg_m3 * self.disc_m2))
            / self.power_W
        )


def check_pair(setup: PairSetup, names: Iterable[str]) -> None:
    """Refuse a study of a pair whose parameters make no sense together.

    Raises
    ------
    InputError
        If spacing, a pitch or an operating point is missing, or there are two.
    """
    every = {*names, *setup.fixed}
    for name in every:
        if name not in PAIR:
            raise InputError("coaxial", name, "cannot be varied or set", f"use one of: {', '.join(PAIR)}")
    if "spacing" not in every:
        raise InputError("coaxial", "spacing", "is missing", "give it, as spacing=20mm")
    each = [n for n in ("upper_pitch", "lower_pitch") if n in every]
    if not ("pitch" in every or len(each) == 2 or (each == ["upper_pitch"] and setup.free == "lower-pitch")):
        raise InputError("coaxial", "pitch", "is missing", "give pitch=14deg, or upper_pitch and lower_pitch")
    if "pitch" in every and len(each) == 2:
        raise InputError("coaxial", "pitch", "is given beside both pitches", "leave it out")
    if setup.free == "lower-pitch" and "lower_pitch" in every:
        raise InputError(
            "coaxial", "lower_pitch", "is given and sought", "leave it out, or balance by lower-speed"
        )
    if ("thrust" in every) == ("upper_speed" in every):
        raise InputError(
            "coaxial", "", "needs one of thrust and upper_speed", "give thrust=0.9N or upper_speed=6000rpm"
        )
    below = [n for n in ("lower_speed", "speed_ratio") if n in every]
    if len(below) == 2:
        raise InputError("coaxial", "speed_ratio", "is given beside lower_speed", "leave one of the two out")
    if "thrust" in every and (below == ["lower_speed"] or (below and setup.free == "lower-speed")):
        raise InputError(
            "coaxial", below[0], "is given beside a thrust, which finds it", "leave one of the two out"
        )


def bladings_of(setup: PairSetup, case: Mapping[str, Value]) -> tuple[Blading, Blading]:
    """Both rotors of a case, reshaped and laid out.

    Raises
    ------
    MuflyError
        If a shape is impossible or an airfoil has no polar.
    """
    every = {**setup.fixed, **case}
    shapes = []
    for side, rotor in (("upper", setup.upper), ("lower", setup.lower)):
        own = {n: every[f"{side}_{n}"] for n in ("chord", "taper", "twist") if f"{side}_{n}" in every}
        shapes.append(reshape(rotor, own))
    names = list(dict.fromkeys(n for r in shapes for n in r.airfoil_names()))
    found = polar_tables(names, float(every.get("n_crit", 0.1)), setup)
    good = {}
    for name, table in found.items():
        if isinstance(table, str):
            raise MuflyError(table)
        good[name] = table
    upper, lower = (prepare(r, good, corrections=setup.corrections, stations=setup.stations) for r in shapes)
    return upper, lower


def air_of(setup: PairSetup, case: Mapping[str, Value]) -> Air:
    """The air of a case."""
    return Air(float({**setup.fixed, **case}.get("density", Air().density_kg_m3)))


def solve_pair(
    setup: PairSetup,
    case: Mapping[str, Value] | None = None,
    *,
    bladings: tuple[Blading, Blading] | None = None,
    start: WakeSolution | None = None,
    progress: Progress | None = None,
) -> PairPoint:
    """Solve a pair at a point.

    Parameters
    ----------
    setup : PairSetup
    case : mapping, optional
        What changes from ``setup.fixed``; see the module docstring.
    bladings : (upper, lower), optional
        From :func:`bladings_of`, if they are at hand.
    start : WakeSolution, optional
        A similar wake to start from.
    progress : callable, optional
        Of the wake: iteration, residual, thrust (N).

    Raises
    ------
    InputError
        If parameters make no sense together, or the blades would touch.
    MuflyError
        If no balance is found. A single wake that does not converge is returned, marked so.
    """
    every = {**setup.fixed, **(case or {})}
    check_pair(setup, every)
    upper, lower = bladings or bladings_of(setup, every)
    air = air_of(setup, every)
    number = {k: float(v) for k, v in every.items() if not isinstance(v, str)}
    spacing, climb, thrust = number["spacing"], number.get("climb", 0.0), number.get("thrust")
    above = number.get("upper_pitch", number.get("pitch", math.nan))
    below = number.get("lower_pitch", number.get("pitch", above))
    first = number.get("upper_speed", 300.0)
    second = number.get("lower_speed", first * number.get("speed_ratio", 1.0))
    check_rotors((Placed(upper, above, first, 0.0, 1), Placed(lower, below, second, -spacing, -1)), climb)
    common = {"spacing_m": spacing, "upper_pitch_rad": above, "climb_m_s": climb}
    wake = setup.method == "wake"
    more = {"settings": setup.wake, "start": start, "progress": progress}
    fixed = "lower_speed" in number or "speed_ratio" in number
    if setup.free == "lower-pitch":
        speeds = {"upper_speed_rad_s": first, "lower_speed_rad_s": second, "thrust_N": thrust}
        answer = (
            balance_pitch_wake(upper, lower, **common, **speeds, air=air, **more)  # type: ignore[arg-type]
            if wake
            else balance_pitch(upper, lower, **common, **speeds, air=air)  # type: ignore[arg-type]
        )
    elif fixed:
        at = {"lower_pitch_rad": below, "upper_speed_rad_s": first, "lower_speed_rad_s": second}
        answer = (
            coaxial_wake(upper, lower, **common, **at, air=air, **more)  # type: ignore[arg-type]
            if wake
            else coaxial(upper, lower, **common, **at, air=air)  # type: ignore[arg-type]
        )
    else:
        given = {"thrust_N": thrust} if thrust is not None else {"upper_speed_rad_s": first}
        answer = (
            balance_torque_wake(upper, lower, **common, **given, lower_pitch_rad=below, air=air, **more)  # type: ignore[arg-type]
            if wake
            else balance_torque(upper, lower, **common, **given, lower_pitch_rad=below, air=air)
        )
    disc = math.pi * max(upper.rotors[0].radius_m, lower.rotors[0].radius_m) ** 2
    if isinstance(answer, WakeSolution):
        a, b = answer.rotors
        return PairPoint(a, b, spacing, disc, air, answer, answer.converged, answer.message)
    return PairPoint(
        answer.upper, answer.lower, spacing, disc, air, None, True, f"settled in {answer.turns} turns"
    )


def alone(
    setup: PairSetup, point: PairPoint, bladings: tuple[Blading, Blading], progress: Progress | None = None
) -> tuple[RotorResult, RotorResult]:
    """Both rotors of a point without each other: same pitch, speed and climb.

    Raises
    ------
    MuflyError
        If a wake does not converge.
    """
    out: list[RotorResult] = []
    for blading, r in zip(bladings, (point.upper, point.lower), strict=True):
        same = out and blading.rotors == bladings[0].rotors
        if same and (r.pitch_rad, r.speed_rad_s) == (out[0].pitch_rad, out[0].speed_rad_s):
            out.append(out[0])
            continue
        at = {"pitch_rad": r.pitch_rad, "speed_rad_s": r.speed_rad_s, "climb_m_s": r.climb_m_s}
        if point.solution is None:
            out.append(hover(blading, **at, air=point.air))  # type: ignore[arg-type]
            continue
        s = hover_wake(blading, **at, air=point.air, settings=setup.wake, progress=progress)  # type: ignore[arg-type]
        if not s.converged:
            raise MuflyError(
                f"coaxial: the wake of the {('upper', 'lower')[len(out)]} rotor alone is {s.message}"
            )
        out.append(s.rotors[0])
    return out[0], out[1]
