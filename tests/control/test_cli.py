from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from mufly.cli.control import app
from mufly.errors import InputError

RUN = CliRunner()


def test_table_stands_beside_the_thesis() -> None:
    result = RUN.invoke(app, ["design"])
    assert result.exit_code == 0
    for text in (
        "heave-yaw",
        "roll-pitch",
        "velocity",
        "gamma claimed",
        "norm achieved",
        "1.38",
        "3.93",
        "36",
        "575",
        "thesis",
    ):
        assert text in result.stdout


def test_json_and_nothing_else(tmp_path: Path) -> None:
    result = RUN.invoke(app, ["design", "mufly-2.0", "--json", "--rate", "250", "--out", str(tmp_path)])
    data = json.loads(result.stdout)
    assert data["vehicle"] == "mufly-2.0"
    assert data["rate_Hz"] == 250
    assert json.loads((tmp_path / "design.json").read_text()) == data
    assert len(list(tmp_path.glob("*.png"))) == 6


def test_bad_input_is_one_clear_line(tmp_path: Path) -> None:
    result = RUN.invoke(app, ["design", "--rate", "3"])
    assert isinstance(result.exception, InputError)
    assert "--rate: 3 Hz is out of range" in str(result.exception)
    blocked = tmp_path / "file"
    blocked.write_text("")
    result = RUN.invoke(app, ["design", "--out", str(blocked)])
    assert isinstance(result.exception, InputError)
    assert "give a folder that can be written" in str(result.exception)


@pytest.mark.parametrize("arguments", [["--help"], ["design", "--help"]])
def test_help(arguments: list[str]) -> None:
    result = RUN.invoke(app, arguments)
    assert result.exit_code == 0
    assert "design" in result.stdout.lower()
