"""CFD studies: cases of a rotor, sweeps, coaxial pairs and mesh studies, with loads by methods without CFD."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mufly.cfd.cfd_solution import CfdSolution, read_field, read_solution, scale_solution_state
from mufly.cfd.meshes.blade_geometry import BladeGeometry, make_tip_hub_geometry
from mufly.cfd.meshes.polymesh import MeshQuality, PolyMesh, make_poly_mesh, measure_mesh_quality, read_poly_mesh
from mufly.cfd.meshes.sector_mesh import MeshDomain, compute_blade_vertical_reach, make_sector_mesh
from mufly.cfd.openfoam_case import (
    MIN_ASSESSMENT_ITERATIONS,
    TURBULENCE_MODELS,
    OperatingPoint,
    momentum_induced_velocity,
    read_operating_point,
    write_case,
)
from mufly.cfd.rotor_pair import (
    ActuatorDisc,
    find_disc_cells,
    make_pair_mesh,
    read_actuator_disc,
    write_actuator_disc,
)
from mufly.cfd.solver_process import (
    MAX_ITERATIONS,
    SolverProgress,
    list_complete_states,
    list_processor_states,
    run_case,
)
from mufly.errors import InputError, MuflyError
from mufly.quantities.units import RPM
from mufly.results import result
from mufly.rotor import (
    Air,
    BladeStructure,
    OperatingCondition,
    Rotor,
    RotorResult,
    RotorSystem,
    prepare_blading,
    solve_rotor,
    solve_system,
)
from mufly.rotor.structure.coupled_rounds import AeroelasticSolution, StripLoads, iterate_elastic_twist
from mufly.rotor.structure.flap_modes import make_blade_beam

Array = NDArray[np.float64]
SCALED_START_MIN_ITERATIONS = 400
"""Iterations before a verdict if the start is the scaled solution of a neighbour."""
_TWIST_MATCH_TOLERANCE_RAD = 1e-5
RESHAPED_START_MIN_ITERATIONS = 800
"""Iterations before a verdict if the neighbour has another pitch setting or tip."""


def mesh_and_write_case(
    folder: Path,
    rotor: Rotor,
    *,
    pitch_rad: float,
    speed_rad_s: float,
    climb_m_s: float = 0.0,
    air: Air | None = None,
    model: str = "laminar",
    level: str = "medium",
    domain: MeshDomain | None = None,
    tip: str = "square",
    hub_m: float = 0.0,
    gurney: float = 0.0,
    gap_m: float = 0.0,
    lower_pitch_rad: float | None = None,
    lower_speed_rad_s: float | None = None,
    other_m: float = 0.0,
    cores: int = 1,
    neighbour: Path | None = None,
) -> MeshQuality:
    """Mesh a rotor and write a case of one operating point; return the mesh's quality.

    Tip, hub and Gurney flap are those of :func:`mufly.cfd.meshes.blade_geometry.make_tip_hub_geometry`. With ``gap_m``
    a second, counter-rotating rotor of the same file lies at that distance below (:mod:`mufly.cfd.rotor_pair`). By
    default it has the same pitch setting and speed; both rotors are frozen in one mesh. ``other_m`` is for
    :func:`solve_rotor_pair`.

    With ``neighbour``, a solved case of another speed, pitch setting or tip with the same cells, the case starts from
    the scaled solution of the neighbour.

    A folder that contains a started case of the same point is unchanged, so that the case can resume.

    Raises
    ------
    InputError
        If the rotor cannot be meshed, its mesh quality is insufficient, or the folder contains the solution of another
        point.
    """
    air = air or Air()
    guess = solve_rotor(
        prepare_blading(rotor), pitch_rad=pitch_rad, speed_rad_s=speed_rad_s, climb_m_s=climb_m_s, air=air
    )
    # At one speed the lower rotor of a pair has about half of the upper one's thrust.
    induced = momentum_induced_velocity(guess.thrust_N * (1.5 if gap_m or other_m else 1.0), rotor.radius_m, air)
    lower = pitch_rad if lower_pitch_rad is None else lower_pitch_rad
    lower_speed = speed_rad_s if lower_speed_rad_s is None else lower_speed_rad_s
    point = OperatingPoint(
        rotor.name,
        rotor.blades,
        rotor.radius_m,
        pitch_rad,
        speed_rad_s,
        climb_m_s,
        model,
        level,
        air.density_kg_m3,
        air.viscosity_Pa_s,
        induced,
        tip=tip,
        hub_m=hub_m,
        gurney=gurney,
        domain=domain or MeshDomain(),
        other_m=other_m,
    )
    if gap_m:
        point = replace(point, gap_m=gap_m, lower_pitch_rad=lower, lower_rad_s=lower_speed)
    near = None if neighbour is None else read_operating_point(neighbour)
    if near is not None:
        alike = near.pitch_rad == pitch_rad and near.tip == tip
        point = replace(point, upwind=0, least=SCALED_START_MIN_ITERATIONS if alike else RESHAPED_START_MIN_ITERATIONS)
    form = make_tip_hub_geometry(tip, hub_m, gurney)
    if gap_m:
        if form != BladeGeometry() or neighbour is not None:
            raise InputError(
                "pair",
                "gap",
                "cannot be combined with a hub, a tip, a flap or the solution of another case",
                "leave them out",
            )
        meshed = make_pair_mesh(rotor, pitch_rad, lower, gap_m, level=level, domain=domain)
    else:
        meshed = make_sector_mesh(rotor, pitch_rad, level=level, domain=domain, form=form)
    mesh = make_poly_mesh(meshed)
    found = measure_mesh_quality(mesh)
    if not found.is_good:
        raise InputError(
            rotor.name, "",
            f"the mesh is poor: non-orthogonality {found.non_orthogonality_deg:.0f} deg, skewness "
            f"{found.skewness:.2g}, smallest cell {found.smallest_volume_m3:.2g} m3",
            "change pitch, twist or cut-out a little, or the level of the mesh",
        )  # fmt: skip
    if (folder / "mufly.json").is_file() and max(
        list_complete_states(folder) + list_processor_states(folder), default=0
    ) > 0:
        if read_operating_point(folder) != point:
            raise InputError(
                "--out",
                str(folder),
                "contains the solution of another point",
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
                str(neighbour), other[0],
                f"is {getattr(near, other[0])} in this case and {getattr(point, other[0])} in the new one",
                "start from a case that differs in speed, pitch setting or tip only",
            )  # fmt: skip
        state = scale_solution_state(neighbour, mesh, ratio)
    write_case(folder, mesh, point, cores=cores, state=state)
    return found


def solve_operating_point(
    folder: Path,
    rotor: Rotor,
    *,
    cores: int = 1,
    progress: Callable[[SolverProgress], None] | None = None,
    **given: Any,
) -> CfdSolution:
    """Mesh an operating point, run the solver, compute the verdict and read the solution; arguments as for
    :func:`mesh_and_write_case`.
    """
    mesh_and_write_case(folder, rotor, cores=cores, **given)
    run_case(folder, cores=cores, progress=progress)
    return read_solution(folder)


_TWIST_ITERATION_FILE = "elastic.json"


def solve_elastic_blade(
    folder: Path,
    rotor: Rotor,
    structure: BladeStructure | None = None,
    *,
    cores: int = 1,
    progress: Callable[[SolverProgress], None] | None = None,
    run: Callable[..., CfdSolution] | None = None,
    **given: Any,
) -> tuple[CfdSolution, AeroelasticSolution]:
    """Solve a rotor with elastic blades: repeat mesh, solution and twist until the tip's twist changes by < 0.05 deg.

    Round k is the case ``round-k`` in the folder. Each round after the first starts from the preceding solution. A
    stopped run resumes.

    Parameters
    ----------
    folder : Path
    rotor : Rotor
    structure : BladeStructure, optional
        Default: that of the rotor file.
    cores, progress
        As for :func:`run_case`.
    run : callable, optional
        Function called in place of :func:`solve_operating_point`, with the same arguments.
    given
        Arguments of :func:`mesh_and_write_case` for one rotor.

    Returns
    -------
    solution : CfdSolution
        Solution of the last round.
    rounds : AeroelasticSolution

    Raises
    ------
    InputError
        If the rotor has no structure, or a round in the folder has another twist.
    MuflyError
        If the twist or the solution of a round does not converge.
    """
    found: list[CfdSolution] = []

    def solve_twisted_blade(deformed: Rotor, twist_rad: Array, turn: int) -> StripLoads:
        place = folder / f"round-{turn}"
        note = place / _TWIST_ITERATION_FILE
        if note.is_file():
            before = np.array(json.loads(note.read_text(encoding="utf-8"))["twist_rad"])
            if before.shape != twist_rad.shape or np.max(np.abs(before - twist_rad)) > _TWIST_MATCH_TOLERANCE_RAD:
                raise InputError(
                    str(place), "", "contains a blade of another twist", "give another folder, or delete it"
                )
        place.mkdir(parents=True, exist_ok=True)
        note.write_text(json.dumps({"twist_rad": twist_rad.tolist()}), encoding="utf-8")
        start = None if turn == 1 else folder / f"round-{turn - 1}"
        one = (run or solve_operating_point)(
            place, deformed, cores=cores, progress=progress, **{**given, "neighbour": start}
        )
        if not one.verdict.settled:
            raise MuflyError(
                f"{place}: the loads are not steady, so no elastic twist is computed; {one.verdict.outcome}"
            )
        found.append(one)
        n = rotor.blades
        return StripLoads(one.r_m, one.thrust_N_m / n, -one.torque_Nm_m / (one.r_m * n), one.moment_Nm_m)

    point = {name: given[name] for name in ("pitch_rad", "speed_rad_s", "climb_m_s", "air") if name in given}
    rounds = iterate_elastic_twist(rotor, make_blade_beam(rotor, structure), solve_twisted_blade, **point)
    return found[-1], rounds


def sweep_speed(
    folder: Path,
    rotor: Rotor,
    speeds_rad_s: Sequence[float],
    *,
    cores: int = 1,
    progress: Callable[[SolverProgress], None] | None = None,
    **given: Any,
) -> list[CfdSolution]:
    """Solve several rotor speeds, each from the solution of the last settled case; solved cases are kept.

    Parameters
    ----------
    folder : Path
        Folder of the sweep; each speed has a subfolder such as ``rpm-5000``.
    rotor : Rotor
    speeds_rad_s : sequence of float
    cores, progress, given
        As for :func:`solve_operating_point`.
    """
    out: list[CfdSolution] = []
    before: Path | None = None
    for speed in speeds_rad_s:
        place = folder / f"rpm-{speed / RPM:.6g}"
        mesh_and_write_case(place, rotor, speed_rad_s=speed, cores=cores, neighbour=before, **given)
        verdict = run_case(place, cores=cores, progress=progress)
        out.append(read_solution(place))
        # A solution that did not converge is no start.
        before = place if verdict.settled else before
    return out


def sweep_climb(
    folder: Path,
    rotor: Rotor,
    climbs_m_s: Sequence[float],
    *,
    cores: int = 1,
    progress: Callable[[SolverProgress], None] | None = None,
    **given: Any,
) -> list[CfdSolution]:
    """Solve several climb velocities at one speed, each from its own initial flow; solved cases are kept.

    Parameters
    ----------
    folder : Path
        Folder of the sweep; each climb has a subfolder such as ``climb-0.5``, for descent ``climb--0.5``.
    rotor : Rotor
    climbs_m_s : sequence of float
    cores, progress, given
        As for :func:`solve_operating_point`.

    Raises
    ------
    InputError
        If the rotor descends too fast; raised before any case is solved.
    """
    # The fastest descent comes first, because it may raise an error.
    return [
        solve_operating_point(folder / f"climb-{w:g}", rotor, climb_m_s=w, cores=cores, progress=progress, **given)
        for w in sorted(set(climbs_m_s))
    ]


@result(eq=False)
class PairSolution:
    """Solution of a counter-rotating pair, each rotor with the other as an actuator disc.

    Attributes
    ----------
    upper, lower : CfdSolution
        Solution of each rotor in its own frame, in which it turns about +z.
    settled : bool
        True if both cases and their mutual loads have converged.
    midway_downwash_m_s : (2,) array
        Mean downward velocity (m/s) within R half way between the discs, in the upper and in the lower rotor's case.
    """

    upper: CfdSolution
    lower: CfdSolution
    settled: bool
    midway_downwash_m_s: Array

    @property
    def thrust_ratio(self) -> float:
        """Thrust of the lower rotor divided by the thrust of the upper rotor."""
        return self.lower.verdict.thrust_N / self.upper.verdict.thrust_N

    @property
    def torque_ratio(self) -> float:
        """Torque of the lower rotor divided by the torque of the upper rotor."""
        return self.lower.verdict.torque_Nm / self.upper.verdict.torque_Nm


PAIR_FOLDERS = ("upper", "lower")
"""Folders of the two cases of a pair."""
MAX_PAIR_ITERATIONS, PAIR_LOAD_TOLERANCE = 6, 0.01
"""Greatest number of alternations between the rotors of a pair, and relative change of loads at convergence."""


def solve_rotor_pair(
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
    progress: Callable[[SolverProgress], None] | None = None,
    **given: Any,
) -> PairSolution:
    """Solve two counter-rotating rotors of one file in folders ``upper`` and ``lower``.

    The other rotor is an actuator disc in each case (:mod:`mufly.cfd.rotor_pair`). Its loads come from blade elements
    first, then from the other case, until they change by less than :data:`PAIR_LOAD_TOLERANCE`. An interrupted pair
    resumes from its stored solutions.

    Parameters
    ----------
    folder : Path
    rotor : Rotor
        Rotor used for both discs.
    pitch_rad, speed_rad_s : float
        Pitch setting (rad) and speed (rad/s) of the upper rotor.
    gap_m : float
        Distance between the discs (m).
    lower_pitch_rad, lower_speed_rad_s : float, optional
        Pitch setting and speed of the lower rotor; default: those of the upper rotor.
    neighbour : Path, optional
        A solved pair of other speeds or pitch settings to start from.
    cores, progress, given
        As for :func:`solve_operating_point`.

    Raises
    ------
    InputError
        If the rotors would collide, or blade elements give no first guess.
    """
    pitches = (pitch_rad, pitch_rad if lower_pitch_rad is None else lower_pitch_rad)
    speeds = (speed_rad_s, speed_rad_s if lower_speed_rad_s is None else lower_speed_rad_s)
    least = compute_blade_vertical_reach(rotor, pitches[0]) + compute_blade_vertical_reach(rotor, pitches[1])
    if not least < gap_m <= 2.0 * rotor.radius_m:
        raise InputError(
            "pair", "gap", f"is {1e3 * gap_m:g} mm", f"give {1e3 * least:.3g} to {2e3 * rotor.radius_m:g} mm"
        )
    air, climb = given.get("air") or Air(), given.get("climb_m_s", 0.0)
    ready = prepare_blading(rotor)
    guess = solve_system(
        RotorSystem.from_coaxial_pair(ready, ready, spacing_m=gap_m),
        OperatingCondition(pitches, speeds, None, climb, air),
        "bemt",
    )
    if not guess.converged:
        raise MuflyError(f"blade element theory finds no initial state of the pair: {guess.message}")
    settings = list(zip(pitches, speeds, strict=True))
    loads = [
        _make_actuator_disc(convert_to_span_loads(one, "bemt"), *at)
        for one, at in zip(guess.rotors, settings, strict=True)
    ]
    for i, name in enumerate(PAIR_FOLDERS):
        if neighbour is not None:
            before = read_solution(neighbour / name)
            ratio = (speeds[i] / before.point.speed_rad_s) ** 2
            loads[i] = _make_actuator_disc(before, *settings[i]).scale_loads(ratio)
        if (
            read_actuator_disc(folder / name) is not None
            and max(list_complete_states(folder / name), default=0) >= MIN_ASSESSMENT_ITERATIONS
        ):
            loads[i] = _make_actuator_disc(read_solution(folder / name), *settings[i])
    meshes: dict[str, PolyMesh] = {}
    for _ in range(MAX_PAIR_ITERATIONS):
        for i, name in enumerate(PAIR_FOLDERS):
            place, (theta, speed) = folder / name, settings[i]
            if name not in meshes:
                mesh_and_write_case(
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
            stands = read_actuator_disc(place)
            if stands is None or stands.relative_load_change(loads[1 - i]) > PAIR_LOAD_TOLERANCE:
                stands = replace(loads[1 - i], set_iteration=max(list_complete_states(place), default=0))
                write_actuator_disc(place, meshes[name], read_operating_point(place), stands)
            verdict = run_case(place, cores=cores, progress=progress, most=MAX_ITERATIONS + stands.set_iteration)
            if verdict.outcome == "diverged":
                raise MuflyError(f"{place}: the {name} rotor's solution diverged; see its log")
            loads[i] = _make_actuator_disc(read_solution(place, meshes[name]), theta, speed)
        if _is_pair_consistent(folder, loads):
            break
    return read_pair_solution(folder)


def read_pair_solution(folder: Path) -> PairSolution:
    """Read a pair solved by :func:`solve_rotor_pair`.

    Raises
    ------
    InputError
        If one of its cases contains no solution.
    """
    upper, lower = (read_solution(folder / name) for name in PAIR_FOLDERS)
    loads = [_make_actuator_disc(one, one.point.pitch_rad, one.point.speed_rad_s) for one in (upper, lower)]
    between = np.array(
        [_mean_downwash(folder / n, 0.5 * s.point.other_m) for n, s in zip(PAIR_FOLDERS, (upper, lower), strict=True)]
    )
    stands = upper.verdict.settled and lower.verdict.settled
    return PairSolution(upper, lower, stands and _is_pair_consistent(folder, loads), between)


def _is_pair_consistent(folder: Path, loads: Sequence[ActuatorDisc]) -> bool:
    """Return True if the actuator disc in each case has the loads of the other case."""
    standing = [read_actuator_disc(folder / name) for name in PAIR_FOLDERS]
    return all(
        one is not None and one.relative_load_change(loads[1 - i]) <= PAIR_LOAD_TOLERANCE
        for i, one in enumerate(standing)
    )


def _make_actuator_disc(loads: SpanLoads | CfdSolution, pitch_rad: float, speed_rad_s: float) -> ActuatorDisc:
    r, t, q = (tuple(float(x) for x in v) for v in (loads.r_m, loads.thrust_N_m, loads.torque_Nm_m))
    return ActuatorDisc(r, t, q, float(loads.thrust_N), float(loads.torque_Nm), pitch_rad, speed_rad_s)


def _mean_downwash(folder: Path, height_m: float) -> float:
    """Return the mean downward velocity (m/s) through a horizontal plane, within the rotor radius."""
    point, mesh = read_operating_point(folder), read_poly_mesh(folder)
    speed = -read_field(folder / str(list_complete_states(folder)[-1]) / "U", mesh.cell_count)[:, 2]
    cells, area = find_disc_cells(mesh, height_m, point.radius_m)
    return float(speed[cells] @ area / area.sum())


DOMAIN_STUDY_SIZE_FACTOR = 1.5
"""Factor by which the domain study enlarges the limits of the domain."""


def list_study_cases(what: str) -> dict[str, dict[str, Any]]:
    """Return the cases of a study ('mesh', 'domain' or 'model') by name, each with its arguments for
    :func:`mesh_and_write_case`.

    Raises
    ------
    InputError
        If there is no such study.
    """
    if what == "mesh":
        return {level: {"level": level} for level in ("coarse", "medium", "fine")}
    if what == "model":
        return {model: {"model": model} for model in TURBULENCE_MODELS}
    if what == "domain":
        own, names = MeshDomain(), ("radius", "above", "below")
        wider = {name: replace(own, **{name: DOMAIN_STUDY_SIZE_FACTOR * getattr(own, name)}) for name in names}
        return {"usual": {}, **{name: {"domain": domain} for name, domain in wider.items()}}
    raise InputError("study", what, "is unknown", "use one of: mesh, domain, model")


def solve_study(
    folder: Path,
    rotor: Rotor,
    what: str,
    *,
    cores: int = 1,
    progress: Callable[[SolverProgress], None] | None = None,
    **given: Any,
) -> dict[str, CfdSolution]:
    """Solve an operating point on several meshes, domains or with several models, each in its own folder.

    Parameters
    ----------
    folder : Path
    rotor : Rotor
    what : str
        'mesh', 'domain' or 'model' (:func:`list_study_cases`).
    cores, progress, given
        As for :func:`solve_operating_point`.
    """
    return {
        name: solve_operating_point(folder / name, rotor, cores=cores, progress=progress, **{**given, **own})
        for name, own in list_study_cases(what).items()
    }


@result(eq=False)
class SpanLoads:
    """Thrust and torque per unit span (N/m, N m/m) at radii (m), by a method other than CFD, such as blade elements."""

    method: str
    r_m: Array
    thrust_N_m: Array
    torque_Nm_m: Array
    thrust_N: float
    torque_Nm: float


def convert_to_span_loads(result: RotorResult, method: str) -> SpanLoads:
    """Convert the result of another method to loads per span, for comparison with a CFD solution."""
    return SpanLoads(
        method,
        result.r_m,
        result.dT_N / result.dr_m,
        result.dQ_Nm / result.dr_m,
        result.thrust_N,
        result.torque_Nm,
    )
