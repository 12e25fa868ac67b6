"""A plugin of pytest that records which code of the kernels each test runs.

The kernels are built with `hits.cpp`. Rows go to the folder that ``KERNEL_HITS`` names:
test, seconds, whether it passed, and the blocks that it ran, in its process and in
those that it started. What a shared fixture ran counts for all tests that use it.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Generator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

TABLE_BYTES = 1 << 22


class Recorder:
    """Keeps what the kernels mark, test by test."""

    def __init__(self, folder: Path) -> None:
        table = folder / f"table.{os.getpid()}"
        self.table = np.memmap(table, np.uint8, "w+", shape=(TABLE_BYTES,))
        os.environ["KERNEL_HITS"] = str(table)
        self.rows = (folder / f"rows.{os.getpid()}.jsonl").open("w", encoding="utf-8")
        self.fixtures: dict[int, set[int]] = {}

    def take(self) -> set[int]:
        """Return the blocks that ran since the last call."""
        hits = np.flatnonzero(self.table)
        self.table[hits] = 0
        return set(hits.tolist())

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(
        self, fixturedef: pytest.FixtureDef[Any], request: pytest.FixtureRequest
    ) -> Generator[None, object, object]:
        """Set what a shared fixture runs aside."""
        if request.scope == "function":
            return (yield)
        before = self.take()
        try:
            return (yield)
        finally:
            self.fixtures[id(fixturedef)] = self.take()
            self.table[sorted(before)] = 1

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(
        self, item: pytest.Item
    ) -> Generator[None, object, object]:
        """Write a row of each test that runs code of the kernels."""
        self.take()
        self.passed, begun = True, time.perf_counter()
        result = yield
        seconds, hits = time.perf_counter() - begun, self.take()
        info = getattr(item, "_fixtureinfo", None)
        for definitions in info.name2fixturedefs.values() if info else ():
            for definition in definitions:
                hits |= self.fixtures.get(id(definition), set())
        if hits:
            row = [item.nodeid, round(seconds, 4), self.passed, sorted(hits)]
            self.rows.write(json.dumps(row) + "\n")
            self.rows.flush()
        return result

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note a failure."""
        self.passed = self.passed and not report.failed


def pytest_configure(config: pytest.Config) -> None:
    """Record, but not in xdist's first process, which runs no tests."""
    if not config.getoption("numprocesses", None) or hasattr(config, "workerinput"):
        recorder = Recorder(Path(os.environ["KERNEL_HITS"]))
        config.pluginmanager.register(recorder)
