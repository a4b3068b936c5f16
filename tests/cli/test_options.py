"""What a library says of its arguments, the command line says of its options."""

import re
from collections.abc import Iterator
from typing import Annotated, Any

import pytest
import typer
from typer.testing import CliRunner

from mufly.cli import app as mufly
from mufly.cli.options import Commands
from mufly.errors import ArgumentError, InputError

app = Commands()


@app.command()
def work(radius: float = 1.0, band: str = "", set_: Annotated[str, typer.Option("--set")] = "") -> None:
    """Do what is always wrong."""
    if set_ == "file":
        raise InputError(
            "bench.csv", "torque", "is not among the columns", "map it with band=OLD=NEW, or --set radius=3"
        )
    if set_:
        raise ArgumentError("set", set_, "is wrong", "write set=3 or radius_m=2, other=1")
    raise ArgumentError("band_rad_s" if band else "radius_m", "", f"{radius:g} m is wrong", "give another")


@app.command()
def other() -> None:
    """Do without options."""
    raise ArgumentError("radius_m", "", "is wrong", "give another")


def fault(*words: str) -> str:
    error = CliRunner().invoke(app, words).exception
    assert isinstance(error, InputError)
    return str(error)


def test_arguments_become_options() -> None:
    assert fault("work") == "--radius: 1 m is wrong; give another"
    assert fault("work", "--band", "x") == "--band: 1 m is wrong; give another"
    assert fault("work", "--set", "x") == "--set: x: is wrong; write --set 3 or --radius 2, other=1"


def test_remedies_of_a_file_name_options_too() -> None:
    told = "bench.csv: torque: is not among the columns; map it with --band OLD=NEW, or --set radius=3"
    assert fault("work", "--set", "file") == told


def test_an_argument_without_option_keeps_its_name() -> None:
    assert fault("other") == "radius_m: is wrong; give another"


def test_the_library_itself_names_arguments() -> None:
    with pytest.raises(InputError, match=re.escape("radius_m: is wrong; give another")):
        raise ArgumentError("radius_m", "", "is wrong", "give another")


ABSURD = ("1e9", "-1", "nan", "1e-12", "5kV")
NUMBERS = {
    "drive show": {"--thrust": ABSURD, "--duty": ABSURD, "--charge": ("1e9", "-1", "nan"), "--voltage": ABSURD},
    "drive show --rotor naca4412-r60-c20": {"--pitch": ("1e9", "nan", "5kV")},
    "drive sweep": {"--thrust": ABSURD, "--duty": ABSURD, "--gear": ABSURD, "--voltage": ABSURD},
    "control design": {"--rate": ABSURD, "--voltage": ABSURD},
    "fly --headless": {
        "--wind": ("1e9,0,0", "nan,0,0", "1"), "--gust": ("1e9", "-1", "nan", "5kV"), "--seed": ("-1", "nan", "1e-12"),
        "--port": ("1000000000", "-1", "nan"),
        "--fault": ("sonar.jump=1e9@1s", "sonar.jump=0.3@1e9s+1s", "sonar.jump=nan", "sonar.jump=0.3@2s+0s", "a.b"),
    },
    "link": {"--system": ("1000000000", "-1", "nan"), "--origin": ("91,0,0", "nan,0,0", "47,8,1e9", "47,8")},
}  # fmt: skip


@pytest.mark.parametrize("command", NUMBERS)
def test_absurd_numbers_are_refused_by_the_name_of_their_option(command: str, tmp_path, monkeypatch) -> None:
    """Before: a thrust of -1 N was looked for, one of 1e-12 N "out of reach: gives 0.7 N", a jump of 1e9 m flown."""
    monkeypatch.chdir(tmp_path)
    for name, values in NUMBERS[command].items():
        for value in values:
            result = CliRunner().invoke(mufly, [*command.split(), f"{name}={value}"])
            said = str(result.exception) if isinstance(result.exception, InputError) else result.output
            assert result.exit_code != 0, f"{command} {name}={value} is accepted"
            assert name in said, f"{command} {name}={value}: {said}"
            assert "\n" not in said or result.exit_code == 2  # the parser's own words are framed
    assert not any(tmp_path.iterdir())


def test_no_help_loses_what_stands_in_brackets() -> None:
    """Rich takes ``[cad]`` for a style and leaves it out, unless it is written ``\\[cad]``."""

    def helps(command: Any) -> Iterator[str]:
        yield command.help or ""
        yield from (getattr(p, "help", None) or "" for p in command.params)
        for inner in getattr(command, "commands", {}).values():
            yield from helps(inner)

    from rich.text import Text

    for text in helps(typer.main.get_command(mufly)):
        shown, asked = Text.from_markup(text).plain, re.findall(r"\[[a-z_.]+\]", text)
        styles = [tag for tag in asked if tag not in shown]
        assert set(styles) <= {"[bold]", "[dim]"}, styles
