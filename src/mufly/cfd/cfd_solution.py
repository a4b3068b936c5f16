"""Solutions of OpenFOAM cases: loads along the blade, pressure, wall friction and y+.

The force of the air on a blade face with centre x and area vector S out of the air is (p in units of pressure)

    dF = p S + mu (u_t - Omega x x) / d |S|          u_t: velocity along the wall in the cell beside it, d its distance

summed over the spanwise strips of the mesh; the caps at root and tip belong to the first and the last strip. The total
equals the result of OpenFOAM's ``forces`` function. With a turbulence model the turbulent viscosity at the wall is
added to mu.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from mufly.cfd.meshes.polymesh import PolyMesh, read_poly_mesh
from mufly.cfd.openfoam_case import OperatingPoint, read_operating_point
from mufly.cfd.rotor_pair import read_actuator_disc
from mufly.cfd.solver_process import ConvergenceAssessment, judge_case_convergence, list_complete_states
from mufly.errors import InputError
from mufly.results import ResultColumn, ShownBlock, result, tabulate_fields

Array = NDArray[np.float64]


@result(eq=False)
class CfdSolution:
    """Loads, pressure, wall friction and convergence verdict of a solved case.

    Attributes
    ----------
    point : OperatingPoint
        Operating point.
    verdict : Verdict
        Convergence verdict.
    thrust_N, torque_Nm, power_W : float
        Loads of the whole rotor in the last state, summed from the fields.
    c_T, c_Q, figure_of_merit : float
        Coefficients as defined in :mod:`mufly.rotor.bemt`.
    friction_torque_fraction : float
        Fraction of the torque due to friction.
    r_m, dr_m : (strips,) arrays
        Middle and width of the spanwise strips.
    thrust_N_m, torque_Nm_m : (strips,) arrays
        Loads per span of all blades (N/m, N m/m).
    moment_Nm_m : (strips,) array
        Moment of one blade about its quarter chord line per span, nose up (N m/m).
    yplus : (faces,) array
        y+ of the blade's faces.
    pressure_Pa : (faces,) array
        Pressure on the blade's faces.
    friction_Pa : (faces, 3) array
        Shear stress of the air on the blade's faces.
    max_eddy_viscosity_ratio : float
        Greatest ratio of turbulent to molecular viscosity within 1.5 R of the hub; 0 for laminar flow.
    wake_torque_ratio, wake_thrust_ratio : float
        Fractions of torque and thrust found in the wake under the rotor (:func:`wake_load_ratios`); 1 if conserved.
        With an actuator disc for another rotor: the fraction of both thrusts, and the missing part of both torques over
        this rotor's torque.
    reversed_flow_fraction : (strips,) array
        Fraction of the upper side with wall shear towards the nose, which indicates separated flow.
    """

    point: OperatingPoint
    verdict: ConvergenceAssessment
    thrust_N: float
    torque_Nm: float
    power_W: float
    c_T: float
    c_Q: float
    figure_of_merit: float
    friction_torque_fraction: float
    r_m: Array
    dr_m: Array
    thrust_N_m: Array
    torque_Nm_m: Array
    yplus: Array
    pressure_Pa: Array
    friction_Pa: Array
    max_eddy_viscosity_ratio: float = 0.0
    wake_torque_ratio: float = math.nan
    wake_thrust_ratio: float = math.nan
    reversed_flow_fraction: Array = field(default_factory=lambda: np.empty(0))
    moment_Nm_m: Array = field(default_factory=lambda: np.empty(0))

    @property
    def yplus_median(self) -> float:
        """Median of y+ over the blade's faces."""
        return float(np.median(self.yplus))

    @property
    def separated_fraction(self) -> float:
        """Fraction of the upper side with separated flow, the mean of ``reversed_flow_fraction`` over the span."""
        return float(np.average(self.reversed_flow_fraction, weights=self.dr_m))

    def make_printed_blocks(self) -> tuple[ShownBlock, ...]:
        """Return convergence, resolution and balances of the solution as printed text."""
        wake = (
            ResultColumn("wake_torque_ratio", "%", ".0f", head="torque found in the wake"),
            ResultColumn("wake_thrust_ratio", "%", ".0f", head="thrust found in the wake"),
        )
        eddy = ResultColumn("max_eddy_viscosity_ratio", form=".3g", head="greatest turbulent over molecular viscosity")
        table = tabulate_fields(self, [
            ResultColumn("verdict.drift", "%", ".2g", head="drift in the last 400 iterations"),
            ResultColumn("verdict.swing", "%", ".2g", head="swing in the last 400 iterations"),
            ("outflow at the bottom", f"{1e3 * self.verdict.outflow_m3_s:.3g} l/s"),
            ResultColumn("verdict.leak", form=".1e", head="continuity error"),
            ResultColumn("friction_torque_fraction", "%", ".0f", head="friction in the torque"),
            ResultColumn("figure_of_merit", form=".3f"),
            ("y+, greatest and median", f"{self.yplus.max():.2g}, {self.yplus_median:.2g}"),
            *(wake if math.isfinite(self.wake_torque_ratio) else ()),
            *((eddy,) if self.max_eddy_viscosity_ratio else ()),
            ResultColumn("separated_fraction", "%", ".0f", head="separated flow on the upper side"),
        ])  # fmt: skip
        return (table,)


