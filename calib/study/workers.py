"""Who computes the parts: this process, worker processes on this machine, or a Dask cluster.

Only this process writes. A part that a dying worker had begun is computed again by another one, with the same
draws, and arrives once; so nothing is lost or doubled.
"""

from __future__ import annotations

import logging
import os
import re
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import islice
from typing import Any

from calib.study.errors import ClusterError, StudyError

CONNECT_S, POLL_S, WORKERLESS_S = 10, 1, 60
WAITING_PER_WORKER = 4  # parts sent ahead: enough to keep workers busy, few enough to hold in memory
# Dask has its workers hand memory back at once, which costs a third of the time of arrays of megabytes. Ours keep it.
ENVIRONMENT = {
    "MALLOC_TRIM_THRESHOLD_": 2**28,
    "MALLOC_MMAP_THRESHOLD_": 2**25,
    "DASK_LOGGING__DISTRIBUTED": "critical",  # what ends early is told in one line here
    **dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), 1),
}


@dataclass(frozen=True)
class Workers:
    """Who is asked to compute.

    Parameters
    ----------
    number : int
        Processes on this machine, one BLAS thread each.
    cluster : str or None
        Address of a Dask scheduler, such as tcp://host:8786; then `number` does not count.
    """

    number: int
    cluster: str | None = None

    @classmethod
    def of_machine(cls) -> Workers:
        """Return one worker per core that this process may use."""
        return cls(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)


def check_distributed() -> None:
    """Say what to install where Dask is missing.

    Raises
    ------
    StudyError
    """
    if find_spec("distributed") is None:
        raise StudyError("distributed missing: pip install 'acoustic-camera-rig[study]'")


def compute(
    function: Callable[..., Any],
    arguments: Sequence[tuple[Any, ...]],
    workers: Workers,
    done: Callable[[int, Any], None],
) -> None:
    """Call a function with each of some arguments; `done` gets the index and the outcome, in any order.

    Raises
    ------
    ClusterError
        The scheduler is not there, or is lost.
    """
    if workers.cluster is None and (workers.number == 1 or len(arguments) == 1):
        for index, each in enumerate(arguments):
            done(index, function(*each))
        return
    with _client(workers) as client:
        _compute_on(client, function, arguments, done)


@contextmanager
def ended_by_sigterm() -> Iterator[None]:
    """Take SIGTERM as Ctrl-C: what was finished stays, and processes are ended in order."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def _children_deaf_to_ctrl_c() -> Iterator[None]:
    """Block SIGINT in what is started here: a terminal sends it to all, and only this process is to answer."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing.resource_tracker import ensure_running  # noqa: PLC0415 (only needed here)

    ensure_running()  # it would unblock SIGINT again
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


@contextmanager
def _client(workers: Workers) -> Iterator[Any]:
    import dask  # noqa: PLC0415 (slow to import, and optional)
    from distributed import Client, LocalCluster  # noqa: PLC0415

    for name in ("distributed", "asyncio"):  # what they log of a lost connection is told in one line here
        logging.getLogger(name).setLevel(logging.CRITICAL)
    for logger in [name for name in logging.root.manager.loggerDict if name.startswith("distributed.")]:
        logging.getLogger(logger).setLevel(logging.CRITICAL)
    with ExitStack() as stack:
        settings = {
            "distributed.comm.timeouts.connect": f"{CONNECT_S}s",
            "distributed.nanny.pre-spawn-environ": ENVIRONMENT,
        }
        stack.enter_context(dask.config.set(settings))
        if workers.cluster is None:
            with _children_deaf_to_ctrl_c():
                local = LocalCluster(
                    n_workers=workers.number,
                    threads_per_worker=1,
                    host="127.0.0.1",
                    memory_limit=0,
                    silence_logs=logging.CRITICAL,
                    dashboard_address="127.0.0.1:0",  # what is left of it: a port that cannot be taken
                    scheduler_kwargs={"dashboard": False},
                )
            stack.callback(local.close)
            yield stack.enter_context(Client(local))
            return
        _check_answers(workers.cluster)
        try:
            client = stack.enter_context(Client(workers.cluster, timeout=CONNECT_S))
        except (OSError, TimeoutError) as error:
            raise _no_answer(workers.cluster) from error
        try:
            client.wait_for_workers(1, timeout=CONNECT_S)
        except TimeoutError as error:
            remedy = f"start some with `dask worker {workers.cluster}`"
            raise ClusterError(f"{workers.cluster}: the scheduler has no workers: {remedy}") from error
        yield client


def _check_answers(address: str) -> None:
    """Knock once: the client itself would go on knocking for a while at a door that is not there."""
    form = re.fullmatch(r"(tcp|tls)://([^/\s]+):(\d{1,5})", address)
    if form is None:
        raise StudyError(f"{address}: not the address of a scheduler: give one such as tcp://host:8786")
    try:
        socket.create_connection((form[2].strip("[]"), int(form[3])), timeout=CONNECT_S).close()
    except (OSError, OverflowError) as error:
        raise _no_answer(address) from error


def _no_answer(address: str) -> ClusterError:
    return ClusterError(f"{address}: no scheduler answers: start one with `dask scheduler`, or leave --cluster out")


def _compute_on(
    client: Any, function: Callable[..., Any], arguments: Sequence[tuple[Any, ...]], done: Callable[[int, Any], None]
) -> None:
    from distributed import wait  # noqa: PLC0415

    waiting: dict[Any, int] = {}
    rest = iter(enumerate(arguments))
    heard_s = time.monotonic()
    while True:
        room = WAITING_PER_WORKER * max(_n_workers(client), 1) - len(waiting)
        for index, each in islice(rest, max(room, 0)):
            waiting[client.submit(function, *each, pure=False)] = index
        if not waiting:
            return
        try:
            finished = wait(list(waiting), timeout=POLL_S, return_when="FIRST_COMPLETED").done
        except TimeoutError:
            _check_alive(client, heard_s)
            continue
        except _lost_errors() as error:
            raise _lost(client) from error
        heard_s = time.monotonic()
        for future in finished:
            done(waiting.pop(future), _outcome(client, future))


def _outcome(client: Any, future: Any) -> Any:
    from distributed import KilledWorker  # noqa: PLC0415

    try:
        return future.result()
    except KilledWorker as error:
        raise ClusterError(
            "workers die again and again over the same part: look at their log, or their memory"
        ) from error
    except _lost_errors() as error:
        raise _lost(client) from error


def _lost_errors() -> tuple[type[BaseException], ...]:
    """Return what is raised when the connection to the scheduler breaks."""
    from distributed.client import FuturesCancelledError  # noqa: PLC0415
    from distributed.comm import CommClosedError  # noqa: PLC0415

    return FuturesCancelledError, CancelledError, CommClosedError


def _n_workers(client: Any) -> int:
    try:
        return len(client.scheduler_info()["workers"])
    except (KeyError, OSError, ValueError, RuntimeError):
        return 0


def _check_alive(client: Any, heard_s: float) -> None:
    if client.status != "running":
        raise _lost(client)
    if time.monotonic() - heard_s > WORKERLESS_S and _n_workers(client) == 0:
        raise ClusterError("all workers of the cluster are gone: start some, and run the same command again")


def _lost(client: Any) -> ClusterError:
    address = getattr(client.scheduler, "address", "the cluster") if client.scheduler else "the cluster"
    return ClusterError(
        f"{address}: the scheduler is lost: run the same command again when it is back; finished parts are kept"
    )
