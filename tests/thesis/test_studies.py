"""Studies of the dissertation: which there are, what they claim, what is known to come out."""

import importlib.util
import json
import re
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from mufly.errors import InputError
from mufly.results.result_figure import blank_figure
from mufly.study import read_study_results
from mufly.thesis import (
    CLAIMS,
    THESIS_ITEMS,
    Claim,
    StudyAnswer,
    StudyOutcome,
    Verdict,
    count_verdicts,
    find_item,
    list_studies,
    load_cached_answer,
    load_or_run_study,
    render_html_page,
    render_markdown_page,
    run_study,
    study_runner,
)
from mufly.thesis.claims import TABLE_3_3_VALUES, Study, judge, meets_limits
from mufly.thesis.figure_catalogue import FIGURE_COUNTS, TABLE_COUNTS
from mufly.thesis.single_rotor_studies import SWEEP_STUDIES
from mufly.thesis.study_runner import STUDIES

DOCS = Path(__file__).parents[2] / "docs"


def test_every_figure_and_table_is_in_the_catalogue_once() -> None:
    figures = [f"fig-{c}.{k + 1}" for c, n in FIGURE_COUNTS.items() for k in range(n)]
    tables = [f"table-{c}.{k + 1}" for c, n in TABLE_COUNTS.items() for k in range(n)]
    assert len(figures) == 91
    assert len(tables) == 7
    assert set(THESIS_ITEMS) == {*figures, *tables}


def test_each_result_has_a_study_and_all_else_a_line() -> None:
    assert {i.name for i in list_studies()} == set(STUDIES)
    for i in THESIS_ITEMS.values():
        assert bool(i.counterpart) == (i.kind != "result"), i.name
        assert i.section[0] == i.name.partition("-")[2][0]
    for i in THESIS_ITEMS.values():
        for page in re.findall(r"docs/([\w-]+\.md)", i.counterpart):
            assert (DOCS / page).is_file(), f"{i.name} names {page}"


@pytest.mark.parametrize("text", ["fig-3.26", "3.26", "Fig. 3.26", "figure 3.26"])
def test_a_figure_is_found_as_people_write_it(text: str) -> None:
    assert find_item(text).name == "fig-3.26"


def test_unknown_study_is_named_and_a_photograph_is_no_study() -> None:
    with pytest.raises(InputError, match=r"fig-9\.9: is not a figure or table"):
        run_study("fig-9.9")
    with pytest.raises(InputError, match=r"fig-2\.2: is a photograph.*mufly thesis show fig-2\.2"):
        run_study("fig-2.2")
    with pytest.raises(InputError, match="does not use a CFD case"):
        run_study("fig-2.4", case=DOCS)


def test_answers_are_kept_until_sources_change_and_taken_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUFLY_CACHE", str(tmp_path / "cache"))
    assert load_cached_answer("fig-2.4").verdict_word == "not run"
    assert load_cached_answer("fig-2.2").verdict_word == "counterpart"
    first = load_or_run_study("fig-2.4")
    assert first.verdict_word == "agrees"
    assert first.picture is not None
    monkeypatch.setitem(study_runner.STUDIES, "fig-2.4", Study(lambda _: pytest.fail("computed again"), 0.0))
    assert load_or_run_study("fig-2.4").verdicts == first.verdicts
    other = load_or_run_study("fig-2.4", tmp_path / "own")
    assert other.picture == tmp_path / "own" / "fig-2.4.png"
    note = tmp_path / "own" / "fig-2.4.json"
    note.write_text(note.read_text()[:-20])  # cut off
    assert not load_cached_answer("fig-2.4", tmp_path / "own").is_answered
    monkeypatch.setattr(study_runner, "hash_study_inputs", lambda name: "other sources")
    assert load_cached_answer("fig-2.4").verdict_word == "not run"


def test_results_that_are_no_one_table_are_written_too(tmp_path: Path) -> None:
    data = xr.Dataset(
        {"x": ("t", [1.0]), "y": (("t", "k"), [[1.0, 2.0]])},
        coords={"ns": ("t", np.array([2**40])), "utc": ("t", np.array(["2026-01-01"], "M8[ns]"))},
        attrs={"of": {"a": "flight"}},
    )
    files = StudyOutcome("fig-6.10", "Step", {"run": data}, [], blank_figure(2.0, 2.0)).write_files(tmp_path)
    assert [f.name for f in files] == ["fig-6.10.png", "fig-6.10.json", "fig-6.10.nc"]
    np.testing.assert_array_equal(read_study_results(tmp_path / "fig-6.10.nc").y, data.y)


def test_words_follow_from_the_verdicts() -> None:
    def word(*agree: bool, missing: str = "") -> str:
        verdicts = tuple(Verdict(Claim("Fig. 2.4", "x"), "m", "1", a, "r") for a in agree)
        return StudyAnswer(THESIS_ITEMS["fig-2.4"], verdicts, missing=missing, is_answered=True).verdict_word

    assert [word(True, True), word(True, False), word(False)] == ["agrees", "in part", "DIFFERS"]
    assert [word(), word(True, missing="CFD")] == ["drawn", "needs CFD"]


