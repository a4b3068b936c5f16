"""What is drawn of the air: gradients, vortices' surfaces, the wake's mean, friction lines."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

from mufly.cfd import Point, PolyMesh, blade_mesh, iso_surface, poly_mesh, velocity_gradient, wake_profile
from mufly.cfd.results import Flow
from mufly.rotor import load_rotor
from mufly.units import RPM

POINT = Point(
    "naca0012-r60-c20", 2, 0.06, math.radians(12), 5000 * RPM, 0.0, "laminar", "tiny", 1.2, 1.81e-5, 2.3
)  # fmt: skip


@cache
def mesh() -> PolyMesh:
    return poly_mesh(blade_mesh(load_rotor("naca0012-r60-c20"), math.radians(12), level="tiny"))


def flow_of(m: PolyMesh, velocity: np.ndarray) -> Flow:
    return Flow(velocity, velocity_gradient(m, velocity, {}))


def test_air_that_turns_as_a_body_has_twice_its_speed_as_vorticity_and_stretched_air_none() -> None:
    m = mesh()
    turn = 30.0 * np.column_stack((-m.centres[:, 1], m.centres[:, 0], 0.0 * m.centres[:, 0]))
    body = flow_of(m, turn)
    assert np.allclose(body.vorticity_1_s, [0.0, 0.0, 60.0], atol=1e-6)
    assert np.allclose(body.q_1_s2, 30.0**2)
    squeezed = flow_of(m, np.column_stack((0.0 * turn[:, :2], 5.0 * m.centres[:, 2])))
    assert np.allclose(squeezed.vorticity_1_s, 0.0, atol=1e-6)


def test_a_surface_of_a_bell_around_the_hub_is_a_sphere_without_gaps_looking_outwards() -> None:
    m, radius = mesh(), 0.15
    points, triangles = iso_surface(m, -np.linalg.norm(m.centres, axis=1), -radius)
    t = points[triangles]
    r = np.linalg.norm(points, axis=1)
    # Points have the mean of cells around them, which here grow from 5 to 40 mm: exact in the middle, not below.
    assert np.median(r) == pytest.approx(radius, rel=0.01)
    # It ends in the periodic plane y = 0 only: without gaps its areas sum to the cut's, which looks along y.
    area = 0.5 * np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]).sum(axis=0)
    assert area[[0, 2]] == pytest.approx(0.0, abs=1e-9)
    assert area[1] == pytest.approx(math.pi * radius**2, rel=0.2)


def test_even_air_down_and_around_is_told_as_it_is_beside_momentum_theory() -> None:
    m = mesh()
    u = np.column_stack((-20.0 * m.centres[:, 1], 20.0 * m.centres[:, 0], np.full(m.cells, -4.0)))
    found = wake_profile(m, flow_of(m, u), POINT, 0.15)
    assert found.down_m_s == pytest.approx(4.0)
    assert found.swirl_m_s == pytest.approx(20.0 * np.tile(found.r_m, (3, 1)))
    disc = math.pi * POINT.radius_m**2
    induced = math.sqrt(0.15 / (2.0 * POINT.density_kg_m3 * disc))
    assert found.mean_m_s * math.pi * found.edge_m**2 == pytest.approx(induced * disc)
