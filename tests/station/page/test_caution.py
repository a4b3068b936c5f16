"""What speaks against sending a vehicle off, and what is asked for twice."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mufly.estimate import Estimate
from mufly.mission import Fence, Mission
from mufly.station import PreflightCheck, VehicleSnapshot
from mufly.station.page.command_checks import (
    CONFIRM_TIMEOUT_S,
    Confirmation,
    check_destination,
    describe_battery,
    encode_fence,
    failed_check_names,
)

HERE = replace(Estimate(), position=np.array([0.0, 0.0, -1.0]))
FLIES = VehicleSnapshot(connected=True, armed=True, flying=True, state="hover", estimate=HERE, battery_left_s=300.0)


@pytest.mark.parametrize(
    ("fence", "place", "left_s", "refused", "beware"),
    [
        (None, (2.0, 1.0, -1.0), 300.0, "", ""),
        (None, (0.0, 500.0, -1.0), 300.0, "flight there and landing take 14:", ""),
        (None, (0.0, 30.0, -1.0), 300.0, "", "30 m away, no geofence"),
        (None, (0.0, 30.0, -1.0), 70.0, "", "battery time left is 1:10"),
        (None, (0.0, 30.0, -1.0), math.nan, "", "no geofence"),
        (Fence(centre_m=(0.0, 0.0), radius_m=40.0), (0.0, 30.0, -1.0), 300.0, "", ""),
        (Fence(centre_m=(0.0, 0.0), radius_m=10.0), (0.0, 30.0, -1.0), 300.0, "20 m outside the fence's circle", ""),
        (Fence(ceiling_m=2.0), (0.0, 1.0, -3.0), 300.0, "1.00 m above the fence's ceiling", ""),
    ],
)  # fmt: skip
def test_a_place_is_refused_or_asked_for_twice(
    fence: Fence | None, place: Any, left_s: float, refused: str, beware: str
) -> None:
    errand = check_destination(replace(FLIES, battery_left_s=left_s), fence, Mission(), place)
    for said, words in ((errand.refusal_reason, refused), (errand.caution_reason, beware)):
        assert words in said
        assert bool(said) == bool(words)


def test_a_second_press_counts_within_three_seconds_and_of_the_same() -> None:
    now = [100.0]
    confirm = Confirmation(lambda: now[0])
    assert not confirm.register_press("land")
    assert not confirm.register_press("take-off")  # another
    assert not confirm.register_press("land")
    now[0] += CONFIRM_TIMEOUT_S + 0.1
    assert not confirm.would_be_second_press("land")
    assert not confirm.register_press("land")
    now[0] += 1.0
    assert confirm.register_press("land")
    assert not confirm.register_press("land")  # the next one begins anew


def test_failed_checks_are_named_and_what_cannot_be_judged_is_no_failure() -> None:
    checks = [PreflightCheck("heartbeat", True, ""), PreflightCheck("battery", False, ""),
              PreflightCheck("free disk space", None, ""), PreflightCheck("vehicle's pre-arm checks", False, ""),
              PreflightCheck("endurance", False, "")]  # fmt: skip
    assert failed_check_names(checks) == ["battery", "endurance"]


@pytest.mark.parametrize(
    ("charge", "left_s", "words"),
    [
        (0.8, 240.0, ("", "80 %, 4:00 left")),
        (0.29, 240.0, ("warning", "29 %, 4:00 left")),
        (0.5, 59.0, ("warning", "50 %, 0:59 left")),
        (0.15, 40.0, ("error", "15 %, 0:40 left")),
        (0.5, 25.0, ("error", "50 %, 0:25 left")),
        (0.5, math.nan, ("", "50 %")),
        (math.nan, math.nan, None),
    ],
)
def test_the_battery_in_words(charge: float, left_s: float, words: Any) -> None:
    assert describe_battery(replace(FLIES, battery_charge=charge, battery_left_s=left_s)) == words


def test_a_fence_is_drawn_with_its_zones_and_ceiling() -> None:
    square = ((0.0, 0.0), (2.0, 0.0), (2.0, 2.0))
    drawn = encode_fence(Fence(polygon_m=square, keep_out_circles_m=((1.0, 0.5, 0.2),), ceiling_m=2.0))
    assert drawn is not None
    assert [zone["in"] for zone in drawn["zones"]] == [True, False]
    assert drawn["zones"][0]["p"] == list(square)
    assert drawn["ceiling"] == 2.0
    assert encode_fence(None) is None