def test_the_report_holds_its_pictures_and_all_items(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUFLY_CACHE", str(tmp_path))
    answers = [load_or_run_study(n) if n in ("fig-2.4", "fig-6.18") else load_cached_answer(n) for n in THESIS_ITEMS]
    page = render_html_page(answers)
    assert page.count("data:image/png;base64,") == 2
    assert all(f"id='{n}'" in page for n in THESIS_ITEMS)
    assert not re.search(r"(src|href)='(?!data:|#)", page)


def test_the_page_of_the_documents_is_that_of_the_kept_answers() -> None:
    spec = importlib.util.spec_from_file_location("make_thesis_page", DOCS / "make_thesis_page.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    kept = module.kept()
    assert module.PAGE.read_text(encoding="utf-8") == render_markdown_page(kept), "run python docs/make_thesis_page.py"
    assert [r["name"] for r in kept] == list(THESIS_ITEMS)
    assert "not run" not in count_verdicts(kept)
    by_name = {r["name"]: r for r in kept}
    # The quick ones are computed: what stands on the page is what comes out today.
    for name in ("fig-2.4", "fig-3.17", "fig-4.4", "fig-6.15", "fig-6.16", "fig-6.18", "table-5.1"):
        assert [v.format_line() for v in run_study(name).verdicts] == by_name[name]["verdicts"], (
            f"{name}: run python docs/make_thesis_page.py"
        )


def test_gear_study_agrees_at_the_voltage_of_the_linear_model() -> None:
    outcome = run_study("fig-3.7")
    at = {(v.claim.text, v.model_name[-5:]): v.agrees for v in outcome.verdicts}
    thrust = CLAIMS["gear-thrust"].text
    assert all(agrees for (text, volt), agrees in at.items() if volt == "6.4 V")
    assert not at[(thrust, "7.2 V")]


@pytest.mark.parametrize("name", ["fig-3.28", "fig-3.31", "fig-3.36"])
def test_sweeps_have_the_dissertations_axes(name: str, tmp_path: Path) -> None:
    outcome = run_study(name)
    left, right = outcome.figure.axes
    assert left.get_xlim() == (6, 20)
    assert left.get_ylabel() == "Thrust / electrical power (N/W)"
    legend = left.get_legend()
    assert legend is not None
    assert [t.get_text() for t in legend.get_texts()] == list(SWEEP_STUDIES[name].labels)
    assert len(right.lines) == len(SWEEP_STUDIES[name].values)
    for data in outcome.data.values():
        assert (data.fault == "").all()
        np.testing.assert_allclose(data.thrust_N, 0.4, rtol=1e-9)
    files = {f.name for f in outcome.write_files(tmp_path)}
    assert {f"{name}.png", f"{name}.json", f"{name}-full.csv", f"{name}-thesis.nc"} <= files
    note = json.loads((tmp_path / f"{name}.json").read_text())
    assert len(note["verdicts"]) == len(outcome.verdicts)


def test_every_claim_of_a_number_is_judged_with_numbers() -> None:
    for name in ("fig-3.26", "fig-3.30", "fig-3.35"):
        for verdict in run_study(name).verdicts:
            assert any(c.isdigit() for c in verdict.ours)
            assert verdict.format_line().startswith(("agrees", "DIFFERS"))


def test_table_3_3_is_consistent_with_its_thrust() -> None:
    # Thrust per power times power is the desired thrust of Sec. 3.4, to the digits printed.
    for _, per_power, power in TABLE_3_3_VALUES.values():
        assert per_power * power == pytest.approx(0.4, rel=5e-3)


def test_the_dissertations_own_theory_gives_its_four_best_airfoils() -> None:
    from mufly.study import TABLE_3_3_AIRFOILS, sweep_parameters
    from mufly.thesis.single_rotor_studies import PITCH_SETTINGS_DEG, make_standard_setup

    best = list(TABLE_3_3_VALUES)[:4]
    pitch = [float(p) for p in np.radians(PITCH_SETTINGS_DEG)]
    data = sweep_parameters(
        make_standard_setup("thesis"), {"airfoil": [TABLE_3_3_AIRFOILS[n] for n in best], "pitch": pitch}
    )
    ours = data.thrust_per_power_N_W.max("pitch").values
    np.testing.assert_allclose(ours, [TABLE_3_3_VALUES[n][1] for n in best], rtol=0.03)


@pytest.mark.parametrize(
    ("limits", "inside", "outside"),
    [
        ({"above": 1.0, "at_most": 2.0}, [1.5, 2.0], [1.0, 1.5]),
        ({"at_least": 1.0, "below": 2.0}, [1.0, 1.9], [1.5, 2.0]),
        ({"equals": 4}, 4, 3),
        ({"near": 10.0, "within": 2.0}, [8.0, 12.0], [9.0, 12.1]),
        ({"near": 10.0, "within_share": 0.1}, [9.1, 10.9], [9.1, 11.1]),
        ({"brackets": 1.5, "slack": 0.1}, [1.0, 1.4], [1.0, 1.3]),
        ({"below": 1.0}, 0.0, float("nan")),
        (True, True, False),
    ],
)
def test_limits_of_a_verdict(limits: dict[str, float] | bool, inside: object, outside: object) -> None:
    assert meets_limits(inside, limits)
    assert not meets_limits(outside, limits)


def test_a_verdict_has_limits_for_what_is_computed_and_no_other() -> None:
    verdict = judge("coax-trim", "wake", "6661 rpm", rpm=6661.0)
    assert verdict.agrees
    assert verdict.claim == CLAIMS["coax-trim"]
    assert not judge("coax-trim", "wake", "7000 rpm", rpm=7000.0).agrees
    with pytest.raises(KeyError, match="coax-trim"):
        judge("coax-trim", "wake", "6661 rpm", speed=6661.0)
