"""docs/reference/link.md and the tables of the code say the same."""

import re
from pathlib import Path

import pytest
from link_rig import Rig

from mufly.link import (
    COMMAND_HANDLERS,
    LINK_PARAMETERS,
    MESSAGE_REQUEST_COMMANDS,
    MESSAGE_STREAMS,
    MISSION_STATES,
    mavlink,
    pack_custom_mode,
    px4_mode_from_state,
)

PAGE = (Path(__file__).parents[2] / "docs" / "reference" / "link.md").read_text(encoding="utf-8")


def table(head):
    """Rows of the table whose head begins so."""
    lines = PAGE[PAGE.index(f"| {head}") :].splitlines()[2:]
    rows = []
    for line in lines:
        if not line.startswith("|"):
            break
        rows.append([cell.strip() for cell in line.strip("|").split("|")])
    return rows


def test_messages_and_rates():
    assert [(name, float(rate)) for name, rate, _ in table("message | default")] == [
        (s.message_name, s.default_rate_Hz) for s in MESSAGE_STREAMS
    ]


def test_commands():
    said = {int(number): name for name, number, _ in table("command | number")}
    assert set(said) == {*COMMAND_HANDLERS, *MESSAGE_REQUEST_COMMANDS}
    for number, name in said.items():
        assert getattr(mavlink, f"MAV_CMD_{name}") == number


def test_items():
    for name, number, _ in table("item | number"):
        assert getattr(mavlink, f"MAV_CMD_{name}") == int(number)


def test_modes():
    for states, mode, _ in table("mission state | mode"):
        main, sub = map(int, re.search(r"\((\d), (\d)\)", mode).groups())
        for state in states.split(", "):
            if state in MISSION_STATES:
                assert pack_custom_mode(px4_mode_from_state(state)) == main << 16 | sub << 24


def test_parameters():
    said = {name: [float(x) for x in re.findall(r"[\d.]+", f"{value} {span}")] for name, value, span, _ in
            table("parameter | default")}  # fmt: skip
    assert said == {name: [p.value, p.minimum, p.maximum] for name, p in LINK_PARAMETERS.items()}


def test_states_are_numbered_as_they_are():
    assert dict(re.findall(r"(\d) ([a-z-]+)", re.search(r"machine: (.*?) \|", PAGE).group(1))) == {
        str(k): state for k, state in enumerate(MISSION_STATES)
    }


def test_the_default_streams_fit_a_radio():
    """5 kB/s, and 5.76 kB/s are what 57600 baud carry."""
    rig = Rig()
    gcs = rig.station()
    rig.run(1.5)
    sizes = []
    gcs.hear = lambda data: sizes.append(len(data))
    rig.run(4.0)
    assert sum(sizes) / 4.0 == pytest.approx(5000.0, rel=0.05)


HOW_TO = Path(__file__).parents[2] / "docs" / "how-to" / "ground-stations.md"


@pytest.mark.parametrize("name", ["fly_with_mavsdk.py", "fly_with_pymavlink.py"])
def test_examples_are_there(name):
    assert f"](../examples/{name})" in HOW_TO.read_text(encoding="utf-8")
    assert (HOW_TO.parent / "../examples" / name).exists()
