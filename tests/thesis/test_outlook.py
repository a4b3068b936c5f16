"""The outlook of the dissertation: its page, its documents, its commands, and the numbers that are quick."""

import shlex
from pathlib import Path

import typer
from typer.testing import CliRunner

from mufly.cli import app
from mufly.rotor import compute_flap_mode, load_rotor
from mufly.thesis import OUTLOOK_SENTENCES, count_outlook_states, render_outlook_page

DOCS = Path(__file__).resolve().parents[2] / "docs"


def test_the_page_is_that_of_the_sentences():
    page = (DOCS / "thesis" / "outlook.md").read_text(encoding="utf-8")
    assert page == render_outlook_page(), "run python docs/make_thesis_page.py --as-kept"
    assert [s.number for s in OUTLOOK_SENTENCES] == list(range(1, 25))
    assert sum(count_outlook_states().values()) == len(OUTLOOK_SENTENCES)
    assert all((DOCS.parent / s.page).is_file() for s in OUTLOOK_SENTENCES)


def test_commands_exist_with_their_options():
    root = typer.main.get_command(app)
    commands = {c for s in OUTLOOK_SENTENCES for c in s.commands}
    assert len(commands) > 8
    for command in commands:
        words = shlex.split(command)[1:]
        found = root
        while hasattr(found, "commands"):
            found = found.commands[words.pop(0)]
        known = {"--help", *(option for p in found.params for option in p.opts)}
        assert {w for w in words if w.startswith("--")} <= known, command


def test_built_sentences_have_a_command_or_a_page_of_their_own():
    assert all(s.commands for s in OUTLOOK_SENTENCES if s.state == "built")


def test_the_flap_frequency_of_the_page_is_the_computed_one():
    mode = compute_flap_mode(load_rotor("walkera-5g6"), 443.6)
    text = next(s.answer for s in OUTLOOK_SENTENCES if "flap frequency of" in s.answer)
    assert f"{mode.ratio:.2f} per revolution" in text
    assert f"{mode.ratio_low:.2f} with a free hinge" in text


def test_the_command_lists_every_sentence():
    told = CliRunner().invoke(app, ["thesis", "outlook", "--json"])
    assert told.exit_code == 0
    assert told.output.count('"answer"') == len(OUTLOOK_SENTENCES)
