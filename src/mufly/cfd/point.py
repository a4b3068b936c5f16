"""From a rotor and an operating point to a case on disk, and what other methods say of the same point."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.cfd.case import MODELS, Point, momentum_start, read_point, write_case
from mufly.cfd.form import Form, named_form
from mufly.cfd.mesh import Domain, blade_mesh
from mufly.cfd.pair import pair_mesh
from mufly.cfd.polymesh import Quality, poly_mesh, quality
from mufly.cfd.results import Solution, read_solution, scaled_state
from mufly.cfd.run import Progress, run_case, times
from mufly.errors import InputError
from mufly.results import result
from mufly.rotor import Air, Rotor, RotorResult, hover, prepare
from mufly.units import RPM

Array = NDArray[np.float64]
SCALED = 400
"""Iterations before a verdict where the start is a neighbour's solution, scaled."""


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
    cores: int = 1,
    neighbour: Path | None = None,
) -> Quality:
    """Mesh a rotor and write a case of one operating point; return the mesh's quality.

    Tip, hub and Gurney flap are those of :func:`mufly.cfd.form.named_form`. With ``gap_m`` a second rotor of the same
    file turns the other way so far below (:mod:`mufly.cfd.pair`), by default with the same pitch setting and speed.

    With ``neighbour``, a solved case of another speed on the same mesh, it starts from that solution, scaled.

    A folder that holds a begun case of the same point is left as it is, so that it can go on.

    Raises
    ------
    InputError
        If the rotor cannot be meshed, its mesh is not good, or the folder holds another point's solution.
    """
    air = air or Air()
    guess = hover(prepare(rotor), pitch_rad=pitch_rad, speed_rad_s=speed_rad_s, climb_m_s=climb_m_s, air=air)
    # At one speed the lower rotor of a pair has about half of the upper one's thrust.
    induced = momentum_start(guess.thrust_N * (1.5 if gap_m else 1.0), rotor.radius_m, air)
    lower = pitch_rad if lower_pitch_rad is None else lower_pitch_rad
    lower_speed = speed_rad_s if lower_speed_rad_s is None else lower_speed_rad_s
    point = Point(
        rotor.name, rotor.blades, rotor.radius_m, pitch_rad, speed_rad_s, climb_m_s, model, level, air.density_kg_m3,
        air.viscosity_Pa_s, induced, tip=tip, hub_m=hub_m, gurney=gurney, domain=domain or Domain(),
    )  # fmt: skip
    if gap_m:
        point = replace(point, gap_m=gap_m, lower_pitch_rad=lower, lower_rad_s=lower_speed)
    if neighbour is not None:
        point = replace(point, upwind=0, least=SCALED)
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
    if (folder / "mufly.json").is_file() and max(times(folder), default=0) > 0:
        if read_point(folder) != point:
            raise InputError(
                "--out",
                str(folder),
                "holds the solution of another point",
                "give another folder, or delete it",
            )
        return found
    state = None
    if neighbour is not None:
        before = read_point(neighbour)
        ratio = speed_rad_s / before.speed_rad_s
        same = (
            "rotor",
            "blades",
            "radius_m",
            "pitch_rad",
            "model",
            "level",
            "density_kg_m3",
            "viscosity_Pa_s",
            "tip",
            "hub_m",
            "gurney",
            "domain",
        )
        other = [name for name in same if getattr(before, name) != getattr(point, name)]
        if other:
            raise InputError(
                str(neighbour), other[0], f"is {getattr(before, other[0])}, not {getattr(point, other[0])}",
                "start from a case that differs in speed only",
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
