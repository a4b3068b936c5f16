"""Hubs, tips, winglets and flaps: closed, conformal, good enough to solve on; surfaces for other programs' viewers."""

from __future__ import annotations

import base64
import json
import math
import struct
import xml.etree.ElementTree as ET
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from mufly.cfd import (
    BLADE_TIPS,
    BladeGeometry,
    BladeTip,
    HubCylinder,
    PolyMesh,
    make_poly_mesh,
    make_sector_mesh,
    make_tip_hub_geometry,
    measure_mesh_quality,
    write_glb,
    write_vtp,
)
from mufly.errors import InputError
from mufly.rotor import Rotor, load_rotor, make_rotor

R, CHORD, ROOT = 0.060, 0.020, 0.009
TURNED = math.radians(12.0)
FORMS = {
    **{
        name: make_tip_hub_geometry(name)
        for name in ("round", "swept-tapered", "thesis-1", "winglet-2-curved", "winglet-3")
    },
    **{name: make_tip_hub_geometry(name) for name in ("plate-up", "winglet-1")},
    "hub": make_tip_hub_geometry(hub_m=0.006),
    "hub, flap, tapered tip": make_tip_hub_geometry("thesis-2", 0.006, 0.03),
}


@cache
def meshed(name: str) -> PolyMesh:
    return make_poly_mesh(make_sector_mesh(load_rotor("naca0012-r60-c20"), TURNED, level="tiny", form=FORMS[name]))


def walls(mesh: PolyMesh) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of the walls' faces along the pitched chord, the radius and across the chord; areas; their sum."""
    c, s = math.cos(TURNED), math.sin(TURNED)
    p = mesh.points[mesh.faces[mesh.patch_face_slice("blade")]]
    turned = np.stack((c * p[..., 0] - s * p[..., 2], p[..., 1], s * p[..., 0] + c * p[..., 2]), axis=-1)
    return (
        turned,
        mesh.face_areas[mesh.patch_face_slice("blade")],
        mesh.face_areas[mesh.patch_face_slice("blade")].sum(axis=0),
    )


@pytest.mark.parametrize("name", FORMS)
def test_every_form_is_a_closed_wall_in_a_positive_smooth_conformal_mesh(name: str) -> None:
    mesh = meshed(name)
    found = measure_mesh_quality(mesh)
    assert found.is_good
    assert found.max_cell_openness < 1e-12
    assert found.non_orthogonality_deg < 80.0
    assert found.skewness < 2.0
    # Each edge of the walls has a face on either side; a plate meets the blade with both of its sides; a hub goes on in
    # the next sector.
    faces = mesh.faces[mesh.patch_face_slice("blade")]
    edges = np.sort(np.stack((faces, np.roll(faces, -1, axis=1)), axis=-1).reshape(-1, 2), axis=1)
    edges, count = np.unique(edges, axis=0, return_counts=True)
    on_plane = np.all(np.abs(mesh.points[edges][..., 1]) < 1e-12, axis=1)
    assert np.all(count[~on_plane] % 2 == 0)
    assert on_plane.any() == (FORMS[name].hub is not None)
    _, _, total = walls(mesh)
    assert np.allclose(total[[0, 2]], 0.0, atol=1e-15)
    # The two halves of the periodic plane meet by rotation (two blades: the image in x = 0 and y = 0).
    left, right = (mesh.points[mesh.faces[mesh.patch_face_slice(f"sector_{n}")]] for n in ("left", "right"))
    assert np.max(np.abs(left - right[:, [0, 3, 2, 1]] * np.array([-1, -1, 1]))) < 1e-9 * R


