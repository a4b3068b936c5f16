"""From a rotor and an operating point to a case on disk, and what other methods say of the same point."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.cfd.case import LEAST, MODELS, Point, momentum_start, read_point, write_case
from mufly.cfd.form import Form, named_form
from mufly.cfd.mesh import Domain, blade_height, blade_mesh
from mufly.cfd.pair import Disc, disc_cells, pair_mesh, put_disc, read_disc
from mufly.cfd.polymesh import PolyMesh, Quality, poly_mesh, quality, read_poly_mesh
from mufly.cfd.results import Solution, read_field, read_solution, scaled_state
from mufly.cfd.run import MOST, Progress, parts, run_case, times
from mufly.errors import InputError, MuflyError
from mufly.results import result
from mufly.rotor import Air, Condition, Rotor, RotorResult, System, hover, prepare, solve
from mufly.units import RPM

Array = NDArray[np.float64]
SCALED = 400
"""Iterations before a verdict where the start is a neighbour's solution, scaled."""
RESHAPED = 800
"""The same where the neighbour has another pitch setting or tip."""


def save_case(
    folder: Path,
    rotor: Rotor,
    *,
    pitch_rad: float,
    speed_rad_s: float,
    climb_m_s: float = 0.0,
    air: Air | None = None,
    model: str = "laminar",
    level: str = "medium",
    domain: Domain | None = None,
    tip: str = "square",
    hub_m: float = 0.0,
    gurney: float = 0.0,
    gap_m: float = 0.0,
    lower_pitch_rad: float | None = None,
    lower_speed_rad_s: float | None = None,
    other_m: float = 0.0,
    cores: int = 1,
    neighbour: Path | None = None,
) -> Quality:
    """Mesh a rotor and write a case of one operating point; return the mesh's quality.

    Tip, hub and Gurney flap are those of :func:`mufly.cfd.form.named_form`. With ``gap_m`` a second rotor of the same
    file turns the other way so far below (:mod:`mufly.cfd.pair`), by default with the same pitch setting and speed,
    frozen. ``other_m`` is for :func:`solve_pair`.

    With ``neighbour``, a solved case of another speed, pitch setting or tip whose mesh has the same cells, it starts
    from that solution, scaled.

    A folder that holds a begun case of the same point is left as it is, so that it can go on.

    Raises
    ------
    InputError
        If the rotor cannot be meshed, its mesh is not good, or the folder holds another point's solution.
    """
    air = air or Air()
    guess = hover(prepare(rotor), pitch_rad=pitch_rad, speed_rad_s=speed_rad_s, climb_m_s=climb_m_s, air=air)
    # At one speed the lower rotor of a pair has about half of the upper one's thrust.
    induced = momentum_start(guess.thrust_N * (1.5 if gap_m or other_m else 1.0), rotor.radius_m, air)
    lower = pitch_rad if lower_pitch_rad is None else lower_pitch_rad
    lower_speed = speed_rad_s if lower_speed_rad_s is None else lower_speed_rad_s
    point = Point(
        rotor.name, rotor.blades, rotor.radius_m, pitch_rad, speed_rad_s, climb_m_s, model, level, air.density_kg_m3,
        air.viscosity_Pa_s, induced, tip=tip, hub_m=hub_m, gurney=gurney, domain=domain or Domain(), other_m=other_m,
    )  # fmt: skip
    if gap_m:
        point = replace(point, gap_m=gap_m, lower_pitch_rad=lower, lower_rad_s=lower_speed)
    near = None if neighbour is None else read_point(neighbour)
    if near is not None:
        alike = near.pitch_rad == pitch_rad and near.tip == tip
        point = replace(point, upwind=0, least=SCALED if alike else RESHAPED)
    form = named_form(tip, hub_m, gurney)
    if gap_m:
        if form != Form() or neighbour is not None:
            raise InputError(
                "pair",
                "gap",
                "goes with neither a hub, a tip or a flap nor a neighbour's solution",
                "leave them out",
            )
        meshed = pair_mesh(rotor, pitch_rad, lower, gap_m, level=level, domain=domain)
    else:
        meshed = blade_mesh(rotor, pitch_rad, level=level, domain=domain, form=form)
    mesh = poly_mesh(meshed)
    found = quality(mesh)
    if not found.good:
        raise InputError(
            rotor.name, "",
            f"its mesh is not good: non-orthogonality {found.non_orthogonality_deg:.0f} deg, skewness "
            f"{found.skewness:.2g}, smallest cell {found.smallest_volume_m3:.2g} m3",
            "change pitch, twist or cut-out a little, or the level of the mesh",
        )  # fmt: skip
    if (folder / "mufly.json").is_file() and max(times(folder) + parts(folder), default=0) > 0:
        if read_point(folder) != point:
            raise InputError(
                "--out",
                str(folder),
                "holds the solution of another point",
                "give another folder, or delete it",
            )
        return found
    state = None
    if neighbour is not None and near is not None:
        ratio = speed_rad_s / near.speed_rad_s
        same = (
            "rotor",
            "blades",
            "radius_m",
            "climb_m_s",
            "model",
            "level",
            "density_kg_m3",
            "viscosity_Pa_s",
            "hub_m",
            "gurney",
            "domain",
            "gap_m",
            "other_m",
        )
        other = [name for name in same if getattr(near, name) != getattr(point, name)]
        if other:
            raise InputError(
                str(neighbour), other[0], f"is {getattr(near, other[0])}, not {getattr(point, other[0])}",
                "start from a case that differs in speed, pitch setting or tip only",
            )  # fmt: skip
        state = scaled_state(neighbour, mesh, ratio)
    write_case(folder, mesh, point, cores=cores, state=state)
    return found


