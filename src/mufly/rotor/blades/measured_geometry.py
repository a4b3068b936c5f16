"""Rotor from a caliper and a protractor: chords and angles at a few stations, with the uncertainty of both.

The propeller lies with its hub flat on a plate. At each station the caliper gives the chord c along the chord line, the
protractor the angle b of the chord line against the plate. A protractor's error has a part common to all stations
(zero, plate, hub) and a part of each reading; the variance s^2 of a reading is divided equally between the two. At the
last station the caliper also gives the height h of the leading over the trailing edge, an angle independent of the
protractor,

    b_h = asin(h / c),      variance  2 s_c^2 / (c cos b)^2 + s_z^2

with the caliper's deviation s_c and s_z = 0.5 degrees for the plate. The offset d = b_h - b of that station corrects
all angles by d v_p / (v_p + v_h), with v_p = s^2 / 2 the common variance and v_h the variance of d without it. The
remaining variance of the angles as a whole, and s^2 / (2 N) of the N readings, go into the rotor file as
``blade.pitch_std``. Several readings of one station (other blades, other days) are averaged; if they scatter by more
than s, their scatter replaces it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.results import ResultColumn, ShownBlock, columns_to_rows, make_lines_block, result, tabulate_results
from mufly.rotor.effective_pitch import PitchOffsetPrior, estimate_pitch_offset_prior
from mufly.rotor.geometry import Rotor, rotor_from_tables

Array = NDArray[np.float64]

STATION_RATIOS = (0.25, 0.40, 0.55, 0.70, 0.85, 0.95)
"""Recommended stations, r/R: more of them where the loading is greatest."""
CHORD_STD_M, BLADE_ANGLE_STD_RAD = 2e-4, math.radians(1.0)
"""Standard deviations of a caliper's chord on rounded edges, and of a protractor's angle."""
_PLATE_ANGLE_STD_RAD = math.radians(0.5)
_SAME_STATION_RADIUS_FRACTION = 0.01  # of the radius: readings closer than this are of one station
_MAX_ANGLE_DISAGREEMENT_SIGMAS = 3.0  # standard deviations between protractor and caliper at the last station
_OUTLIER_SIGMAS = 3.0  # standard deviations of a reading from a smooth curve through the others
_MIN_OUTLIER_STATIONS = 5  # for the search of outliers
_MIN_ODD_CHORD_DEVIATION = 0.2  # of the median chord: planforms have corners, angles do not


MEASUREMENT_INSTRUCTIONS = (
    "Lay the propeller with its hub flat on a plate. Mark the radii below from the middle of the shaft.",
    "Caliper: chord from leading to trailing edge, along the blade's surface line.",
    "Protractor: angle against the plate; on a curved underside, of the line through both edges.",
    "Caliper: thickness, the greatest at that radius; it may be left out.",
    "Caliper, at the last station: height of leading edge less height of trailing edge.",
)
_READING_TABLE_COMMENTS = (
    "Columns: chord_mm, angle_deg, thickness_mm. The height at the last station is for --tip-height.",
    "Repeat the rows for the other blade. Empty rows may be deleted.",
)


class GeometryReadings(NamedTuple):
    """Readings of calipers and protractor at n stations of a blade.

    Radius and chord (m), angle (rad) and greatest thickness over chord (nan where not measured) are (n,) arrays.
    ``tip_leading_edge_rise_m`` is the height of the leading over the trailing edge at the last station, or None.
    """

    r_m: Array
    chord_m: Array
    angle_rad: Array
    tip_leading_edge_rise_m: float | None = None
    thickness: Array | None = None


@result(
    eq=False,
    json="name=rotor.name common_pitch_std_rad chord_std_m effective_pitch_mean_rad=pitch_prior.offset_mean_rad "
    "effective_pitch_std_rad=pitch_prior.offset_std_rad notes",
)
class MeasuredGeometry:
    """Rotor whose geometry was measured.

    Attributes
    ----------
    rotor : Rotor
    common_pitch_std_rad : float
        Standard deviation of the error that is common to all angles.
    chord_std_m : float
        Standard deviation of a chord.
    notes : tuple of str
    """

    rotor: Rotor
    common_pitch_std_rad: float
    chord_std_m: float
    notes: tuple[str, ...]

    @property
    def pitch_prior(self) -> PitchOffsetPrior:
        """Prior of the effective pitch."""
        return estimate_pitch_offset_prior(self.rotor)

    def make_printed_blocks(self) -> tuple[ShownBlock, ...]:
        """Return the stations, notes and the uncertainty of the angles as printed text."""
        blade, prior = self.rotor.blade, self.pitch_prior
        x = blade.r_over_R.to_si_array()
        rows = columns_to_rows({
            "r_over_R": x, "chord_m": blade.chord.to_si_array(), "chord_std_m": np.full(x.size, self.chord_std_m),
            "angle_rad": blade.twist.to_si_array(), "thickness": self.rotor.stated_thickness(x),
        })  # fmt: skip
        columns = (
            ResultColumn("r_over_R", form=".3f", head="r/R"), ResultColumn("chord_m", "mm", ".2f"),
            ResultColumn("chord_std_m", "mm", ".2f"), ResultColumn("angle_rad", "deg", ".1f"),
            ResultColumn("thickness", "%", ".1f", head="thickness over chord"),
        )  # fmt: skip
        offset, std, whole = np.degrees([prior.offset_mean_rad, prior.offset_std_rad, self.common_pitch_std_rad])
        return (
            tabulate_results(rows, columns),
            make_lines_block(*self.notes, mark="Note", style="yellow"),
            make_lines_block(
                f"angles as a whole: ± {whole:.2f}°; effective pitch {prior.origin}: {offset:+.2f} ± {std:.2f}°"
            ),
        )


def rotor_from_readings(
    readings: GeometryReadings,
    *,
    radius_m: float,
    blades: int,
    name: str,
    airfoil: str = "naca4412",
    stated_pitch_m: float | None = None,
    chord_std_m: float = CHORD_STD_M,
    angle_std_rad: float = BLADE_ANGLE_STD_RAD,
) -> MeasuredGeometry:
    """Return the rotor whose geometry is estimated from caliper and protractor readings.

    Parameters
    ----------
    readings : GeometryReadings
    radius_m, blades, name, airfoil
        As in a rotor file.
    stated_pitch_m : float, optional
        Pitch that the maker states, advance in a turn (m).
    chord_std_m, angle_std_rad : float
        Standard deviations of a reading.

    Raises
    ------
    InputError
        If there are fewer than three stations, one lies outside the radius, or the tip height exceeds the chord.
    """
    order = np.argsort(readings.r_m, kind="stable")
    r, chord, angle = (np.asarray(v, dtype=np.float64)[order] for v in readings[:3])
    if r.size and not (r[0] > 0.0 and r[-1] <= radius_m * (1.0 + 1e-6)):
        raise InputError(
            name, "r", f"goes from {1e3 * r[0]:g} to {1e3 * r[-1]:g} mm",
            f"measure within the radius of {1e3 * radius_m:g} mm, from the middle of the shaft",
        )  # fmt: skip
    starts = np.flatnonzero(np.diff(r, prepend=-math.inf) > _SAME_STATION_RADIUS_FRACTION * radius_m)
    if starts.size < 3:
        raise InputError(name, "stations", f"are {starts.size}", "measure at three radii or more; six are recommended")
    counts = np.diff(np.append(starts, r.size))
    at, width, twist = (np.add.reduceat(v, starts) / counts for v in (r, chord, angle))
    notes = []
    s, s_c = angle_std_rad, chord_std_m
    if r.size > starts.size:
        free = r.size - starts.size
        scatter, scatter_c = (
            math.sqrt(float(np.sum((v - np.repeat(mean, counts)) ** 2)) / free)
            for v, mean in ((angle, twist), (chord, width))
        )
        notes.append(
            f"{r.size} readings at {starts.size} stations scatter by {math.degrees(scatter):.2f} degrees and "
            f"{1e3 * scatter_c:.2f} mm"
        )
        s, s_c = max(s, scatter), max(s_c, scatter_c)
    common, single = 0.5 * s**2, 0.5 * s**2
    left = common
    if readings.tip_leading_edge_rise_m is not None:
        h, c, b = readings.tip_leading_edge_rise_m, float(width[-1]), float(twist[-1])
        if not abs(h) < c:
            raise InputError(
                name, "tip height", f"{1e3 * h:g} mm is not less than the chord of {1e3 * c:g} mm",
                "give the height of the leading over the trailing edge at the last station",
            )  # fmt: skip
        apart = math.asin(h / c) - b
        caliper = 2.0 * s_c**2 / (c * math.cos(b)) ** 2 + _PLATE_ANGLE_STD_RAD**2 + single / counts[-1]
        twist = twist + apart * common / (common + caliper)
        left = common * caliper / (common + caliper)
        notes.append(
            f"the tip height gives {math.degrees(b + apart):.1f} degrees at the last station, the protractor "
            f"{math.degrees(b):.1f}: all angles move by {math.degrees(apart * common / (common + caliper)):+.2f}"
        )
        if abs(apart) > _MAX_ANGLE_DISAGREEMENT_SIGMAS * math.sqrt(common + caliper):
            notes.append("protractor and tip height disagree; measure both again")
    std = math.sqrt(left + single / r.size)
    number = np.arange(r.size) - np.repeat(starts, counts) + 1  # of a reading at its station, in the order of the file
    blade_name = "blade" if counts.max() == blades else "reading"
    owner = [f"{blade_name} {k}" if counts.max() > 1 else "" for k in number.tolist()]
    for what, unit, values, deviation, least in (
        ("angle", "degrees", np.degrees(angle), math.degrees(angle_std_rad), 0.0),
        ("chord", "mm", 1e3 * chord, 1e3 * chord_std_m, _MIN_ODD_CHORD_DEVIATION * 1e3 * float(np.median(chord))),
    ):
        for k, off in _find_outliers(r / radius_m, values, deviation):
            if abs(off) > least:
                of = f" of {owner[k]}" if owner[k] else ""
                notes.append(
                    f"the {what}{of} at {r[k] / radius_m:.2f} R, {values[k]:.4g} {unit}, is {off:+.1f} {unit} off its "
                    "neighbours; check it"
                )
    x = np.append(at / radius_m, 1.0) if at[-1] < radius_m * (1.0 - 1e-6) else at / radius_m
    x[-1] = 1.0
    held = (np.append(v, v[-1]) if x.size > at.size else v for v in (width, twist))
    source = {"source": "measured", "note": f"caliper and protractor, {r.size} readings"}
    columns = {k: {"value": v.tolist(), "unit": u, **source} for k, v, u in zip(("chord", "twist"), held, ("m", "rad"),
               strict=True)}  # fmt: skip
    blade: dict[str, object] = {
        "r_over_R": {"value": x.tolist(), "unit": "1", **source}, **columns, "airfoils": [airfoil],
        "geometry": "caliper",
        "pitch_std": {"value": std, "unit": "rad", "source": "estimated", "note": "of the readings"},
    }  # fmt: skip
    tables = {
        "name": name,
        "description": "measured by caliper and protractor",
        "blades": blades,
        "radius": {"value": radius_m, "unit": "m", **source},
        "hub_cutout": {"value": min(float(x[0]), 0.9), "unit": "1", "source": "estimated", "note": "first station"},
        "blade": blade,
    }
    if readings.thickness is not None and np.isfinite(readings.thickness).any():
        thick = readings.thickness[order]
        total, seen = (np.add.reduceat(v, starts) for v in (np.nan_to_num(thick), np.isfinite(thick).astype(float)))
        ratios = np.interp(x, (at / radius_m)[seen > 0.0], total[seen > 0.0] / seen[seen > 0.0])
        blade["thickness"] = {"value": ratios.tolist(), "unit": "1", **source}
    if stated_pitch_m is not None:
        tables["nominal_pitch"] = {"value": stated_pitch_m, "unit": "m", "source": "datasheet"}
    return MeasuredGeometry(rotor_from_tables(tables, name), std, s_c / math.sqrt(float(np.median(counts))),
                            tuple(notes))  # fmt: skip


def _find_outliers(x: Array, values: Array, std: float) -> list[tuple[int, float]]:
    """Return index and deviation of each reading that lies off the parabola through the others, the farthest first.

    The standard deviation of the others is that of a reading or, if greater, their own about the parabola.
    """
    left, found = np.arange(x.size), list[tuple[int, float]]()
    while np.unique(np.round(x[left], 2)).size >= _MIN_OUTLIER_STATIONS and len(found) < x.size // 3:
        ratios, offs = np.zeros(left.size), np.zeros(left.size)
        for i, k in enumerate(left):
            others = np.delete(left, i)
            basis = np.polynomial.polynomial.polyvander(x[others] - x[k], 2)
            inverse = np.linalg.inv(basis.T @ basis)
            curve = inverse @ basis.T @ values[others]
            own = float(np.sum((values[others] - basis @ curve) ** 2)) / (others.size - 3)
            offs[i] = values[k] - curve[0]
            ratios[i] = abs(offs[i]) / math.sqrt(max(std**2, own) * (1.0 + inverse[0, 0]))
        i = int(np.argmax(ratios))
        if ratios[i] <= _OUTLIER_SIGMAS:
            break
        found.append((int(left[i]), float(offs[i])))
        left = np.delete(left, i)
    return found


def make_blank_reading_table(radius_m: float, stated_pitch_m: float | None = None) -> str:
    """Return an empty table of readings, CSV, with the steps of the measurement as comments.

    Parameters
    ----------
    radius_m : float
    stated_pitch_m : float, optional
        Pitch that the maker states (m); angles to expect are then written as comments.
    """
    lines = [f"# {k}. {text}" for k, text in enumerate((*MEASUREMENT_INSTRUCTIONS, *_READING_TABLE_COMMENTS), 1)]
    if stated_pitch_m is not None:
        angles = [math.degrees(math.atan(stated_pitch_m / (2.0 * math.pi * x * radius_m))) for x in STATION_RATIOS]
        lines.append("# The stated pitch gives " + ", ".join(f"{a:.0f}" for a in angles) + " degrees.")
    rows = [f"{1e3 * x * radius_m:.1f},,," for x in STATION_RATIOS]
    return "\n".join([*lines, "r_mm,chord_mm,angle_deg,thickness_mm", *rows, ""])
