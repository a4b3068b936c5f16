"""Bandwidth and phase delay of the attitude response to a stick input, as defined by ADS-33.

ADS-33E-PRF, *Handling Qualities Requirements for Military Rotorcraft*, 2000, Sec. 3.3.2.1 and Fig. 2; Hoh, Mitchell,
Ashkenas, Klein, Heffley and Hodgkinson 1982, AFWAL-TR-82-3081. With the phase ``Phi`` (deg) of attitude over stick and
the lowest frequency ``w_180`` at which the phase is -180 deg:

    w_phase:  Phi = -135 deg, 45 deg of phase margin
    w_gain:   the gain is 6 dB above the gain at w_180
    tau_p   = -(Phi(2 w_180) + 180) / (57.3 * 2 w_180)

The bandwidth of a rate response (rate command, attitude hold) is the smaller of the two. The bandwidth of an attitude
response is ``w_phase``; a ``w_gain`` below it, or none, warns of pilot-induced oscillations. For a phase that is curved
between ``w_180`` and ``2 w_180`` the standard uses a least-squares line, which is reported as well. Standard deviations
are the random error of the response over the local slope of phase or gain.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.identify.linear.frequency_response import FrequencyResponse
from mufly.results import (
    ShownBlock,
    ShownLines,
    ShownTable,
    format_value,
    make_lines_block,
    make_table_block,
    result,
    to_plain_data,
)

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
_PHASE_MARGIN_DEG, _GAIN_MARGIN_DB = 45.0, 6.0


@result
class Bandwidth:
    """Bandwidth and phase delay; NaN if a value does not exist or lies outside the data.

    Attributes
    ----------
    bandwidth_rad_s : float
        Bandwidth of a rate response: the smaller of ``phase_rad_s`` and ``gain_rad_s``.
    phase_rad_s, gain_rad_s : float
        Bandwidth by phase margin, and by gain margin.
    phase_crossover_rad_s : float
        Lowest frequency with a phase of -180 deg.
    phase_delay_s : float
    phase_delay_line_s : float
        Phase delay from a least-squares line through the phase from ``phase_crossover_rad_s`` to twice this frequency.
    bandwidth_std_rad_s, phase_std_rad_s, gain_std_rad_s, phase_crossover_std_rad_s, phase_delay_std_s : float
        Standard deviations.
    notes : tuple of str
        Missing values and the reasons.
    """

    bandwidth_rad_s: float
    phase_rad_s: float
    gain_rad_s: float
    phase_crossover_rad_s: float
    phase_delay_s: float
    phase_delay_line_s: float
    bandwidth_std_rad_s: float
    phase_std_rad_s: float
    gain_std_rad_s: float
    phase_crossover_std_rad_s: float
    phase_delay_std_s: float
    notes: tuple[str, ...]

    def make_printed_blocks(self) -> tuple[ShownTable, ShownLines]:
        """Return the values with their standard deviations as printed text."""
        values = (
            ("bandwidth, the lesser", self.bandwidth_rad_s, self.bandwidth_std_rad_s, "rad/s"),
            ("by phase margin of 45 deg", self.phase_rad_s, self.phase_std_rad_s, "rad/s"),
            ("by gain margin of 6 dB", self.gain_rad_s, self.gain_std_rad_s, "rad/s"),
            ("phase -180 deg at", self.phase_crossover_rad_s, self.phase_crossover_std_rad_s, "rad/s"),
            ("phase delay", self.phase_delay_s, self.phase_delay_std_s, "s"),
            ("phase delay, by a straight line", self.phase_delay_line_s, None, "s"),
        )
        rows = [(label, format_value(x, ".3g"), format_value(std, ".2g"), unit) for label, x, std, unit in values]
        table = make_table_block(("", "value", "std", "unit"), rows, text=(0, 3))
        return table, make_lines_block(*self.notes, mark="Note")


@result(eq=False)
class AttitudeBandwidth:
    """Bandwidth of an attitude response, with the response.

    Attributes
    ----------
    bandwidth : Bandwidth
    response : FrequencyResponse
        Response of the attitude to the stick, the first input, and to other inputs.
    """

    bandwidth: Bandwidth
    response: FrequencyResponse

    def as_record(self) -> dict[str, Any]:
        """Return the fields of the bandwidth and of the response."""
        return {**to_plain_data(self.bandwidth), **to_plain_data(self.response)}

    def make_printed_blocks(self) -> tuple[ShownBlock, ...]:
        """Return the bandwidth as printed text."""
        table, notes = self.bandwidth.make_printed_blocks()
        return replace(table, title=f"{self.response.inputs[0]} to {self.response.outputs[0]}"), notes


def measure_attitude_bandwidth(response: FrequencyResponse) -> AttitudeBandwidth:
    """Measure the bandwidth of the first output to the first input, from its coherent points; a rate p, q, r is
    integrated.

    Raises
    ------
    InputError
        If too few points are coherent, or the sign of the response is inverted.
    """
    name = response.outputs[0]
    if name in ("p", "q", "r"):
        angle = response.response / (2j * np.pi * response.frequency_hz[:, None, None])
        response = replace(response, response=angle, outputs=(f"{name}/s", *response.outputs[1:]))
    coherent = np.where(response.is_coherent[:, 0, 0], response.response[:, 0, 0], np.nan)
    found = measure_bandwidth(response.frequency_hz, coherent, response.error[:, 0, 0])
    return AttitudeBandwidth(found, response)


def measure_bandwidth(frequency_hz: Array, response: ComplexArray, error: Array | None = None) -> Bandwidth:
    """Compute bandwidth and phase delay by the rules of ADS-33 from a frequency response.

    Parameters
    ----------
    frequency_hz : (f,) array
        Increasing frequencies, so close that the phase changes by less than 180 deg between neighbours.
    response : (f,) complex array
        Attitude over stick; incoherent points should be omitted or NaN.
    error : (f,) array, optional
        Relative standard deviation of the magnitude, which equals the standard deviation of the phase (rad).

    Raises
    ------
    InputError
        If there are fewer than four points, or the initial phase is impossible for an attitude: an inverted sign.
    """
    good = np.isfinite(response) & (np.abs(np.nan_to_num(response)) > 0.0)
    w, h = 2.0 * np.pi * np.asarray(frequency_hz)[good], np.asarray(response)[good]
    eps = np.zeros(len(w)) if error is None else np.asarray(error)[good]
    if len(w) < 4:
        raise InputError("bandwidth", "", f"{len(w)} coherent points are too few", "give four or more")
    phase = np.degrees(np.unwrap(np.angle(h)))
    phase -= 360.0 * np.round(
        (phase[0] + 90.0) / 360.0
    )  # initial phase of an attitude response: between 0 and -180 deg
    if phase[0] > 45.0:
        raise InputError(
            "bandwidth", "", f"the phase begins at {phase[0]:+.0f} deg, but that of an attitude begins "
            "between 0 and -180",
            "invert the sign of input or output",
        )  # fmt: skip
    gain = 20.0 * np.log10(np.abs(h))
    notes: list[str] = []
    sigma_phase, sigma_gain = np.degrees(eps), 8.686 * eps
    at_phase, std_phase = _find_crossing(w, phase, -180.0 + _PHASE_MARGIN_DEG, sigma_phase)
    at_180, std_180 = _find_crossing(w, phase, -180.0, sigma_phase)
    if np.isnan(at_phase):
        begins = phase[0] <= -180.0 + _PHASE_MARGIN_DEG
        notes.append(
            "the phase begins below -135 deg: give a band that begins lower" if begins
            else "the phase does not reach -135 deg: give a band that ends higher"
        )  # fmt: skip
    at_gain = std_gain = delay = line = std_delay = float("nan")
    if np.isnan(at_180):
        passed = "begins below" if phase[0] <= -180.0 else "does not reach"
        notes.append(f"the phase {passed} -180 deg: no gain bandwidth and no phase delay")
    else:
        level = float(np.interp(np.log(at_180), np.log(w), gain))
        low = w <= at_180
        # The uncertainty of the level includes its own error and the error of the crossing frequency.
        at = int(np.searchsorted(w, at_180))
        doubt = np.hypot(np.interp(at_180, w, sigma_gain), _local_slope(w, gain, at - 1) * std_180)
        at_gain, std_gain = _find_crossing(
            w[low], gain[low], level + _GAIN_MARGIN_DB, np.hypot(sigma_gain, doubt)[low], last=True
        )
        if np.isnan(at_gain):
            notes.append("the gain is nowhere 6 dB above that at -180 deg: no gain bandwidth")
        if w[-1] >= 2.0 * at_180:
            far = float(np.interp(2.0 * at_180, w, phase))
            delay = -np.radians(far + 180.0) / (2.0 * at_180)
            std_delay = np.radians(float(np.interp(2.0 * at_180, w, sigma_phase))) / (2.0 * at_180)
        else:
            way = "from a line through the available points" if w[-1] >= 1.3 * at_180 else "not to be had"
            notes.append(
                f"the band ends below {at_180 / np.pi:.3g} Hz, twice the frequency of -180 deg: phase delay {way}"
            )
        inside = (w >= at_180) & (w <= 2.0 * at_180)
        if inside.sum() >= 2 and w[-1] >= 1.3 * at_180:
            x, y = w[inside] - at_180, phase[inside] + 180.0
            line = -np.radians(float((x @ y) / (x @ x))) / 2.0 if (x @ x) > 0 else float("nan")
    both = [(v, s) for v, s in ((at_phase, std_phase), (at_gain, std_gain)) if not np.isnan(v)]
    least = min(both) if both else (float("nan"), float("nan"))
    if not np.isnan(at_gain) and at_gain < at_phase:
        notes.append("the gain margin decides: for an attitude response that warns of pilot-induced oscillations")
    return Bandwidth(
        least[0],
        at_phase,
        at_gain,
        at_180,
        delay,
        line,
        least[1],
        std_phase,
        std_gain,
        std_180,
        std_delay,
        tuple(notes),
    )


def _find_crossing(w: Array, y: Array, level: float, sigma: Array, *, last: bool = False) -> tuple[float, float]:
    """Return the first (or last) frequency at which a falling curve crosses a level, and its standard deviation
    (rad/s).
    """
    places = np.flatnonzero((y[:-1] > level) & (y[1:] <= level))
    if not places.size:
        return float("nan"), float("nan")
    k = int(places[-1 if last else 0])
    share = (level - y[k]) / (y[k + 1] - y[k])
    at = float(np.exp(np.log(w[k]) + share * np.log(w[k + 1] / w[k])))
    slope = _local_slope(w, y, k)
    doubt = float(sigma[k] + share * (sigma[k + 1] - sigma[k]))
    return at, doubt / abs(slope) if slope else float("nan")


def _local_slope(w: Array, y: Array, k: int) -> float:
    """Return the slope of a curve between points ``k`` and ``k + 1``, from a line fitted to four points."""
    near = slice(max(k - 1, 0), k + 3)
    return float(np.polyfit(w[near], y[near], 1)[0])
