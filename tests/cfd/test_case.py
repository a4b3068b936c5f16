"""Cases: the start, the text, the verdict, the reading of fields; with OpenFOAM, a run and its resumption."""

from __future__ import annotations

import math
import os
import re
import shutil
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from mufly.cfd import (
    TURBULENCE_MODELS,
    OperatingPoint,
    PolyMesh,
    compare_cases_with_table,
    compute_momentum_slipstream,
    find_solver,
    judge_load_convergence,
    list_study_cases,
    make_poly_mesh,
    make_sector_mesh,
    mesh_and_write_case,
    read_operating_point,
    read_solution,
    run_case,
    write_case,
)
from mufly.cfd.cfd_solution import read_field, scale_solution_state, wake_load_ratios
from mufly.cfd.initial_flow import compute_vortex_ring_velocity
from mufly.cfd.solver_process import list_complete_states, read_load_history
from mufly.cli import app
from mufly.cli.aero import cfd_case_report
from mufly.cli.aero.rotor_theory_options import TheoryOptions
from mufly.cli.rotor import hover
from mufly.errors import InputError, MuflyError
from mufly.quantities.units import RPM
from mufly.rotor import load_rotor

POINT = OperatingPoint(
    "naca0012-r60-c20", 2, 0.06, math.radians(12), 5000 * RPM, 0.0, "laminar", "tiny", 1.2, 1.81e-5, 2.3
)  # fmt: skip


@cache
def mesh() -> PolyMesh:
    return make_poly_mesh(make_sector_mesh(load_rotor("naca0012-r60-c20"), math.radians(12), level="tiny"))


def test_a_ring_moves_the_air_on_its_axis_as_biot_savart_says() -> None:
    z = np.linspace(-2.0, 2.0, 9)
    radial, axial = compute_vortex_ring_velocity(np.zeros(9), z, np.ones(9), np.zeros(9), core=0.0)
    assert np.allclose(axial, 0.5 / (1.0 + z**2) ** 1.5)
    assert np.allclose(radial, 0.0)


def test_the_start_is_the_slipstream_of_momentum_theory() -> None:
    at = np.array([[0, 0, 0.3], [0, 0, 0.0], [0, 0, -0.35], [0.28, 0, 0.0]])
    w = compute_momentum_slipstream(at, radius_m=0.06, induced_m_s=2.0)[:, 2]
    assert abs(w[0]) < 0.1
    assert w[1] == pytest.approx(-2.0, rel=0.12)  # slower on the axis than in the disc's mean, as it contracts
    assert w[2] == pytest.approx(-4.0, rel=0.03)
    assert abs(w[3]) < 0.05
    # No sources: what comes in through a cylinder's side and top leaves through its bottom.
    turn = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
    h = np.linspace(-0.1, 0.1, 81)
    side = np.array([[0.05 * np.cos(t), 0.05 * np.sin(t), z] for t in turn for z in h])
    u = compute_momentum_slipstream(side, radius_m=0.06, induced_m_s=2.0)
    inward = -(u[:, :2] * side[:, :2]).sum(axis=1).reshape(8, 81).mean(axis=0) / 0.05
    r = np.linspace(0.0, 0.05, 51)
    ends = [
        compute_momentum_slipstream(np.column_stack((r, 0 * r, 0 * r + z)), radius_m=0.06, induced_m_s=2.0)[:, 2]
        for z in (0.1, -0.1)
    ]
    flow = [float(np.trapezoid(2 * np.pi * r * w, r)) for w in ends]
    assert np.trapezoid(inward, h) * 2 * np.pi * 0.05 == pytest.approx(flow[0] - flow[1], rel=0.03)


