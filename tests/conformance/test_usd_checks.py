"""What the checks find in USD's own files and in those of other tools."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import pytest
import yaml
from support.data import data_files

from animtool.core.errors import Fault, Severity
from animtool.usd.checks import check_layer

LIST = Path(__file__).with_name("usd_findings.yaml")
# What is made to be refused, by its name: the code that refuses it.
BAD = {
    "badSkelBindingAPIApplied": "USD236",
    "badSkelBindingNoSkelRoot": "USD237",
    "timeCodesPerSecond_0": "USD253",
    "start_end_timeCodes_swapped": "USD254",
}


def listed() -> dict[str, dict[str, str]]:
    """Return the findings that are expected, by the hash of a file's bytes."""
    entries = yaml.safe_load(LIST.read_text("utf-8"))
    return {entry["sha256"]: entry["findings"] for entry in entries}


EXPECTED = listed()


def found(path: Path) -> list[Fault]:
    faults = check_layer(path)
    for fault in faults:
        assert fault.path == str(path)
    return faults


def files() -> list[Any]:
    return [*data_files("usd", "**/*.usd*"), *data_files("rigs", "*.usd*")]


@pytest.mark.parametrize("path", files())
def test_what_is_found_is_what_is_listed(path: Path) -> None:
    digest = hashlib.sha256(path.read_bytes()).hexdigest()[:16]
    faults = found(path)
    if digest in EXPECTED:
        assert {fault.code for fault in faults} == set(EXPECTED[digest])
    elif path.stem not in BAD:
        errors = [fault for fault in faults if fault.severity is Severity.ERROR]
        # What this USD cannot read is no matter of ours.
        assert [str(e) for e in errors if e.code != "USD001"] == []


@pytest.mark.parametrize(
    "path", [path for stem in BAD for path in data_files("usd", f"**/{stem}.usda")]
)
def test_what_is_made_to_be_refused_is(path: Path) -> None:
    assert BAD[path.stem] in {fault.code for fault in found(path)}


def test_every_finding_that_is_listed_has_a_reason() -> None:
    for findings in EXPECTED.values():
        for code, reason in findings.items():
            assert code.startswith("USD")
            assert len(reason) > 10
