"""A small dask cluster on this machine, for tests."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any

import pytest


@contextmanager
def local_cluster(workers: int = 2) -> Iterator[str]:
    """Give the address of a cluster of some workers; skip where dask is missing."""
    with small_cluster(workers) as cluster:
        yield str(cluster.scheduler_address)


def small_cluster(workers: int = 2) -> AbstractContextManager[Any]:
    """Return a cluster of some workers; skip where dask is missing."""
    pytest.importorskip("distributed", reason="distributed is not installed (farm)")
    from distributed import LocalCluster

    cluster: AbstractContextManager[Any] = LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        dashboard_address=":0",
        silence_logs=50,
    )
    return cluster
