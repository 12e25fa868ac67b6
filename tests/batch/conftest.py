from __future__ import annotations

from collections.abc import Iterator

import pytest
from support.batch import trouble_plug_in
from support.cluster import local_cluster

from animtool.batch.spec import package_versions


@pytest.fixture(scope="package")
def troubled_cluster(
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[tuple[str, dict[str, str]]]:
    """Give the address of a cluster, and the environment of its workers' plug-in."""
    place = trouble_plug_in(tmp_path_factory.mktemp("plug"))
    with pytest.MonkeyPatch.context() as patch:
        for name, value in place.items():
            patch.setenv(name, value)
            patch.syspath_prepend(value)
        with local_cluster() as address:
            # Other tests of this process have no plug-in.
            patch.undo()
            yield address, place


@pytest.fixture
def cluster(
    troubled_cluster: tuple[str, dict[str, str]], monkeypatch: pytest.MonkeyPatch
) -> Iterator[str]:
    """Give a cluster whose workers, like this process, read takes in trouble."""
    address, place = troubled_cluster
    for name, value in place.items():
        # A worker that ends is replaced from here.
        monkeypatch.setenv(name, value)
        monkeypatch.syspath_prepend(value)
    # What was found before has none of the plug-in.
    package_versions.cache_clear()
    yield address
    package_versions.cache_clear()
