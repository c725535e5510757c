"""Trials spread over processes, here or on other machines, by dask.distributed."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

from kreisel.errors import SettingsError

Result = TypeVar("Result")

_RETRIES = 3
"""Further attempts at a trial that fails. Chosen: a fault of a machine passes; a defect of the code fails again, and
ends the study soon."""

_ANSWER = 10.0
"""Longest time for a scheduler to answer, s."""

_ASK_AGAIN, _ALONE = 5.0, 60.0
"""Seconds after which all trials are checked again, and after which a study without workers ends with an error."""


_KEEP_FREED_MEMORY = {
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": 1 << 30,
    "distributed.nanny.pre-spawn-environ.MALLOC_MMAP_THRESHOLD_": 1 << 25,
}
"""The C library of a worker keeps freed memory: a third more trials, because the system zeroes every new page."""


def check_installed() -> None:
    """Check, without loading it, that dask.distributed is there: before work begins, and before folders are made.

    Raises
    ------
    SettingsError
        If it is not.
    """
    if importlib.util.find_spec("distributed") is None:
        raise SettingsError(
            "studies and several --jobs need dask.distributed: pip install 'kreisel[study]'; `kreisel batch --jobs 1` "
            "does without"
        )


def dask_map(
    function: Callable[[int], Result], numbers: Iterable[int], *, scheduler: str | None, workers: int
) -> Iterator[Result]:
    """Yield the results of function(number) as they come in, in any order.

    Parameters
    ----------
    scheduler
        Address of a running scheduler, tcp://host:port; a cluster of local processes without.
    workers
        Local processes.

    Raises
    ------
    SettingsError
        If dask.distributed is not installed, the scheduler does not answer, or no worker is left.

    Notes
    -----
    If a worker dies, no trial is lost: its trials are given to another one.
    """
    check_installed()
    from dask import config
    from distributed import Client, LocalCluster, wait

    if scheduler is None:
        with config.set(_KEEP_FREED_MEMORY):
            cluster = LocalCluster(
                n_workers=workers, threads_per_worker=1, host="127.0.0.1", dashboard_address="127.0.0.1:0",
                silence_logs=50,
            )  # fmt: skip
    try:
        client = Client(cluster if scheduler is None else scheduler, timeout=_ANSWER)
    except (OSError, TimeoutError, ValueError) as error:
        raise SettingsError(f"no scheduler answers at {scheduler}: {error}") from error
    try:
        pending = set(client.map(function, list(numbers), pure=False, retries=_RETRIES))
        alone = 0.0
        while pending:
            try:
                done, pending = wait(pending, timeout=_ASK_AGAIN, return_when="FIRST_COMPLETED")
            except TimeoutError:
                alone = 0.0 if client.scheduler_info()["workers"] else alone + _ASK_AGAIN
                if alone >= _ALONE:
                    raise SettingsError(
                        f"{len(pending)} trials are left, and there is no worker for them; "
                        "check that all workers have the same kreisel installed"
                    ) from None
                continue
            for future in done:
                yield future.result()
                future.release()
    finally:
        client.close()
        if scheduler is None:
            cluster.close()
