"""Ports over real sockets on loopback: what is sent arrives, what breaks is mended, nothing raises or blocks."""

import contextlib
import os
import socket
import time

import pytest

from mufly.errors import InputError
from mufly.link import Endpoint, open_port, parse_endpoint, wait_for_input
from mufly.link.ports import MAX_PEERS, RECONNECT_PERIOD_S


def gather(port, until, seconds=3.0):
    """Receive until ``until(bytes so far)``."""
    data, end = b"", time.monotonic() + seconds
    while not until(data) and time.monotonic() < end:
        wait_for_input([port], 0.02)
        data += b"".join(part for _, part in port.receive_bytes())
    return data


def listening(kind):
    return open_port(parse_endpoint(f"{kind}:127.0.0.1:0", "station", least_port=0))


def test_udp_there_and_back():
    with contextlib.closing(listening("udpin")) as here:
        there = open_port(Endpoint("udpout", "127.0.0.1", here.bound_port_number))
        there.send_frame(None, b"hello")
        wait_for_input([here], 1.0)
        ((peer, data),) = here.receive_bytes()
        assert data == b"hello"
        here.send_frame(peer, b"back")
        assert gather(there, lambda d: d) == b"back"
        assert there.reachable_peers[0].address == f"127.0.0.1:{here.bound_port_number}"
        assert (there.configured_targets, here.configured_targets) == (there.reachable_peers, [])
        there.close()


def test_udp_to_nobody_is_silent():
    with contextlib.closing(listening("udpin")) as taken:
        number = taken.bound_port_number
    port = open_port(Endpoint("udpout", "127.0.0.1", number))
    for _ in range(5):
        port.send_frame(None, b"x")
        assert port.receive_bytes() == []
    port.close()


def test_udp_serves_many_but_not_without_end():
    with contextlib.closing(listening("udpin")) as here:
        callers = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(MAX_PEERS + 5)]
        for caller in callers:
            caller.sendto(b"x", ("127.0.0.1", here.bound_port_number))
            wait_for_input([here], 1.0)
            here.receive_bytes()
            caller.close()
        assert len(here.reachable_peers) == MAX_PEERS


def test_tcp_serves_several_and_notices_who_hangs_up():
    with contextlib.closing(listening("tcpin")) as server:
        callers = [open_port(Endpoint("tcp", "127.0.0.1", server.bound_port_number)) for _ in range(3)]
        for k, caller in enumerate(callers):
            gather(caller, lambda _, c=caller: c.reachable_peers)
            caller.send_frame(None, bytes([65 + k]))
        assert sorted(gather(server, lambda d: len(d) == 3)) == [65, 66, 67]
        server.send_frame(None, b"all")
        assert all(gather(c, lambda d: len(d) == 3) == b"all" for c in callers)
        callers[0].close()
        gather(server, lambda _: len(server.reachable_peers) == 2)
        assert len(server.reachable_peers) == 2
        assert any("disconnected" in n for n in server.take_notices())
        for caller in callers[1:]:
            caller.close()


def test_tcp_calls_again_until_there_is_an_answer_and_says_so_once():
    with contextlib.closing(listening("tcpin")) as server:
        number = server.bound_port_number
    port = open_port(Endpoint("tcp", "127.0.0.1", number))
    gather(port, lambda _: False, 0.1)
    port.receive_bytes()
    assert [("cannot connect" in n) for n in port.take_notices()] == [True]
    server = open_port(Endpoint("tcpin", "127.0.0.1", number))
    gather(port, lambda _: server.receive_bytes() or port.reachable_peers, 3.0 * RECONNECT_PERIOD_S)
    assert port.reachable_peers
    server.close()
    gather(port, lambda _: not port.reachable_peers)
    said = port.take_notices()
    assert sum("connected" in n for n in said) == 1
    assert sum("lost" in n for n in said) == 1
    port.close()


