"""Write the reference pages from docstrings, command help, file schemas and the table of tunable parameters.

``conf.py`` calls it before a build; by hand: ``python docs/make_reference.py docs/api``. The repository does not
keep the pages that it writes.
"""

from __future__ import annotations

import argparse
import importlib
import inspect
import re
import types
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from mufly.cli import app
from mufly.control import design_flight_controller
from mufly.flight import FlightSoftware
from mufly.flight.tunable_parameters import STORAGE_KEYS, TunableParameters
from mufly.mission import Mission, load_mission
from mufly.rotor import Rotor
from mufly.vehicle import Vehicle, load_vehicle
from mufly.vehicle.quantity import Quantity, ValueSource

ROOMS = (
    "vehicle", "world", "rotor", "rotor.wake", "rotor.forward", "drive", "bench", "cfd", "study", "dynamics",
    "identify", "control", "sensors", "estimate", "mission", "flight", "flight.monte_carlo", "flight.policy",
    "firmware", "gym", "link", "station", "bridges", "fmi", "logs", "thesis",
)  # fmt: skip


def write(folder: Path) -> None:
    """Write all pages; those that say the same as before keep their time, so that they are not built again."""
    pages = {f"commands-{name}.md": text for name, text in commands()}
    pages |= {f"api-{room.replace('.', '-')}.md": api(room) for room in ROOMS}
    pages["vehicle-file.md"] = vehicle_file()
    pages["mission-file.md"] = mission_file()
    pages["rotor-file.md"] = rotor_file()
    pages["parameters.md"] = parameters()
    pages["index.md"] = index(list(pages))
    folder.mkdir(exist_ok=True)
    for name, text in pages.items():
        page = folder / name
        if not page.exists() or page.read_text(encoding="utf-8") != text:
            page.write_text(text, encoding="utf-8")
    for old in set(folder.glob("*.md")) - {folder / name for name in pages}:
        old.unlink()


def index(pages: list[str]) -> str:
    """The page that leads to the others."""

    def tree(title: str, start: str) -> str:
        names = "\n".join(p.removesuffix(".md") for p in pages if p.startswith(start))
        return f"## {title}\n\n```{{toctree}}\n:maxdepth: 1\n\n{names}\n```\n"

    names = "vehicle-file\nmission-file\nrotor-file\nparameters"
    files = f"## Files and parameters\n\n```{{toctree}}\n:maxdepth: 1\n\n{names}\n```\n"
    return "# Reference\n\n" + "\n".join((tree("Commands", "commands-"), files, tree("Python", "api-")))


# Commands


def commands() -> Iterator[tuple[str, str]]:
    """Name and page of every command, with those below it."""
    top: Any = typer.main.get_command(app)
    for name, command in sorted(top.commands.items()):
        yield name, _command(command, f"mufly {name}", "#")


def _command(command: Any, path: str, level: str) -> str:
    text = [f"{level} `{path}`", "", plain_help(command.help or "")]
    if hasattr(command, "commands"):
        parts = [_command(c, f"{path} {n}", level + "#") for n, c in sorted(command.commands.items())]
        return "\n".join(text) + "\n\n" + "\n\n".join(parts)
    with typer.Context(command, info_name=path) as context:
        usage = " ".join([path, *command.collect_usage_pieces(context)])
        rows = [r for p in command.params if (r := p.get_help_record(context)) is not None]
    text += ["", f"```text\n{usage}\n```", "", "| | |", "|---|---|"]
    text += [f"| `{_cell(names)}` | {_cell(plain_help(what))} |" for names, what in rows]
    return "\n".join(text)


def plain_help(text: str) -> str:
    """A help text as Markdown: markup for terminals gone, example lines as code."""
    text = re.sub(r"\[/?(bold|dim|italic|green|yellow|red|cyan)[^\]]*\]", "", inspect.cleandoc(text.replace("\b", "")))
    text = re.sub(r"(?<!`)(--[a-z][a-z0-9-]*)(?!`)", r"`\1`", text)
    text = re.sub(r"(?<=[.)])\s(?=Examples?: )", "\n\n", text)
    # Several examples stand one to an indented paragraph; or in one line, with semicolons.
    text = re.sub(
        r"(^|\n)Examples?:\n((?:\n+(?: +|(?=mufly ))[^\n]+)+)",
        lambda m: _shell_block(m[1], m[2].split("\n")),
        text,
    )
    return re.sub(
        r"(^|\n)Examples?: (.+?)(?=\n\n|$)",
        lambda m: _shell_block(m[1], re.split(r";|,\sthen\s|\sExamples?: ", m[2])),
        text,
        flags=re.DOTALL,
    )