def read_solution(folder: Path, mesh: PolyMesh | None = None, *, patch: str = "blade") -> CfdSolution:
    """Read the last state of a case; for a pair, ``patch`` selects the upper (``blade``) or lower rotor
    (``blade_lower``).

    Raises
    ------
    InputError
        If there is no state, or a file is truncated.
    """
    point = read_operating_point(folder)
    at = [t for t in list_complete_states(folder) if t > 0]
    if not at:
        raise InputError(str(folder), "", "contains no solution", "run it first: mufly cfd run")
    mesh = mesh or read_poly_mesh(folder)
    place = folder / str(at[-1])
    velocity, pressure = read_field(place / "U", mesh.cell_count), read_field(place / "p", mesh.cell_count)
    faces, speed = mesh.patch_face_slice(patch), point.patch_speeds_rad_s[patch]
    cell = mesh.owner[faces]
    area, centre = mesh.face_areas[faces], mesh.face_centres[faces]
    size = np.linalg.norm(area, axis=1)
    normal = area / size[:, None]  # out of the air, into the blade
    distance = np.einsum("fi,fi->f", centre - mesh.cell_centres[cell], normal)
    wall = speed * np.stack((-centre[:, 1], centre[:, 0], np.zeros(len(centre))), axis=-1)
    slip = velocity[cell] - wall
    slip -= np.einsum("fi,fi->f", slip, normal)[:, None] * normal
    mu, eddy = np.full(len(cell), point.viscosity_Pa_s), 0.0
    if (place / "nut").is_file():
        close = np.linalg.norm(mesh.cell_centres, axis=1) < 1.5 * point.radius_m
        eddy = float(np.max(read_field(place / "nut", mesh.cell_count)[close])) / point.kinematic_viscosity_m2_s
        mu += point.density_kg_m3 * read_patch_field(place / "nut", patch, len(cell))
    friction = mu[:, None] * slip / distance[:, None]
    p = point.density_kg_m3 * pressure[cell]
    force = p[:, None] * area + friction * size[:, None]
    moment = centre[:, 0] * force[:, 1] - centre[:, 1] * force[:, 0]
    # The quarter chord line is the y axis; the nose points to -x if the rotor turns anticlockwise.
    pitching = math.copysign(1.0, speed) * (centre[:, 2] * force[:, 0] - centre[:, 0] * force[:, 2])
    of_friction = centre[:, 0] * friction[:, 1] - centre[:, 1] * friction[:, 0]
    edges = mesh.strip_edges_m
    # Caps belong to no strip: root cap and hub count to the first strip, the tip cap to the last.
    strip = np.where(centre[:, 1] < 0.5 * (edges[0] + edges[-1]), 0, len(edges) - 2)
    width, sense = np.diff(edges), math.copysign(1.0, speed)
    strip = np.where(
        mesh.cell_strip[cell] >= 0, mesh.cell_strip[cell] % len(width), strip
    )  # strip numbers of a lower rotor continue
    thrust = point.blades * np.bincount(strip, force[:, 2], len(width))
    torque = -sense * point.blades * np.bincount(strip, moment, len(width))
    over, back = area[:, 2] < 0.0, sense * friction[:, 0] < 0.0
    upper = np.bincount(strip[over], size[over], len(width))
    left = np.bincount(strip[over & back], size[over & back], len(width)) / np.maximum(upper, 1e-300)
    u_tau = np.sqrt(np.linalg.norm(friction, axis=1) / point.density_kg_m3)
    t, q = float(thrust.sum()), float(torque.sum())
    tip = abs(speed) * point.radius_m
    disc = math.pi * point.radius_m**2
    ideal = t * math.sqrt(t / (2.0 * point.density_kg_m3 * disc)) if t > 0 else math.nan
    power = q * abs(speed)
    # The wake of a pair has the loads of both rotors.
    below, other = (math.nan, math.nan), read_actuator_disc(folder)
    if not point.gap_m:
        more = (0.0, 0.0) if other is None else (other.thrust_N, other.torque_Nm)
        found = wake_load_ratios(mesh, point, velocity, pressure, t + more[0], q)
        below = (found[0] + more[1] / q, found[1])
    return CfdSolution(
        point,
        judge_case_convergence(folder, patch=patch),
        t,
        q,
        power,
        t / (point.density_kg_m3 * disc * tip**2),
        q / (point.density_kg_m3 * disc * tip**2 * point.radius_m),
        ideal / power if power > 0 else math.nan,
        float(-sense * point.blades * np.sum(of_friction * size) / q),
        0.5 * (edges[1:] + edges[:-1]),
        width,
        thrust / width,
        torque / width,
        u_tau * distance / point.kinematic_viscosity_m2_s,
        p,
        friction,
        eddy,
        *below,
        left,
        np.bincount(strip, pitching, len(width)) / width,
    )