def solve_point(
    folder: Path,
    rotor: Rotor,
    *,
    cores: int = 1,
    progress: Callable[[Progress], None] | None = None,
    **given: Any,
) -> Solution:
    """Mesh, run, judge and read one operating point; arguments as for :func:`save_case`."""
    save_case(folder, rotor, cores=cores, **given)
    run_case(folder, cores=cores, progress=progress)
    return read_solution(folder)


def sweep(
    folder: Path,
    rotor: Rotor,
    speeds_rad_s: Sequence[float],
    *,
    cores: int = 1,
    progress: Callable[[Progress], None] | None = None,
    **given: Any,
) -> list[Solution]:
    """Solve several speeds, each but the first from its neighbour's solution; those that are solved are kept.

    Parameters
    ----------
    folder : Path
        Each speed gets a folder in it, ``rpm-5000``.
    rotor : Rotor
    speeds_rad_s : sequence of float
    cores, progress, given
        As for :func:`solve_point`.
    """
    out: list[Solution] = []
    before: Path | None = None
    for speed in speeds_rad_s:
        place = folder / f"rpm-{speed / RPM:.6g}"
        save_case(place, rotor, speed_rad_s=speed, cores=cores, neighbour=before, **given)
        verdict = run_case(place, cores=cores, progress=progress)
        out.append(read_solution(place))
        # What did not settle is nothing to start from.
        before = place if verdict.settled else before
    return out


def sweep_climb(
    folder: Path,
    rotor: Rotor,
    climbs_m_s: Sequence[float],
    *,
    cores: int = 1,
    progress: Callable[[Progress], None] | None = None,
    **given: Any,
) -> list[Solution]:
    """Solve several climbs at one speed, each from its own start; those that are solved are kept.

    Parameters
    ----------
    folder : Path
        Each climb gets a folder in it, ``climb-0.5``; descent ``climb--0.5``.
    rotor : Rotor
    climbs_m_s : sequence of float
    cores, progress, given
        As for :func:`solve_point`.

    Raises
    ------
    InputError
        If the rotor descends too fast; before anything is solved.
    """
    # The fastest descent comes first, as it may be refused.
    return [
        solve_point(folder / f"climb-{w:g}", rotor, climb_m_s=w, cores=cores, progress=progress, **given)
        for w in sorted(set(climbs_m_s))
    ]


