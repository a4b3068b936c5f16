"""What blade element momentum theory says of the very points that the bench measured: single rotors and pairs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mufly.bench.loads import Loads
from mufly.errors import InputError
from mufly.rotor import Air, Blading, coaxial, hover_batch

__all__ = ["Prediction", "predict"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Prediction:
    """Predicted loads at the measured points.

    Attributes
    ----------
    speed_rad_s, load : dict of str to (n,) array
        By channel; N or N m.
    error : dict of str to (n,) array
        Prediction over measurement less one.
    """

    speed_rad_s: dict[str, Array]
    load: dict[str, Array]
    error: dict[str, Array]

    def in_words(self) -> list[str]:
        """Return mean and mean absolute error of each channel."""
        return [
            f"{name}: prediction {100 * np.mean(e):+.1f} % from the measured on average, "
            f"{100 * np.mean(np.abs(e)):.1f} % in the mean of absolute errors ({e.size} points)"
            for name, e in self.error.items()
        ]


def predict(
    loads: Loads, blading: Blading, *, density_kg_m3: float, pitch_rad: float | None = None,
    spacing_m: float | None = None, progress: Callable[[int, int], None] | None = None,
) -> Prediction:  # fmt: skip
    """Predict the measured points.

    Parameters
    ----------
    loads : Loads
    blading : Blading
        The rotor; a pair has two of them.
    density_kg_m3 : float
        Of the air.
    pitch_rad : float, optional
        Pitch setting where the file does not say; default 0, the blades as in the rotor file.
    spacing_m : float, optional
        Between the discs of a pair.
    progress : callable, optional
        Called with points done and all points.

    Raises
    ------
    InputError
        For a pair without a spacing.
    """
    table = loads.table
    air = Air(density_kg_m3=density_kg_m3)
    pitch = (
        table["pitch"] if "pitch" in table else np.full(len(table), 0.0 if pitch_rad is None else pitch_rad)
    )
    values: dict[str, Array] = {}
    speeds: dict[str, Array] = {}
    if "speed_upper" in table and "speed_lower" in table:
        if spacing_m is None:
            raise InputError(
                "--spacing", "", "is missing for a coaxial pair", "give the distance between the discs in m"
            )
        up, dw = table["speed_upper"], table["speed_lower"]
        found = np.full((len(table), 4), np.nan)
        both = np.flatnonzero((up > 0) & (dw > 0))
        for done, k in enumerate(both):
            pair = coaxial(
                blading, blading, spacing_m=spacing_m, upper_pitch_rad=pitch[k], lower_pitch_rad=pitch[k],
                upper_speed_rad_s=up[k], lower_speed_rad_s=dw[k], air=air,
            )  # fmt: skip
            u, d = pair.upper, pair.lower
            found[k] = u.thrust_N, u.torque_Nm, d.thrust_N, d.torque_Nm
            if progress is not None:
                progress(done + 1, both.size)
        values = dict(
            zip(("thrust_upper", "torque_upper", "thrust_lower", "torque_lower"), found.T, strict=True)
        )
        values["thrust"] = values["thrust_upper"] + values["thrust_lower"]
        speeds = {name: dw if name.endswith("lower") else up for name in values}
    else:
        table.require(("speed",))
        out = hover_batch(blading, pitch_rad=pitch, speed_rad_s=np.abs(table["speed"]), air=air)
        values = {"thrust": out.thrust_N, "torque": out.torque_Nm}
        speeds = dict.fromkeys(values, table["speed"])
    chosen = {
        name: np.isfinite(v) & np.isfinite(loads.values[name])
        for name, v in values.items()
        if name in loads.values
    }
    return Prediction(
        {name: np.abs(speeds[name][c]) for name, c in chosen.items()},
        {name: values[name][c] for name, c in chosen.items()},
        {name: values[name][c] / np.abs(loads.values[name][c]) - 1.0 for name, c in chosen.items()},
    )