def wake_load_ratios(
    mesh: PolyMesh, point: OperatingPoint, velocity: Array, pressure: Array, thrust_N: float, torque_Nm: float
) -> tuple[float, float]:
    """Return the wake's torque and thrust, from 1 to 2 R below the disc within radius 2 R, divided by the rotor's.

    Only the blades exert a torque on the air (friction far away is small), so the flux of angular momentum equals the
    torque. The momentum of the lateral inflow is small, too::

        Q = -rho int u_theta u_z r dA,    T = int (p + rho u_z (u_z + climb)) dA

    Discretisation errors of the rotating frame show as a deficit of torque.
    """
    c, v = mesh.cell_centres, mesh.cell_volumes
    r = np.hypot(c[:, 0], c[:, 1])
    low = max(-2.0, -0.8 * point.domain.below) * point.radius_m
    slab = (c[:, 2] < -point.radius_m) & (c[:, 2] > low)  # complete layers, because the mesh is horizontal there
    k = slab & (r < 2.0 * point.radius_m)
    if not k.any() or thrust_N == 0.0 or torque_Nm == 0.0:
        return math.nan, math.nan
    thick = float(v[slab].sum() / -mesh.face_areas[mesh.patch_face_slice("bottom"), 2].sum())
    axial, swirl = velocity[k, 2], velocity[k, 1] * c[k, 0] - velocity[k, 0] * c[k, 1]
    share = point.blades * point.density_kg_m3 * v[k] / thick
    return (
        float(-share @ (swirl * axial)) / torque_Nm,
        float(share @ (pressure[k] + axial * (axial + point.climb_m_s))) / thrust_N,
    )


@result(eq=False)
class FlowField:
    """Velocity field around a solved rotor.

    Attributes
    ----------
    velocity_m_s : (cells, 3) array
        Absolute velocity, including the oncoming stream in climb and descent.
    gradient_1_s : (cells, 3, 3) array
        Velocity gradient; ``[:, i, j]`` is the derivative of component j along axis i.
    """

    velocity_m_s: Array
    gradient_1_s: Array

    @property
    def vorticity_1_s(self) -> Array:
        """Vorticity, the curl of the velocity (1/s); (cells, 3)."""
        g = self.gradient_1_s
        return np.stack((g[:, 1, 2] - g[:, 2, 1], g[:, 2, 0] - g[:, 0, 2], g[:, 0, 1] - g[:, 1, 0]), axis=-1)

    @property
    def q_1_s2(self) -> Array:
        """Q criterion (1/s^2), half of rotation rate squared less strain rate squared, above 0 in vortices; (cells,).

        Source: Hunt, Wray and Moin, Center for Turbulence Research CTR-S88, 1988.
        """
        g = self.gradient_1_s
        return -0.5 * np.einsum("cij,cji->c", g, g) + 0.5 * np.trace(g, axis1=1, axis2=2) ** 2


def read_flow(folder: Path, mesh: PolyMesh) -> FlowField:
    """Read the velocity of a case's last state, with its gradient.

    Raises
    ------
    InputError
        If there is no state, or a file is truncated.
    """
    at = [t for t in list_complete_states(folder) if t > 0]
    if not at:
        raise InputError(str(folder), "", "contains no solution", "run it first: mufly cfd run")
    velocity = read_field(folder / str(at[-1]) / "U", mesh.cell_count)
    return FlowField(
        velocity, compute_velocity_gradient(mesh, velocity, read_operating_point(folder).patch_speeds_rad_s)
    )