def _shell_block(before: str, lines: list[str]) -> str:
    """Commands as a shell block; a remark in parentheses behind one becomes a comment."""
    plain = [line.strip().replace("\n", " ").replace("`", "") for line in lines]
    commands = [re.sub(r" {2,}\((.+)\)$", r"  # \1", line) for line in plain if line]
    return f"{before}```sh\n" + "\n".join(commands) + "\n```"


def _cell(text: object) -> str:
    return " ".join(str(text).split()).replace("|", "\\|")


# Python


def api(room: str) -> str:
    """Page of a room: what its ``__all__`` names and is defined in it."""
    module = importlib.import_module(f"mufly.{room}")
    shown = [n for n in getattr(module, "__all__", ()) if not isinstance(getattr(module, n), types.ModuleType)]
    text = [f"# `mufly.{room}`", "", _first_paragraph(module.__doc__), ""]
    kinds: dict[str, list[str]] = {"Functions": [], "Classes": [], "Values": []}
    for name in shown:
        thing = getattr(module, name)
        home = getattr(thing, "__module__", "") or ""
        if not callable(thing) or not home.startswith("mufly."):
            kinds["Values"].append(name)
        elif home.startswith(f"mufly.{room}"):  # what another room makes is described there
            kinds["Classes" if inspect.isclass(thing) else "Functions"].append(name)
    for title, names in kinds.items():
        if not names:
            continue
        text += [f"## {title}", ""]
        for name in sorted(names, key=str.lower):
            text += _entry(module, room, name, title)
    return "\n".join(text) + "\n"


def _entry(module: types.ModuleType, room: str, name: str, kind: str) -> list[str]:
    if kind == "Values":
        value = repr(getattr(module, name))
        short = value if len(value) < 80 and " object at " not in value and "<function" not in value else ""
        return [f"`{name}`{f' = `{short}`' if short else ''}", ""]
    directive, options = ("autoclass", [":members:"]) if kind == "Classes" else ("autofunction", [])
    return [
        "```{eval-rst}",
        f".. {directive}:: mufly.{room}.{name}",
        *(f"   {o}" for o in options),
        "```",
        "",
    ]


def _first_paragraph(doc: str | None) -> str:
    return " ".join(inspect.cleandoc(doc or "").split("\n\n")[0].split())


# Files


def vehicle_file() -> str:
    """Every table and key of a vehicle file."""
    text = [
        "# Vehicle files",
        "",
        "[Vehicle files](../reference/vehicles.md) explains the format. `mufly vehicle show mufly-1.1 --toml` and "
        "`mufly new` write a file to start from. Each number is a table:",
        "",
        '    mass = { value = 95, unit = "g", source = "measured", std = 0.1, note = "kitchen scale" }',
        "",
        f"`source` is one of {', '.join(f'`{s}`' for s in typing.get_args(ValueSource))}; `std` (standard "
        f"deviation in the same "
        "unit) and `note` are optional. Every unit of the right dimension is accepted and converted to SI.",
        "",
    ]
    return "\n".join(text + list(_groups(Vehicle, "")))


def rotor_file() -> str:
    """Every table and key of a rotor file."""
    return "\n".join(["# Rotor files", "", "See also [rotor theory](../explanation/bemt.md).", "", *_groups(Rotor, "")])


def mission_file() -> str:
    """Every table and key of a mission file."""
    text = [
        "# Mission files",
        "",
        "[Missions](../reference/missions.md) explains the file. Each key ends in its unit.",
        "",
    ]
    return "\n".join(text + list(_groups(Mission, "")))


PARAMETER_VEHICLE = "mufly-1.1"
"""The built-in vehicle whose defaults and ranges the page of parameters gives."""


