"""Studies on a Dask cluster."""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from itertools import islice
from typing import TYPE_CHECKING

from threadpoolctl import threadpool_limits

from eivor.errors import EivorError, InputError, UsageError
from eivor.process_pool import TASKS_PER_WORKER, Executor, Item, Result, Results

if TYPE_CHECKING:
    from distributed import Client, Future


#: How long a scheduler may take to answer [s].
PATIENCE_S = 10
#: Packages whose versions bear on a task's numbers.
NUMERIC_PACKAGES = ("eivor", "numpy", "scipy")


@dataclass(frozen=True, slots=True)
class DaskCluster(Executor):
    """On the workers of a Dask scheduler; what a lost worker had at hand is computed by another."""

    address: str

    def __post_init__(self) -> None:
        if "://" not in self.address:
            expected = "the address of a Dask scheduler"
            raise UsageError(expected, f"'{self.address}'", "Give one such as tcp://HOST:8786.")

    def map(self, function: Callable[[Item], Result], items: Iterable[Item]) -> Results[Result]:
        try:
            import distributed
        except ImportError as error:
            expected = "Dask, which is needed to reach a cluster"
            received = "an installation without it"
            raise UsageError(expected, received, "Install it: pip install 'eivor[dask]'.") from error
        versions = {package: version(package) for package in NUMERIC_PACKAGES}
        waiting = enumerate(items)
        with self._client() as client:
            # No key is used twice: what another study left on the cluster is none of this one's results.
            name = f"eivor-{uuid.uuid4().hex}"
            flying = distributed.as_completed(loop=client.loop)
            room = TASKS_PER_WORKER * max(1, sum(client.nthreads().values()))
            while True:
                for entry, item in islice(waiting, room):
                    task = (function, entry, item, versions)
                    flying.add(client.submit(_task_on_worker, *task, key=f"{name}-{entry}"))
                if flying.is_empty():
                    return
                future = next(flying)
                yield _result(future)
                future.release()
                room = 1

    def _client(self) -> Client:
        from distributed import Client

        try:
            client = Client(self.address, timeout=PATIENCE_S, set_as_default=False)
        except (OSError, ValueError) as error:
            remedy = "Start one with `dask scheduler`, or correct the address."
            raise InputError(f"a Dask scheduler at {self.address}", f"no answer: {error}", remedy) from error
        try:
            client.wait_for_workers(1, timeout=PATIENCE_S)
        except TimeoutError as error:
            client.close()
            expected = f"a Dask scheduler at {self.address} that has workers"
            received = "one without any"
            raise InputError(expected, received, f"Start some with `dask worker {self.address}`.") from error
        return client


def _result(future: Future[tuple[int, Result]]) -> tuple[int, Result]:
    try:
        return future.result()
    except EivorError:
        raise
    except Exception as error:
        raise InputError(
            "workers that compute their tasks",
            f"{type(error).__name__}: {error}",
            "Check that the scheduler is up and that every worker has this version of eivor. Complete trials "
            "are kept: run the same again.",
        ) from error


def _task_on_worker(
    function: Callable[[Item], Result], position: int, item: Item, versions: Mapping[str, str]
) -> tuple[int, Result]:
    """Result of an item, computed with the versions that the caller has."""
    selected = {package: version(package) for package in versions}
    if selected != dict(versions):
        expected = f"workers with the versions {dict(versions)}"
        raise InputError(expected, f"one with {selected}", "Install the same everywhere.")
    threadpool_limits(limits=1)  # for good: another thread of this worker may be computing as well
    return position, function(item)
