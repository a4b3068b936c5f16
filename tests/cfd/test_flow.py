"""What is drawn of the air: gradients, vortices' surfaces, the wake's mean, friction lines."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from mufly.cfd import (
    CfdSolution,
    FlowSampler,
    OperatingPoint,
    PolyMesh,
    compute_velocity_gradient,
    compute_wake_profile,
    draw_skin_friction,
    extract_iso_surface,
    extract_vortex_surface,
    make_poly_mesh,
    make_sector_mesh,
    make_tip_hub_geometry,
)
from mufly.cfd.cfd_solution import FlowField
from mufly.quantities.units import RPM
from mufly.rotor import load_rotor

POINT = OperatingPoint(
    "naca0012-r60-c20", 2, 0.06, math.radians(12), 5000 * RPM, 0.0, "laminar", "tiny", 1.2, 1.81e-5, 2.3
)  # fmt: skip


@cache
def mesh() -> PolyMesh:
    return make_poly_mesh(make_sector_mesh(load_rotor("naca0012-r60-c20"), math.radians(12), level="tiny"))


def flow_of(m: PolyMesh, velocity: np.ndarray) -> FlowField:
    return FlowField(velocity, compute_velocity_gradient(m, velocity, {}))


def test_air_that_turns_as_a_body_has_twice_its_speed_as_vorticity_and_stretched_air_none() -> None:
    m = mesh()
    turn = 30.0 * np.column_stack((-m.cell_centres[:, 1], m.cell_centres[:, 0], 0.0 * m.cell_centres[:, 0]))
    body = flow_of(m, turn)
    assert np.allclose(body.vorticity_1_s, [0.0, 0.0, 60.0], atol=1e-6)
    assert np.allclose(body.q_1_s2, 30.0**2)
    squeezed = flow_of(m, np.column_stack((0.0 * turn[:, :2], 5.0 * m.cell_centres[:, 2])))
    assert np.allclose(squeezed.vorticity_1_s, 0.0, atol=1e-6)


def test_a_surface_of_a_bell_around_the_hub_is_a_sphere_without_gaps_looking_outwards() -> None:
    m, radius = mesh(), 0.15
    points, triangles = extract_iso_surface(m, -np.linalg.norm(m.cell_centres, axis=1), -radius)
    t = points[triangles]
    r = np.linalg.norm(points, axis=1)
    # Points have the mean of cells around them, which here grow from 5 to 40 mm: exact in the middle, not below.
    assert np.median(r) == pytest.approx(radius, rel=0.01)
    # Neighbours share their points: an edge is of two triangles, but where the surface meets the periodic plane.
    ends = np.sort(np.concatenate((triangles[:, :2], triangles[:, 1:], triangles[:, ::2])), axis=1)
    edges, count = np.unique(ends, axis=0, return_counts=True)
    assert count.max() == 2
    assert np.abs(points[edges[count == 1]][..., 1]).max() < 1e-9
    assert len(points) < 0.6 * len(triangles)
    # It ends in the periodic plane y = 0 only: without gaps its areas sum to the cut's, which looks along y.
    area = 0.5 * np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]).sum(axis=0)
    assert area[[0, 2]] == pytest.approx(0.0, abs=1e-9)
    assert area[1] == pytest.approx(math.pi * radius**2, rel=0.2)


def test_a_vortex_is_shown_till_it_is_spread_over_half_a_chord_whatever_the_speed() -> None:
    m = mesh()
    c, radius = m.cell_centres, POINT.radius_m
    away = np.hypot(c[:, 1] - radius, c[:, 2] + 0.5 * radius)  # along x, off the blade

    def shown(core_m: float, speed: float) -> int:
        point = replace(POINT, speed_rad_s=speed * POINT.speed_rad_s)
        spin = 0.3 * 0.02 * radius * point.speed_rad_s / (math.pi * core_m**2)
        q = np.where(away < 2.0 * radius, 0.25 * spin**2 * np.exp(-2.0 * (away / core_m) ** 2), 0.0)
        gradient = np.zeros((m.cell_count, 3, 3))  # a spin about x with just this Q
        gradient[:, 1, 2], gradient[:, 2, 1] = np.sqrt(q), -np.sqrt(q)
        return len(extract_vortex_surface(m, FlowField(np.zeros((m.cell_count, 3)), gradient), point)[1])

    thin = shown(0.008, 1.0)
    assert thin > 0
    assert shown(0.008, 2.0) == thin
    assert shown(0.012, 1.0) == 0


def test_even_air_down_and_around_is_told_as_it_is_beside_momentum_theory() -> None:
    m = mesh()
    u = np.column_stack((-20.0 * m.cell_centres[:, 1], 20.0 * m.cell_centres[:, 0], np.full(m.cell_count, -4.0)))
    found = compute_wake_profile(m, flow_of(m, u), POINT, 0.15)
    assert found.down_m_s == pytest.approx(4.0)
    assert found.swirl_m_s == pytest.approx(20.0 * np.tile(found.r_m, (3, 1)))
    disc = math.pi * POINT.radius_m**2
    induced = math.sqrt(0.15 / (2.0 * POINT.density_kg_m3 * disc))
    assert found.momentum_theory_velocity_m_s * math.pi * found.momentum_theory_radius_m**2 == pytest.approx(
        induced * disc
    )


def test_what_lies_in_the_blade_or_the_hub_is_told_from_air() -> None:
    m = make_poly_mesh(
        make_sector_mesh(
            load_rotor("naca0012-r60-c20"),
            math.radians(12),
            level="tiny",
            form=make_tip_hub_geometry("square", 6e-3),
        )
    )
    probe = FlowSampler(m, FlowField(np.zeros((m.cell_count, 3)), np.zeros((m.cell_count, 3, 3))))
    r = np.array([0.03, 0.003, 0.03, 0.03, 0.003, 0.015])
    around = 0.5 * math.pi + np.array([0.0, 1.0, 0.0, 1.5, 1.0, -1.5])
    z = np.array([0.0, 0.0, 0.01, 0.0, 0.02, 0.006])
    assert probe.is_inside_solid(r, around, z, ["blade"]).tolist() == [True, True, False, False, False, False]
    # Friction lines are the blade's; the hub's faces are not on its plan.
    solved = SimpleNamespace(point=POINT, friction_Pa=m.face_centres[m.patch_face_slice("blade")])
    drawn = draw_skin_friction(m, cast(CfdSolution, solved))
    assert drawn.axes[0].get_xlim()[0] > 6.0
