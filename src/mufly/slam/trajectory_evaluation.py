"""Comparison of a trajectory with the truth (errors, drift, consistency); both are read from files.

A row is ``t x y z qx qy qz qw`` (TUM), separated by blanks, commas, semicolons or tabs. A header line above the rows,
in a comment or not, may put ``qw`` first and the time in ns (EuRoC). Stamps are s, ms, us or ns since 1970 by their
magnitude. Axes are N-E-D unless a comment names others, or the file is the ground truth of a data set of TUM or EuRoC
(x north, y west, z up). Quaternions are normalised; rows without numbers are skipped and counted; unordered rows are
sorted. Every repair is a :class:`mufly.logs.LogWarning`.

ATE (Sturm et al. 2012) is the root mean square of position errors, here without alignment and after the best rotation
about the vertical and shift (Umeyama 1991; scale fixed). RPE is the error of the displacement over a time, in axes of
the heading at its start. NEES is e^T P^-1 e over N, E, D and heading; divided by four its mean is one for a
consistent P. The share inside the 95 % ellipsoid is that below the chi-squared quantile 9.49.
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Callable
from dataclasses import field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mufly.errors import InputError
from mufly.files.text_table import decode_text, detect_separator_and_decimal_mark
from mufly.logs import LogWarning
from mufly.results import ShownBlock, make_table_block, result
from mufly.rotations import euler_from_quaternion

_Array = NDArray[np.float64]
_QUATERNION_COLUMNS = slice(4, 8)
"""Columns of a pose, behind its time and place."""
CHI2_95_4_DOF = 9.4877
_MIN_POSITION_SIGMA_M = 1e-4
"""Positions with a smaller sigma (m) are given, not estimated, as at the start of a map; NEES omits them."""


_MIN_POSE_ROWS = 3
_MAX_GAP_S, _MAX_GAP_INTERVALS = 0.2, 5.0
"""Larger gaps (s, and steps) between rows of the truth are excluded from the comparison."""
_MIN_OTHER_AXES_ERROR_M = 0.02
_QUATERNION_NORM_TOLERANCE, _MIN_QUATERNION_NORM = 1e-3, 1e-6
_EPOCH_STAMP_UNITS = (
    (1e17, 1e-9, "ns"),
    (1e14, 1e-6, "us"),
    (1e11, 1e-3, "ms"),
)  # units of stamps since 1970 above these magnitudes
_QUATERNION_W_PATTERN = re.compile(r"(?:q|quat|rot|orientation)?[a-z_.]*w")
_AXIS_CONVENTIONS: dict[str, tuple[str, tuple[int, int, int], Callable[[_Array], _Array]]] = {
    # Pattern in a comment, signed columns of N, E, D (from 1), and the heading as a function of yaw.
    "x north, y west, z up": (r"x north, y west, z up|\bNWU\b", (1, -2, -3), lambda yaw: -yaw),
    "x east, y north, z up": (r"x east, y north, z up|\bENU\b", (2, 1, -3), lambda yaw: math.pi / 2 - yaw),
    "N-E-D": (r"\bN-?E-?D\b", (1, 2, 3), lambda yaw: yaw),
}
_NWU_TRUTH_FILES = {("groundtruth.txt", ""), ("data.csv", "state_groundtruth_estimate0")}


class PoseTable(NamedTuple):
    """Rows of a trajectory's file, in order of time.

    Attributes
    ----------
    time_s, position, heading : (n,), (n, 3), (n,) arrays
        Times, positions N-E-D and headings (s, m, rad).
    extra_cells : list of n lists of str
        Further cells of each row.
    file_pose_count : int
        Number of poses in the file, including skipped ones.
    """

    time_s: _Array
    position: _Array
    heading: _Array
    extra_cells: list[list[str]]
    file_pose_count: int


def read_poses(file: Path) -> PoseTable:
    """Read a trajectory in TUM's text format, EuRoC's ground-truth format, or a similar table of poses.

    Raises
    ------
    InputError
        If the file cannot be read, or its rows are no poses.
    """
    where, remedy = str(file), "give a trajectory: t x y z qx qy qz qw"
    try:
        text = decode_text(file.read_bytes())
    except OSError as error:
        raise InputError(where, "", f"cannot be read ({error.strerror or error})", remedy) from error
    if "\0" in text:
        raise InputError(where, "", "is not text", remedy)
    comments, lines = [], []
    for number, line in enumerate(text.splitlines(), 1):
        content, _, comment = line.replace("%", "#", 1).partition("#") if line[:1] == "%" else line.partition("#")
        comments += [comment] if comment else []
        lines += [(number, content)] if content.strip() else []
    if not lines:
        raise InputError(where, "", "contains no rows", remedy)
    separator, decimal = detect_separator_and_decimal_mark([content for _, content in lines[:: 1 + len(lines) // 200]])
    cells = [(n, _split_cells(content, separator, decimal)) for n, content in lines]
    if not _is_number(cells[0][1][0]):
        comments.append(lines[0][1])
        cells = cells[1:]
    said: list[str] = []
    rows, more, numbers = _parse_pose_rows(cells, where, said)
    order, ns, named = _find_named_columns(comments, where)
    rows, keep = _drop_invalid_rows(rows[:, order], numbers, said)
    if not named and _has_scalar_first_order(rows[:, _QUATERNION_COLUMNS]):
        if separator == "," and np.median(rows[:, 0]) > _EPOCH_STAMP_UNITS[0][0]:  # EuRoC's format without a header
            rows[:, _QUATERNION_COLUMNS] = np.roll(rows[:, _QUATERNION_COLUMNS], -1, axis=1)
            said.append("its quaternions are read with w first; otherwise the vehicle would be upside down")
        else:
            said.append(
                "the vehicle is upside down; if w is the first number of its quaternions, name the "
                "columns: # t x y z qw qx qy qz"
            )
    _, columns, heading_of = _AXIS_CONVENTIONS[_detect_axes(comments, file)]
    stamps, tick = _stamps_to_seconds(rows[:, 0], ns)
    said += [f"its time stamps are read as {tick}"] if tick != "s" and not ns else []
    position = np.stack([math.copysign(1, k) * rows[:, abs(k)] for k in columns], axis=1)
    heading = np.angle(np.exp(1j * heading_of(euler_from_quaternion(rows[:, _QUATERNION_COLUMNS])[:, 2])))
    kept, repeated = _sort_by_time(stamps, [numbers[k] for k in keep], said)
    for note in said:
        warnings.warn(f"{file.name}: {note}", LogWarning, stacklevel=3)
    return PoseTable(
        stamps[kept], position[kept], heading[kept], [more[keep[k]] for k in kept], len(numbers) - repeated
    )


def read_truth_trajectory(place: Path) -> tuple[_Array, _Array, _Array] | None:
    """Return times, positions N-E-D and headings of the truth in a file or folder; None if a folder has none."""
    inside = (
        "truth.txt",
        "groundtruth.txt",
        *(f"{base}state_groundtruth_estimate0/data.csv" for base in ("mav0/", "")),
    )
    file = next((place / name for name in inside if (place / name).is_file()), None) if place.is_dir() else place
    return None if file is None else read_poses(file)[:3]


def _split_cells(line: str, separator: str, decimal: str) -> list[str]:
    cells = line.split() if separator == " " else [c.strip() for c in line.strip().split(separator)]
    while len(cells) > 1 and not cells[-1]:
        cells.pop()
    return [c.replace(",", ".") for c in cells] if decimal == "," else cells


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _parse_pose_rows(
    cells: list[tuple[int, list[str]]], where: str, said: list[str]
) -> tuple[_Array, list[list[str]], list[int]]:
    """Return the first eight numbers of each row, the further cells, and the line numbers.

    An incomplete last row is skipped.
    """
    if cells and len(cells[0][1]) == 12 and all(map(_is_number, cells[0][1])):
        raise InputError(where, f"line {cells[0][0]}", "has 12 numbers: KITTI's poses, which have no times",
                         "give TUM's text: t x y z qx qy qz qw")  # fmt: skip
    rows = np.empty((len(cells), 8))
    for k, (number, row) in enumerate(cells):
        try:
            rows[k] = [float(c) for c in row[:8]]
        except ValueError:
            if k and k == len(cells) - 1 and len(row) < 8:
                said.append(f"the last row (line {number}) is truncated and skipped")
                cells, rows = cells[:-1], rows[:-1]
                break
            raise InputError(where, f"line {number}", f"{' '.join(row)[:60]!r} is not 8 numbers",
                             "correct that row: t x y z qx qy qz qw") from None  # fmt: skip
    if not len(rows):
        raise InputError(where, "", "contains no rows", "give a trajectory: t x y z qx qy qz qw")
    return rows, [row[_QUATERNION_COLUMNS.stop :] for _, row in cells], [number for number, _ in cells]


def _find_named_columns(comments: list[str], where: str) -> tuple[list[int], bool, bool]:
    """Find the columns of time, position and quaternion in a header.

    Return the columns of t, x, y, z, w, x, y, z; whether stamps are in ns; and whether there is such a header.
    """
    for line in comments:
        names = [
            re.sub(r"[\[(].*?[\])]", "", n).strip().lower()
            for n in re.split(r"[,;\t]" if "," in line else r"\s+", line.strip())
        ]
        found = next(
            (
                k
                for k, n in enumerate(names)
                if n.startswith(("q", "w", "rot", "ori")) and _QUATERNION_W_PATTERN.fullmatch(n)
            ),
            None,
        )
        if found is None or len(names) < 8:
            continue
        if found not in (4, 7):
            raise InputError(where, names[found], f"is column {found + 1} of {len(names)}",
                             "order the columns: t x y z qx qy qz qw")  # fmt: skip
        return [0, 1, 2, 3, *((4, 5, 6, 7) if found == 4 else (7, 4, 5, 6))], "[ns]" in line, True
    return [0, 1, 2, 3, 7, 4, 5, 6], False, False


def _has_scalar_first_order(q: _Array) -> bool:
    """Return whether quaternions have the order w, x, y, z in place of x, y, z, w: only then are they upright."""
    if not len(q):
        return False
    w_first = q[:, [1, 2, 3, 0]]
    down, other = (np.median(1 - 2 * (p[:, 1] ** 2 + p[:, 2] ** 2)) for p in (q, w_first))
    return bool(down < -0.5 and other > 0.5)


def _drop_invalid_rows(rows: _Array, numbers: list[int], said: list[str]) -> tuple[_Array, list[int]]:
    """Return the rows of finite numbers, with unit quaternions, and their line numbers."""
    finite = np.isfinite(rows).all(axis=1)
    length = np.linalg.norm(rows[:, _QUATERNION_COLUMNS], axis=1)
    turned = length > _MIN_QUATERNION_NORM
    _note_skipped_lines(said, "with NaN or infinity, skipped", np.flatnonzero(~finite), numbers)
    _note_skipped_lines(said, "with a quaternion of zeros, skipped", np.flatnonzero(finite & ~turned), numbers)
    keep = np.flatnonzero(finite & turned)
    odd = keep[np.abs(length[keep] - 1) > _QUATERNION_NORM_TOLERANCE]
    if len(odd):
        worst = length[odd[np.argmax(np.abs(np.log(length[odd])))]]
        _note_skipped_lines(said, f"whose quaternion is not of unit length ({worst:.3g}), normalised", odd, numbers)
    out = rows[keep]
    out[:, _QUATERNION_COLUMNS] /= length[keep, None]
    return out, keep.tolist()


def _note_skipped_lines(said: list[str], what: str, which: NDArray[np.intp], numbers: list[int]) -> None:
    if len(which):
        first = f"line {numbers[which[0]]}" if len(which) == 1 else f"the first in line {numbers[which[0]]}"
        said.append(f"{len(which)} row{'s' if len(which) > 1 else ''} {what} ({first})")


def _detect_axes(comments: list[str], file: Path) -> str:
    for name, (words, _, _) in _AXIS_CONVENTIONS.items():
        if any(re.search(words, line) for line in comments):
            return name
    of_data_set = {(file.name, ""), (file.name, file.parent.name)} & _NWU_TRUTH_FILES
    return "x north, y west, z up" if of_data_set else "N-E-D"


def _stamps_to_seconds(stamps: _Array, ns: bool) -> tuple[_Array, str]:
    """Return the stamps in s, and their unit."""
    largest = float(np.median(stamps)) if len(stamps) else 0.0
    for least, factor, unit in _EPOCH_STAMP_UNITS:
        if largest > least or (ns and unit == "ns"):
            return stamps * factor, unit
    return stamps, "s"


def _sort_by_time(stamps: _Array, numbers: list[int], said: list[str]) -> tuple[NDArray[np.intp], int]:
    """Return the row indices in order of time, only the last row of each time, and the number of duplicates."""
    late = np.flatnonzero(np.diff(stamps) < 0) + 1
    _note_skipped_lines(said, "earlier than the previous row, sorted by time", late, numbers)
    order = np.argsort(stamps, kind="stable")
    last = np.append(np.diff(stamps[order]) > 0, True)[: len(order)]
    repeated = order[~last]
    _note_skipped_lines(said, "with the time of another row; the last of them is kept", np.sort(repeated), numbers)
    return order[last], len(repeated)


@result
class TrajectoryEvaluation:
    """Evaluation of one trajectory; lengths in m, angles in rad."""

    pictures: int = field(metadata={"unit": "1", "meaning": "pictures with a result"})
    lost_share: float = field(metadata={"unit": "1", "meaning": "share without an answer"})
    horizontal_rms_m: float = field(
        metadata={"unit": "m", "meaning": "horizontal error without alignment, root mean square"}
    )
    horizontal_worst_m: float = field(metadata={"unit": "m", "meaning": "greatest horizontal error"})
    height_rms_m: float = field(metadata={"unit": "m", "meaning": "error of the height, root mean square"})
    heading_rms_rad: float = field(metadata={"unit": "rad", "meaning": "error of the heading, root mean square"})
    ate_m: float = field(metadata={"unit": "m", "meaning": "position error after the best shift and turn, rms"})
    rpe_m: float = field(metadata={"unit": "m", "meaning": "error of the displacement in a second, rms"})
    way_m: float = field(metadata={"unit": "m", "meaning": "way flown"})
    horizontal_end_m: float = field(metadata={"unit": "m", "meaning": "horizontal error at the end"})
    nees: float = field(metadata={"unit": "1", "meaning": "NEES over its four numbers"})
    inside_share: float = field(metadata={"unit": "1", "meaning": "share inside the 95 % ellipsoid"})

    def make_printed_blocks(self) -> list[ShownBlock]:
        """Return errors, drift and consistency of the trajectory as a printed table."""
        rows = [
            ("pictures with a position", f"{1 - self.lost_share:.1%}"),
            ("horizontal error, rms (cm)", f"{100 * self.horizontal_rms_m:.1f}"),
            ("... worst (cm)", f"{100 * self.horizontal_worst_m:.1f}"),
            ("... at the end (cm)", f"{100 * self.horizontal_end_m:.1f}"),
            ("height error, rms (cm)", f"{100 * self.height_rms_m:.1f}"),
            ("heading error, rms (deg)", f"{math.degrees(self.heading_rms_rad):.2f}"),
            ("ATE (cm)", f"{100 * self.ate_m:.1f}"),
            ("RPE over 1 s (cm)", f"{100 * self.rpe_m:.1f}"),
            ("path length (m)", f"{self.way_m:.1f}"),
            ("NEES/n", "-" if math.isnan(self.nees) else f"{self.nees:.2f}"),
            ("inside the 95 % ellipsoid", "-" if math.isnan(self.inside_share) else f"{self.inside_share:.1%}"),
        ]
        return [make_table_block(("", ""), rows)]


def evaluate_trajectory(
    time: _Array, position: _Array, heading: _Array, covariance: _Array | None, true_time: _Array, true_position:
    _Array, true_heading: _Array, pictures: int | None = None,
) -> TrajectoryEvaluation:  # fmt: skip
    """Compare results with the truth.

    Parameters
    ----------
    time, position, heading : (n,), (n, 3), (n,) arrays
        Results (s, m N-E-D, rad).
    covariance : (n, 4, 4) array or None
        Covariances of N, E, D, heading.
    true_time, true_position, true_heading : (m,), (m, 3), (m,) arrays
        Truth (s, m N-E-D, rad).
    pictures : int, optional
        Number of pictures; by default that of the results.

    Raises
    ------
    InputError
        If results and truth do not overlap in time.
    """
    inside = (time >= true_time[0] - 0.02) & (time <= true_time[-1] + 0.02)
    if inside.sum() < _MIN_POSE_ROWS:
        raise InputError(*_explain_no_overlap(time, true_time))
    inside &= ~_is_in_gap(time, true_time)
    if inside.sum() < _MIN_POSE_ROWS:
        raise InputError("truth", "", "has gaps at the times of all results", "give a truth without gaps there")
    t, x, psi = time[inside], position[inside], heading[inside]
    true = np.stack([np.interp(t, true_time, c) for c in true_position.T], axis=1)
    turn = np.interp(t, true_time, np.unwrap(true_heading))
    off = x - true
    turned = np.angle(np.exp(1j * (psi - turn)))
    flat = np.hypot(off[:, 0], off[:, 1])
    way = float(np.hypot(*np.diff(true[:, :2], axis=0).T).sum())
    nees = within = math.nan
    found = inside if covariance is None else inside & (covariance[:, 0, 0] > _MIN_POSITION_SIGMA_M**2)
    if covariance is not None and found.any():
        e, p = np.column_stack([off, turned])[found[inside]], covariance[found]
        each = np.einsum("ni,ni->n", e, np.linalg.solve(p, e[..., None])[..., 0])
        nees, within = float(each.mean() / 4), float((each < CHI2_95_4_DOF).mean())
    count = len(time) if pictures is None else pictures
    return TrajectoryEvaluation(
        count,
        1.0 - len(time) / max(count, 1),
        _root_mean_square(flat),
        float(flat.max()),
        _root_mean_square(off[:, 2]),
        _root_mean_square(turned),
        _root_mean_square(np.linalg.norm(_align_horizontally(x, true) - true, axis=1)),
        _relative_pose_error(t, x, psi, true, turn),
        way,
        float(flat[-1]),
        nees,
        within,
    )


def _explain_no_overlap(time: _Array, true_time: _Array) -> tuple[str, str, str, str]:
    """Return place, key, problem and remedy of the error that trajectory and truth share no time span."""
    for who, stamps in (("trajectory", time), ("truth", true_time)):
        if len(stamps) < _MIN_POSE_ROWS:
            problem = f"the {who} has {len(stamps)} usable rows with different times"
            return "trajectory", "time", problem, f"give {_MIN_POSE_ROWS} or more, stamps with enough digits"
    spans = f"{time[0]:.3f} to {time[-1]:.3f} s, the truth's from {true_time[0]:.3f} to {true_time[-1]:.3f} s"
    ratio = (time[-1] - time[0]) / max(true_time[-1] - true_time[0], 1e-9)
    for factor, unit in ((1e9, "ns"), (1e6, "us"), (1e3, "ms")):
        for size, who in ((ratio, "trajectory"), (1 / max(ratio, 1e-12), "truth")):
            if 0.3 * factor < size < 3 * factor:
                return (
                    "trajectory",
                    "time",
                    f"its times go from {spans}",
                    f"the {who}'s are in {unit}: give them in s",
                )
    offset = time[0] - true_time[0]
    return (
        "trajectory",
        "time",
        f"its times go from {spans}",
        f"give its own truth, or --offset {offset:.3f} if both begin together",
    )


def _is_in_gap(time: _Array, true_time: _Array) -> NDArray[np.bool_]:
    """Return the mask of times inside a gap of the truth."""
    if len(true_time) < 2:
        return np.zeros(len(time), dtype=bool)
    steps = np.diff(true_time)
    after = np.clip(np.searchsorted(true_time, time), 1, len(steps))
    longest = max(_MAX_GAP_S, _MAX_GAP_INTERVALS * float(np.median(steps)))
    return (steps[after - 1] > longest) & ~np.isin(time, true_time)


def find_better_fitting_axes(time: _Array, position: _Array, true_time: _Array, true_position: _Array) -> str:
    """Return the name of other axes that fit the truth far better than the given ones; ``""`` if there are none."""
    inside = (time >= true_time[0]) & (time <= true_time[-1])
    if inside.sum() < _MIN_POSE_ROWS:
        return ""
    x = position[inside]
    true = np.stack([np.interp(time[inside], true_time, c) for c in true_position.T], axis=1)
    flipped = np.stack([x[:, 0], -x[:, 1], -x[:, 2]], axis=1)  # ENU is equal up to a rotation
    for name, fitted in (("ATE", _align_horizontally), ("position error", lambda p, _: p)):
        as_it_is, other = (_root_mean_square(np.linalg.norm(fitted(p, true) - true, axis=1)) for p in (x, flipped))
        if other < 0.2 * as_it_is and as_it_is > _MIN_OTHER_AXES_ERROR_M:
            return f"{name} {100 * other:.1f} cm in place of {100 * as_it_is:.1f}"
    return ""


def _root_mean_square(a: _Array) -> float:
    return float(np.sqrt(np.mean(np.square(a))))


def _align_horizontally(x: _Array, true: _Array) -> _Array:
    a, b = x - x.mean(axis=0), true - true.mean(axis=0)
    z = np.angle(((a[:, 0] - 1j * a[:, 1]) * (b[:, 0] + 1j * b[:, 1])).sum())
    c, s = math.cos(z), math.sin(z)
    return a @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]]) + true.mean(axis=0)


def _relative_pose_error(t: _Array, x: _Array, psi: _Array, true: _Array, turn: _Array, span_s: float = 1.0) -> float:
    j = np.searchsorted(t, t + span_s)
    i = np.nonzero(j < len(t))[0]
    if not len(i):
        return math.nan
    j = j[i]
    i, j = i[t[j] - t[i] < 1.5 * span_s], j[t[j] - t[i] < 1.5 * span_s]

    def relative_displacement(p: _Array, h: _Array) -> _Array:
        d = p[j] - p[i]
        z = (d[:, 0] + 1j * d[:, 1]) * np.exp(-1j * h[i])
        return np.column_stack([z.real, z.imag, d[:, 2]])

    return (
        _root_mean_square(np.linalg.norm(relative_displacement(x, psi) - relative_displacement(true, turn), axis=1))
        if len(i)
        else math.nan
    )
