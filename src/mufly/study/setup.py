"""What all cases of a study share, what they answer, and which parameters go together."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from mufly.drive import Drive
from mufly.errors import InputError
from mufly.rotor import PLAIN, Corrections, Rotor
from mufly.rotor.blading import STATIONS
from mufly.rotor.wake import WakeSettings
from mufly.study.parameters import DRIVE, PARAMETERS, Value

__all__ = ["DRIVE_OUTPUTS", "METHODS", "MODELS", "OUTPUTS", "Setup", "check_names"]

# Blade element momentum theory as recommended here, as in textbooks, and as the dissertation has it (Sec. 3.3.1:
# effective radius of eq. 3.13, no swirl, no hub loss; its tuning to one rotor is not given).
MODELS: dict[str, Corrections] = {
    "full": Corrections(),
    "plain": PLAIN,
    "thesis": replace(PLAIN, tip_loss="effective_radius", hub_loss=False, swirl=False),
}

# Name -> unit, meaning.
OUTPUTS: dict[str, tuple[str, str]] = {
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
METHODS = ("bemt", "wake")
_GIVEN = ("speed", "thrust", "duty")


@dataclass(frozen=True)
class Setup:
    """What all cases of a study share.

    Attributes
    ----------
    rotor : Rotor
    drive : Drive, optional
    fixed : mapping
        Parameters that hold in every case unless it names them itself.
    corrections : Corrections
        Of the blade element calculation.
    engine, model : str
        Of the polars.
    flags : bool
        Whether ``outside_share`` is computed, which takes as long as the rest.
    method : 'bemt' or 'wake'
        Blade element momentum theory, or the wake method: a thousand to ten thousand times as long a case.
    wake : WakeSettings
        Of the wake method.
    stations : int
        Along a blade.
    """

    rotor: Rotor
    drive: Drive | None = None
    fixed: Mapping[str, Value] = field(default_factory=dict)
    corrections: Corrections = field(default_factory=Corrections)
    engine: str = "neuralfoil"
    model: str = "xlarge"
    flags: bool = True
    method: str = "bemt"
    wake: WakeSettings = field(default_factory=WakeSettings)
    stations: int = STATIONS

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise InputError(
                "study", "method", f"{self.method!r} is unknown", f"use one of: {', '.join(METHODS)}"
            )

    def outputs(self) -> dict[str, tuple[str, str]]:
        """Return name, unit and meaning of what :func:`evaluate` answers."""
        more = DRIVE_OUTPUTS if self.drive is not None else {}
        return {**OUTPUTS, **more, **(WAKE_OUTPUTS if self.method == "wake" else {})}


def check_names(setup: Setup, names: Iterable[str]) -> None:
    """Refuse a study whose parameters make no sense together.

    Raises
    ------
    InputError
        If the pitch is missing, or not exactly one of speed, thrust and duty is there, or a drive is.
    """
    every = {*names, *setup.fixed}
    for name in every:
        if name not in PARAMETERS:
            raise InputError("study", name, "cannot be varied or set", f"use one of: {', '.join(PARAMETERS)}")
    if "pitch" not in every:
        raise InputError("study", "pitch", "is missing", "fix it (pitch=12deg) or vary it (pitch=6:20:1deg)")
    given = [g for g in _GIVEN if g in every]
    if len(given) != 1:
        raise InputError(
            "study", "", f"{' and '.join(given) or 'no operating point'} given",
            "give one of speed (5000rpm), thrust (0.4N) and duty (100%)",
        )  # fmt: skip
    needs = [name for name in every if name in DRIVE or name == "duty"]
    if setup.drive is None and needs:
        raise InputError("study", needs[0], "needs a drive train", "give a drive, as mufly")
    if setup.drive is not None and setup.fixed.get("gear") in ("adapted", "best") and "thrust" not in every:
        raise InputError(
            "study", "gear", "can only be found for a thrust", "give the thrust, or a gear ratio"
        )
