"""Two rotors frozen against each other: one conformal mesh, each in a frame of its own."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from mufly.cfd import PolyMesh, blade_mesh, poly_mesh, quality, read_point, read_poly_mesh, save_case
from mufly.cfd.pair import pair_mesh
from mufly.errors import InputError
from mufly.rotor import load_rotor

GAP, TURNED = 0.020, math.radians(14.0)


@cache
def meshed() -> PolyMesh:
    return poly_mesh(pair_mesh(load_rotor("naca0012-r60-c20"), TURNED, TURNED, GAP, level="tiny"))


def test_both_blades_are_the_same_closed_body_each_the_others_image() -> None:
    mesh = meshed()
    found = quality(mesh)
    assert found.good
    assert found.open_cells < 1e-12
    alone = poly_mesh(blade_mesh(load_rotor("naca0012-r60-c20"), TURNED, level="tiny"))
    volumes = []
    for m, patch in ((alone, "blade"), (mesh, "blade"), (mesh, "blade_lower")):
        area, centre = m.face_areas[m.patch(patch)], m.face_centres[m.patch(patch)]
        assert np.allclose(area.sum(axis=0), 0.0, atol=1e-15)
        volumes.append(-np.einsum("fi,fi->", area, centre) / 3.0)
    assert volumes == pytest.approx([volumes[0]] * 3, rel=1e-9)
    upper, lower = (mesh.points[mesh.faces[mesh.patch(p)]].reshape(-1, 3) for p in ("blade", "blade_lower"))
    image = lower * np.array([-1.0, 1.0, 1.0]) + np.array([0.0, 0.0, GAP])
    assert np.allclose(np.sort(upper, axis=0), np.sort(image, axis=0), atol=1e-12)
    # Turning about -z the lower blade moves to +x: its nose is there, and up.
    assert lower[np.argmax(lower[:, 0]), 2] > -GAP > lower[np.argmin(lower[:, 0]), 2]


def test_the_frames_meet_in_a_level_plane_half_way() -> None:
    mesh, inside = meshed(), len(meshed().neighbour)
    a, b = mesh.sense[mesh.owner[:inside]], mesh.sense[mesh.neighbour]
    assert set(np.unique(mesh.sense)) == {-1.0, 0.0, 1.0}
    between = a * b < 0.0
    assert between.any()
    assert np.allclose(mesh.face_centres[:inside][between, 2], -0.5 * GAP, atol=1e-15)
    assert np.allclose(mesh.face_areas[:inside][between, :2], 0.0, atol=1e-18)
    assert np.all(mesh.sense[mesh.owner[mesh.patch("blade")]] == 1.0)
    assert np.all(mesh.sense[mesh.owner[mesh.patch("blade_lower")]] == -1.0)


def test_a_pairs_case_has_two_zones_and_two_loads(tmp_path: Path) -> None:
    save_case(
        tmp_path, load_rotor("naca0012-r60-c20"), pitch_rad=TURNED, speed_rad_s=500.0, level="tiny", gap_m=GAP,
        lower_speed_rad_s=550.0,
    )  # fmt: skip
    assert read_point(tmp_path).rotors == {"blade": 500.0, "blade_lower": -550.0}
    zones = (tmp_path / "constant" / "MRFProperties").read_text()
    assert "cellZone rotor" in zones
    assert "cellZone lower" in zones
    assert "omega constant -550;" in zones
    assert "patches (blade_lower);" in (tmp_path / "system" / "controlDict").read_text()
    again = read_poly_mesh(tmp_path)
    assert np.array_equal(again.sense, meshed().sense)


@pytest.mark.parametrize(
    ("gap", "pitch", "message"),
    [(0.012, 14.0, "give at least 1"), (0.0, 14.0, "give 0 to"), (0.02, 25.0, "give at least")],
)
def test_rotors_too_close_are_refused_in_one_line(gap: float, pitch: float, message: str) -> None:
    rotor, angle = load_rotor("naca0012-r60-c20"), math.radians(pitch)
    with pytest.raises(InputError, match=message):
        pair_mesh(rotor, angle, angle, gap, level="tiny")
