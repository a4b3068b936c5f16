"""How far a start is: its stages by a stepped clock, and the page that tells them until another is served."""

import http.client
import json
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from mufly.station.page.page_address import COOKIE_NAME, PageAddress, bind_page_address, hash_token_for_cookie
from mufly.station.page.page_session import StationSession
from mufly.station.page.start_page import StartPage, Startup

TOKEN = "a-token-for-tests"


class Clock:
    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def startup(clock: Clock) -> Startup:
    """Libraries took 3 s, controllers 0.2 s; the model has been compiled for 12 s."""
    made = Startup("mufly-1.1 flies square", clock)
    for text, seconds in (("loading the libraries", 3.0), ("designing the controllers", 0.2)):
        made.begin_stage(text)
        clock.now_s += seconds
    made.begin_stage("compiling the model")
    clock.now_s += 12.0
    return made


@pytest.fixture(params=["", TOKEN])
def address(request: pytest.FixtureRequest) -> Iterator[PageAddress]:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = int(probe.getsockname()[1])
    found = bind_page_address("127.0.0.1", port, request.param or None)
    yield found
    found.socket.close()


def get(address: PageAddress, path: str, **headers: str) -> tuple[int, str]:
    connection = http.client.HTTPConnection("127.0.0.1", address.port, timeout=5)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    text = answer.read().decode()
    connection.close()
    return answer.status, text


def test_every_stage_has_its_seconds(startup: Startup, clock: Clock) -> None:
    startup.begin_stage("compiling the model")  # said twice, it goes on
    told = startup.status_fields()
    assert [text for text, _, _ in told["stages"]] == [
        "loading the libraries",
        "designing the controllers",
        "compiling the model",
    ]
    assert [seconds for _, seconds, _ in told["stages"]] == pytest.approx([3.0, 0.2, 12.0])
    assert [ended for _, _, ended in told["stages"]] == [True, True, False]
    assert startup.describe_stage() == "compiling the model, 12 s"
    startup.mark_succeeded()
    clock.now_s += 50.0
    startup.begin_stage("something else")
    assert startup.describe_duration() == "15 s (loading the libraries 3 s; compiling the model 12 s)"


def test_a_stage_is_said_once_and_the_end_of_all(clock: Clock) -> None:
    said: list[str] = []
    startup = Startup(clock=clock)
    startup.on_change = said.append
    for text in ("a", "a", "b"):
        startup.begin_stage(text)
    startup.end_with_fault("no room on the disk")
    startup.mark_succeeded()
    assert said == ["a", "b", ""]
    assert (startup.is_done, startup.fault) == (True, "no room on the disk")


def test_a_window_is_told_until_the_vehicle_stands_and_why_it_does_not(startup: Startup) -> None:
    session = StationSession(lambda: [], Path(), startup=startup)
    view = session.open_view("one")
    assert view.status_fields()["start"]["stages"][-1][0] == "compiling the model"
    startup.mark_succeeded()
    assert view.status_fields()["start"] is None
    startup.end_with_fault("the vehicle's process ended while it flew")  # later than the start
    assert view.status_fields()["start"]["fault"] == "the vehicle's process ended while it flew"
    session.close_view("one")
    assert session.opened_count == 1  # one that was opened and closed was opened


def test_the_page_is_there_from_the_first_moment(address: PageAddress, startup: Startup) -> None:
    with StartPage(address, startup) as page:
        query = f"?token={TOKEN}" if address.token else ""
        status, text = get(address, f"/{query}")
        assert status == 200
        assert "Starting mufly" in text
        assert startup.visit_count == 1
        status, text = get(address, f"/starting{query}")
        assert status == 200
        assert json.loads(text)["stages"][-1] == ["compiling the model", 12.0, False]
        assert startup.visit_count == 1
        assert get(address, f"/_nicegui/x{query}")[0] == 503
        page.stop_serving()
        # What calls now waits for the station's page, which answers on the same socket.
        late = socket.create_connection(("127.0.0.1", address.port), timeout=5)
        late.sendall(b"GET /starting HTTP/1.0\r\n\r\n")
        found, _ = _accept(address.socket)
        found.close()
        late.close()


def _accept(listening: socket.socket) -> tuple[socket.socket, object]:
    listening.settimeout(5.0)
    return listening.accept()


def test_strangers_learn_nothing_of_a_start(address: PageAddress, startup: Startup) -> None:
    with StartPage(address, startup):
        for path in ("/", "/starting", "/?token=wrong-token"):
            if address.token:
                assert get(address, path) == (401, "the station is starting; token required")
            else:
                assert get(address, path, Host="rebound.example")[0] == 403
        assert startup.visit_count == 0
        if address.token:
            cookie = f"{COOKIE_NAME}={hash_token_for_cookie(TOKEN)}"
            assert get(address, "/", Cookie=cookie)[0] == 200
            assert get(address, "/", Cookie=f"{COOKIE_NAME}=other")[0] == 401


def test_a_start_that_fails_says_why_and_ends_at_once_where_nobody_looks(
    address: PageAddress, startup: Startup
) -> None:
    with pytest.raises(OSError, match="no such device"), StartPage(address, startup):
        raise OSError("no such device")
    assert startup.fault == "no such device"
