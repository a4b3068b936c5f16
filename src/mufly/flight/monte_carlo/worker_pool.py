"""Execution of a campaign on all cores or a cluster, with stored results; search for the worst case by CMA-ES.

Every finished flight becomes a line of ``flights.jsonl`` at once, so that an abort loses only the flights in progress.
``campaign.json`` holds the hash of the campaign's settings: a folder resumes the same campaign and refuses another.
"""

from __future__ import annotations

import functools
import gc
import math
import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import cma
import numpy as np
from threadpoolctl import threadpool_limits

from mufly.errors import ArgumentError, MuflyError
from mufly.files.answer_store import StoredResultLines, claim_folder
from mufly.flight.monte_carlo.campaign import Campaign, FlightCase, FlightResult, fly_case
from mufly.results import to_plain_data
from mufly.study.sweeps import open_executor
from mufly.version import __version__

ProgressCallback = Callable[[int, int], None]
StopCheck = Callable[[], bool]

RESULTS_FILE, SETTINGS_FILE = "flights.jsonl", "campaign.json"
_QUEUED_FLIGHTS_PER_WORKER = 2  # flights queued for each worker, so that no worker is idle
_QUEUED_FLIGHTS_ON_CLUSTER = 256


class WorkerPool:
    """Pool of workers that simulate flights: local processes, threads, or a dask cluster. A context manager.

    Parameters
    ----------
    jobs : int, optional
        Number of workers; default one per core. A single worker runs in this process.
    cluster : str, optional
        Address of a dask scheduler, as ``tcp://host:8786``; its workers need mufly.
    how : "processes" or "threads"
        Threads run Python code one at a time; use them where processes are unavailable.
    """

    def __init__(
        self,
        jobs: int | None = None,
        *,
        cluster: str | None = None,
        how: Literal["processes", "threads"] = "processes",
    ) -> None:
        self.worker_count = jobs or os.cpu_count() or 1
        self._cluster, self._how = cluster, how
        self._ahead = (
            _QUEUED_FLIGHTS_ON_CLUSTER if cluster is not None else _QUEUED_FLIGHTS_PER_WORKER * self.worker_count
        )

    def __enter__(self) -> WorkerPool:
        self._opened = self._open_executor()
        self._executor = self._opened.__enter__()
        return self

    def __exit__(self, *exc: Any) -> None:
        self._opened.__exit__(*exc)

    @contextmanager
    def _open_executor(self) -> Iterator[Executor]:
        if self._cluster is not None or self._how == "threads":
            with open_executor(self._cluster, self.worker_count) as executor:
                yield executor
        elif self.worker_count == 1:
            gc.freeze()  # excludes imported objects from garbage collection
            try:
                with ThreadPoolExecutor(1) as alone:
                    yield alone
            finally:
                gc.unfreeze()
        else:
            pool = ProcessPoolExecutor(self.worker_count, _process_context(), initializer=_initialise_worker)
            try:
                yield pool
            finally:
                pool.shutdown(wait=True, cancel_futures=True)

    def fly_cases(
        self,
        campaign: Campaign,
        cases: Iterable[tuple[FlightCase, Path | None]],
        stop: StopCheck = lambda: False,
    ) -> Iterator[FlightResult]:
        """Yield results as flights end, in any order; a path beside a case receives its recording.

        Once ``stop`` returns True, no more flights begin, and running ones are completed.

        Raises
        ------
        MuflyError
            If a worker process has ended.
        """
        todo, flying = iter(cases), set[Future[FlightResult]]()
        more = True
        packed = pickle.dumps(campaign) if isinstance(self._executor, ProcessPoolExecutor) else None
        try:
            while True:
                while more and not stop() and len(flying) < self._ahead:
                    case, path = next(todo, (None, None))
                    more = case is not None
                    if case is not None:
                        flying.add(
                            self._executor.submit(fly_case, campaign, case, path)
                            if packed is None
                            else self._executor.submit(_fly_packed, packed, case, path)
                        )
                if not flying:
                    return
                landed, flying = wait(flying, timeout=0.2, return_when=FIRST_COMPLETED)
                if stop():
                    more = False
                    flying = {f for f in flying if not f.cancel()}
                for future in landed:
                    yield future.result()
        except BrokenProcessPool as error:
            raise MuflyError(
                "a worker process ended (out of memory, or killed); give fewer --jobs, the same command resumes"
            ) from error
        finally:
            for future in flying:
                future.cancel()