def test_a_reader_that_does_not_read_costs_whole_frames_and_no_time():
    with contextlib.closing(listening("tcpin")) as server:
        lazy = socket.create_connection(("127.0.0.1", server.bound_port_number))
        gather(server, lambda _: server.reachable_peers, 1.0)
        frame = bytes(range(250))
        for _ in range(60_000):
            server.send_frame(None, frame)
        lazy.settimeout(0.5)
        data = bytearray()
        with contextlib.suppress(TimeoutError):
            while True:
                data += lazy.recv(1 << 20)
                server.receive_bytes()
        assert len(data) < 60_000 * 250  # some were dropped
        assert data == frame * (len(data) // 250)  # none was cut
        lazy.close()


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="needs a pseudo terminal")
def test_a_serial_cable_that_is_pulled_and_put_back(tmp_path):
    device = tmp_path / "ttyUSB0"
    port = open_port(Endpoint("serial", str(device), 57600))
    port.receive_bytes()
    assert "cannot connect" in port.take_notices()[0]

    def plug():
        ours, theirs = os.openpty()
        device.unlink(missing_ok=True)
        device.symlink_to(os.ttyname(theirs))
        gather(port, lambda _: port.reachable_peers, 3.0 * RECONNECT_PERIOD_S)
        os.close(theirs)
        return ours

    cable = plug()
    assert port.reachable_peers
    os.write(cable, b"abc\x00\xff\r\n")
    assert gather(port, lambda d: len(d) == 7) == b"abc\x00\xff\r\n"
    port.send_frame(None, b"\xfdxyz\n")
    assert os.read(cable, 100) == b"\xfdxyz\n"
    for _ in range(2000):  # nobody reads: the line fills, and send returns
        port.send_frame(None, bytes(250))
    assert len(port._lines[port.reachable_peers[0]]._waiting) <= 0.3 * 57600 / 10 + 1  # nothing grows old in here
    os.close(cable)
    gather(port, lambda _: not port.reachable_peers)
    assert not port.reachable_peers
    assert sum("lost" in n for n in port.take_notices()) == 1
    os.close(plug())
    assert "connected" in " ".join(port.take_notices())
    port.close()


def test_a_port_in_use_and_an_unknown_host_are_one_line():
    with contextlib.closing(listening("udpin")) as here, pytest.raises(InputError, match="cannot listen"):
        open_port(Endpoint("udpin", "127.0.0.1", here.bound_port_number))
    with pytest.raises(InputError, match="not known"):
        open_port(Endpoint("udpout", "no such host.invalid", 1))


@pytest.mark.parametrize("kinds", [("udpin", "udpout"), ("tcpin", "tcp")])
def test_what_waited_unheard_is_thrown_away_and_the_line_goes_on(kinds):
    """As after a stop of the process: of a stream more waits at the other end, so it is called again."""
    with contextlib.closing(listening(kinds[0])) as here:
        there = open_port(Endpoint(kinds[1], "127.0.0.1", here.bound_port_number))
        until = time.monotonic() + 5.0
        while not there.reachable_peers and time.monotonic() < until:
            there.receive_bytes(), here.receive_bytes()
        there.send_frame(None, b"first")
        assert gather(here, lambda d: d == b"first") == b"first"
        for _ in range(400):
            there.send_frame(None, b"land")
        wait_for_input([here], 1.0)
        here.discard_input()
        assert here.receive_bytes() == []
        there._retry_s = -RECONNECT_PERIOD_S  # it may call at once
        until = time.monotonic() + 5.0
        while time.monotonic() < until:
            there.receive_bytes(), here.receive_bytes()
            there.send_frame(None, b"now")
            if b"now" in (data := gather(here, lambda d: d, 0.1)):
                break
        assert b"now" in data
        assert b"land" not in data
        there.close()


def test_a_connection_that_nobody_acknowledges_is_given_up_soon_with_what_waits_in_it():
    with contextlib.closing(listening("tcpin")) as here, contextlib.closing(socket.socket()) as caller:
        caller.connect(("127.0.0.1", here.bound_port_number))
        wait_for_input([here], 1.0)
        here.receive_bytes()
        ((line, _),) = here._lines.values()
        assert 0 < line.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) <= 3000


def test_a_serial_device_that_cannot_be_used_is_told_as_what_it_is(tmp_path):
    """And told until it can: missing, no serial device, taken by another program, unplugged."""
    file, here = tmp_path / "no-device", tmp_path / "cable"
    file.write_text("")
    for path, words in ((tmp_path / "none", "there is no such device"), (file, "it is no serial device")):
        port = open_port(Endpoint("serial", str(path), 57600))
        port.receive_bytes()
        assert port.problem.startswith(f"serial:{path}:57600: cannot connect ({words}")
        port.close()
    ours, theirs = os.openpty()
    here.symlink_to(os.ttyname(theirs))
    port, other = (open_port(Endpoint("serial", str(here), 57600)) for _ in range(2))
    port.receive_bytes()
    assert port.problem == ""
    other.receive_bytes()
    assert "another program uses it" in other.problem
    other.close()
    os.close(ours)
    os.close(theirs)
    here.unlink()
    for _ in range(3):
        port.receive_bytes()
        port._retry_s = -RECONNECT_PERIOD_S
    assert "there is no such device; plug it in" in port.problem
    port.close()
