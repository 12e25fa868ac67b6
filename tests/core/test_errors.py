from __future__ import annotations

import json
from pathlib import Path

import pytest

from animtool.core.errors import (
    AnimtoolError,
    ExitCode,
    Fault,
    FormatError,
    OptionError,
    OutputError,
    StrictError,
    excerpt,
    faults_in,
)


def test_one_line_a_fault() -> None:
    fault = Fault("BVH010", "the row is short", "a.bvh", (12, 13), "wrapped?")
    assert str(fault) == "a.bvh:12: BVH010 the row is short; wrapped?"
    assert str(Fault("X1", "odd", "a.bvh")) == "a.bvh: X1 odd"
    assert str(Fault("X1", "odd")) == "X1 odd"
    assert json.loads(json.dumps(fault.as_dict()))["lines"] == [12, 13]


def test_errors_carry_their_faults_and_exit_codes() -> None:
    faults = [Fault("A1", "one"), Fault("A2", "two")]
    error = FormatError(faults)
    assert (error.code, len(error.faults), str(error)) == ("A1", 2, "A1 one\nA2 two")
    codes = {
        FormatError: ExitCode.MALFORMED,
        OutputError: ExitCode.MALFORMED,
        OptionError: ExitCode.USAGE,
        StrictError: ExitCode.FINDINGS,
    }
    for kind, code in codes.items():
        assert issubclass(kind, AnimtoolError)
        assert kind(faults[0]).exit_code is code


def test_excerpts_are_short_and_quoted() -> None:
    assert len(excerpt("x" * 10_000)) < 50
    assert excerpt("a\nb") == "'a\\nb'"


@pytest.mark.parametrize("kind", [FormatError, OptionError])
def test_faults_without_a_file_get_that_of_the_block(kind: type[FormatError]) -> None:
    faults = [Fault("SOL001", "a"), Fault("SOL002", "b", "other.yaml")]
    with pytest.raises(kind) as caught, faults_in(Path("take.c3d")):
        raise kind(faults)
    assert [fault.path for fault in caught.value.faults] == ["take.c3d", "other.yaml"]