def _fly_packed(packed: bytes, case: FlightCase, path: Path | None) -> FlightResult:
    """Simulate one flight of a pickled campaign."""
    return fly_case(_unpack_campaign(packed), case, path)


@functools.lru_cache(maxsize=1)
def _unpack_campaign(packed: bytes) -> Campaign:
    """Unpickle a campaign in a worker process; the cache gives the same object to all its flights."""
    campaign: Campaign = pickle.loads(packed)
    return campaign


def _process_context() -> Any:
    """Return a multiprocessing context; with a fork server its workers share one import of the package."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])
    return context


def _initialise_worker() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends its workers
    threadpool_limits(1)
    gc.freeze()  # excludes imported objects from garbage collection
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """End a worker process when its parent has ended."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


_OTHER_CAMPAIGN_ERROR = (
    "holds the flights of another campaign (other settings, or another version of mufly)",
    "give another folder, or delete this one",
)


def _stored_flights(
    folder: Path | None, campaign: Campaign, file: str = RESULTS_FILE
) -> StoredResultLines[FlightResult]:
    """Return the stored flights of a campaign, by index.

    Raises
    ------
    InputError
        If the folder holds another campaign, or cannot be written.
    """

    def decode_stored_flight(content: Any) -> tuple[int, FlightResult]:
        flown = FlightResult.from_json(content)
        return flown.index, flown

    if folder is None:
        return StoredResultLines(None, decode_stored_flight)
    settings = {"version": __version__, **to_plain_data(campaign_to_dict(campaign))}
    claim_folder(folder, SETTINGS_FILE, campaign.settings_hash, settings, _OTHER_CAMPAIGN_ERROR)
    return StoredResultLines(
        folder / file, decode_stored_flight, damaged=("is damaged", "delete this file; its flights are repeated")
    )


def campaign_to_dict(campaign: Campaign) -> dict[str, Any]:
    """Return a readable description of a campaign's settings, in JSON types."""
    return {
        "vehicle": campaign.vehicle_name,
        "mission": campaign.mission_name,
        "vary": [v.request_text for v in campaign.variations],
        "untold": campaign.keys_unknown_on_board,
        "told": campaign.keys_known_on_board,
        "wind_m_s": campaign.wind,
        "gust_m_s": campaign.gust,
        "sensors": campaign.sensors,
        "faults": campaign.faults,
        "seed": campaign.seed,
        "tolerance_m": campaign.tolerance_m,
        "redesign": campaign.redesign,
    }


def run_campaign(
    campaign: Campaign,
    flights: int,
    *,
    crew: WorkerPool,
    folder: Path | None = None,
    progress: ProgressCallback | None = None,
    stop: StopCheck = lambda: False,
) -> list[FlightResult]:
    """Run flights 0 to ``flights`` - 1 of a campaign.

    Parameters
    ----------
    campaign : Campaign
    flights : int
        Number of flights.
    crew : WorkerPool
        Pool, entered as a context manager.
    folder : Path, optional
        Folder of the stored results, which are not computed again.
    progress : callable, optional
        Called with (flights done, total flights).
    stop : callable, optional
        Called between flights; once it returns True, no more begin.

    Returns
    -------
    list of FlightResult
        Results by index, fewer than ``flights`` after a stop. They do not depend on the workers.

    Raises
    ------
    InputError
        If the folder holds another campaign, or almost all drawn vehicles are impossible.
    """
    if flights < 1:
        raise ArgumentError("flights", "", f"{flights} flights", "give 1 or more")
    kept = _stored_flights(folder, campaign)
    known = {k: f for k, f in kept.known.items() if k < flights}
    done = dict(known)
    if progress is not None:
        progress(len(done), flights)
    todo = ((campaign.draw_case(k), None) for k in range(flights) if k not in known)
    for flown in crew.fly_cases(campaign, todo, stop):
        done[flown.index] = flown
        kept.append_result(flown.index, flown, to_plain_data(flown))
        if progress is not None:
            progress(len(done), flights)
    return [done[k] for k in sorted(done)]


