"""Two rotors frozen against each other: one conformal mesh, each in a frame of its own."""

from __future__ import annotations

import math
import re
import shutil
import subprocess
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from mufly.cfd import (
    PolyMesh,
    judge_case_convergence,
    make_poly_mesh,
    make_sector_mesh,
    measure_mesh_quality,
    mesh_and_write_case,
    read_operating_point,
    read_poly_mesh,
    solve_rotor_pair,
)
from mufly.cfd.openfoam_case import set_schemes_and_end
from mufly.cfd.rotor_pair import (
    ActuatorDisc,
    find_disc_cells,
    make_pair_mesh,
    read_actuator_disc,
    write_actuator_disc,
)
from mufly.cfd.solver_process import find_solver, openfoam_environment
from mufly.errors import InputError
from mufly.rotor import load_rotor

GAP, TURNED = 0.020, math.radians(14.0)


@cache
def meshed() -> PolyMesh:
    return make_poly_mesh(make_pair_mesh(load_rotor("naca0012-r60-c20"), TURNED, TURNED, GAP, level="tiny"))


def test_both_blades_are_the_same_closed_body_each_the_others_image() -> None:
    mesh = meshed()
    found = measure_mesh_quality(mesh)
    assert found.is_good
    assert found.max_cell_openness < 1e-12
    alone = make_poly_mesh(make_sector_mesh(load_rotor("naca0012-r60-c20"), TURNED, level="tiny"))
    volumes = []
    for m, patch in ((alone, "blade"), (mesh, "blade"), (mesh, "blade_lower")):
        area, centre = m.face_areas[m.patch_face_slice(patch)], m.face_centres[m.patch_face_slice(patch)]
        assert np.allclose(area.sum(axis=0), 0.0, atol=1e-15)
        volumes.append(-np.einsum("fi,fi->", area, centre) / 3.0)
    assert volumes == pytest.approx([volumes[0]] * 3, rel=1e-9)
    upper, lower = (mesh.points[mesh.faces[mesh.patch_face_slice(p)]].reshape(-1, 3) for p in ("blade", "blade_lower"))
    image = lower * np.array([-1.0, 1.0, 1.0]) + np.array([0.0, 0.0, GAP])
    assert np.allclose(np.sort(upper, axis=0), np.sort(image, axis=0), atol=1e-12)
    # Turning about -z the lower blade moves to +x: its nose is there, and up.
    assert lower[np.argmax(lower[:, 0]), 2] > -GAP > lower[np.argmin(lower[:, 0]), 2]


def test_the_frames_meet_in_a_level_plane_half_way() -> None:
    mesh, inside = meshed(), len(meshed().neighbour)
    a, b = mesh.cell_rotation_sign[mesh.owner[:inside]], mesh.cell_rotation_sign[mesh.neighbour]
    assert set(np.unique(mesh.cell_rotation_sign)) == {-1.0, 0.0, 1.0}
    between = a * b < 0.0
    assert between.any()
    assert np.allclose(mesh.face_centres[:inside][between, 2], -0.5 * GAP, atol=1e-15)
    assert np.allclose(mesh.face_areas[:inside][between, :2], 0.0, atol=1e-18)
    assert np.all(mesh.cell_rotation_sign[mesh.owner[mesh.patch_face_slice("blade")]] == 1.0)
    assert np.all(mesh.cell_rotation_sign[mesh.owner[mesh.patch_face_slice("blade_lower")]] == -1.0)


def test_a_pairs_case_has_two_zones_and_two_loads(tmp_path: Path) -> None:
    mesh_and_write_case(
        tmp_path, load_rotor("naca0012-r60-c20"), pitch_rad=TURNED, speed_rad_s=500.0, level="tiny", gap_m=GAP,
        lower_speed_rad_s=550.0,
    )  # fmt: skip
    assert read_operating_point(tmp_path).patch_speeds_rad_s == {"blade": 500.0, "blade_lower": -550.0}
    zones = (tmp_path / "constant" / "MRFProperties").read_text()
    assert "cellZone rotor" in zones
    assert "cellZone lower" in zones
    assert "omega constant -550;" in zones
    assert "patches (blade_lower);" in (tmp_path / "system" / "controlDict").read_text()
    again = read_poly_mesh(tmp_path)
    assert np.array_equal(again.cell_rotation_sign, meshed().cell_rotation_sign)


