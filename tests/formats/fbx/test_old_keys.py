"""Keys of takes before version 7000, of each kind."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from animtool.core.errors import FormatError
from animtool.formats.fbx.curves import (
    CONSTANT,
    CUBIC,
    LINEAR,
    NEXT,
    ONE_THIRD,
    FbxCurve,
)
from animtool.formats.fbx.elements import Element
from animtool.formats.fbx.old_keys import WEIGHTED_LAYOUT, read_channel_curve
from animtool.formats.fbx.settings import TICKS_PER_SECOND
from animtool.formats.file_diagnostics import FileDiagnostics


def read(keys: list[Any], version: int = 4005) -> tuple[FbxCurve, list[str]]:
    """Return a curve of keys, and the codes of what was said of it."""
    rows = [Element("KeyVer", [version], ""), Element("Key", keys, "line 1")]
    diagnostics = FileDiagnostics(str(Path("arm.fbx")))
    element = Element("Channel", ["X"], "", rows)
    curve = read_channel_curve(element, diagnostics, WEIGHTED_LAYOUT)
    assert curve is not None
    return curve, [fault.code for fault in diagnostics.notices]


END = [TICKS_PER_SECOND, 3.0, "L"]


def test_kinds_of_segments() -> None:
    keys = [0, 0.0, "C", "s", 1, 1.0, "C", "n", 2, 2.0, "L", 3, 5.0]
    curve, _ = read([*keys, "U", "s", 7.0, 8.0, "n", *END])
    assert curve.modes.tolist() == [CONSTANT, NEXT, LINEAR, CUBIC, LINEAR]
    assert (curve.out_slopes[3], curve.in_slopes[3]) == (7.0, 8.0)


@pytest.mark.parametrize(
    ("weights", "expected"),
    [
        (["n"], (ONE_THIRD, ONE_THIRD)),
        (["c"], (ONE_THIRD, ONE_THIRD)),
        (["a", 0.1, 0.2], (0.1, 0.2)),
        (["r", 0.1], (0.1, ONE_THIRD)),
        (["l", 0.2], (ONE_THIRD, 0.2)),
    ],
)
def test_weights_of_handles(weights: list[Any], expected: tuple[float, float]) -> None:
    curve, _ = read([0, 0.0, "U", "b", 7.0, 8.0, *weights, *END])
    assert tuple(curve.weights[0]) == expected


def test_layouts_have_weights_and_letters_or_none() -> None:
    assert len(read([0, 0.0, "U", "s", 7.0, 8.0, *END], 4003)[0].times) == 2
    assert len(read([0, 0.0, "C", *END], 4003)[0].times) == 2
    assert len(read([0, 0.0, "U", "a", *END], 4004)[0].times) == 2
    assert len(read([0, 0.0, "U", "a", "n", *END], 4005)[0].times) == 2


@pytest.mark.parametrize(
    "kind",
    [
        ["p", 1.0, 2.0, "n", "n"],
        ["q", 1.0, 2.0, "n", "a", 0.1, 0.2],
        ["t", 0.0, 0.0, 0.0],
        ["d", 0.0, "n"],
    ],
)
def test_tangents_that_nobody_documents_are_automatic_and_named(
    kind: list[Any],
) -> None:
    keys = [
        0,
        0.0,
        "L",
        TICKS_PER_SECOND,
        1.0,
        "U",
        *kind,
        2 * TICKS_PER_SECOND,
        2.0,
        "L",
    ]
    curve, codes = read(keys)
    assert codes == ["FBX120"]
    # Half way up, from one neighbour to the other.
    np.testing.assert_allclose(curve.out_slopes[1], 1.0)


@pytest.mark.parametrize("kind", [["x"], ["s", 1.0, 2.0, "x"], ["s", 1.0]])
def test_others_are_refused(kind: list[Any]) -> None:
    with pytest.raises(FormatError) as caught:
        read([0, 0.0, "U", *kind])
    assert caught.value.faults[0].code == "FBX006"
