"""``mufly link`` as a user meets it: in a process, over a real socket, ended by a signal."""

import os
import signal
import socket
import subprocess
import sys
import time

import pytest
from typer.testing import CliRunner

from mufly.cli import app
from mufly.cli.station import ShutdownHandler
from mufly.errors import InputError
from mufly.link import FrameDecoder
from mufly.logs import read_log


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--link", "bogus"], "not a MAVLink endpoint"),
        (["--link", "udpin:14998", "--link", "udpin:127.0.0.1:14998"], "given twice"),
        (["--system", "0"], "--system"),
        (["--origin", "north pole"], "not a global position"),
        (["--wind", "strong"], "--wind: 'strong' is not a number"),
        (["no-such-mission"], "no such mission"),
        (["--vehicle", "no-such-vehicle"], "no such vehicle"),
    ],
)
def test_what_is_wrong_is_told_before_anything_starts(arguments, says):
    result = CliRunner().invoke(app, ["link", *arguments])
    assert isinstance(result.exception, InputError)
    assert says in str(result.exception)


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_it_flies_until_it_is_told_to_end_and_leaves_whole_recordings(tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
        station.bind(("127.0.0.1", 0))
        station.settimeout(120.0)
        end = f"udp:127.0.0.1:{station.getsockname()[1]}"
        command = [
            sys.executable,
            "-c",
            "from mufly.cli import main; main()",
            "link",
            "--sensors",
            "ideal",
            "--link",
            end,
        ]
        process = subprocess.Popen(
            [*command, "--out", tmp_path, "--system", "9"],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env={**os.environ, "COLUMNS": "200"},
        )
        try:
            codec = FrameDecoder()
            heard = []
            while not any(x.get_type() == "SYS_STATUS" for x in heard):
                heard += codec.decode_bytes(time.monotonic(), "vehicle", station.recv(1000))
            time.sleep(0.5)
            # An impatient supervisor's second signal does not cut short the closing of files.
            process.send_signal(signal.SIGTERM)
            process.send_signal(signal.SIGTERM)
            said, _ = process.communicate(timeout=60.0)
        finally:
            process.kill()
    assert process.returncode == 128 + signal.SIGTERM
    assert heard[0].get_srcSystem() == 9
    assert "MAVLink system 9" in said
    assert "ready for no mission" in said
    assert "Traceback" not in said
    assert read_log(tmp_path / "flight.mcap").attrs["complete"]
    assert read_log(tmp_path / "link.tlog").sizes["time"] > 5


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_the_first_signal_asks_and_only_a_second_ctrl_c_no_longer_waits():
    inherited = signal.signal(signal.SIGHUP, signal.SIG_DFL)  # under nohup it is ignored, and stays so
    before = {s: signal.getsignal(s) for s in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    try:
        for number in before:
            with ShutdownHandler() as ending:
                assert (ending.stop_requested.is_set(), ending.exit_status, ending.is_hurried) == (
                    False,
                    0,
                    False,
                )
                os.kill(os.getpid(), number)
                assert (ending.stop_requested.is_set(), ending.exit_status) == (True, 128 + number)
                assert ending.is_hurried == (number != signal.SIGINT)
                os.kill(os.getpid(), signal.SIGTERM)  # again: nothing changes
                os.kill(os.getpid(), signal.SIGHUP)
                with pytest.raises(KeyboardInterrupt):
                    os.kill(os.getpid(), signal.SIGINT)
                assert ending.exit_status == 128 + number
            assert {s: signal.getsignal(s) for s in before} == before
        with pytest.raises(KeyboardInterrupt), ShutdownHandler(patient=False):
            os.kill(os.getpid(), signal.SIGTERM)
        # Under nohup a terminal that is closed ends nothing.
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        with ShutdownHandler() as ending:
            os.kill(os.getpid(), signal.SIGHUP)
            assert not ending.stop_requested.is_set()
    finally:
        signal.signal(signal.SIGHUP, inherited)
        ShutdownHandler.was_signalled = False


def test_the_help_has_examples():
    result = CliRunner().invoke(app, ["link", "--help"])
    assert result.exit_code == 0
    assert "mufly link box-on-leg" in result.output
