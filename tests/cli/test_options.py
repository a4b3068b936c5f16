"""What a library says of its arguments, the command line says of its options."""

import math
import re
from collections.abc import Iterator
from typing import Annotated, Any

import pytest
import typer
from typer.testing import CliRunner

from mufly.cli import app as mufly
from mufly.cli.options import CommandGroup, NumberOptionParser
from mufly.cli.station import parse_wind_option, resolve_wind
from mufly.errors import ArgumentError, InputError
from mufly.quantities.units import list_compatible_units, unit_conversion

app = CommandGroup()


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
        "--wind": ("1e9,0,0", "nan,0,0", "-1"), "--gust": ("1e9", "-1", "nan", "5kV"), "--seed": ("-1", "nan", "1e-12"),
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


def every_option() -> Iterator[tuple[str, Any]]:
    """Every option of every command, with the command's words."""

    def walk(command: Any, words: list[str]) -> Iterator[tuple[str, Any]]:
        for name, inner in getattr(command, "commands", {}).items():
            yield from walk(inner, [*words, name])
        if not hasattr(command, "commands"):
            yield from ((" ".join(words), p) for p in command.params if p.param_type_name == "option")

    yield from walk(typer.main.get_command(mufly), [])


def notation_of(option: Any) -> NumberOptionParser | None:
    parser = option.type_descriptor.parameter_info.parser
    return parser if isinstance(parser, NumberOptionParser) else None


# Options whose numbers have no dimension.
COUNTS = {
    "--again", "--aid", "--baud", "--blades", "--boxes", "--cells", "--calibrate", "--cores", "--flights",
    "--frequencies", "--generations", "--jobs", "--order",
    "--point", "--points", "--port", "--record", "--reference-every", "--repeat",
    "--restarts", "--rounds", "--search", "--seed", "--starts", "--stations", "--steps", "--system", "--top",
    "--sensor-seeds", "--uart",
}  # fmt: skip
PLAIN = {
    "--activity", "--complementary", "--disk", "--gamma", "--gear", "--mu", "--n-crit", "--sensitivity", "--speed",
}  # fmt: skip
SHARES = {
    "--zero-thrust", "--zero-torque",
    "--amplitude", "--band", "--charge", "--duty", "--flap-frequency-ratio", "--gear", "--gear-efficiency",
    "--hold-out-share", "--light",
    "--ratio", "--shadows", "--split", "--gurney",
}  # fmt: skip
# Options that hold names, files, addresses, or NAME=VALUE with values that the grammar reads.
TEXTS = {
    "--accept", "--aid", "--airfoil", "--airfoils", "--align", "--as", "--axis", "--board", "--by", "--calibration",
    "--camera", "--camera-fault", "--case", "--centre", "--channel", "--checkpoint", "--clock", "--cluster", "--code",
    "--column", "--connect", "--data", "--designed-for", "--domain", "--drive", "--engine", "--family", "--fault",
    "--fit", "--flight-map", "--floor", "--for", "--foxglove", "--free", "--from", "--geometry", "--hold-out", "--host",
    "--imu", "--input", "--inputs", "--keep", "--kind", "--known", "--layout", "--limit", "--link", "--log", "--logs",
    "--loop", "--map", "--material", "--measured", "--mesh", "--method", "--methods", "--mission", "--model",
    "--motion", "--name", "--noise", "--only", "--open", "--origin", "--others", "--out", "--output", "--outputs",
    "--over", "--part", "--plot", "--policy", "--position", "--prefix", "--receiver", "--reference", "--report",
    "--rig", "--rotor", "--save-map", "--section", "--sensors", "--set", "--signal", "--simulator", "--start",
    "--stream", "--telemetry", "--template", "--times", "--tip", "--token", "--tuned", "--unit", "--vary", "--vehicle",
    "--wake", "--wake-set", "--with", "--without", "--write",
}  # fmt: skip


def test_every_option_with_a_number_is_read_by_the_one_grammar() -> None:
    quantities: dict[str, set[str]] = {}
    count = 0
    for command, option in every_option():
        count += 1
        kind, name = option.type_descriptor.annotation, max(option.opts, key=len)
        notation, opts = notation_of(option), set(option.opts)
        if kind is bool or option.is_flag:
            continue
        if notation is None:
            assert kind not in (int, float, list[int], list[float]), f"{command} {name} is read by typer"
            assert opts & TEXTS, f"{command} {name} is neither a quantity nor listed as a text"
        elif notation.form == "count":
            assert opts & COUNTS, f"{command} {name} is not listed as a count"
        elif notation.unit == "":
            assert opts & PLAIN, f"{command} {name} is not listed as a plain number"
        elif notation.unit in ("1", "%"):
            assert opts & SHARES, f"{command} {name} is not listed as a share"
        else:
            quantities.setdefault(name, set()).add(notation.unit)
            assert f"[{notation.unit}]" in option.metavar, f"{command} {name} does not show its unit"
    assert count > 400
    assert {n: u for n, u in quantities.items() if len(u) > 1} == DIFFERENT
    assert len(quantities) > 50