def compute_velocity_gradient(mesh: PolyMesh, velocity: Array, walls: dict[str, float]) -> Array:
    """Return the velocity gradient in the cells by least squares over the neighbours; exact for a linear field.

    Neighbours are weighted by the inverse square of the distance. Across a periodic plane the neighbours are cells of
    the other plane, rotated by one sector. A wall counts as a neighbour with its own velocity (no slip).

    Parameters
    ----------
    mesh : PolyMesh
    velocity : (cells, 3) array
        Velocity of the cells (m/s).
    walls : dict of float
        Rotational speed (rad/s) of the walls by patch.

    Returns
    -------
    (cells, 3, 3) array
        Gradient (1/s); ``[:, i, j]`` is the derivative of component j along axis i.
    """
    inside = len(mesh.neighbour)
    a, b = mesh.owner[:inside], mesh.neighbour
    cells = [a, b]
    offset = [mesh.cell_centres[b] - mesh.cell_centres[a]] * 2
    change = [velocity[b] - velocity[a]] * 2
    left, right = (mesh.owner[mesh.patch_face_slice(name)] for name in ("sector_left", "sector_right"))
    for here, there, sense in ((left, right, 1.0), (right, left, -1.0)):
        turn = _rotation_matrix(sense * 2.0 * math.pi / mesh.blade_count)
        cells.append(here)
        offset.append(mesh.cell_centres[there] @ turn - mesh.cell_centres[here])
        change.append(velocity[there] @ turn - velocity[here])
    for name, speed in walls.items():
        faces = mesh.patch_face_slice(name)
        here, centre = mesh.owner[faces], mesh.face_centres[faces]
        wall = speed * np.stack((-centre[:, 1], centre[:, 0], np.zeros(len(centre))), axis=-1)
        cells.append(here)
        offset.append(centre - mesh.cell_centres[here])
        change.append(wall - velocity[here])
    normal, moment = np.zeros((mesh.cell_count, 3, 3)), np.zeros((mesh.cell_count, 3, 3))
    for c, d, u in zip(cells, offset, change, strict=True):
        weight = 1.0 / np.einsum("fi,fi->f", d, d)
        for i in range(3):
            for j in range(3):
                normal[:, i, j] += np.bincount(c, weight * d[:, i] * d[:, j], mesh.cell_count)
                moment[:, i, j] += np.bincount(c, weight * d[:, i] * u[:, j], mesh.cell_count)
    found: Array = np.asarray(np.linalg.solve(normal, moment), dtype=np.float64)
    return found


def _rotation_matrix(angle_rad: float) -> Array:
    """Return the matrix that rotates row vectors about z: ``v @ matrix``."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


class FlowSampler:
    """Sampler of the flow at any point: the nearest cell's vorticity, and its velocity extrapolated by the gradient."""

    def __init__(self, mesh: PolyMesh, flow: FlowField) -> None:
        self._mesh, self._flow, self._tree = mesh, flow, cKDTree(mesh.cell_centres)

    def sample_cylindrical(self, r_m: Array, azimuth_rad: Array, z_m: Array) -> tuple[Array, Array]:
        """Return velocity (m/s) and vorticity (1/s), radial, azimuthal and up, at points of given radius, azimuth and
        height.

        The blade lies at an azimuth of pi/2; it repeats every sector. Returns two (points, 3) arrays.
        """
        at, c, s = self._rotate_into_sector(r_m, azimuth_rad, z_m)
        cell = self._tree.query(at)[1]
        away = at - self._mesh.cell_centres[cell]
        u = self._flow.velocity_m_s[cell] + np.einsum("pi,pij->pj", away, self._flow.gradient_1_s[cell])
        both = []
        for v in (u, self._flow.vorticity_1_s[cell]):
            both.append(np.stack((v[:, 0] * c + v[:, 1] * s, v[:, 1] * c - v[:, 0] * s, v[:, 2]), axis=-1))
        return both[0], both[1]

    def is_inside_solid(self, r_m: Array, azimuth_rad: Array, z_m: Array, walls: Iterable[str]) -> NDArray[np.bool_]:
        """Return whether points lie inside a blade or the hub: behind the nearest of the ``walls``, and closer to it
        than to any cell's centre.
        """
        at = self._rotate_into_sector(r_m, azimuth_rad, z_m)[0]
        faces = np.concatenate([np.arange(len(self._mesh.faces))[self._mesh.patch_face_slice(name)] for name in walls])
        away, nearest = cKDTree(self._mesh.face_centres[faces]).query(at)
        near = faces[nearest]
        # Area vectors point out of the air.
        behind = np.einsum("pi,pi->p", at - self._mesh.face_centres[near], self._mesh.face_areas[near]) > 0.0
        return np.asarray(behind & (away < self._tree.query(at)[0]))

    def _rotate_into_sector(self, r_m: Array, azimuth_rad: Array, z_m: Array) -> tuple[Array, Array, Array]:
        """Rotate points into the mesh's sector; return them with cosine and sine of their azimuth."""
        sector = 2.0 * math.pi / self._mesh.blade_count
        into = (azimuth_rad - 0.5 * math.pi + 0.5 * sector) % sector + 0.5 * math.pi - 0.5 * sector
        c, s = np.cos(into), np.sin(into)
        return np.stack((r_m * c, r_m * s, z_m), axis=-1), c, s


