"""What holds for all tests: Hypothesis without a clock, signals that arrive, the whole suite in several processes.

``pytest`` alone shares the tests out to a process for each core, at most four (``-n 0``: one process).
What is named (``pytest tests/rotor``) runs in one process, where a debugger can be used.
"""

from __future__ import annotations

import os
import signal
from typing import Any

import pytest
from hypothesis import settings

SHARED = "PYTEST_XDIST_WORKER" in os.environ
# Threads that wait for each other by turning round take the cores from all others: a wake of 6 s of work took 49, a
# path of 1 s took 17 on a busy machine. Both are read when NumPy and Numba are loaded, which is later.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

# A first call compiles, so an example may take seconds; and a red suite has to be red again on the next run.
settings.register_profile("mufly", deadline=None, derandomize=True)
settings.load_profile("mufly")

MOST_WORKERS = 4  # more begin by compiling the same, and starve those that fly in real time
TOGETHER = ("tests/interop",)  # folders whose tests share what is flown for them
EARLY = (
    # Each of these compiles what many others need: they begin beside each other, not one after the other twice.
    "tests/firmware/test_estimate_c.py",
    "tests/cli/test_coax_cli.py",
    "tests/estimate/test_kalman.py",
    "tests/identify/test_flight_fit.py",
    "tests/identify/test_plan.py",
    # These take long, most of it waiting for a clock: no process is left alone with them at the end.
    "tests/interop/",
    "tests/station/page/test_browser.py",
    "tests/cli/test_fly_cli.py",
    "tests/link/test_real_time.py",
    "tests/firmware/test_firmware.py",
    "tests/flight/test_safety.py",
    "tests/identify/",
    "tests/cli/",
    "tests/firmware/",
    "tests/link/",
    "tests/flight/",
    "tests/station/",
    "tests/rotor/",
)
"""What is begun with where the tests are shared out."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the length of the runs of bad MAVLink messages."""
    parser.addoption(
        "--fuzz-messages", type=int, metavar="N",
        help="send N bad MAVLink messages in tests/link/test_fuzz.py and tests/station/test_fuzz.py, and print the "
        "findings with -s; default: short runs",
    )  # fmt: skip
    parser.addoption("--fuzz-seed", type=int, default=0, metavar="N", help="seed of --fuzz-messages; default 0")


def pytest_configure(config: pytest.Config) -> None:
    """Let Ctrl-C arrive: a shell that starts a program in the background has it ignored by all that it starts."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """As many processes as there are cores for the whole suite, one for what is named."""
    if config.args_source is not pytest.Config.ArgsSource.TESTPATHS:
        return 0
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(MOST_WORKERS, cores)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Share out whole files, so that what a file's tests share is made once; the longest begin."""
    from xdist.scheduler import LoadScopeScheduling

    class ByFile(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = nodeid.partition("::")[0]
            return next((folder for folder in TOGETHER if file.startswith(f"{folder}/")), file)

    return ByFile(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with what takes longest where the tests are shared out."""
    if SHARED:
        place = {name: k for k, name in enumerate(EARLY)}
        items.sort(key=lambda item: min((place[n] for n in place if item.nodeid.startswith(n)), default=len(place)))