@pytest.mark.parametrize("model", TURBULENCE_MODELS)
def test_a_case_is_whole_and_its_brackets_close(model: str, tmp_path: Path) -> None:
    still = None if model == "laminar" else {"U": np.zeros((mesh().cell_count, 3))}  # the start itself is made once
    write_case(tmp_path, mesh(), replace(POINT, model=model), state=still)
    assert read_operating_point(tmp_path) == replace(POINT, model=model)
    for file in [*tmp_path.glob("system/*"), *tmp_path.glob("constant/*Properties"), *tmp_path.glob("0/*")]:
        text = file.read_bytes().decode("latin-1")
        if "binary" in text[:200]:
            continue
        for a, b in ("{}", "()"):
            assert text.count(a) == text.count(b), file
        assert re.search(rf"object\s+{re.escape(file.name.removesuffix('.second'))};", text), file
        if file.parent.name == "0":
            for patch in mesh().patches:
                assert re.search(rf"\b{patch} {{ type \w+;", text), (file, patch)
    names = {p.name for p in (tmp_path / "0").iterdir()}
    wanted = {"laminar": set(), "k-epsilon": {"k", "epsilon", "nut"}}.get(model, {"k", "omega", "nut"})
    assert names == {"U", "p", "phi"} | wanted


@pytest.mark.parametrize(("climb", "before", "behind"), [(1.0, "top", "bottom"), (-1.0, "bottom", "top")])
def test_oncoming_air_has_its_total_pressure_where_it_comes_from(
    climb: float, before: str, behind: str, tmp_path: Path
) -> None:
    write_case(tmp_path, mesh(), replace(POINT, climb_m_s=climb), state={"U": np.zeros((mesh().cell_count, 3))})
    u, p = ((tmp_path / "0" / name).read_bytes().decode("latin-1") for name in ("U", "p"))
    assert re.search(rf"{before} {{ type totalPressure; p0 uniform 0.5;", p)
    for place in (before, "side"):
        assert re.search(rf"{place} {{ type pressureInletOutletVelocity;", u)
    for place in (behind, "side"):  # a total pressure along the side would be 0 and w^2 / 2 by turns
        assert re.search(rf"{place} {{ type fixedValue; value uniform 0;", p)
    assert re.search(rf"{behind} {{ type inletOutlet; inletValue uniform \(0 0 {-climb:g}\)", u)
    assert f"tangentialVelocity uniform (0 0 {-climb:g})" in u
    # In descent air comes in through the bottom, and that is no fault.
    flows = judge_load_convergence(loads(1300), -0.01, 1e-4, replace(POINT, climb_m_s=climb))
    assert flows.outcome == ("blown back" if climb > 0 else "settled")


def test_the_fluxes_of_the_start_leave_no_cell_with_more_than_the_mesh_blurs(tmp_path: Path) -> None:
    write_case(tmp_path, mesh(), POINT)
    data = (tmp_path / "0" / "phi").read_bytes()
    inside = len(mesh().neighbour)
    begin = data.index(b"(", data.index(b"internalField")) + 1
    phi = np.frombuffer(data[begin : begin + 8 * inside], dtype="<f8")
    spin = POINT.speed_rad_s * np.stack((-mesh().face_centres[:, 1], mesh().face_centres[:, 0]), axis=-1)
    turning = -np.einsum("fi,fi->f", spin, mesh().face_areas[:, :2])[:inside]
    with_frame = mesh().is_rotating[mesh().owner[:inside]] | mesh().is_rotating[mesh().neighbour]
    assert np.corrcoef(phi[with_frame], turning[with_frame])[0, 1] > 0.99  # relative to the frame
    turning[~with_frame] = 0.0  # in the outer air, absolute
    own = phi - turning
    assert np.max(np.abs(own) / np.linalg.norm(mesh().face_areas[:inside], axis=1)) < 6.0  # 2 v_h and the rings' cores


def loads(count: int, drift: float = 0.0, swing: float = 0.0) -> np.ndarray:
    i = np.arange(1, count + 1)
    shape = 1.0 + drift * (i - count) / 200.0 + 0.5 * swing * np.sin(i / 9.0)
    return np.column_stack((i, 0.15 * shape, 0.0016 * shape))


