"""Runs of a study on the workers of a Dask scheduler."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from typing import Any

from comove._version import __version__
from comove.data.episode import Made
from comove.data.many import require_kernels
from comove.data.runner import Run, RunSource
from comove.errors import ComoveError, ExtraError, InputError, OptionError
from comove.processes import ONE_THREAD, TaskResult
from comove.processes.worker import told

LOCAL = "local"
"""Address that stands for a scheduler and workers on this machine."""
ENVIRONMENT = "distributed.nanny.pre-spawn-environ"
"""What workers find in their environment: by Dask's own they would give back memory after each array."""


def on_dask(address: str, workers: int, timeout: float = 10.0) -> Run:
    """Return a runner on the workers of a scheduler.

    A run whose worker dies is repeated by the scheduler, as often as it allows. A run is not stopped for taking too
    long.

    Parameters
    ----------
    address : address of the scheduler, such as ``tcp://host:8786``, or `LOCAL`
    workers : number of workers of a local scheduler
    timeout : time after which a scheduler counts as unreachable [s]

    Raises
    ------
    ExtraError
        If Dask is not installed.
    """
    try:
        import distributed  # noqa: F401
    except ImportError as error:
        raise ExtraError("a Dask scheduler", "dask") from error

    def run(
        study: RunSource, next_task: Callable[[], int | None], allowed: float
    ) -> Iterator[TaskResult[int, Made]]:
        with _connected(study, address, workers, timeout) as client:
            _require_version(client)
            _require(client, study)
            yield from _run(client, study.run, next_task)

    return run


@contextmanager
def _connected(study: RunSource, address: str, workers: int, timeout: float) -> Iterator[Any]:
    """Yield a client of the scheduler, stopping one started here."""
    import dask
    from distributed import Client, LocalCluster

    if address == LOCAL:
        require_kernels(study.example_scenes())
        with (
            dask.config.set({"distributed.scheduler.allowed-failures": 0, ENVIRONMENT: dict(ONE_THREAD)}),
            LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster,
            Client(cluster) as client,
        ):
            yield client
        return
    try:
        client = Client(address, timeout=timeout)
    except (OSError, TimeoutError, ValueError) as error:
        raise OptionError(
            f"no scheduler answers at {address!r}: {' '.join(str(error).split())}",
            key="--dask",
            way_out="start one (dask scheduler) and give its address, or --dask local",
        ) from error
    with client:
        yield client


def _require_version(client: Any) -> None:
    """Refuse workers that have another version of comove, or none."""
    try:
        found = client.run(_version)
    except Exception as error:  # whatever the workers lack
        raise OptionError(
            f"the workers cannot import comove: {told(error)}",
            key="--dask",
            way_out="install the same version where the workers run",
        ) from error
    for worker, version in found.items():
        if version != __version__:
            raise OptionError(
                f"the worker {worker} has comove {version}, and this is {__version__}",
                key="--dask",
                way_out="install the same version where the workers run",
            )


def _require(client: Any, study: RunSource) -> None:
    for worker, lacks in client.run(_lacking, study).items():
        if lacks:
            raise OptionError(
                f"the worker {worker} cannot do the runs: {lacks}",
                key="--dask",
                way_out="mend that where the workers run",
            )


def _lacking(study: RunSource) -> str:
    """Return the requirement that this process lacks; empty if none."""
    try:
        study.require()
    except ComoveError as error:
        return str(error)
    return ""


def _version() -> str:
    from comove._version import __version__

    return __version__


def _run(
    client: Any, work: Callable[[int], Made], next_task: Callable[[], int | None], ahead: int = 2
) -> Iterator[TaskResult[int, Made]]:
    """Yield tasks as they end. `ahead` tasks are sent for each thread, so that none waits for this process."""
    from distributed import as_completed

    under_way: dict[Any, int] = {}
    ended = as_completed()
    most = ahead * max(1, sum(client.nthreads().values()))
    try:
        while True:
            while len(under_way) < most and (task := next_task()) is not None:
                future = client.submit(work, task, pure=False)
                under_way[future] = task
                ended.add(future)
            if not under_way:
                return
            future = next(ended)
            yield _ended(future, under_way.pop(future))
    except (OSError, TimeoutError, CancelledError) as error:  # what a run raises comes as its result
        raise _lost() from error
    finally:
        with suppress(OSError, TimeoutError, CancelledError):
            client.cancel(list(under_way))


def _lost() -> OptionError:
    return OptionError(
        "the scheduler was lost", key="--dask", way_out="start it again; the same command goes on"
    )


def _ended(future: Any, task: int) -> TaskResult[int, Made]:
    """Return the result of an ended task."""
    from distributed import KilledWorker

    if future.status == "finished":
        return TaskResult(task, future.result())
    if future.status != "error":
        raise _lost()
    error = future.exception()
    if isinstance(error, KilledWorker):
        return TaskResult(task, killed=error.allowed_failures + 1)
    if isinstance(error, InputError):
        return TaskResult(task, error=str(error), refused=True)
    return TaskResult(task, error=told(error))
