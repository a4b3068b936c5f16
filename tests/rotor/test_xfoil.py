"""XFOIL as a second opinion: runs, dies, hangs and fails to converge, and is compared with NeuralFoil."""

import os
import stat

import numpy as np
import pytest

from mufly.errors import MuflyError
from mufly.rotor import compute_polar, load_airfoil, lookup_lift_drag
from mufly.rotor.sections import neuralfoil_network, polar_engines
from mufly.rotor.sections.polar_engines import compute_xfoil_polars as run

MISSING = polar_engines.xfoil_unavailable_reason()
needs_xfoil = pytest.mark.skipif(bool(MISSING), reason=MISSING)
ANGLES = np.arange(-2.0, 8.5, 1.0)


@needs_xfoil
@pytest.mark.parametrize("n_crit", [0.1, 9.0])
@pytest.mark.parametrize("reynolds", [3e4, 1e5])
def test_neuralfoil_agrees_with_xfoil(n_crit, reynolds):
    """Attached flow on the standard section; docs/log/2026-11-28-polars.md has the whole comparison."""
    airfoil = load_airfoil("naca4412")
    theirs = run(airfoil, [reynolds], n_crit=n_crit, alpha_deg=ANGLES)
    ours = neuralfoil_network.compute_neuralfoil_polars([airfoil], [reynolds], n_crit=n_crit)[0]
    same = np.isin(np.round(np.rad2deg(ours.alpha_rad), 6), ANGLES)
    known = theirs.known[0]
    assert known.sum() >= 8
    assert np.mean(np.abs(ours.cl[0, same][known] - theirs.cl[0, known])) < 0.04
    assert np.mean(np.abs(np.log(ours.cd[0, same][known] / theirs.cd[0, known]))) < 0.10


@needs_xfoil
def test_symmetric_section_at_zero_angle():
    data = run(load_airfoil("naca0012"), [1e5], n_crit=9.0, alpha_deg=[-2.0, 0.0, 2.0])
    assert data.cl[0, 1] == pytest.approx(0.0, abs=2e-3)
    assert data.cl[0, 2] == pytest.approx(-data.cl[0, 0], abs=5e-3)
    assert 0.01 < data.cd[0, 1] < 0.03


@needs_xfoil
def test_gurney_flap_adds_lift():
    clean, flapped = (
        run(load_airfoil(name), [1e5], alpha_deg=np.arange(0.0, 6.1, 0.5))
        for name in ("naca0012", "naca0012+gurney1.5")
    )
    both = clean.known[0] & flapped.known[0]
    assert both.sum() >= 5
    gain = (flapped.cl - clean.cl)[0, both]
    assert 0.1 < gain.mean() < 0.6
    assert np.all(flapped.cm[0, both] < clean.cm[0, both])


@needs_xfoil
def test_engine_xfoil_makes_a_table():
    t = compute_polar("naca4412", engine="xfoil", reynolds=np.geomspace(5e4, 1e5, 2), n_crit=9.0)
    assert "XFOIL" in t.source
    assert np.all(np.rad2deg(t.alpha_valid_rad[:, 1]) > 8)
    cl, _ = lookup_lift_drag(t, np.deg2rad([0.0, 5.0]), 1e5)
    assert 0.3 < cl[0] < cl[1] < 1.3


def stand_in(tmp_path, monkeypatch, script):
    """A program called xfoil that does what ``script`` says."""
    program = tmp_path / "bin" / "xfoil"
    program.parent.mkdir()
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", f"{program.parent}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setattr(polar_engines, "xfoil_unavailable_reason", lambda: "")
    monkeypatch.setattr(polar_engines, "_needs_fpe_stub", [])


POLAR = "\n".join(f" {a:7.3f} {0.1 * a:8.4f} 0.02000 0.00100 -0.0100 1.0000 1.0000" for a in (0.0, 1.0, 2.0, 3.0))


def test_what_a_hanging_run_had_written_is_used(tmp_path, monkeypatch):
    stand_in(tmp_path, monkeypatch, f"cat > polar.txt <<'END'\n{POLAR}\nEND\nexec sleep 60")
    monkeypatch.setattr(polar_engines, "_XFOIL_TIME_LIMIT_S", 1.0)
    data = run(load_airfoil("naca0012"), [1e5], alpha_deg=np.arange(0.0, 6.0))
    assert data.known[0].tolist() == [True] * 4 + [False] * 2
    assert np.allclose(data.cl[0, :4], [0.0, 0.1, 0.2, 0.3])


def test_a_run_that_converges_nowhere_is_one_clear_line(tmp_path, monkeypatch):
    stand_in(tmp_path, monkeypatch, "cat > /dev/null")
    with pytest.raises(MuflyError, match="does not converge on naca0012 at Re 20000 and n_crit 9"):
        run(load_airfoil("naca0012"), [2e4], n_crit=9.0, alpha_deg=np.arange(0.0, 6.0))


def test_a_build_that_traps_is_run_again_without_its_trap(tmp_path, monkeypatch):
    """The stand-in dies of SIGFPE unless something is preloaded, as Debian's build does."""
    script = f"test -n \"$LD_PRELOAD\" || kill -FPE $$\ncat > polar.txt <<'END'\n{POLAR}\nEND"
    stand_in(tmp_path, monkeypatch, script)
    monkeypatch.setattr(polar_engines, "_build_fpe_stub", lambda: "libm.so.6")
    data = run(load_airfoil("naca0012"), [1e5], alpha_deg=np.arange(0.0, 4.0))
    assert data.known.all()
    assert polar_engines._needs_fpe_stub == [True]


def test_without_a_compiler_the_trap_is_explained(tmp_path, monkeypatch):
    stand_in(tmp_path, monkeypatch, "kill -FPE $$")
    monkeypatch.setattr(polar_engines.shutil, "which", lambda name: None)
    polar_engines._build_fpe_stub.cache_clear()
    try:
        with pytest.raises(MuflyError, match=r"without a C compiler this cannot be disabled; install gcc"):
            run(load_airfoil("naca0012"), [1e5], alpha_deg=np.arange(0.0, 4.0))
    finally:
        polar_engines._build_fpe_stub.cache_clear()


def test_absent_xfoil_is_explained(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    polar_engines.xfoil_unavailable_reason.cache_clear()
    try:
        with pytest.raises(
            MuflyError, match=r"not installed \(on Debian: apt install xfoil\); use engine 'neuralfoil'"
        ):
            run(load_airfoil("naca0012"), [1e5])
    finally:
        polar_engines.xfoil_unavailable_reason.cache_clear()


def test_narrow_gaps_are_bridged_and_wide_ones_end_the_range():
    alpha = np.arange(-6.0, 10.0)
    table = np.column_stack((0.1 * alpha, 0.02 + 0 * alpha, -0.01 + 0 * alpha))
    table[[2, 7, 12, 13, 14]] = np.nan  # at -4, 1, and 6 to 8 degrees
    filled, known = polar_engines._bridge_gaps(alpha, table)
    assert np.flatnonzero(~known).tolist() == [12, 13, 14, 15]
    assert np.allclose(filled[known, 0], 0.1 * alpha[known])
    assert not polar_engines._bridge_gaps(alpha, np.full((16, 3), np.nan))[1].any()