@result(eq=False, picture="mufly.cfd.pictures:pair_picture")
class MeanPair:
    """Two rotors that turn against each other, each beside the other's mean around the shaft.

    Attributes
    ----------
    upper, lower : Solution
        Each in the frame of its own, in which it turns about +z.
    settled : bool
        Whether both stand, and neither would change the other any more.
    between_m_s : (2,) array
        Mean velocity down within R half way between the discs, as the upper and the lower rotor's case have it: the
        same air, once under blades and once under a disc.
    """

    upper: Solution
    lower: Solution
    settled: bool
    between_m_s: Array

    @property
    def thrust_ratio(self) -> float:
        """Lower over upper."""
        return self.lower.verdict.thrust_N / self.upper.verdict.thrust_N

    @property
    def torque_ratio(self) -> float:
        """Lower over upper."""
        return self.lower.verdict.torque_Nm / self.upper.verdict.torque_Nm


PAIR = ("upper", "lower")
"""The two cases of a pair."""
ROUNDS, SAME = 6, 0.01
"""Of a pair: how often the rotors take turns at most, and the change of thrust or torque that is none."""


def solve_pair(
    folder: Path,
    rotor: Rotor,
    *,
    pitch_rad: float,
    speed_rad_s: float,
    gap_m: float,
    lower_pitch_rad: float | None = None,
    lower_speed_rad_s: float | None = None,
    neighbour: Path | None = None,
    cores: int = 1,
    progress: Callable[[Progress], None] | None = None,
    **given: Any,
) -> MeanPair:
    """Solve two rotors of one file that turn against each other, in folders ``upper`` and ``lower``.

    Each stands beside the mean of the other (:mod:`mufly.cfd.pair`), first as blade elements have it, then as its own
    case does, until that changes by less than :data:`SAME`. What is solved is kept; a pair that was stopped goes on.

    Parameters
    ----------
    folder : Path
    rotor : Rotor
        Both.
    pitch_rad, speed_rad_s : float
        Of the upper one.
    gap_m : float
        Between the discs.
    lower_pitch_rad, lower_speed_rad_s : float, optional
        Of the lower one; default: as the upper.
    neighbour : Path, optional
        A solved pair of other speeds or pitch settings to start from.
    cores, progress, given
        As for :func:`solve_point`.

    Raises
    ------
    InputError
        If the rotors would meet, or blade elements find no first guess.
    """
    pitches = (pitch_rad, pitch_rad if lower_pitch_rad is None else lower_pitch_rad)
    speeds = (speed_rad_s, speed_rad_s if lower_speed_rad_s is None else lower_speed_rad_s)
    least = blade_height(rotor, pitches[0]) + blade_height(rotor, pitches[1])
    if not least < gap_m <= 2.0 * rotor.radius_m:
        raise InputError(
            "pair", "gap", f"is {1e3 * gap_m:g} mm", f"give {1e3 * least:.3g} to {2e3 * rotor.radius_m:g} mm"
        )
    air, climb = given.get("air") or Air(), given.get("climb_m_s", 0.0)
    ready = prepare(rotor)
    guess = solve(
        System.coaxial(ready, ready, spacing_m=gap_m), Condition(pitches, speeds, None, climb, air), "bemt"
    )
    if not guess.converged:
        raise MuflyError(f"the pair has no first guess by blade elements: {guess.message}")
    settings = list(zip(pitches, speeds, strict=True))
    loads = [_disc(beside(one, "bemt"), *at) for one, at in zip(guess.rotors, settings, strict=True)]
    for i, name in enumerate(PAIR):
        if neighbour is not None:
            before = read_solution(neighbour / name)
            ratio = (speeds[i] / before.point.speed_rad_s) ** 2
            loads[i] = _disc(before, *settings[i]).scaled(ratio)
        if read_disc(folder / name) is not None and max(times(folder / name), default=0) >= LEAST:
            loads[i] = _disc(read_solution(folder / name), *settings[i])
    meshes: dict[str, PolyMesh] = {}
    for _ in range(ROUNDS):
        for i, name in enumerate(PAIR):
            place, (theta, speed) = folder / name, settings[i]
            if name not in meshes:
                save_case(
                    place,
                    rotor,
                    pitch_rad=theta,
                    speed_rad_s=speed,
                    other_m=(-gap_m, gap_m)[i],
                    neighbour=None if neighbour is None else neighbour / name,
                    cores=cores,
                    **given,
                )
                meshes[name] = read_poly_mesh(place)
            stands = read_disc(place)
            if stands is None or stands.off(loads[1 - i]) > SAME:
                stands = replace(loads[1 - i], since=max(times(place), default=0))
                put_disc(place, meshes[name], read_point(place), stands)
            verdict = run_case(place, cores=cores, progress=progress, most=MOST + stands.since)
            if verdict.what == "diverged":
                raise MuflyError(f"{place}: the {name} rotor's solution diverged; see its log")
            loads[i] = _disc(read_solution(place, meshes[name]), theta, speed)
        if _agreed(folder, loads):
            break
    return read_pair(folder)


