"""Setup of a study: shared settings, output variables, consistency of parameters, and changes of rotor geometry."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mufly.drive import DriveTrain
from mufly.errors import InputError
from mufly.rotor import TEXTBOOK_CORRECTIONS, Corrections, Rotor, rotor_from_tables
from mufly.rotor.blading import STATION_COUNT
from mufly.rotor.wake import WakeSettings
from mufly.study.study_parameters import (
    DRIVE_PARAMETERS,
    GEOMETRY_PARAMETERS,
    PAIR_PARAMETERS,
    ROTOR_PARAMETERS,
    ParameterValue,
    StudyParameterSpec,
)

# Blade element momentum theory as recommended, as in textbooks, and as in the dissertation (Sec. 3.3.1: effective #
# radius of eq. 3.13, no swirl, no hub loss; its calibration to one rotor is not published).
BEMT_MODELS: dict[str, Corrections] = {
    "full": Corrections(),
    "plain": TEXTBOOK_CORRECTIONS,
    "thesis": replace(TEXTBOOK_CORRECTIONS, tip_loss="effective_radius", hub_loss=False, swirl=False),
}

# Name -> unit, meaning.
ROTOR_OUTPUTS: dict[str, tuple[str, str]] = {
    "thrust_N": ("N", "thrust"),
    "torque_Nm": ("N m", "torque"),
    "power_W": ("W", "mechanical power at the rotor"),
    "speed_rad_s": ("rad/s", "rotor speed"),
    "figure_of_merit": ("1", "figure of merit"),
    "c_T": ("1", "T / (rho pi R^4 Omega^2)"),
    "c_Q": ("1", "Q / (rho pi R^5 Omega^2)"),
    "reynolds_75": ("1", "Reynolds number at 75 % radius"),
    "outside_share": ("1", "share of the thrust from sections beyond the polar's range"),
}
DRIVE_OUTPUTS: dict[str, tuple[str, str]] = {
    "electrical_power_W": ("W", "electrical input power"),
    "thrust_per_power_N_W": ("N/W", "thrust per electrical power"),
    "efficiency": ("1", "mechanical over electrical power"),
    "gear_ratio": ("1", "motor speed over rotor speed"),
    "duty": ("1", "share of the supply voltage at the motor"),
    "motor_current_A": ("A", "motor current"),
}
WAKE_OUTPUTS: dict[str, tuple[str, str]] = {
    "core_limit": ("1", "core radius of the old wake over R at which the wake settled"),
}
SINGLE_OF_PAIR_OUTPUTS: dict[str, tuple[str, str]] = {
    "thrust_N": ("N", "thrust of the {} rotor"),
    "torque_Nm": ("N m", "torque of the {} rotor"),
    "power_W": ("W", "power of the {} rotor"),
    "speed_rad_s": ("rad/s", "speed of the {} rotor"),
    "pitch_rad": ("rad", "pitch setting of the {} rotor"),
    "c_T": ("1", "c_T of the {} rotor"),
    "c_Q": ("1", "c_Q of the {} rotor"),
    "outside_share": ("1", "share of the {} rotor's thrust from sections beyond the polar's range"),
}
PAIR_OUTPUTS: dict[str, tuple[str, str]] = {
    "thrust_N": ("N", "thrust of the pair"),
    "power_W": ("W", "mechanical power of the pair"),
    "yaw_torque_Nm": ("N m", "torque of the lower minus that of the upper rotor"),
    "figure_of_merit": ("1", "figure of merit of the pair, one disc"),
    "thrust_ratio": ("1", "lower over upper thrust"),
    "torque_ratio": ("1", "lower over upper torque"),
    **{
        f"{side}_{key}": (unit, text.format(side))
        for side in ("upper", "lower")
        for key, (unit, text) in SINGLE_OF_PAIR_OUTPUTS.items()
    },
    "iterations": ("1", "iterations of the last wake"),
    **WAKE_OUTPUTS,
}
AERODYNAMIC_METHODS = ("bemt", "tubes", "wake")
TorqueBalance = Literal["lower-speed", "lower-pitch"]
_OPERATING_POINT_PARAMETERS = ("speed", "thrust", "duty")


@dataclass(frozen=True)
class StudySetup:
    """Settings shared by all cases of a study.

    Attributes
    ----------
    rotor : Rotor
        The rotor, or the upper rotor of a coaxial pair.
    drive : DriveTrain, optional
        Drive train of a single rotor.
    fixed_parameters : mapping
        Parameters of all cases; a case may override them.
    corrections : Corrections
        Corrections of the blade element calculation.
    polar_engine, polar_model : str
        Engine of the polars, and size of its network.
    with_outside_share : bool
        Whether ``outside_share`` of single rotors is computed, which doubles the time.
    method : 'bemt', 'tubes' or 'wake'
        Blade element momentum theory; for pairs with vortex tubes, ten times as slow; or the wake method, a thousand to
        ten thousand times as slow.
    wake_settings : WakeSettings
        Settings of the wake method.
    station_count : int
        Number of stations along a blade.
    lower_rotor : Rotor, optional
        Lower rotor of a coaxial pair.
    balance_by : 'lower-speed' or 'lower-pitch'
        Variable that cancels the torques of a pair.
    """

    rotor: Rotor
    drive: DriveTrain | None = None
    fixed_parameters: Mapping[str, ParameterValue] = field(default_factory=dict)
    corrections: Corrections = field(default_factory=Corrections)
    polar_engine: str = "neuralfoil"
    polar_model: str = "xlarge"
    with_outside_share: bool = True
    method: str = "bemt"
    wake_settings: WakeSettings = field(default_factory=WakeSettings)
    station_count: int = STATION_COUNT
    lower_rotor: Rotor | None = None
    balance_by: TorqueBalance = "lower-speed"

    def __post_init__(self) -> None:
        if self.method not in AERODYNAMIC_METHODS:
            known = f"use one of: {', '.join(AERODYNAMIC_METHODS)}"
            raise InputError(self.study_name_in_errors, "method", f"{self.method!r} is unknown", known)
        if self.balance_by not in ("lower-speed", "lower-pitch"):
            problem = f"{self.balance_by!r} cannot balance the torques"
            raise InputError(self.study_name_in_errors, "free", problem, "use lower-speed or lower-pitch")

    @property
    def study_name_in_errors(self) -> str:
        """Name of the study in error messages."""
        return "study" if self.lower_rotor is None else "coaxial"

    @property
    def rotors(self) -> tuple[Rotor, ...]:
        """The rotor, or both rotors of a pair, the upper first."""
        return (self.rotor,) if self.lower_rotor is None else (self.rotor, self.lower_rotor)

    @property
    def parameters(self) -> Mapping[str, StudyParameterSpec]:
        """Parameters that can be varied or fixed."""
        return ROTOR_PARAMETERS if self.lower_rotor is None else PAIR_PARAMETERS

    def output_meanings(self) -> dict[str, tuple[str, str]]:
        """Return name, unit and meaning of the results of :func:`mufly.study.evaluate_cases`."""
        if self.lower_rotor is not None:
            return PAIR_OUTPUTS
        more = DRIVE_OUTPUTS if self.drive is not None else {}
        return {**ROTOR_OUTPUTS, **more, **(WAKE_OUTPUTS if self.method == "wake" else {})}


def check_study_parameters(setup: StudySetup, names: Iterable[str]) -> None:
    """Check that the parameters of a study are consistent.

    Raises
    ------
    InputError
        For a single rotor, if the pitch or a required drive is missing, or not exactly one of speed, thrust and duty is
        given. For a pair, if spacing or a pitch is missing, or not exactly one operating point is given.
    """
    every = {*names, *setup.fixed_parameters}
    table = setup.parameters
    for name in every:
        if name not in table:
            remedy = f"use one of: {', '.join(table)}"
            raise InputError(setup.study_name_in_errors, name, "cannot be varied or set", remedy)
    fault = _check_single_rotor(setup, every) if setup.lower_rotor is None else _check_pair(setup, every)
    if fault is not None:
        raise InputError(setup.study_name_in_errors, *fault)


def _check_single_rotor(setup: StudySetup, every: set[str]) -> tuple[str, str, str] | None:
    """Return key, problem and remedy of the first error in the parameters of a single rotor; None if there is none."""
    if "pitch" not in every:
        return "pitch", "is missing", "fix it (pitch=12deg) or vary it (pitch=6:20:1deg)"
    given = [g for g in _OPERATING_POINT_PARAMETERS if g in every]
    if len(given) != 1:
        problem = f"{' and '.join(given) or 'no operating point'} given"
        return "", problem, "give one of speed (5000rpm), thrust (0.4N) and duty (100%)"
    needs = [name for name in every if name in DRIVE_PARAMETERS or name == "duty"]
    if setup.drive is None and needs:
        return needs[0], "needs a drive train", "give a drive, as mufly"
    if setup.drive is not None and setup.fixed_parameters.get("gear") in ("adapted", "best") and "thrust" not in every:
        return "gear", "can only be found for a thrust", "give the thrust, or a gear ratio"
    return None


def _check_pair(setup: StudySetup, every: set[str]) -> tuple[str, str, str] | None:
    """Return key, problem and remedy of the first error in the parameters of a pair; None if there is none."""
    if "spacing" not in every:
        return "spacing", "is missing", "give it, as spacing=20mm"
    each = [n for n in ("upper_pitch", "lower_pitch") if n in every]
    by_pitch = setup.balance_by == "lower-pitch"
    if not ("pitch" in every or len(each) == 2 or (each == ["upper_pitch"] and by_pitch)):
        return "pitch", "is missing", "give pitch=14deg, or upper_pitch and lower_pitch"
    if "pitch" in every and len(each) == 2:
        return "pitch", "is given beside both pitches", "leave it out"
    if by_pitch and "lower_pitch" in every:
        return "lower_pitch", "is given and sought", "omit it, or balance by lower-speed"
    if ("thrust" in every) == ("upper_speed" in every):
        return "", "needs one of thrust and upper_speed", "give thrust=0.9N or upper_speed=6000rpm"
    below = [n for n in ("lower_speed", "speed_ratio") if n in every]
    if len(below) == 2:
        return "speed_ratio", "is given beside lower_speed", "leave one of the two out"
    if "thrust" in every and (below == ["lower_speed"] or (below and not by_pitch)):
        return below[0], "excludes thrust", "leave one of the two out"
    return None


# ----------------------------------------------------------------------------
# Changes of a rotor's blades, as in the dissertation's studies.
#
# With x = r/R, the cut-out x0 and the mean chord c_m between x0 and the tip:
#
# * ``chord``: all chords times chord / c_m.
# * ``taper`` t: c = c_h + (c_t - c_h) (x - x0) / (1 - x0), c_h = 2 c_m / (1 + t), c_t = t c_h, so that the area
#   stays; the dissertation's TAPER3505 (35 mm at the hub, 5 mm at the tip, 20 mm before) is t = 1/7.
# * ``twist`` T: theta = T (1 - x) / (1 - x0), zero at the tip. The dissertation does not state the
#   radius of its pitch angle. Its optimum moves to smaller pitch with stronger twist (Fig. 3.36), which fits the tip.


Array = NDArray[np.float64]

_STUDY_VALUE_PROVENANCE = {"source": "specified", "note": "set by a study"}
_NACA_PARAMETERS = ("camber", "camber_position", "thickness")


def modify_naca_name(base: str, changes: Mapping[str, ParameterValue]) -> str:
    """Return the four-digit NACA name with changed camber, camber position or thickness (all over chord).

    Raises
    ------
    InputError
        If the airfoil is not of that series or four digits cannot express a number.
    """
    match = re.fullmatch(r"naca(\d)(\d)(\d\d)", re.sub(r"[\s_-]", "", base.lower()))
    if match is None:
        key = next(k for k in _NACA_PARAMETERS if k in changes)
        raise InputError(key, "", f"{base} is not a four-digit NACA section", "start from one, as in airfoil=naca4412")
    digits = [int(digit) for digit in match.groups()]
    for place, (key, step, most) in enumerate(
        (("camber", 0.01, 9), ("camber_position", 0.1, 9), ("thickness", 0.01, 40))
    ):
        if key in changes:
            number = float(changes[key]) / step
            if abs(number - round(number)) > 1e-6 or not 0 <= round(number) <= most:
                raise InputError(
                    key, "", f"{100 * float(changes[key]):g} % is not in the NACA four-digit series",
                    f"give multiples of {100 * step:g} % up to {100 * step * most:g} %",
                )  # fmt: skip
            digits[place] = round(number)
    if digits[0] == 0:
        digits[1] = 0
    elif digits[1] == 0:
        digits[1] = 4
    return f"naca{digits[0]}{digits[1]}{digits[2]:02d}"


def reshape_rotor(rotor: Rotor, changes: Mapping[str, ParameterValue]) -> Rotor:
    """Return the rotor with changed :data:`mufly.study.study_parameters.GEOMETRY_PARAMETERS` (SI values).

    Raises
    ------
    InputError
        If a value is impossible.
    """
    unknown = [key for key in changes if key not in GEOMETRY_PARAMETERS]
    if unknown:
        raise InputError(
            "rotor", unknown[0], "is not a parameter of a blade", f"use one of: {', '.join(GEOMETRY_PARAMETERS)}"
        )
    if not changes:
        return rotor
    # All changes act on arrays and are validated once at the end, because a search makes thousands of rotors.
    tables = rotor.toml_tables()
    blade = tables["blade"]
    x0 = float(changes.get("hub_cutout", float(rotor.hub_cutout)))
    names = [str(changes["airfoil"])] if "airfoil" in changes else list(rotor.blade.airfoils)
    if any(key in changes for key in _NACA_PARAMETERS):
        names = [modify_naca_name(name, changes) for name in names]
    x = rotor.blade.r_over_R.to_si_array()
    if ("taper" in changes or "twist" in changes) and len(names) == 1 and 0.0 <= x0 < 1.0 and x[0] < x0:
        x = np.concatenate(([x0], x[x > x0]))  # the linear distribution begins at the cut-out
    chord, twist = rotor.chord_m(x), rotor.twist_rad(x)
    outboard = np.maximum(x, x0)
    if "taper" in changes:
        shape = 1.0 + (float(changes["taper"]) - 1.0) * (outboard - x0) / (1.0 - x0)
        chord = shape * _mean_over_blade(x, chord, x0) / _mean_over_blade(x, shape, x0)
    if "chord" in changes:
        chord = chord * float(changes["chord"]) / _mean_over_blade(x, chord, x0)
    if "twist" in changes:
        twist = float(changes["twist"]) * (1.0 - outboard) / (1.0 - x0)
    blade["airfoils"] = names
    if names != list(rotor.blade.airfoils):
        tables.pop("fit", None)  # a fit is valid only for its own sections
    columns = {"r_over_R": x, "chord": chord, "twist": twist}
    if "thickness" in changes:
        blade.pop("thickness", None)
    elif rotor.blade.thickness is not None:
        columns["thickness"] = rotor.stated_thickness(x)
    for key, values in columns.items():
        if not np.array_equal(values, getattr(rotor.blade, key).to_si_array()):
            blade[key] = {**blade[key], "value": values.tolist(), **_STUDY_VALUE_PROVENANCE}
    for key in ("radius", "hub_cutout"):
        if key in changes:
            tables[key] = {**tables[key], "value": float(changes[key]), **_STUDY_VALUE_PROVENANCE}
    for key in ("trip_upper", "trip_lower"):
        if key in changes:
            blade[key] = {"value": float(changes[key]), "unit": "1", **_STUDY_VALUE_PROVENANCE}
    if "blades" in changes:
        tables["blades"] = round(float(changes["blades"]))
    return rotor_from_tables(tables, rotor.name)


def _mean_over_blade(x: Array, values: Array, x0: float) -> float:
    """Return the mean from cut-out to tip of a piecewise linear distribution that is constant inside the first
    station."""
    at = np.concatenate(([x0], x[x > x0]))
    y = np.interp(at, x, values)
    return float(np.sum(0.5 * (y[1:] + y[:-1]) * np.diff(at)) / (1.0 - x0))