@pytest.mark.parametrize(
    ("gap", "pitch", "message"),
    [(0.012, 14.0, "give at least 1"), (0.0, 14.0, "give 0 to"), (0.02, 25.0, "give at least")],
)
def test_rotors_too_close_are_refused_in_one_line(gap: float, pitch: float, message: str) -> None:
    rotor, angle = load_rotor("naca0012-r60-c20"), math.radians(pitch)
    with pytest.raises(InputError, match=message):
        make_pair_mesh(rotor, angle, angle, gap, level="tiny")


def disc(since: int = 0) -> ActuatorDisc:
    """A rotor whose thrust per span rises as r^2, its torque as r^3, between 10 and 60 mm."""
    r = np.linspace(0.01, 0.06, 21)
    t, q = 3e3 * r**2, 40.0 * r**3
    thrust, torque = (float(np.trapezoid(v, r)) for v in (t, q))
    return ActuatorDisc(tuple(r), tuple(t), tuple(q), thrust, torque, TURNED, 500.0, since)


def beside(folder: Path, height_m: float, since: int = 0) -> tuple[PolyMesh, ActuatorDisc]:
    mesh_and_write_case(
        folder,
        load_rotor("naca0012-r60-c20"),
        pitch_rad=TURNED,
        speed_rad_s=500.0,
        level="tiny",
        other_m=height_m,
    )
    mesh, other = read_poly_mesh(folder), disc(since)
    write_actuator_disc(folder, mesh, read_operating_point(folder), other)
    return mesh, other


@pytest.mark.parametrize("height", [-GAP, GAP])
def test_the_disc_covers_the_rotor_once_and_has_its_loads(tmp_path: Path, height: float) -> None:
    mesh, other = beside(tmp_path, height)
    cells, area = find_disc_cells(mesh, height, 0.06)
    assert area.sum() == pytest.approx(0.5 * math.pi * 0.06**2, rel=0.05)  # half of it: one of two blades
    assert np.abs(mesh.cell_centres[cells[area > 0.0], 2] - height).max() < 0.15 * 0.06
    # What the solver is told, summed as its rotorDisk does, about 1 rad/s.
    text = (tmp_path / "constant" / "fvOptions").read_text()
    r = np.array([float(x) for x in re.findall(r"\(at\d+ \((\S+) 0 1\)\)", text)])
    drag, lift = np.array(re.findall(r"\(180 (\S+) ([^\s)]+)\)", text), dtype=float).T
    at = np.hypot(mesh.cell_centres[cells, 0], mesh.cell_centres[cells, 1])
    force = 0.5 * at**2 * 2 * area / (2.0 * math.pi * at)  # per density
    thrust = 2 * 1.2 * float(force @ np.interp(at, r, lift))
    torque = 2 * 1.2 * float((force * at) @ np.interp(at, r, drag))
    assert thrust == pytest.approx(other.thrust_N, rel=1e-6)
    assert torque == pytest.approx(-other.torque_Nm, rel=1e-6)  # against this rotor's sense
    assert read_actuator_disc(tmp_path) == other


def test_no_verdict_before_the_air_knows_the_other_rotors_new_loads(tmp_path: Path) -> None:
    beside(tmp_path, GAP, since=1600)
    for name, row in (("force.dat", "0 0 0.05"), ("moment.dat", "0 0 -0.001")):
        file = tmp_path / "postProcessing" / "loads" / "0" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text("".join(f"{i} {row}\n" for i in range(1, 1801)))
    assert judge_case_convergence(tmp_path).outcome == "not done"  # they stand still, but for 200 iterations only
    (tmp_path / "disc.json").write_text('{"r_m": [')
    with pytest.raises(InputError, match="not a complete disc"):
        read_actuator_disc(tmp_path)


@pytest.mark.parametrize("gap", [0.004, 0.2])
def test_a_pair_by_turns_whose_rotors_would_meet_is_refused(tmp_path: Path, gap: float) -> None:
    with pytest.raises(InputError, match="give 1"):
        solve_rotor_pair(tmp_path, load_rotor("naca0012-r60-c20"), pitch_rad=TURNED, speed_rad_s=500.0, gap_m=gap)


@pytest.mark.skipif(shutil.which("simpleFoam") is None, reason="OpenFOAM is not installed")
def test_the_solver_takes_the_disc_for_the_rotor(tmp_path: Path) -> None:
    _, other = beside(tmp_path, GAP)
    set_schemes_and_end(tmp_path, upwind=True, end=1)
    told = subprocess.run(
        [find_solver()], cwd=tmp_path, env=openfoam_environment(), capture_output=True, text=True, check=True
    )
    lift = float(re.findall(r"Effective lift = (\S+)", told.stdout)[-1])
    assert 2.0 * lift == pytest.approx(other.thrust_N, rel=1e-5)