WAKE_PROFILE_DEPTHS = (0.25, 0.5, 1.0)
"""Distances below the disc, in radii, of the wake profiles."""


@result(eq=False)
class WakeProfile:
    """Azimuthally averaged velocity in horizontal planes under the disc.

    Attributes
    ----------
    below_m : (planes,) array
    r_m : (radii,) array
    down_m_s, swirl_m_s : (planes, radii) arrays
        Velocity downwards, and azimuthal velocity in the sense of rotation.
    momentum_theory_radius_m, momentum_theory_velocity_m_s : (planes,) arrays
        Radius and velocity of the stream tube of momentum theory. From the induced velocity v of the disc, the velocity
        at distance h is v (1 + h / sqrt(h^2 + R^2)), as of a cylindrical vortex sheet.
    """

    below_m: Array
    r_m: Array
    down_m_s: Array
    swirl_m_s: Array
    momentum_theory_radius_m: Array
    momentum_theory_velocity_m_s: Array


def compute_wake_profile(mesh: PolyMesh, flow: FlowField, point: OperatingPoint, thrust_N: float) -> WakeProfile:
    """Average the velocity over a sector, at 40 radii up to 1.4 R and 72 azimuths in each plane.

    Parameters
    ----------
    mesh : PolyMesh
    flow : FlowField
    point : OperatingPoint
    thrust_N : float
        Thrust of the whole rotor, or of both rotors of a pair, for momentum theory.
    """
    radius, probe = point.radius_m, FlowSampler(mesh, flow)
    h = radius * np.array(WAKE_PROFILE_DEPTHS)
    r = radius * 1.4 * (np.arange(40) + 0.5) / 40
    around = 2.0 * math.pi / mesh.blade_count * (np.arange(72) + 0.5) / 72
    z, rr, psi = (x.ravel() for x in np.meshgrid(-h, r, around, indexing="ij"))
    u = probe.sample_cylindrical(rr, psi, z)[0].reshape(len(h), len(r), len(around), 3).mean(axis=2)
    w = point.climb_m_s
    # T = 2 rho A (w + v) v
    whole = w * w + 2.0 * max(thrust_N, 0.0) / (point.density_kg_m3 * math.pi * radius**2)
    v = 0.5 * (math.sqrt(whole) - w)
    speed = w + v * (1.0 + h / np.hypot(h, radius))
    edge = radius * np.sqrt(np.clip((w + v) / np.maximum(speed, 1e-12), 0.0, None))
    sense = math.copysign(1.0, point.speed_rad_s)
    return WakeProfile(h, r, -u[..., 2], sense * u[..., 1], edge, speed)


_FIELD_SPEED_EXPONENTS = {"U": 1, "p": 2, "phi": 1, "k": 2, "epsilon": 3, "omega": 1, "nut": 1}