def case_from_result(flown: FlightResult) -> FlightCase:
    """Return the case that repeats a flight."""
    return FlightCase(flown.index, flown.seed, flown.values, flown.wind, flown.refused)


# Worst case: the flight nearest to failure within the range of all variations


def flight_severity(flown: FlightResult, tolerance_m: float) -> float:
    """Return the severity of a flight: the largest ratio of a metric to its limit; at least 10 after a failure.

    The limits are the tolerance for waypoints, overshoot and landing, twice the tolerance for tracking, 0.5 m/s at
    touchdown, 30 degrees of tilt, and one second at an input's limit. An earlier failure is more severe.
    """
    parts = (
        (flown.waypoint_error_m, tolerance_m),
        (flown.landing_error_m, tolerance_m),
        (flown.overshoot_m, tolerance_m),
        (flown.tracking_peak_m, 2.0 * tolerance_m),
        (flown.touchdown_speed_m_s, 0.5),
        (flown.tilt_peak_deg, 30.0),
        (flown.railed_s, 1.0),
    )
    worst = max((v / most for v, most in parts if v is not None), default=0.0)
    if flown.success:
        return min(worst, 9.0)
    return 10.0 + 10.0 / (1.0 + (flown.duration_s or 0.0) / 60.0)


def search_worst_case(
    campaign: Campaign,
    flights: int,
    *,
    crew: WorkerPool,
    folder: Path | None = None,
    progress: ProgressCallback | None = None,
    stop: StopCheck = lambda: False,
) -> list[FlightResult]:
    """Find the worst flight within the variations by CMA-ES (Hansen, The CMA Evolution Strategy, arXiv:1604.00772).

    The search varies vehicle parameters and the direction of the wind; gusts and sensor noise are those of flight 0.

    Parameters
    ----------
    campaign, crew, folder, progress, stop
        See :func:`run_campaign`.
    flights : int
        Number of flights, rounded up to whole generations.

    Returns
    -------
    list of FlightResult
        Results in the order of the search. A flight of an impossible vehicle fails before its start and does not
        count.

    Raises
    ------
    InputError
        If the campaign varies only noise.
    """
    n = campaign.search_dimension
    if n == 0:
        raise ArgumentError("search", "", "only the noise varies", "vary something with --vary or --wind")
    kept = _stored_flights(folder, campaign, "search.jsonl")
    size = 4 + int(3 * math.log(max(n, 2)))
    total = max(1, math.ceil(flights / size)) * size
    options = {
        "bounds": [-1.0, 1.0], "popsize": size, "seed": campaign.seed % (2**31) + 1, "verbose": -9, "maxiter": 10**9,
        "tolfun": 0, "tolx": 0,
    }  # fmt: skip
    # pycma needs two dimensions or more; the flights do not depend on an added one.
    strategy = cma.CMAEvolutionStrategy(np.zeros(max(n, 2)), 0.5, options)
    found: dict[int, FlightResult] = {}
    for first in range(0, total, size):
        points = strategy.ask()
        cases = [campaign.case_at_point(np.asarray(p)[:n], first + k) for k, p in enumerate(points)]
        known = {k: f for k, f in kept.known.items() if first <= k < first + size}
        landed = dict(known)
        for flown in crew.fly_cases(campaign, ((c, None) for c in cases if c.index not in known), stop):
            landed[flown.index] = flown
            kept.append_result(flown.index, flown, to_plain_data(flown))
            if progress is not None:
                progress(len(found) + len(landed), total)
        found |= landed
        if len(landed) < size:
            break
        strategy.tell(points, [_search_cost(landed[first + k], campaign) for k in range(size)])
    return [found[k] for k in sorted(found)]


def _search_cost(flown: FlightResult, campaign: Campaign) -> float:
    return 0.0 if _has_impossible_vehicle(flown) else -flight_severity(flown, campaign.tolerance_m)


def _has_impossible_vehicle(flown: FlightResult) -> bool:
    return flown.reason.startswith("did not fly")


def sort_by_severity(flights: Sequence[FlightResult], tolerance_m: float) -> list[FlightResult]:
    """Return flights sorted by severity, the worst first."""
    return sorted(
        (f for f in flights if not _has_impossible_vehicle(f)),
        key=lambda f: (-flight_severity(f, tolerance_m), f.index),
    )