def read_pair(folder: Path) -> MeanPair:
    """Read a pair that :func:`solve_pair` solved.

    Raises
    ------
    InputError
        If one of its cases holds no solution.
    """
    upper, lower = (read_solution(folder / name) for name in PAIR)
    loads = [_disc(one, one.point.pitch_rad, one.point.speed_rad_s) for one in (upper, lower)]
    between = np.array(
        [_down(folder / n, 0.5 * s.point.other_m) for n, s in zip(PAIR, (upper, lower), strict=True)]
    )
    stands = upper.verdict.settled and lower.verdict.settled
    return MeanPair(upper, lower, stands and _agreed(folder, loads), between)


def _agreed(folder: Path, loads: Sequence[Disc]) -> bool:
    """Whether each rotor's case has the loads of the other one."""
    standing = [read_disc(folder / name) for name in PAIR]
    return all(one is not None and one.off(loads[1 - i]) <= SAME for i, one in enumerate(standing))


def _disc(loads: Beside | Solution, pitch_rad: float, speed_rad_s: float) -> Disc:
    r, t, q = (tuple(float(x) for x in v) for v in (loads.r_m, loads.thrust_N_m, loads.torque_Nm_m))
    return Disc(r, t, q, float(loads.thrust_N), float(loads.torque_Nm), pitch_rad, speed_rad_s)


def _down(folder: Path, height_m: float) -> float:
    """Mean velocity (m/s) down through a level plane within R."""
    point, mesh = read_point(folder), read_poly_mesh(folder)
    speed = -read_field(folder / str(times(folder)[-1]) / "U", mesh.cells)[:, 2]
    cells, area = disc_cells(mesh, height_m, point.radius_m)
    return float(speed[cells] @ area / area.sum())


WIDER = 1.5
"""By how much the study of the domain moves each of its limits out."""


def study_cases(what: str) -> dict[str, dict[str, Any]]:
    """Return names and arguments for :func:`save_case` of a study's cases: 'mesh', 'domain' or 'model'.

    Raises
    ------
    InputError
        If there is no such study.
    """
    if what == "mesh":
        return {level: {"level": level} for level in ("coarse", "medium", "fine")}
    if what == "model":
        return {model: {"model": model} for model in MODELS}
    if what == "domain":
        own, names = Domain(), ("radius", "above", "below")
        wider = {name: replace(own, **{name: WIDER * getattr(own, name)}) for name in names}
        return {"usual": {}, **{name: {"domain": domain} for name, domain in wider.items()}}
    raise InputError("study", what, "is unknown", "use one of: mesh, domain, model")


def study(
    folder: Path,
    rotor: Rotor,
    what: str,
    *,
    cores: int = 1,
    progress: Callable[[Progress], None] | None = None,
    **given: Any,
) -> dict[str, Solution]:
    """Solve one operating point on several meshes, domains or with several models, each in a folder of its name.

    Parameters
    ----------
    folder : Path
    rotor : Rotor
    what : str
        'mesh', 'domain' or 'model' (:func:`study_cases`).
    cores, progress, given
        As for :func:`solve_point`.
    """
    return {
        name: solve_point(folder / name, rotor, cores=cores, progress=progress, **{**given, **own})
        for name, own in study_cases(what).items()
    }


@result(eq=False)
class Beside:
    """Loads per span (N/m, N m/m) of another method at its own radii (m)."""

    method: str
    r_m: Array
    thrust_N_m: Array
    torque_Nm_m: Array
    thrust_N: float
    torque_Nm: float


def beside(result: RotorResult, method: str) -> Beside:
    """A method's result as loads per span, to lay beside a solution's."""
    return Beside(
        method,
        result.r_m,
        result.dT_N / result.dr_m,
        result.dQ_Nm / result.dr_m,
        result.thrust_N,
        result.torque_Nm,
    )