@pytest.mark.parametrize("name", FORMS)
def test_the_blade_ends_where_it_should(name: str) -> None:
    p, _, _ = walls(meshed(name))
    tip, form = FORMS[name].tip, FORMS[name]
    assert p[..., 1].max() == pytest.approx(R + (0.02 * CHORD if tip.cant_rad else 0.0), abs=0.03 * CHORD)
    end = p[p[..., 1].min(axis=1) > R - 1e-9]
    if tip.cant_rad:
        reach = p[..., 2].max() if tip.cant_rad > 0 else -p[..., 2].min()
        assert reach == pytest.approx(tip.height * CHORD, abs=0.06 * CHORD)
    elif tip.plate_above:
        assert end[..., 2].max() == pytest.approx((tip.plate_above + 0.05) * CHORD, abs=0.015 * CHORD)
        low = -0.055 - tip.plate_below
        assert end[..., 2].min() == pytest.approx(low * CHORD, abs=0.02 * CHORD)
    elif tip.length and not tip.round:
        assert np.ptp(end[..., 0]) == pytest.approx(tip.taper * CHORD, rel=0.01)
        assert end[..., 0].min() == pytest.approx((tip.aft - 0.25 * tip.taper) * CHORD, abs=0.01 * CHORD)
    inner = p[(p[..., 1].min(axis=1) > 0.018) & (p[..., 1].max(axis=1) < 0.036)]
    below = form.gurney_height * CHORD
    at_tail = inner[inner[..., 0].max(axis=1) > 0.7499 * CHORD]
    assert at_tail[..., 2].min() == pytest.approx(-0.003 * CHORD - below, abs=2e-3 * CHORD)
    least = 0.0 if form.hub else ROOT
    assert p[..., 1].min() == pytest.approx(least, abs=1e-12)


def test_a_round_tips_outline_is_half_an_ellipse() -> None:
    p, _, _ = walls(meshed("round"))
    p = p.reshape(-1, 3) / CHORD
    out = (p[:, 1] - (R / CHORD - 0.5)) / 0.5
    across = (p[:, 0] - 0.25) / 0.5
    assert np.max(np.hypot(across, out)[out > 0]) == pytest.approx(1.0, abs=0.02)
    edge = p[(out > 0.5) & (np.hypot(across, out) > 0.97)]
    assert len(np.unique(np.round(edge[:, 0], 3))) > 8


def test_three_blades_share_a_hub_and_the_file_s_square_tip_is_the_same_as_none() -> None:
    rotor = make_rotor(name="three", blades=3, radius_m=0.05, hub_cutout=0.2, chord_m=0.010, airfoils="naca0012")
    mesh = make_poly_mesh(make_sector_mesh(rotor, 0.1, level="tiny", form=make_tip_hub_geometry("winglet-up", 0.004)))
    assert measure_mesh_quality(mesh).is_good
    p = mesh.points[mesh.faces[mesh.patch_face_slice("blade")]].reshape(-1, 3)
    on_plane = np.abs(p[:, 1] - np.abs(p[:, 0]) / math.tan(math.pi / 3)) < 1e-12
    assert np.max(np.hypot(p[on_plane, 0], p[on_plane, 1])) == pytest.approx(0.004)
    a, b = (make_sector_mesh(rotor, 0.1, level="tiny", form=f) for f in (None, make_tip_hub_geometry()))
    assert np.array_equal(a.points, b.points)


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (lambda: make_tip_hub_geometry("pointed"), "is not a tip"),
        (lambda: BladeTip(length=1.0, taper=0.0), "a pointed tip cannot be meshed"),
        (lambda: BladeTip(length=0.1, aft=2.0), "slope more than 65"),
        (lambda: BladeTip(cant_rad=1.5, height=1.0), "a plate stands at 90"),
        (lambda: BladeTip(cant_rad=1.0, height=0.1), "what the turn takes"),
        (lambda: BladeTip(plate_above=0.8), "holds no higher"),
        (lambda: HubCylinder(-0.001, 0.002), "above 0"),
        (lambda: make_tip_hub_geometry(gurney=-0.01), "0.003 to 0.1"),
        (lambda: BladeGeometry(BLADE_TIPS["plate-up"], gurney_height=0.02), "cannot be combined with a Gurney flap"),
        (lambda: shape(make_tip_hub_geometry(hub_m=0.02)), "blades begin at 9 mm"),
        (lambda: shape(BladeGeometry(hub=HubCylinder(0.004, 0.05))), "at most 12 mm"),
        (lambda: shape(BladeGeometry(BladeTip(length=4.0, taper=0.5))), "too long for the blade"),
        (lambda: shape(BladeGeometry(BladeTip(cant_rad=1.2, height=2.0, bend_radius_chords=3.0))), "too much|longer"),
    ],
)  # fmt: skip
def test_impossible_forms_are_refused_in_one_line(made: Callable[[], object], message: str) -> None:
    with pytest.raises(InputError, match=message) as told:
        made()
    assert "\n" not in str(told.value)