@pytest.mark.parametrize(
    ("table", "outflow", "leak", "what"),
    [
        (loads(1300), 0.01, 1e-4, "settled"),
        (loads(600), 0.01, 1e-4, "not done"),
        (loads(1300, drift=0.01), 0.01, 1e-4, "plateau"),
        (loads(1300, swing=0.05), 0.01, 1e-4, "sloshing"),
        (loads(1300), -0.01, 1e-4, "blown back"),
        (loads(1300), 0.01, 1e-2, "leaking"),
        (loads(1300) * np.array([1.0, 1e6, 1.0]), 0.01, 1e-4, "diverged"),
        (loads(1300) * np.array([1.0, math.nan, 1.0]), 0.01, 1e-4, "diverged"),
        (loads(1300), math.nan, 1e-4, "blown back"),
        (loads(1300), 0.01, math.nan, "leaking"),
        (np.empty((0, 3)), math.nan, math.nan, "not begun"),
    ],
)  # fmt: skip
def test_a_verdict_names_what_is_wrong(table: np.ndarray, outflow: float, leak: float, what: str) -> None:
    verdict = judge_load_convergence(table, outflow, leak, POINT)
    assert verdict.outcome == what
    assert verdict.settled == (what == "settled")
    if what == "settled":
        assert verdict.thrust_N == pytest.approx(0.15)


def solved_by_hand(folder: Path, pressure: np.ndarray, velocity: np.ndarray) -> None:
    """A case with a made-up state, binary pressure and ASCII velocity."""
    write_case(folder, mesh(), POINT, state={"U": velocity})
    place = folder / "7"
    place.mkdir()
    head = "/* a long banner */\n" * 60 + "FoamFile { format %s; }\n"
    n = len(pressure)
    (place / "p").write_bytes(
        (head % "binary").encode() + f"internalField nonuniform List<scalar> \n{n}\n(".encode()
        + pressure.astype("<f8").tobytes() + b")\n;\nboundaryField { }\n"
    )  # fmt: skip
    rows = "\n".join(f"({x:.17g} {y:.17g} {z:.17g})" for x, y, z in velocity)
    (place / "U").write_text(
        head % "ascii" + f"internalField nonuniform List<vector> \n{n}\n(\n{rows}\n)\n;\nboundaryField {{ }}\n",
        encoding="utf-8",
    )
    (place / "phi").write_bytes(b"boundaryField { }")


def test_still_air_turning_with_the_blade_puts_nothing_on_it_and_a_gradient_lifts_its_volume(
    tmp_path: Path,
) -> None:
    m = mesh()
    u = POINT.speed_rad_s * np.column_stack((-m.cell_centres[:, 1], m.cell_centres[:, 0], np.zeros(m.cell_count)))
    solved_by_hand(tmp_path, np.full(m.cell_count, 3.0), u)
    even = read_solution(tmp_path)
    assert abs(even.thrust_N) < 1e-9
    # A cell's centre, further out or in than its face, still moves with the blade: mu Omega at most.
    assert np.linalg.norm(even.friction_Pa, axis=1).max() < 1.5 * POINT.viscosity_Pa_s * POINT.speed_rad_s
    # p = -g z lifts the blade by rho g V. A face has its cell's pressure, and the cells of this mesh lie 40 um off a
    # blade of 1.6 mm mean thickness on either side: 5 % more.
    shutil.rmtree(tmp_path)
    solved_by_hand(tmp_path, -9.81 * m.cell_centres[:, 2], u)
    area, centre = m.face_areas[m.patch_face_slice("blade")], m.face_centres[m.patch_face_slice("blade")]
    volume = -np.einsum("fi,fi->", area, centre) / 3.0
    lifted = read_solution(tmp_path)
    assert lifted.thrust_N == pytest.approx(2 * 1.2 * 9.81 * volume, rel=0.06)
    # The lift acts at the centroid of the volume, behind the quarter chord line: nose down.
    behind = -0.5 * np.sum(centre[:, 0] ** 2 * area[:, 0]) / volume
    assert behind > 0.1 * 0.02
    assert np.sum(lifted.moment_Nm_m * lifted.dr_m) == pytest.approx(-behind * 1.2 * 9.81 * volume, rel=0.08)
    # Air at rest rubs the blade aft everywhere, air that overtakes it towards the nose.
    for factor, share in ((0.0, 0.0), (2.0, 1.0)):
        shutil.rmtree(tmp_path)
        solved_by_hand(tmp_path, np.zeros(m.cell_count), factor * u)
        assert read_solution(tmp_path).reversed_flow_fraction == pytest.approx(share, abs=0.02)


