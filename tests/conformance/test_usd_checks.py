"""What the checks find in USD's own files and in those of other tools, against USD.

What a layer states is read with Usd and Sdf, and each finding held against it: a file
that is made to be refused is, and no other.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from pxr import Tf, Usd, UsdGeom
from support.data import data_files

from animtool.core.errors import Severity
from animtool.usd.checks import check_layer


def opened(path: Path) -> Usd.Stage | None:
    """Return a stage; None where USD does not open it, or composes it with errors."""
    try:
        stage = Usd.Stage.Open(str(path))
    except Tf.ErrorException:
        return None
    return None if stage.GetCompositionErrors() else stage


def states(stage: Usd.Stage, *names: str) -> bool:
    """Return whether the root layer states all of some metadata."""
    root = stage.GetRootLayer().pseudoRoot
    return all(root.HasInfo(name) for name in names)


def has_no_rate(stage: Usd.Stage) -> bool:
    root = stage.GetRootLayer()
    return not (root.timeCodesPerSecond > 0 and root.framesPerSecond > 0)


def ends_before_it_starts(stage: Usd.Stage) -> bool:
    root = stage.GetRootLayer()
    whole = states(stage, "startTimeCode", "endTimeCode")
    return whole and root.endTimeCode < root.startTimeCode


def binds_without_schema(stage: Usd.Stage) -> bool:
    """Return whether a prim has properties of a skin, and not the schema for them."""
    return any(
        name.startswith(("skel:", "primvars:skel:"))
        for prim in stage.TraverseAll()
        if "SkelBindingAPI" not in prim.GetAppliedSchemas()
        for name in prim.GetAuthoredPropertyNames()
    )


def lacks_unit(stage: Usd.Stage) -> bool:
    return not states(stage, UsdGeom.Tokens.metersPerUnit, UsdGeom.Tokens.upAxis)


def lacks_default(stage: Usd.Stage) -> bool:
    return not stage.GetDefaultPrim()


def lacks_range(stage: Usd.Stage) -> bool:
    return not states(stage, "startTimeCode", "endTimeCode")


def lacks_rate(stage: Usd.Stage) -> bool:
    return not states(stage, "timeCodesPerSecond", "framesPerSecond")


# Findings that are there where, and only where, a layer states this.
FACTS: dict[str, Callable[[Usd.Stage], bool]] = {
    "USD253": has_no_rate,
    "USD254": ends_before_it_starts,
    "USD236": binds_without_schema,
    "USD258": lacks_unit,
    "USD259": lacks_default,
}
# Those that also ask that something moves.
OF_MOTION: dict[str, Callable[[Usd.Stage], bool]] = {
    "USD252": lacks_rate,
    "USD255": lacks_range,
}


def files() -> list[Any]:
    return [*data_files("usd", "**/*.usd*"), *data_files("rigs", "*.usd*")]


@pytest.mark.parametrize("path", files())
def test_what_is_found_is_what_the_file_states(path: Path) -> None:
    faults = check_layer(path)
    assert {fault.path for fault in faults} <= {str(path)}
    codes = {fault.code for fault in faults}
    errors = {fault.code for fault in faults if fault.severity is Severity.ERROR}
    stage = opened(path)
    if stage is None:
        assert "USD001" in codes
        return
    assert errors <= {*FACTS, *OF_MOTION}
    assert {code: code in codes for code in FACTS} == {
        code: fact(stage) for code, fact in FACTS.items()
    }
    for code, fact in OF_MOTION.items():
        assert code not in codes or fact(stage)