def parameters() -> str:
    """Every parameter that may be changed in flight: unit, default, range, effect and key of the mission file."""
    vehicle = load_vehicle(PARAMETER_VEHICLE)
    controller = design_flight_controller(vehicle)
    software = FlightSoftware(vehicle, controller, load_mission("demonstration"))
    text = [
        "# Parameters",
        "",
        "Parameters can be changed in flight: in the tab *Parameters* of the "
        "[ground station](../reference/station.md), "
        f"by PARAM_SET of [MAVLink](../reference/link.md#parameters) or by `Autopilot.set_parameter` in Python. "
        f"Defaults and ranges are those of `{PARAMETER_VEHICLE}` on the mission `demonstration`. A value outside its "
        f"range is refused.",
        "",
        "- `LIM_` parameters are limits of the reference trajectory. Their maximum is at most 80 % of the limit of the "
        "controllers, so it depends on the vehicle.",
        "- `CTL_` parameters belong to the [control law](../explanation/control.md). A change takes effect with a time "
        "constant of 0.5 s; all other parameters take effect at once. Their defaults come from the controller design "
        "and no file keeps a changed value.",
        "- `STK_` parameters are the commands at full stick deflection.",
        "",
        "| name | unit | default | range | effect | key of the mission file |",
        "|---|---|---|---|---|---|",
    ]
    for p in TunableParameters(vehicle, controller, software).values():
        table, key = STORAGE_KEYS[p.name]
        kept = f"`{table}.{key}`" if table in Mission.model_fields else ""
        span = f"{p.minimum:.4g} to {p.maximum:.4g}"
        text.append(f"| `{p.name}` | {p.unit or '-'} | {p.value:.4g} | {span} | {_cell(p.description)} | {kept} |")
    return "\n".join([*text, ""])


def _groups(model: type[BaseModel], table: str) -> Iterator[str]:
    """Tables of keys, of this model and then of those inside it."""
    plain, inner = [], []
    for name, field in model.model_fields.items():
        kind, many = _model_of(field.annotation)
        extra = field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}
        if kind is not None and "unit" not in extra:
            inner.append((f"{table}.{name}".lstrip("."), kind, many))
        else:
            plain.append(_key(name, field, extra))
    if plain:
        heading = f"`[{table}]`" if table else "Top level"
        yield from ("", f"## {heading}", "", _first_paragraph(model.__doc__), "")
        yield from (
            "| key | meaning | symbol | unit | limits | default |",
            "|---|---|---|---|---|---|",
            *plain,
            "",
        )
    for path, kind, many in inner:
        yield from _groups(kind, f"[{path}]" if many else path)


def _model_of(annotation: Any) -> tuple[type[BaseModel] | None, bool]:
    """The model that a field holds, and whether it holds many."""
    if inspect.isclass(annotation) and issubclass(annotation, BaseModel):
        return annotation, False
    many = typing.get_origin(annotation) in (tuple, list)
    for part in typing.get_args(annotation):
        found, _ = _model_of(part)
        if found is not None:
            return found, many
    return None, False


def _key(name: str, field: FieldInfo, extra: dict[str, Any]) -> str:
    limits = [
        f"{k.replace('_', ' ')} {extra[k]:g}"
        for k in ("above", "at_least", "below", "at_most")
        if extra.get(k) is not None
    ]
    words = {"gt": "above", "ge": "at least", "lt": "below", "le": "at most"}
    limits += [
        f"{w} {getattr(m, k):g}"
        for m in field.metadata
        for k, w in words.items()
        if isinstance(getattr(m, k, None), int | float)
    ]
    given = field.default
    if isinstance(given, Quantity):
        otherwise = f"{given.value:g}"
    elif field.is_required():
        otherwise = "required"
    else:
        otherwise = "" if given in (None, "", ()) else f"`{given!r}`"
    cells = (
        f"`{name}`",
        field.description or "",
        extra.get("symbol", ""),
        extra.get("unit", ""),
        ", ".join(limits),
        otherwise,
    )
    return f"| {' | '.join(_cell(c) for c in cells)} |"


if __name__ == "__main__":
    asked = argparse.ArgumentParser(description="Write the reference of commands and functions.")
    asked.add_argument("folder", nargs="?", type=Path, default=Path(__file__).parent / "api")
    write(asked.parse_args().folder)