def shape(form: BladeGeometry) -> object:
    rotor: Rotor = load_rotor("naca0012-r60-c20")
    return make_sector_mesh(rotor, TURNED, level="tiny", form=form)


POINTS = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1]])
FACES = np.array([[0, 3, 2, 1], [0, 1, 5, 4]])


def test_a_vtp_holds_what_was_given(tmp_path: Path) -> None:
    shear = np.array([[1.0, 2, 3], [4, 5, 6]])
    tree = ET.parse(write_vtp(tmp_path / "a.vtp", POINTS, FACES, {"p": np.array([7.0, 8]), "shear": shear}))
    root = tree.getroot()
    assert root.attrib["header_type"] == "UInt64"
    appended = (root.findtext("AppendedData") or "").strip().removeprefix("_")

    def values(name: str, kind: str) -> np.ndarray:
        found = root.find(f".//DataArray[@Name='{name}']")
        assert found is not None
        at = int(found.attrib["offset"])
        head = base64.b64decode(appended[at : at + 12])
        size = struct.unpack("<Q", head[:8])[0]
        block = base64.b64decode(appended[at : at + 4 * math.ceil((8 + size) / 3)])
        return np.frombuffer(block[8 : 8 + size], dtype=kind)

    assert np.array_equal(values("Points", "<f4").reshape(-1, 3), POINTS)
    assert np.array_equal(values("connectivity", "<i4").reshape(-1, 4), FACES)
    assert np.array_equal(values("offsets", "<i4"), [4, 8])
    assert np.array_equal(values("shear", "<f8").reshape(-1, 3), shear)
    with pytest.raises(InputError, match="cannot be written"):
        write_vtp(tmp_path / "a.vtp" / "b.vtp", POINTS, FACES, {})


def test_a_glb_is_whole_and_its_triangles_look_outwards(tmp_path: Path) -> None:
    paint = np.array([[255, 0, 0], [0, 0, 255]], dtype=np.uint8)
    data = write_glb(tmp_path / "a.glb", POINTS, FACES, paint).read_bytes()
    magic, version, length = struct.unpack("<4sII", data[:12])
    assert (magic, version, length) == (b"glTF", 2, len(data))
    size = struct.unpack("<I", data[12:16])[0]
    tree = json.loads(data[20 : 20 + size])
    body = data[28 + size :]
    assert len(body) == tree["buffers"][0]["byteLength"]
    parts = [body[v["byteOffset"] : v["byteOffset"] + v["byteLength"]] for v in tree["bufferViews"]]
    corner = np.frombuffer(parts[0], "<f4").reshape(-1, 3)
    triangles = corner[np.frombuffer(parts[3], "<u4").reshape(-1, 3)]
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    # The first face looks down, the second to -y; y up: down is -y and -y is +z.
    assert np.allclose(normal / np.linalg.norm(normal, axis=1)[:, None], np.repeat([[0, -1, 0], [0, 0, 1]], 2, axis=0))
    assert np.allclose(np.frombuffer(parts[1], "<f4").reshape(2, 4, 3)[:, 0], [[0, -1, 0], [0, 0, 1]])
    assert tree["accessors"][0]["max"] == corner.max(axis=0).tolist()
