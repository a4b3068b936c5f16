from __future__ import annotations

from pathlib import Path

from mufly.control import FlightController
from mufly.control.analysis.plots import draw_loop, draw_plant_singular_values, write_design_pictures


def test_every_design_gets_its_pictures(controller: FlightController, tmp_path: Path) -> None:
    written = write_design_pictures(controller, tmp_path / "new" / "folder")
    assert sorted(p.name for p in written) == [
        f"{name}-{what}.png" for name in ("heave-yaw", "roll-pitch", "velocity") for what in ("loop", "plant")
    ]
    for path in written:
        assert path.read_bytes().startswith(b"\x89PNG")


def test_axes_carry_units_and_the_thesis_is_marked(controller: FlightController) -> None:
    for figure in (draw_plant_singular_values(controller.heave_yaw), draw_loop(controller.heave_yaw)):
        assert figure.axes[-1].get_xlabel() == "frequency (rad/s)"
        assert all(a.get_ylabel() == "singular values (dB)" for a in figure.axes)
        assert any("thesis" in t.get_text() for a in figure.axes for t in a.texts)
