"""Betaflight's software in the loop ("SITL") as a program: its CLI file, over its first serial port (TCP 5761).

``#`` opens the command line, which echoes each line, answers, and prints a prompt ``#``. ``save`` writes ``eeprom.bin``
in Betaflight's working folder and ends the program: it must be started again. Two programs cannot use the port at once.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from mufly.bridges.betaflight.betaflight_messages import decode_arming_refusals, encode_status_request
from mufly.errors import MuflyError
from mufly.link.ports import Endpoint

CLI_ENDPOINT = Endpoint("tcp", "127.0.0.1", 5761)
"""Address of Betaflight's first serial port."""
STATE_PORT = 9003
"""UDP port where Betaflight receives the state of the simulated vehicle."""
_CONNECT_TIMEOUT_S, _ANSWER_TIMEOUT_S, _CONNECT_RETRY_PERIOD_S = 20.0, 20.0, 0.02
_MAX_START_ATTEMPTS, _START_TIMEOUT_S = 3, 10.0
_ERROR_MARK = b"###ERROR"


def send_cli_file(text: str, *, endpoint: Endpoint = CLI_ENDPOINT) -> None:
    """Send the lines of a CLI file and wait until Betaflight has saved them and ended.

    Parameters
    ----------
    text : str
        With ``save`` as its last command; empty lines and comments are not sent.
    endpoint : Endpoint

    Raises
    ------
    MuflyError
        If Betaflight does not answer, or refuses a line.
    """
    lines = [line.strip() for line in text.splitlines() if line.strip() and not line.startswith("#")]
    with _open_connection(endpoint) as line:
        _send_and_receive(line, b"#", endpoint)
        for command in lines[:-1] if lines and lines[-1] == "save" else lines:
            answer = _send_and_receive(line, command.encode() + b"\r\n", endpoint)
            if _ERROR_MARK in answer:
                reason = answer[answer.index(_ERROR_MARK) :].splitlines()[0].decode("ascii", "replace").strip("# ")
                raise MuflyError(f"Betaflight refuses {command!r}: {reason}; is it version 4.6 with servos?")
        line.sendall(b"save\r\n")
        _wait_for_end(line, endpoint)


def _open_connection(endpoint: Endpoint) -> socket.socket:
    end_s = time.monotonic() + _CONNECT_TIMEOUT_S
    while True:
        try:
            return socket.create_connection((endpoint.host, endpoint.port), timeout=_ANSWER_TIMEOUT_S)
        except OSError as error:
            if time.monotonic() > end_s:
                raise MuflyError(
                    f"no Betaflight answers at {endpoint} ({error.strerror or error}); start its SITL"
                ) from None
            time.sleep(_CONNECT_RETRY_PERIOD_S)


def _send_and_receive(line: socket.socket, data: bytes, endpoint: Endpoint) -> bytes:
    """Send bytes; return the answer up to the next prompt."""
    line.sendall(data)
    answer = b""
    while not answer.rstrip(b" ").endswith(b"\n#"):
        try:
            part = line.recv(65536)
        except OSError:
            part = b""
        if not part:
            raise MuflyError(
                f"Betaflight's command line at {endpoint} does not answer; close its other connections, or restart it"
            )
        answer += part
    return answer


def _wait_for_end(line: socket.socket, endpoint: Endpoint) -> None:
    try:
        while line.recv(65536):
            pass
    except TimeoutError:
        raise MuflyError(f"Betaflight at {endpoint} did not end after `save`; use Betaflight's SITL") from None
    except OSError:  # the program ended with data under way
        pass


def find_betaflight() -> Path | None:
    """Return the program of Betaflight's SITL: that of MUFLY_BETAFLIGHT, or ``betaflight_SITL`` on the PATH."""
    named = os.environ.get("MUFLY_BETAFLIGHT")
    found = named or shutil.which("betaflight_SITL")
    return Path(found) if found and Path(found).is_file() else None


@contextmanager
def run_betaflight(program: Path, folder: Path, text: str) -> Iterator[subprocess.Popen[bytes]]:
    """Start Betaflight's SITL with the settings of a CLI file, and end it after the ``with`` block.

    Parameters
    ----------
    program : Path
    folder : Path
        Working folder, for ``eeprom.bin`` and the output of the program, ``betaflight.log``; an earlier
        ``eeprom.bin`` is replaced.
    text : str
        CLI file.

    Raises
    ------
    MuflyError
        If another Betaflight runs, it does not answer, or it refuses a line.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("", STATE_PORT))
        except OSError:
            raise MuflyError(f"UDP port {STATE_PORT} is in use; end the other Betaflight") from None
    (folder / "eeprom.bin").unlink(missing_ok=True)
    with (folder / "betaflight.log").open("wb") as log:
        process = _start_program(program, folder, log)
        try:
            send_cli_file(text)
            process.wait(_ANSWER_TIMEOUT_S)
            process = _start_program(program, folder, log)
            yield process
        finally:
            process.kill()
            process.wait()


def _start_program(program: Path, folder: Path, log: IO[bytes]) -> subprocess.Popen[bytes]:
    """Start Betaflight and wait until it answers MSP; a start that hangs or crashes, as a few do, is tried again."""
    for _ in range(_MAX_START_ATTEMPTS):
        process = subprocess.Popen([program.absolute()], cwd=folder, stdout=log, stderr=subprocess.STDOUT)
        end_s = time.monotonic() + _START_TIMEOUT_S
        while process.poll() is None and time.monotonic() < end_s:
            with (
                contextlib.suppress(OSError),
                socket.create_connection((CLI_ENDPOINT.host, CLI_ENDPOINT.port), timeout=_START_TIMEOUT_S) as line,
            ):
                line.sendall(encode_status_request())
                answer = b""
                while part := line.recv(65536):
                    answer += part
                    if decode_arming_refusals(answer) is not None:
                        return process
            time.sleep(_CONNECT_RETRY_PERIOD_S)
        process.kill()
        process.wait()
    raise MuflyError(f"{program} does not answer at port {CLI_ENDPOINT.port}; see {folder / 'betaflight.log'}")