# The same option means different bare units in different commands; everything else is one unit everywhere.
DIFFERENT = {
    "--radius": {"mm", "m"},  # `new` in mm, `identify rotor` in m
    "--delay": {"ms", "s"},  # `identify flight` in ms
}

OTHER_DIMENSION = {"V": "kg", "N": "V"}


def test_every_quantity_takes_units_and_refuses_what_is_none_in_our_words() -> None:
    """Before: `--thrust 0.9N` was "Input should be a valid number, unable to parse string as a number"."""
    seen = set()
    for command, option in every_option():
        notation, name = notation_of(option), max(option.opts, key=len)
        if notation is None or (name, notation) in seen:
            continue
        seen.add((name, notation))
        for text in ("", "abc", "nan", "1e999", "5 parsec", "1.2.3"):
            with pytest.raises(InputError) as told:
                notation.parse_option_text(name, text)
            assert str(told.value).startswith(f"{name}: "), f"{command} {name}={text}: {told.value}"
            assert "Input should be" not in str(told.value)
            assert told.value.remedy
        if notation.form == "one" and notation.unit and not notation.allowed_words:
            for unit in set(list_compatible_units(unit_conversion(notation.unit)[0])) - {"1"}:
                low, high = notation.allowed_range.low, notation.allowed_range.high
                value = next(v for v in (1.0, low, high, 0.5) if v is not None and (low or v) <= v <= (high or v))
                factor = unit_conversion(notation.unit, unit)[1]
                assert notation.parse_option_text(name, f"{value * factor!r}{unit}") == pytest.approx(value), (
                    command,
                    unit,
                )
            with pytest.raises(InputError, match=r"cannot become|is unknown"):
                notation.parse_option_text(name, f"1{OTHER_DIMENSION.get(notation.unit, 'V')}")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("drive", "show", "--thrust", "0,9"), "--thrust: '0,9' has a decimal comma; write 0.9"),
        (("monte-carlo", "--flights", "3.5"), "--flights: '3.5' is not a whole number"),
        (("monte-carlo", "--flights=-3"), "--flights: -3 is out of range; give 0 or more"),
        (("fly", "--wind", "0,5"), "--wind: '0,5' holds 2 numbers"),
        (("fly", "demonstraton"), "did you mean 'demonstration'?"),
        (("fly", "--vehicle", "mufly-1.l"), "did you mean 'mufly-1.1'"),
        (("rotor", "show", "naca4412-r60-c21"), "did you mean 'naca4412-r60-c20'"),
        (("rotor", "hover", "--rpm", "5000", "--pitch", "12", "--engine", "xfol"), "did you mean 'xfoil'"),
        (("fly", "--fault", "sonr.jump"), "--fault: sonr: is not a sensor; did you mean 'sonar'?"),
        (("fly", "--fault", "sonar.jump=3kg"), "'3kg' is in kg, which cannot become m"),
        (("coax", "hover", "--spacing", "20"), "--spacing: 20 m is out of range: no coaxial pair has such a distance"),
        (
            ("identify", "plan", "mufly-1.1", "--free", "cT_dw", "--limit", "heigth_m=1"),
            "did you mean 'height_m'",
        ),
    ],
)
def test_refusals_name_option_value_and_remedy(words: tuple[str, ...], message: str) -> None:
    error = CliRunner().invoke(mufly, words).exception
    assert isinstance(error, InputError), error
    assert message in str(error)


def test_wind_means_the_same_in_every_command() -> None:
    def read(text: str) -> float | tuple[float, float, float] | None:
        return parse_wind_option(NumberOptionParser("m/s", "vector").parse_option_text("--wind", text))

    assert read("0.5") == read("0.5m/s") == 0.5
    assert read("1.8km/h,0,0") == pytest.approx((0.5, 0.0, 0.0))
    assert read("0.5,0,0") == read("0.5m/s,0,0m/s") == (0.5, 0.0, 0.0)
    with pytest.raises(InputError, match=r"'-0\.5' is not a wind speed"):
        read("-0.5")
    found, again, other = (
        resolve_wind((0.5,), None, 7),
        resolve_wind((0.5,), None, 7),
        resolve_wind((0.5,), None, 8),
    )
    assert found == again != other  # the seed draws where it comes from
    assert math.hypot(*found) == pytest.approx(0.5)
    assert found[2] == 0.0