def scale_solution_state(folder: Path, mesh: PolyMesh, ratio: float) -> dict[str, Array]:
    """Return a case's last state, scaled to initial fields for another speed, pitch setting or blade tip.

    Velocities and fluxes are multiplied by the ratio of speeds, pressure by its square.

    For another speed this is exact apart from Reynolds effects. For another shape the cells keep their values and the
    faces their fluxes, which remain balanced in every cell. The meshes must have the same topology.

    Raises
    ------
    InputError
        If there is no state, or its mesh has another topology.
    """
    at = [t for t in list_complete_states(folder) if t > 0]
    if not at:
        raise InputError(str(folder), "", "contains no solution", "run it first: mufly cfd run")
    before = read_poly_mesh(folder)
    of = _map_faces_between_meshes(before, mesh)
    if of is None:
        raise InputError(
            str(folder),
            "",
            "has a mesh with other cells",
            "start from a case of the same level and kind of tip",
        )
    place, out = folder / str(at[-1]), {}
    for name, power in _FIELD_SPEED_EXPONENTS.items():
        file = place / name
        if not file.is_file():
            continue
        inside = len(mesh.neighbour) if name == "phi" else mesh.cell_count
        values = read_field(file, inside)
        if name == "phi":
            parts = [read_patch_field(file, p, n) for p, (_, n) in before.patches.items()]
            values = np.concatenate([values, *parts])[of]
        out[name] = values * ratio**power
    return out


def _map_faces_between_meshes(before: PolyMesh, mesh: PolyMesh) -> NDArray[np.int64] | None:
    """Return for each face of ``mesh`` its index in ``before``; None if the meshes differ in faces or cells."""
    if before.faces.shape != mesh.faces.shape or before.patches != mesh.patches:
        return None
    orders = [np.lexsort(np.sort(m.faces, axis=1).T) for m in (before, mesh)]
    of = np.empty(len(mesh.faces), dtype=np.int64)
    of[orders[1]] = orders[0]
    alike = np.array_equal(np.sort(before.faces[of], axis=1), np.sort(mesh.faces, axis=1))
    inside = len(mesh.neighbour)
    alike = (
        alike and np.array_equal(before.owner[of], mesh.owner) and np.array_equal(before.is_rotating, mesh.is_rotating)
    )
    return of if alike and np.array_equal(before.neighbour[of[:inside]], mesh.neighbour) else None


def read_field(file: Path, cells: int) -> Array:
    """Read the cells' values of a field, ASCII or binary; (cells,) or (cells, 3).

    Raises
    ------
    InputError
        If the file cannot be read or is truncated.
    """
    try:
        data = file.read_bytes()
    except OSError as error:
        raise InputError(str(file), "", f"cannot be read ({error.strerror})", "run the case again") from error
    at = data.find(b"internalField")
    return _parse_values(data, at + len(b"internalField"), cells, file)


def read_patch_field(file: Path, patch: str, faces: int) -> Array:
    """Read a field's values on the faces of a patch; zeros if the file states no values for the patch.

    Raises
    ------
    InputError
        If the file is truncated.
    """
    data = file.read_bytes()
    begin = data.find(f"{patch}\n".encode(), data.find(b"boundaryField"))
    at = data.find(b"value", begin)
    if begin < 0 or at < 0:
        return np.zeros(faces)
    return _parse_values(data, at + len(b"value"), faces, file)


_FIELD_HEADER_BYTES = 200
"""Bytes that hold a field's head, and the whole of a uniform one."""


def _parse_values(data: bytes, at: int, count: int, file: Path) -> Array:
    head = data[at : at + _FIELD_HEADER_BYTES]
    words = head.split()
    if words[:1] == [b"uniform"]:
        text = head.partition(b"uniform")[2].partition(b";")[0].replace(b"(", b" ").replace(b")", b" ")
        numbers = np.array([float(x) for x in text.split()])
        return np.full(count, numbers[0]) if numbers.size == 1 else np.tile(numbers, (count, 1))
    size = 3 if b"vector" in head else 1
    begin = data.index(b"(", at) + 1
    told = int(data[data.index(b">", at) + 1 : begin - 1].split()[0])
    if told != count:
        raise InputError(str(file), "", f"has {told} values, but the mesh has {count} cells", "run the case again")
    if re.search(rb"format\s+binary", data[: data.index(b"}")]):
        end = begin + 8 * size * count
        if end > len(data):
            raise InputError(str(file), "", "is cut short", "delete its folder and run the case again")
        values = np.frombuffer(data[begin:end], dtype="<f8")
    else:
        end = data.index(b"\n)", begin)
        text = data[begin:end].replace(b"(", b" ").replace(b")", b" ")
        values = np.array(text.split(), dtype=np.float64)
        if values.size != size * count:
            raise InputError(str(file), "", "is cut short", "delete its folder and run the case again")
    return values.reshape(count, size) if size > 1 else values
