"""Reports of batches."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest
from support.batch import take_files

from animtool.batch.report import BatchReport, junit_report
from animtool.batch.run import RunOptions, run_batch
from animtool.batch.spec import BatchSpec
from animtool.core.errors import Fault, Severity
from animtool.core.values import plain_value


@pytest.fixture
def report(tmp_path: Path) -> BatchReport:
    """Return the report of a run that skips one, makes two and fails at one."""
    take_files(tmp_path / "takes", 4)
    (tmp_path / "takes/take003.bvh").write_text("HIERARCHY\n")
    spec = BatchSpec(("takes/*.bvh",), tmp_path, output="out/{stem}.usdc")
    run_batch(spec, RunOptions(executor="serial", numbers=(1, 1)))
    return run_batch(spec, RunOptions(executor="serial"))


def test_plain_values(report: BatchReport) -> None:
    found = json.loads(json.dumps(plain_value(report), allow_nan=False))
    counts = {key: found[key] for key in ("done", "skipped", "failed", "not_run")}
    assert counts == {"done": 2, "skipped": 1, "failed": 1, "not_run": 0}
    assert [entry["item"] for entry in found["items"]] == [1, 2, 3, 4]
    skipped, done, _, failed = found["items"]
    assert "seconds" not in skipped
    assert done["samples"] == 4
    assert done["error"]["joint"] in {"Hips", "Spine"}
    assert failed["faults"][0]["path"].endswith("take003.bvh")


def test_what_stands_out(report: BatchReport) -> None:
    times = [entry.seconds for entry in report.slowest_items]
    assert len(times) == 2
    assert times == sorted(times, reverse=True)
    errors = [
        entry.measurements.error
        for entry in report.largest_errors
        if entry.measurements
    ]
    assert errors == sorted(errors, reverse=True)


def test_junit(report: BatchReport) -> None:
    root = ElementTree.fromstring(junit_report(report.items))
    suite = root.find("testsuite")
    assert suite is not None
    counts = [suite.get(key) for key in ("tests", "failures", "errors", "skipped")]
    assert counts == ["4", "1", "0", "1"]
    assert [case.get("name") for case in suite] == [
        f"take{number:03}.usdc" for number in range(4)
    ]
    for case, entry in zip(suite, report.items, strict=True):
        assert float(case.get("time", "0")) == pytest.approx(entry.seconds, abs=1e-3)


def test_junit_says_warnings_and_no_notes(report: BatchReport) -> None:
    odd = Fault("BVH107", "rates alike", severity=Severity.NOTE)
    worse = Fault("BVH101", "rows lost", severity=Severity.WARNING)
    entries = [replace(entry, notices=(odd, worse)) for entry in report.items]
    (suite,) = ElementTree.fromstring(junit_report(entries))
    said = [case.findtext("system-out") for case in suite]
    assert said == [None, *["warning: BVH101 rows lost"] * 3]
