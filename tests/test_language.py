"""The language check: sentences, openings, history words, subjects and budgets of pages, docstrings and help texts."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

_SCRIPT = Path(__file__).resolve().parents[1] / "docs" / "check_language.py"
if not _SCRIPT.exists():
    pytest.skip("no documents beside the tests", allow_module_level=True)
_spec = importlib.util.spec_from_file_location("check_language", _SCRIPT)
check_language = importlib.util.module_from_spec(_spec)
sys.modules["check_language"] = check_language
_spec.loader.exec_module(check_language)

_LONG = "The filter " + "and the filter " * 13


def rules_of(text, file="docs/reference/x.md"):
    return [(f.line, f.rule) for b in check_language.markdown_blocks(text) for f in check_language.judge_block(b, file)]


def test_a_sentence_of_forty_words_passes_and_one_of_forty_one_does_not():
    assert rules_of(f"{_LONG[:-1]}.") == [(1, "long")]  # 41 words
    assert rules_of(f"{_LONG.removesuffix('filter ')}.") == []


@pytest.mark.parametrize(
    "frame", ["{}.", "- {}.", "1. {}.", "| a | {} |\n|---|---|", "## {}", "> {}", "```{{note}}\n{}.\n```"]
)
def test_long_sentences_are_found_in_every_kind_of_block(frame):
    assert [rule for _, rule in rules_of(frame.format(_LONG.strip()))] == ["long"]


@pytest.mark.parametrize(
    "frame",
    [
        "```sh\n{}\n```",
        "    {}",
        "```math\n{}\n```",
        "$$\n{}\n$$",
        "<!-- {} -->",
        "---\ntitle: {}\n---",
        "```{{toctree}}\n{}\n```",
    ],
)
def test_code_equations_and_comments_hold_no_sentences(frame):
    assert rules_of(frame.format(_LONG)) == []
    assert rules_of(frame.format(_LONG) + f"\n\n{_LONG}.")[0][1] == "long", "and what follows is read again"


def test_items_are_judged_one_by_one_with_their_continuations():
    half = "word " * 25
    assert rules_of(f"- {half}\n- {half}") == []
    assert rules_of(f"- {half}\n  {half}\n- short") == [(1, "long")]
    assert rules_of(f"a: {half}; {half}") == [(1, "long")], "a colon ends no sentence"


def test_abbreviations_initials_and_decimals_end_no_sentence():
    text = "See D. Schafroth, Fig. 4.2, e.g. the pair at 1.5 m. Next one."
    assert check_language.split_sentences(text) == [text[:-10], "Next one."]


def test_spans_count_as_a_reader_sees_them():
    assert check_language.plain_text("[the *filter*](a b c.md) `a b` $x + y$") == "the *filter* `code` `formula`"
    assert check_language.count_words("an angle - in degrees") == 4


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("## What it believes", True),
        ("Who flies it decides.", True),
        ("It flies. Whatever is left stays.", True),
        ("Which motor turns?", False),
        ("## What is measured?", False),
        ("where $x$ is the position.", False),
        ("| What | Where |", False),
        ("Whether it flies is open.", False),
    ],
)
def test_relative_clauses_at_the_beginning(text, found):
    assert ("opening" in [rule for _, rule in rules_of(text)]) is found


@pytest.mark.parametrize(
    "text",
    [
        "The error is 8 % (before, 12 %).",
        "It was 12 % then.",
        "Until now it fails.",
        "It used to drift.",
        "Over seed 6954.",
    ],
)
def test_history_belongs_to_the_log(text):
    assert [rule for _, rule in rules_of(text)] == ["history"]
    assert rules_of(text, "docs/log/2026-11-28-names.md") == rules_of(text, "CHANGELOG.md") == []


@pytest.mark.parametrize(
    "text",
    [
        "Before 20 s have passed it waits.",
        "The key is used to sort.",
        "It takes no longer than 5 s.",
        "Seed 7 repeats it.",
    ],
)
def test_present_tense_is_no_history(text):
    assert rules_of(text) == []


def test_cells_of_a_table_in_a_docstring_are_judged_one_by_one():
    half = "word " * 22
    table = f"""Table.

    =====  ====
    key    says
    =====  ====
    short  {half}
    other  {half}
    {{}}  {half}
    =====  ====

    What follows.
    """
    found = [
        [
            (f.line, f.rule)
            for b in check_language.docstring_blocks(text, 1)
            for f in check_language.judge_block(b, "x.py")
        ]
        for text in (table.format("third"), table.format("     "))
    ]
    assert found == [[(11, "opening")], [(7, "long"), (11, "opening")]], "an empty first cell continues the row above"


def test_docstrings_and_help_texts_are_read():
    source = '''"""What a module is."""

SPEED = 1.0
"""Whatever it is."""


def turn(x):
    """Turn.

    Parameters
    ----------
    x : float
        Where it stands.
    """
    return define_option("--out DIR", "Where to write.", unit=None), Option(help="Who asks.")
'''
    blocks = [
        b for line, text in check_language.source_texts(source) for b in check_language.docstring_blocks(text, line)
    ]
    found = [(f.line, f.text) for b in blocks for f in check_language.judge_block(b, "src/mufly/x.py")]
    assert sorted(found) == [
        (1, "What a module is."),
        (4, "Whatever it is."),
        (13, "Where it stands."),
        (15, "Where to write."),
        (15, "Who asks."),
    ]


@pytest.fixture
def repository(tmp_path, monkeypatch):
    """A repository of one page, with a commit of a long subject after the base."""

    def git(*words):
        identity = ("-c", "user.name=x", "-c", "user.email=x@example.org")
        return subprocess.run(
            ["git", "-C", tmp_path, *identity, *words], check=True, capture_output=True, text=True
        ).stdout

    (tmp_path / "docs" / "how-to").mkdir(parents=True)
    (tmp_path / "docs" / "how-to" / "fly.md").write_text("word " * 501, encoding="utf-8")
    git("init", "-q")
    git("commit", "-q", "--allow-empty", "-m", "x" * 80)
    monkeypatch.setattr(check_language, "SUBJECTS_SINCE", git("rev-parse", "HEAD").strip())
    git("commit", "-q", "--allow-empty", "-m", "y" * 73)
    git("commit", "-q", "--allow-empty", "-m", "z" * 72)
    return tmp_path


def test_budgets_subjects_and_exceptions(repository, monkeypatch):
    rules = [(f.rule, f.text) for f in check_language.check(repository, pending=())]
    assert rules == [
        ("long", "501 words: " + ("word " * 18)[:87] + "..."),
        ("budget", "501 words, 500 allowed"),
        ("subject", f"73 characters: {'y' * 73}"),
    ]
    assert {f.rule for f in check_language.check(repository, pending=("docs/*",))} == {"subject"}
    page = "docs/how-to/fly.md"
    monkeypatch.setattr(check_language, "EXCEPTIONS", ((page, "long", "a reason"), (page, "history", "a reason")))
    rules = [(f.rule, f.file) for f in check_language.check(repository, pending=())]
    assert ("long", page) not in rules
    assert ("exception", page) in rules, "one that excuses nothing is told"


def test_a_sum_of_pages_has_a_budget(repository, monkeypatch):
    monkeypatch.setattr(check_language, "TOTALS", (("docs", ("docs/log/*",), 500), ("docs/log", (), 5)))
    found = {f.file: f.text for f in check_language.check(repository, pending=("docs/how-to/*",)) if f.rule == "budget"}
    assert found == {"docs": "501 words in all, 500 allowed"}


def test_a_shallow_clone_has_no_subjects_to_judge(repository, monkeypatch):
    monkeypatch.setattr(check_language, "SUBJECTS_SINCE", "0" * 40)
    assert list(check_language.subject_findings(repository)) == []
