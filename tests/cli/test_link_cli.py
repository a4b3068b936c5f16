"""``mufly link`` as a user meets it: in a process, over a real socket, ended by Ctrl-C."""

import os
import signal
import socket
import subprocess
import sys
import time

import pytest
from typer.testing import CliRunner

from mufly.cli import app
from mufly.errors import InputError
from mufly.link import Codec
from mufly.logs import read_log


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--link", "bogus"], "no MAVLink endpoint"),
        (["--link", "udpin:14998", "--link", "udpin:127.0.0.1:14998"], "given twice"),
        (["--system", "0"], "--system"),
        (["--origin", "north pole"], "no place on the globe"),
        (["--wind", "strong"], "no wind"),
        (["no-such-mission"], "no such mission"),
        (["--vehicle", "no-such-vehicle"], "no such vehicle"),
    ],
)
def test_what_is_wrong_is_told_before_anything_starts(arguments, says):
    result = CliRunner().invoke(app, ["link", *arguments])
    assert isinstance(result.exception, InputError)
    assert says in str(result.exception)


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_it_flies_until_ctrl_c_and_leaves_whole_recordings(tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
        station.bind(("127.0.0.1", 0))
        station.settimeout(30.0)
        end = f"udp:127.0.0.1:{station.getsockname()[1]}"
        command = [sys.executable, "-c", "from mufly.cli import main; main()", "link", "--link", end]
        process = subprocess.Popen(
            [*command, "--out", tmp_path, "--system", "9"],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env={**os.environ, "COLUMNS": "200"},
        )
        try:
            codec = Codec()
            heard = []
            while not any(x.get_type() == "SYS_STATUS" for x in heard):
                heard += codec.receive(time.monotonic(), "vehicle", station.recv(1000))
            time.sleep(0.5)
            process.send_signal(signal.SIGINT)
            said, _ = process.communicate(timeout=20.0)
        finally:
            process.kill()
    assert process.returncode == 130
    assert heard[0].get_srcSystem() == 9
    assert "MAVLink system 9" in said
    assert "ready for no mission" in said
    assert "Traceback" not in said
    assert read_log(tmp_path / "flight.mcap").attrs["complete"]
    assert read_log(tmp_path / "link.tlog").sizes["time"] > 5


def test_the_help_has_examples():
    result = CliRunner().invoke(app, ["link", "--help"])
    assert result.exit_code == 0
    assert "mufly link box-on-leg" in result.output
