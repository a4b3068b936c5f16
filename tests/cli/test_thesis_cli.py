"""``mufly thesis``: list and run."""

import json

import pytest
from typer.testing import CliRunner

from mufly.cli.study import thesis_commands as app
from mufly.errors import InputError

runner = CliRunner()


@pytest.fixture(autouse=True)
def wide_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")


def test_list() -> None:
    text = runner.invoke(app, ["list"]).stdout
    names = [row["name"] for row in json.loads(runner.invoke(app, ["list", "--json"]).stdout)]
    assert all(name in text for name in names)
    assert "table-3.3" in names


def test_run_prints_a_verdict_for_every_claim_and_writes(tmp_path) -> None:
    result = runner.invoke(app, ["run", "fig-3.7", "--out", str(tmp_path)])
    assert result.exit_code == 0, result.exception
    assert result.stdout.count("Rule:") == 8
    assert (tmp_path / "fig-3.7.png").exists()
    answer = json.loads(runner.invoke(app, ["run", "fig-3.7", "--json"]).stdout)
    assert (answer["agree"], len(answer["verdicts"])) == (7, 8)
    assert sum(v.startswith("DIFFERS") for v in answer["verdicts"]) == 1


def test_unknown_study_is_named() -> None:
    result = runner.invoke(app, ["run", "fig-9.9"])
    assert isinstance(result.exception, InputError)
    assert "fig-3.26" in str(result.exception)
