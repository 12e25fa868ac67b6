"""A plugin of pytest, put into the environment of a copy of the tree.

With ``MUTATION_COVER`` it tells coverage.py, which `recording.py` started, the test
that runs, and keeps outcomes and seconds. With ``MUTATION_TESTS`` pytest runs the tests
that a file names, in its order, and writes to ``MUTATION_PROGRESS`` which one begins.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import pytest

COVER = "MUTATION_COVER"
TESTS = "MUTATION_TESTS"
PROGRESS = "MUTATION_PROGRESS"
MEMORY_BYTES = 8 << 30
# What the context of a fixture begins with, in place of a test's name.
FIXTURE = "fixture "


class Recorder:
    """Tells coverage.py which test runs, and keeps outcomes and seconds."""

    def __init__(self, folder: Path) -> None:
        self.rows = (folder / f"tests.{os.getpid()}.jsonl").open("a", encoding="utf-8")

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, Any, Any]:
        """Attribute what runs from here on to a test, computed by it alone."""
        import coverage

        for name, module in list(sys.modules.items()):
            if name.split(".")[0] == "animtool":
                for value in list(vars(module).values()):
                    if hasattr(value, "cache_clear"):
                        value.cache_clear()
        recorder = coverage.Coverage.current()
        assert recorder is not None
        recorder.switch_context(item.nodeid)
        self.seconds, self.passed = 0.0, True
        begun = cpu_seconds()
        try:
            return (yield)
        finally:
            seconds = cpu_seconds() - begun
            recorder.switch_context("")
            row = {
                "test": item.nodeid,
                "seconds": round(seconds, 3),
                "passed": self.passed,
                "fixtures": sorted(shared_fixtures(item)),
            }
            self.rows.write(json.dumps(row) + "\n")
            self.rows.flush()

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(
        self, fixturedef: pytest.FixtureDef[Any], request: pytest.FixtureRequest
    ) -> Generator[None, Any, Any]:
        """Attribute what a fixture of several tests runs to the fixture."""
        import coverage

        recorder = coverage.Coverage.current()
        if fixturedef.scope == "function" or recorder is None:
            return (yield)
        test = os.environ["PYTEST_CURRENT_TEST"]
        name = fixture_name(fixturedef, request.param_index)
        recorder.switch_context(name)
        os.environ["PYTEST_CURRENT_TEST"] = f"{name} (setup)"
        try:
            return (yield)
        finally:
            os.environ["PYTEST_CURRENT_TEST"] = test
            recorder.switch_context(test.rpartition(" (")[0])

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note a failure."""
        self.passed = self.passed and not report.failed


def cpu_seconds() -> float:
    """Return what this process and those that it started and that ended have used."""
    return sum(os.times()[:4])


def fixture_name(fixture: pytest.FixtureDef[Any], index: int) -> str:
    """Return the context of what a fixture of several tests runs."""
    return f"{FIXTURE}{fixture.baseid}::{fixture.argname}#{index}"


def shared_fixtures(item: pytest.Item) -> Iterator[str]:
    """Yield the contexts of the fixtures that a test shares with others."""
    known = getattr(item, "_fixtureinfo", None)
    indices = getattr(getattr(item, "callspec", None), "indices", {})
    for name, definitions in known.name2fixturedefs.items() if known else ():
        for fixture in definitions:
            if fixture.scope != "function":
                yield fixture_name(fixture, indices.get(name, 0))


class Chosen:
    """Runs chosen tests alone, in the order of their list, and tells which is begun."""

    def __init__(self, tests: Path, progress: Path) -> None:
        self.order = {name: i for i, name in enumerate(json.loads(tests.read_text()))}
        self.progress = progress

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(
        self, config: pytest.Config, items: list[pytest.Item]
    ) -> None:
        """Leave out what is not in the list, and sort the rest."""
        left = [item for item in items if item.nodeid not in self.order]
        items[:] = [item for item in items if item.nodeid in self.order]
        items.sort(key=lambda item: self.order[item.nodeid])
        config.hook.pytest_deselected(items=left)

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        """Write the test that begins."""
        with self.progress.open("a", encoding="utf-8") as file:
            file.write(json.dumps(nodeid) + "\n")


def bound_memory() -> None:
    """Bound the memory of tests and their children: a bug may ask for all there is."""
    import resource

    _, most = resource.getrlimit(resource.RLIMIT_AS)
    least = MEMORY_BYTES if most == resource.RLIM_INFINITY else min(most, MEMORY_BYTES)
    resource.setrlimit(resource.RLIMIT_AS, (least, most))


def plugins() -> Iterator[object]:
    """Yield what the environment asks for."""
    if COVER in os.environ:
        yield Recorder(Path(os.environ[COVER]))
    if TESTS in os.environ:
        bound_memory()
        yield Chosen(Path(os.environ[TESTS]), Path(os.environ[PROGRESS]))


def pytest_configure(config: pytest.Config) -> None:
    """Add what the environment asks for; xdist's first process runs no tests."""
    if config.getoption("numprocesses", None) and not hasattr(config, "workerinput"):
        return
    for plugin in plugins():
        config.pluginmanager.register(plugin)
