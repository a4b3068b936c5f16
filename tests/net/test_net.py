"""The quick part of the net: what commands answer and how they refuse. The whole of it: ``tests/net/net.py check``."""

import importlib.util
import sys
from pathlib import Path

import pytest

_spec = importlib.util.spec_from_file_location("mufly_net", Path(__file__).with_name("net.py"))
assert _spec is not None
assert _spec.loader is not None
net = importlib.util.module_from_spec(_spec)
sys.modules["mufly_net"] = net
_spec.loader.exec_module(net)
KEPT = net.frozen()


@pytest.mark.parametrize("name", sorted(net.QUICK))
def test_answers_are_those_that_were_frozen(name: str) -> None:
    found = [line for line, _ in net.differences(KEPT[name], net.now(name), digits=5)]
    assert not found, "\n".join(found[:20])


def test_everything_has_been_frozen_and_nothing_else() -> None:
    assert set(KEPT) == set(net.CASES)
