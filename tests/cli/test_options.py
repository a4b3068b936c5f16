"""What a library says of its arguments, the command line says of its options."""

import re
from typing import Annotated

import pytest
import typer
from typer.testing import CliRunner

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
