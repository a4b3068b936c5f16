"""Figures of accuracy: each has what a reader needs, its text follows from its numbers, and the documents print it."""

import importlib.util
import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
if not (ROOT / "docs" / "figures.json").exists():
    pytest.skip("no documents beside the tests", allow_module_level=True)


def script(path):
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


figure_record = script(ROOT / "benchmarks" / "figure_record.py")
pages = script(ROOT / "docs" / "write_figures.py")
ROWS = figure_record.read_figures()


def test_the_pages_print_the_figures():
    for page in pages.PAGES:
        text = page.read_text(encoding="utf-8")
        assert pages.fill_page(text, ROWS) == text, "run python docs/write_figures.py"


def test_every_figure_is_on_the_page_of_accuracy():
    text = (ROOT / "docs" / "accuracy.md").read_text(encoding="utf-8")
    missing = [r["key"] for r in ROWS if f"|{r['quantity']}|{r['data']}|{pages.value_text(r)}|" not in text]
    assert missing == []


def test_a_figure_has_all_that_a_reader_needs():
    keys = [r["key"] for r in ROWS]
    assert len(set(keys)) == len(keys)
    for row in ROWS:
        assert row["key"].isidentifier(), "a page names it in {{ }}"
        assert all(row[k] for k in ("subsystem", "quantity", "data", "command", "numbers")), row["key"]
        assert re.fullmatch(r"20\d\d-\d\d-\d\d", row["date"]), row["key"]
        assert bool(row["target"]) == bool(row["limits"]), row["key"]
        assert row["value"] == figure_record.format_value(row), row["key"]
        assert row["status"] == figure_record.judge_status(row), row["key"]


def test_commands_of_figures_exist():
    for row in ROWS:
        words = row["command"].split()
        if words[0] == "python":
            assert (ROOT / words[1]).is_file(), row["key"]
        elif words[0] == "pytest":
            assert (ROOT / words[1]).exists(), row["key"]
        else:
            assert words[0] == "mufly", row["key"]


def test_values_that_pages_take_exist():
    keys = {r["key"] for r in ROWS}
    for page in (ROOT / "docs").rglob("*.md"):
        taken = re.findall(r"\{\{ *(\w+) *\}\}", re.sub(r"`[^`]*`", "", page.read_text(encoding="utf-8")))
        assert set(taken) <= keys, page


@pytest.fixture
def figures(tmp_path):
    row = {"key": "x", "numbers": [1.0, 2.0], "form": "{}; {} %", "digits": [1, 0], "limits": [[None, 5], [2, 3]]}
    path = tmp_path / "figures.json"
    figure_record.write_figures([row, {"key": "y", "numbers": [1]}], path)
    return path


@pytest.mark.parametrize(("second", "status"), [(2.6, "met"), (3.4, "met"), (3.6, "missed"), (1.4, "missed")])
def test_a_record_renews_a_row_and_leaves_others(figures, second, status):
    figure_record.record_figure("x", 4.04, second, path=figures)
    row, other = json.loads(figures.read_text(encoding="utf-8"))
    assert row["value"] == f"4.0; {second:.0f} %"
    assert row["status"] == status, "a number counts as it is printed"
    assert row["numbers"] == [4.0, round(second)]
    assert re.fullmatch(r"20\d\d-\d\d-\d\d", row["date"])
    assert other == {"key": "y", "numbers": [1]}


def test_a_record_of_no_row_or_of_another_count_is_refused(figures):
    with pytest.raises(KeyError, match="no row of key 'z'"):
        figure_record.record_figure("z", 1.0, path=figures)
    with pytest.raises(ValueError, match="3 numbers for a row of 2"):
        figure_record.record_figure("x", 1.0, 2.0, 3.0, path=figures)


def test_only_a_script_that_is_asked_records(monkeypatch):
    told = []
    monkeypatch.setattr(figure_record, "record_figure", lambda *a: told.append(a))
    words = ["script.py", "--record", "7"]
    figure_record.take_record_option(words)("x", 1.0)
    figure_record.take_record_option(words)("x", 2.0)
    assert words == ["script.py", "7"]
    assert told == [("x", 1.0)]


def test_scores_of_the_rotor_benchmark_are_recorded(tmp_path, monkeypatch):
    head = "code,group,thrust_error,torque_error\n"
    lines = (
        "bemt,UIUC micro,0.112,0.146\n"
        "bemt,Table 3.2,0.9,0.9\n"
        '"bemt, 1 point seen",UIUC micro,0.024,0.051\n'
        '"bemt, half seen",UIUC micro,0.014,0.026\n'
    )
    (tmp_path / "scores.csv").write_text(head + lines, encoding="utf-8")
    told = {}
    monkeypatch.setattr(figure_record, "record_figure", lambda key, *numbers: told.update({key: numbers}))
    figure_record.record_scores(tmp_path)
    assert told == {
        "bemt_uiuc": pytest.approx((11.2, 14.6)),
        "bemt_one_point": pytest.approx((2.4, 5.1)),
        "bemt_half": pytest.approx((1.4, 2.6)),
    }