def test_the_wake_s_torque_and_thrust_are_its_flows_of_momentum() -> None:
    m, wide, w, spin = mesh(), 0.05, 4.0, 30.0
    bell = np.exp(-0.5 * (m.cell_centres[:, :2] ** 2).sum(axis=1) / wide**2)
    u = (
        np.column_stack((-spin * m.cell_centres[:, 1], spin * m.cell_centres[:, 0], np.full(m.cell_count, -w)))
        * bell[:, None]
    )
    thrust = POINT.density_kg_m3 * w * w * math.pi * wide**2
    torque = POINT.density_kg_m3 * spin * w * math.pi * wide**4
    found = wake_load_ratios(m, POINT, u, np.zeros(m.cell_count), thrust, torque)
    assert found == pytest.approx((1.0, 1.0), rel=0.1)  # cells of 6 to 20 mm
    still = wake_load_ratios(m, POINT, np.zeros((m.cell_count, 3)), w * w * bell**2, thrust, torque)
    assert still == pytest.approx((0.0, 1.0), rel=0.1)


def test_a_study_varies_one_thing_and_a_case_keeps_its_domain(tmp_path: Path) -> None:
    assert [*list_study_cases("mesh")] == ["coarse", "medium", "fine"]
    assert list_study_cases("model")["sst"] == {"model": "sst"}
    wider = list_study_cases("domain")
    assert wider["below"]["domain"].below == pytest.approx(10.0)
    assert wider["below"]["domain"].radius == 5.0
    with pytest.raises(InputError, match="use one of: mesh, domain, model"):
        list_study_cases("weather")
    # A wider domain keeps the cells near the blade and adds rows further out.
    large = make_poly_mesh(
        make_sector_mesh(
            load_rotor("naca0012-r60-c20"), math.radians(12), level="tiny", domain=wider["above"]["domain"]
        )
    )
    assert mesh().cell_count < large.cell_count < 1.2 * mesh().cell_count
    point = replace(POINT, domain=wider["above"]["domain"])
    write_case(tmp_path, mesh(), point, state={"U": np.zeros((mesh().cell_count, 3))})
    assert read_operating_point(tmp_path) == point


def test_a_state_cut_short_or_missing_is_said_in_one_line(tmp_path: Path) -> None:
    m = mesh()
    with pytest.raises(InputError, match="not a case of mufly cfd"):
        read_operating_point(tmp_path)
    solved_by_hand(tmp_path, np.zeros(m.cell_count), np.zeros((m.cell_count, 3)))
    p = tmp_path / "7" / "p"
    assert list_complete_states(tmp_path) == [0, 7]
    p.write_bytes(p.read_bytes()[:9000])  # the disk was full
    assert list_complete_states(tmp_path) == [0]
    with pytest.raises(InputError, match="cut short"):
        read_field(p, m.cell_count)
    with pytest.raises(InputError, match="cannot be read"):
        read_field(tmp_path / "8" / "p", m.cell_count)
    (tmp_path / "9").mkdir()
    (tmp_path / "9" / "U").write_bytes(b"")
    assert list_complete_states(tmp_path) == [0]  # 9 was cut off in mid-write
    shutil.rmtree(tmp_path / "7")
    with pytest.raises(InputError, match="contains no solution"):
        read_solution(tmp_path)


