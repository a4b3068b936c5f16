"""What is said of the exported code: fuzzed, read by checkers, covered by its tests, in one report."""

from __future__ import annotations

import pytest

from mufly.control import design
from mufly.firmware import export, export_fixed, missing_fuzzer, run_fuzzer
from mufly.vehicle import load_vehicle


@pytest.fixture(scope="module")
def vehicle():
    return load_vehicle("mufly-1.1")


@pytest.fixture(scope="module")
def tree(vehicle, tmp_path_factory):
    folder = tmp_path_factory.mktemp("report") / "fw"
    controller = design(vehicle)
    export(controller, folder, vehicle)
    export_fixed(controller, folder)
    return folder


@pytest.mark.skipif(bool(missing_fuzzer()), reason=missing_fuzzer())
def test_any_bytes_are_borne_and_a_fault_is_found(tree) -> None:
    """A short run; then with the guard of the sine taken away, whose cast of what is no number C leaves undefined."""
    sound = run_fuzzer(tree, seconds=2)
    assert sound.found == ""
    assert sound.runs > 100
    assert set(sound.parts) == {"controllers", "avoidance", "whole numbers", "flight software", "estimator"}
    source = tree / "real.c"
    text = source.read_text()
    try:
        source.write_text(text.replace("if (real_abs(angle) < GREATEST) {", "if (true) {"))
        assert source.read_text() != text
        broken = run_fuzzer(tree, seconds=30)
    finally:
        source.write_text(text)
    assert "outside the range of representable values" in broken.found
    assert "real.c" in broken.found
    assert broken.input_hex
