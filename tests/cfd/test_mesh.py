"""Meshes of a rotor's sector: closed, conformal, in OpenFOAM's order, and good enough to solve on."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from mufly.cfd import (
    MeshDomain,
    PolyMesh,
    make_poly_mesh,
    make_sector_mesh,
    measure_mesh_quality,
    read_poly_mesh,
    write_poly_mesh,
)
from mufly.cfd.meshes.section_mesh import (
    MIN_TAIL_THICKNESS_CHORDS,
    SectionLayout,
    make_geometric_spacing,
    make_ring_contour,
    make_vinokur_spacing,
)
from mufly.cfd.meshes.sector_mesh import MESH_LEVELS
from mufly.errors import InputError
from mufly.rotor import Rotor, load_airfoil, load_rotor, make_rotor


def propeller(blades: int, cutout: float = 0.2) -> Rotor:
    """Twisted, tapered, cambered, with two airfoils."""
    return make_rotor(
        name="propeller", blades=blades, radius_m=0.05, hub_cutout=cutout, r_over_R=[0.15, 0.6, 1.0],
        chord_m=[0.010, 0.012, 0.004], twist_rad=[0.5, 0.3, 0.15], airfoils=["naca4415", "naca4412", "naca4409"],
    )  # fmt: skip


CASES = {
    "thesis 12": lambda: (load_rotor("naca0012-r60-c20"), 12.0),
    "thesis 0": lambda: (load_rotor("naca0012-r60-c20"), 0.0),
    "thesis 20": lambda: (load_rotor("naca0012-r60-c20"), 20.0),
    "walkera": lambda: (load_rotor("walkera-5g6"), 14.0),
    "three blades": lambda: (propeller(3), 5.0),
    "gurney": lambda: (
        make_rotor(name="g", radius_m=0.06, chord_m=0.02, airfoils="naca0012+gurney3", hub_cutout=0.15),
        16.0,
    ),
}


@cache
def meshed(name: str) -> PolyMesh:
    rotor, pitch = CASES[name]()
    return make_poly_mesh(make_sector_mesh(rotor, math.radians(pitch), level="tiny"))


@pytest.mark.parametrize("name", CASES)
def test_every_mesh_is_closed_positive_and_smooth(name: str) -> None:
    mesh = meshed(name)
    found = measure_mesh_quality(mesh)
    assert found.smallest_volume_m3 > 0.0
    assert found.max_cell_openness < 1e-12
    assert found.non_orthogonality_deg < 80.0
    assert found.skewness < 4.0
    # The cells fill the sector: a wedge of 2 pi / N, its outer arc in chords, less the blade.
    rotor, _ = CASES[name]()
    outer, tall = 5.0 * rotor.radius_m, 10.0 * rotor.radius_m
    whole = math.pi / rotor.blades * outer**2 * tall
    assert 0.97 * whole < mesh.cell_volumes.sum() < whole


@pytest.mark.parametrize("name", CASES)
def test_the_blade_is_one_closed_surface_around_the_right_volume(name: str) -> None:
    mesh = meshed(name)
    faces = mesh.faces[mesh.patch_face_slice("blade")]
    assert np.allclose(mesh.face_areas[mesh.patch_face_slice("blade")].sum(axis=0), 0.0, atol=1e-15)
    edges = np.sort(np.stack((faces, np.roll(faces, -1, axis=1)), axis=-1).reshape(-1, 2), axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    assert np.all(count == 2)
    rotor, _ = CASES[name]()
    area, centre = mesh.face_areas[mesh.patch_face_slice("blade")], mesh.face_centres[mesh.patch_face_slice("blade")]
    volume = -np.einsum("fi,fi->", area, centre) / 3.0
    x = np.linspace(float(rotor.hub_cutout), 1.0, 401)
    sections = rotor.sections_at(x)
    unit = []
    for airfoil in sections.airfoil_names:
        p = load_airfoil(airfoil).coordinates
        tail = max(0.0, MIN_TAIL_THICKNESS_CHORDS - float(np.linalg.norm(p[0] - p[-1])))
        a, b = p, np.roll(p, -1, axis=0)
        unit.append(0.5 * float(np.sum(a[:, 0] * b[:, 1] - b[:, 0] * a[:, 1])) + 0.5 * tail)
    ratio = (1 - sections.second_weight) * np.array(unit)[sections.first_airfoil] + sections.second_weight * np.array(
        unit
    )[sections.second_airfoil]
    exact = np.trapezoid(sections.chord_m**2 * ratio, x * rotor.radius_m)
    assert volume == pytest.approx(exact, rel=0.03)


@pytest.mark.parametrize("name", CASES)
def test_periodic_faces_meet_by_rotation_point_by_point(name: str) -> None:
    mesh = meshed(name)
    turn = 2.0 * math.pi / mesh.blade_count
    c, s = math.cos(turn), math.sin(turn)
    left = mesh.points[mesh.faces[mesh.patch_face_slice("sector_left")]]
    right = mesh.points[mesh.faces[mesh.patch_face_slice("sector_right")]] @ np.array(
        [[c, s, 0], [-s, c, 0], [0, 0, 1]]
    )
    assert len(left) == len(right) > 0
    again = right[:, [0, 3, 2, 1]]
    assert np.max(np.abs(left - again)) < 1e-9 * 0.06
    a, b = (mesh.face_areas[mesh.patch_face_slice(f"sector_{n}")] for n in ("left", "right"))
    assert np.allclose(a, -b @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]), atol=1e-15)


def test_faces_are_in_upper_triangular_order_and_leave_their_owner() -> None:
    mesh = meshed("thesis 12")
    inside = len(mesh.neighbour)
    owner = mesh.owner[:inside]
    assert np.all(owner < mesh.neighbour)
    assert np.all(np.diff(owner * mesh.cell_count + mesh.neighbour) > 0)
    out = np.einsum("fi,fi->f", mesh.face_centres - mesh.cell_centres[mesh.owner], mesh.face_areas)
    assert np.all(out > 0.0)
    starts = [mesh.patches[p][0] for p in mesh.patches]
    assert starts[0] == inside
    assert sum(n for _, n in mesh.patches.values()) + inside == len(mesh.faces)


def test_the_root_cap_and_the_tip_are_where_the_rotor_says() -> None:
    mesh = meshed("thesis 12")
    p = mesh.points[mesh.faces[mesh.patch_face_slice("blade")]].reshape(-1, 3)
    assert p[:, 1].min() == pytest.approx(0.009, abs=1e-12)
    assert p[:, 1].max() == pytest.approx(0.060, abs=1e-12)
    nose, tail = p[np.argmin(p[:, 0])], p[np.argmax(p[:, 0])]
    assert nose[2] > 0.0 > tail[2]  # nose up, the rotor turning about +z moves the blade to -x


def test_levels_are_finer_by_one_factor() -> None:
    cells = {name: _count(name) for name in ("coarse", "medium", "fine")}
    assert cells["coarse"] == pytest.approx(57e3, rel=0.1)
    assert cells["medium"] == pytest.approx(124e3, rel=0.1)
    assert cells["fine"] == pytest.approx(342e3, rel=0.1)


def _count(level: str) -> int:
    k = MESH_LEVELS[level]
    layout = SectionLayout(k)
    core, sections = k.aerofoil_side * k.nose_and_tail, k.axis_to_root + k.root_to_tip + k.beyond_tip
    around = k.box_to_cylinder + k.cylinder_to_boundary
    wings = 2 * sections * around * layout.nz
    return (sections + around) * len(layout.outer_quads) + (sections + around - k.root_to_tip) * core + wings


@pytest.mark.parametrize("name", CASES)
def test_the_turning_air_ends_at_surfaces_of_revolution(name: str) -> None:
    mesh = meshed(name)
    inside = len(mesh.neighbour)
    edge = mesh.is_rotating[mesh.owner[:inside]] != mesh.is_rotating[mesh.neighbour]
    assert 0.5 < mesh.is_rotating.mean() < 0.95
    centre, area = mesh.face_centres[:inside][edge], mesh.face_areas[:inside][edge]
    through = np.einsum("fi,fi->f", np.stack((-centre[:, 1], centre[:, 0]), axis=-1), area[:, :2])
    r = np.hypot(centre[:, 0], centre[:, 1])
    assert np.max(np.abs(through) / (r * np.linalg.norm(area, axis=1))) < 2e-3  # corners of the ring are not level
    assert abs(through.sum()) < 1e-6 * np.sum(r * np.linalg.norm(area, axis=1))
    blade = mesh.face_centres[mesh.patch_face_slice("blade")]
    assert np.all(mesh.is_rotating[mesh.owner[mesh.patch_face_slice("blade")]])
    assert np.max(np.abs(blade[:, 2])) < 0.6 * np.max(centre[:, 2])


def test_the_turning_frame_hardly_pushes_on_air_that_flows_straight_to_the_shaft() -> None:
    # u = -e_r R / r, convected with the still air's relative flux at second order upwind, and Coriolis' force: nothing
    # is to be left. What is left makes swirl out of nothing; a mesh of one frame lost half the wake's torque to it.
    mesh, n = meshed("thesis 12"), len(meshed("thesis 12").neighbour)
    c, f, area, own, other = mesh.cell_centres, mesh.face_centres, mesh.face_areas, mesh.owner, mesh.neighbour

    def inflow(x: np.ndarray) -> np.ndarray:
        return -0.06 * x[:, :2] / np.sum(x[:, :2] ** 2, axis=1, keepdims=True)

    def summed(faces: np.ndarray) -> np.ndarray:
        out = np.zeros((mesh.cell_count, faces.shape[1]))
        np.add.at(out, own, faces)
        np.subtract.at(out, other, faces[:n])
        return out

    u = inflow(c)
    to_own = np.abs(np.einsum("fi,fi->f", f[:n] - c[own[:n]], area[:n]))
    to_other = np.abs(np.einsum("fi,fi->f", c[other] - f[:n], area[:n]))
    share = (to_other / (to_own + to_other))[:, None]
    at = np.concatenate((share * u[own[:n]] + (1 - share) * u[other], inflow(f[n:])))
    slope = (
        summed((at[:, :, None] * area[:, None, :]).reshape(-1, 6)).reshape(-1, 2, 3) / mesh.cell_volumes[:, None, None]
    )
    turning = mesh.is_rotating[own]
    turning[:n] |= mesh.is_rotating[other]
    flux = -np.where(turning, f[:, 0] * area[:, 1] - f[:, 1] * area[:, 0], 0.0)  # per rad/s
    up = np.where(flux[:n] > 0, own[:n], other)
    at[:n] = u[up] + np.einsum("fij,fj->fi", slope[up], f[:n] - c[up])
    left = summed(flux[:, None] * at) - summed(flux[:, None]) * u
    left += np.stack((-u[:, 1], u[:, 0]), axis=-1) * (mesh.cell_volumes * mesh.is_rotating)[:, None]
    torque = -(c[:, 0] * left[:, 1] - c[:, 1] * left[:, 0])
    r = np.hypot(c[:, 0], c[:, 1])
    k = mesh.is_rotating & (r > 0.02) & (np.abs(c[:, 2]) > 0.01) & (np.abs(c[:, 2]) < 0.06)
    whole = np.sum((r * np.linalg.norm(u, axis=1) * mesh.cell_volumes)[k])
    assert abs(torque[k].sum()) < 5e-3 * whole


def test_files_come_back_as_they_were(tmp_path: Path) -> None:
    mesh = meshed("three blades")
    write_poly_mesh(mesh, tmp_path)
    again = read_poly_mesh(tmp_path)
    for name in ("points", "faces", "owner", "neighbour", "cell_strip", "strip_edges_m"):
        assert np.array_equal(getattr(mesh, name), getattr(again, name))
    assert again.patches == mesh.patches
    assert again.blade_count == 3
    points = tmp_path / "constant" / "polyMesh" / "points"
    points.write_bytes(points.read_bytes()[:5000])
    with pytest.raises(InputError, match="not a complete mesh"):
        read_poly_mesh(tmp_path)


def test_points_on_a_line_have_the_sizes_asked_for() -> None:
    for first, last in ((0.01, 0.05), (0.2, 0.01), (0.05, 0.05)):
        t = make_vinokur_spacing(20, first, last)
        assert t[0] == 0.0
        assert t[-1] == pytest.approx(1.0)
        assert np.all(np.diff(t) > 0)
        assert np.diff(t)[0] == pytest.approx(first, rel=0.35)
        assert np.diff(t)[-1] == pytest.approx(last, rel=0.35)
    t = make_geometric_spacing(12, 0.01)
    ratio = np.diff(t)[1:] / np.diff(t)[:-1]
    assert np.diff(t)[0] == pytest.approx(0.01)
    assert np.allclose(ratio, ratio[0])


def test_a_contour_keeps_to_its_airfoil_and_has_a_tail() -> None:
    loop = make_ring_contour(load_airfoil("naca0012"), MESH_LEVELS["medium"])
    assert len(loop) == 2 * (MESH_LEVELS["medium"].aerofoil_side + MESH_LEVELS["medium"].nose_and_tail)
    area = -0.5 * np.sum(loop[:, 0] * np.roll(loop[:, 1], -1) - np.roll(loop[:, 0], -1) * loop[:, 1])
    assert area == pytest.approx(
        0.0817 + 0.5 * (MIN_TAIL_THICKNESS_CHORDS - 0.00252), rel=0.01
    )  # 0.685 t, and the tail opened
    assert np.ptp(loop[loop[:, 0] > 0.9999, 1]) == pytest.approx(MIN_TAIL_THICKNESS_CHORDS, rel=1e-3)


@pytest.mark.parametrize(
    ("rotor", "pitch", "message"),
    [
        (lambda: propeller(1), 5.0, "one blade has no periodic sector"),
        (lambda: propeller(2, 0.02), 5.0, "blades meet at the shaft"),
        (lambda: propeller(2), 70.0, "give -60 to 60"),
        (lambda: propeller(2), 55.0, "give at most 75 deg"),
        (
            lambda: make_rotor(name="wide", blades=6, radius_m=0.06, chord_m=0.02, airfoils="naca0012"),
            5.0,
            "the blades meet at r/R",
        ),
    ],
)  # fmt: skip
def test_impossible_rotors_are_refused_in_one_line(rotor: Callable[[], Rotor], pitch: float, message: str) -> None:
    with pytest.raises(InputError, match=message):
        make_sector_mesh(rotor(), math.radians(pitch), level="tiny")


def test_a_domain_that_cuts_the_blade_is_refused() -> None:
    with pytest.raises(InputError, match="domain"):
        MeshDomain(radius=1.0)
    with pytest.raises(InputError, match="is unknown"):
        make_sector_mesh(load_rotor("naca0012-r60-c20"), 0.2, level="huge")
