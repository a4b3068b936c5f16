"""Endpoints are read as people write them, and faults are explained in one line."""

import pytest

from mufly.errors import InputError
from mufly.link import Endpoint, parse_endpoint


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("udp:127.0.0.1:14550", Endpoint("udpout", "127.0.0.1", 14550)),
        ("udpin:0.0.0.0:14550", Endpoint("udpin", "0.0.0.0", 14550)),
        ("UDPIN:14550", Endpoint("udpin", "127.0.0.1", 14550)),
        ("udpout:drone.local:14550", Endpoint("udpout", "drone.local", 14550)),
        ("udp:[::1]:14550", Endpoint("udpout", "::1", 14550)),
        ("tcp:localhost:5760", Endpoint("tcp", "localhost", 5760)),
        ("tcpin::5760", Endpoint("tcpin", "127.0.0.1", 5760)),
        ("serial:/dev/ttyUSB0:115200", Endpoint("serial", "/dev/ttyUSB0", 115200)),
        ("serial:/dev/ttyUSB0", Endpoint("serial", "/dev/ttyUSB0", 57600)),
        (
            "serial:/dev/serial/by-path/pci-0000:00:14.0-usb-0:1:1.0-port0:9600",
            Endpoint("serial", "/dev/serial/by-path/pci-0000:00:14.0-usb-0:1:1.0-port0", 9600),
        ),
        ("serial:COM3:57600", Endpoint("serial", "COM3", 57600)),
    ],
)
def test_forms(text, expected):
    assert parse_endpoint(text, "vehicle") == expected


def test_plain_udp_means_what_each_side_does_by_custom():
    assert parse_endpoint("udp:127.0.0.1:14550", "vehicle").kind == "udpout"
    assert parse_endpoint("udp:127.0.0.1:14550", "station").kind == "udpin"


def test_an_endpoint_reads_back_from_its_text():
    for text in ("udpin:[::]:14550", "tcp:10.0.0.1:5760", "serial:/dev/ttyACM0:57600"):
        end = parse_endpoint(text, "station")
        assert parse_endpoint(str(end), "vehicle") == end


@pytest.mark.parametrize(
    "text",
    [
        "",
        "udp",
        "14550",
        "usb:x:1",
        "udp:127.0.0.1",
        "udp:::1:14550",
        "udp:[fff]:14550",
        "udp:a:70000",
        "udp:a:0",
        "udp:a:-1",
        "udp:a:x",
        "udp:a:१४",
        "serial:",
        "serial:/dev/x:1",
        "tcp:",
    ],
)
def test_faults_are_one_line_with_an_example(text):
    with pytest.raises(InputError, match=r"endpoint: .*; ") as caught:
        parse_endpoint(text, "vehicle")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "open_to_others"),
    [
        ("udpin:127.0.0.1:1", False),
        ("udpin:localhost:1", False),
        ("udpin:[::1]:1", False),
        ("udpin:0.0.0.0:1", True),
        ("tcpin:192.168.0.7:1", True),
        ("udpout:192.168.0.7:1", False),
    ],
)
def test_who_can_reach_it(text, open_to_others):
    assert parse_endpoint(text, "station").is_beyond_loopback is open_to_others