def test_cases_are_laid_beside_the_rows_of_a_table(tmp_path: Path) -> None:
    write_case(tmp_path, mesh(), POINT, state={"U": np.zeros((mesh().cell_count, 3))})
    place = tmp_path / "postProcessing" / "loads" / "0"
    place.mkdir(parents=True)
    rows = [(i, 0.0755, -0.00075) for i in range(1, 5)]  # of one of two blades
    (place / "force.dat").write_text("# Time\n" + "".join(f"{i}\t(0 0 {t}) (0 0 0) (0 0 0)\n" for i, t, _ in rows))
    (place / "moment.dat").write_text("# Time\n" + "".join(f"{i}\t(0 0 {q}) (0 0 0) (0 0 0)\n" for i, _, q in rows))
    table = tmp_path / "table.csv"
    table.write_text(
        "# a note\npitch_deg,rpm,T_meas_N,Q_meas_Nm,T_laminar,Q_laminar\n12,5000,0.151,0.0016,0.136,0.00174\n"
    )
    (found,) = compare_cases_with_table(table, [tmp_path])
    assert found.thrust_deviations == pytest.approx({"meas": 0.0, "laminar": 0.151 / 0.136 - 1})
    assert found.torque_deviations == pytest.approx({"meas": 0.0015 / 0.0016 - 1, "laminar": 0.0015 / 0.00174 - 1})
    assert found.verdict.outcome == "not done"
    table.write_text("pitch_deg,rpm,T_meas_N\n14,5000,0.2\n")
    with pytest.raises(InputError, match="no row at 12 degrees and 5000 rpm"):
        compare_cases_with_table(table, [tmp_path])
    table.write_text("pitch_deg,T_meas_N\n14,0.2\n")
    with pytest.raises(InputError, match="rpm: is not among the columns; give columns pitch_deg, rpm"):
        compare_cases_with_table(table, [tmp_path])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"model": "les"}, "is unknown"),
        ({"climb_m_s": -1.5}, "not steady"),
        ({"speed_rad_s": math.nan}, "above 0"),
    ],
)
def test_impossible_points_are_refused(change: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        replace(POINT, **change)


def test_without_openfoam_one_line_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    with pytest.raises(MuflyError, match="apt-get install"):
        find_solver()
    with pytest.raises(MuflyError, match="apt-get install"):
        hover("naca0012-r60-c20", pitch=12.0, rpm=5000.0, theory=TheoryOptions(method="cfd"))
    with pytest.raises(InputError, match="give --pitch and --rpm"):
        hover("naca0012-r60-c20", pitch=12.0, thrust=0.2, theory=TheoryOptions(method="cfd"))


@pytest.mark.skipif(not Path("/dev/full").is_char_device(), reason="there is no /dev/full")
def test_a_full_disk_or_a_second_run_is_said_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import fcntl

    case = tmp_path / "case"
    write_case(case, mesh(), POINT, state={"U": np.zeros((mesh().cell_count, 3))})
    solver = tmp_path / "simpleFoam"
    solver.write_text("#!/bin/sh\necho Time = 1\n", encoding="utf-8")
    solver.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    log = case / "log.simpleFoam"
    with log.open("a", encoding="utf-8") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        with pytest.raises(MuflyError, match="another run uses this case"):
            run_case(case)
    log.unlink()
    log.symlink_to("/dev/full")
    with pytest.raises(MuflyError, match=r"No space left on device.*: free disk space.* the same command resumes"):
        run_case(case)


needs_openfoam = pytest.mark.skipif(
    shutil.which("simpleFoam") is None, reason="OpenFOAM is not installed (apt-get install openfoam)"
)


@needs_openfoam
def test_a_run_goes_on_after_it_was_killed_and_our_loads_are_the_solvers(tmp_path: Path) -> None:
    rotor = load_rotor("naca0012-r60-c20")
    given: dict[str, Any] = {"pitch_rad": math.radians(12), "speed_rad_s": 5000 * RPM, "level": "tiny"}
    mesh_and_write_case(tmp_path, rotor, **given)

    class Killed(Exception):
        pass

    def stop(progress: object) -> None:
        if progress.iteration >= 20:  # type: ignore[attr-defined]
            raise Killed

    with pytest.raises(Killed):
        run_case(tmp_path, progress=stop)
    assert list_complete_states(tmp_path) == [0]  # states are written every 40
    mesh_and_write_case(tmp_path, rotor, **given)
    verdict = run_case(tmp_path, most=120)  # 80 of them at first order
    assert verdict.outcome == "not done"
    assert list_complete_states(tmp_path)[-1] == 120
    past = read_load_history(tmp_path)
    assert np.array_equal(past[:, 0], np.arange(1, 121))  # those told twice stand once
    found = read_solution(tmp_path)
    assert found.thrust_N == pytest.approx(past[-1, 1], rel=2e-3)
    assert found.torque_Nm == pytest.approx(past[-1, 2], rel=5e-3)
    assert found.thrust_N == pytest.approx(float(found.thrust_N_m @ found.dr_m))
    assert 0.1 < found.thrust_N < 0.3  # of 0.15 N in the end; a start that throws the air about is far outside
    with pytest.raises(InputError, match="another point"):
        mesh_and_write_case(tmp_path, rotor, **{**given, "speed_rad_s": 500.0})
    # Another speed, from this solution scaled: its first iteration gives the scaled loads, friction's share aside.
    faster = tmp_path / "faster"
    mesh_and_write_case(faster, rotor, **{**given, "speed_rad_s": 7000 * RPM}, neighbour=tmp_path)
    assert read_operating_point(faster).upwind == 0
    run_case(faster, most=40)
    assert read_load_history(faster)[0, 1] == pytest.approx(found.thrust_N * 1.4**2, rel=0.05)
    # Another pitch setting has the same cells in other places: its fluxes balance in each as they did.
    mesh_16 = make_poly_mesh(make_sector_mesh(rotor, math.radians(16), level="tiny"))
    state, inside = scale_solution_state(tmp_path, mesh_16, 1.0), len(mesh_16.neighbour)
    assert not np.allclose(mesh_16.points, mesh().points, atol=1e-4)
    assert np.array_equal(state["U"], read_field(tmp_path / "120" / "U", mesh_16.cell_count))
    flux = state["phi"]
    left = np.bincount(mesh_16.owner, flux, mesh_16.cell_count) - np.bincount(
        mesh_16.neighbour, flux[:inside], mesh_16.cell_count
    )
    assert np.abs(left).max() < 1e-3 * np.abs(flux).max()
    with pytest.raises(InputError, match="mesh with other cells"):
        mesh_and_write_case(tmp_path / "other", rotor, **given, tip="plate-up", neighbour=tmp_path)
    with pytest.raises(InputError, match="differs in speed, pitch setting or tip only"):
        mesh_and_write_case(tmp_path / "other", rotor, **given, model="sst", neighbour=tmp_path)


def test_tips_near_the_speed_of_sound_are_refused():
    at = ("r", 2, 0.06, 0.2, 1e5, 0.0, "laminar", "tiny", 1.2, 1.8e-5, 1.0)
    with pytest.raises(InputError, match=r"954930 rpm moves the tips at Mach 17; stay below 0.7"):
        OperatingPoint(*at)


@pytest.mark.parametrize("settled", [True, False])
def test_an_answer_that_did_not_settle_ends_with_status_1(tmp_path, monkeypatch, settled):
    found = SimpleNamespace(settled=settled)
    for name in ("find_solver", "mesh_and_write_case", "run_case"):
        monkeypatch.setattr(f"mufly.cfd.{name}", lambda *a, **k: None)
    monkeypatch.setattr("mufly.cfd.build_solution_report", lambda *a: found)
    monkeypatch.setattr(cfd_case_report, "_write_report_files", lambda *a: [])
    status = CliRunner().invoke(app, ["cfd", "run", "--out", str(tmp_path / "case")]).exit_code
    assert status == (0 if settled else 1)
