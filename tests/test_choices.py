"""Words in place of choices: those of scenes are taken, others refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from support.faults import raises
from support.small_takes import content, small

from animtool.core.errors import OptionError
from animtool.edit.layers import LayerMode, blend, layer
from animtool.edit.mirroring import Axis, mirror
from animtool.edit.retiming import time_warp
from animtool.edit.root_motion import RootMotionOptions
from animtool.motion.keyed import KeyInterpolation
from animtool.motion.passes import PassContext, apply_pass, find_pass
from animtool.motion.take import Take, TakeStream

PAIRS = ((1, 0), (5, 1), (9, 0.25))
CURVE = ((1, 1), (5, 9), (12, 12))


def other() -> Take:
    return mirror(small())


CALLS: dict[str, tuple[Callable[[str], Take], list[str]]] = {
    "mode": (lambda mode: layer(small(), other(), mode=mode, weight=0.5),
             [*LayerMode]),
    "weights of a layer": (
        lambda how: layer(small(), other(), weight=PAIRS, interpolation=how),
        [*KeyInterpolation],
    ),
    "weights of a blend": (
        lambda how: blend(small(), other(), weight=PAIRS, interpolation=how),
        [*KeyInterpolation],
    ),
    "curve of time": (
        lambda how: time_warp(small(), CURVE, how), [*KeyInterpolation]
    ),
    "axis": (lambda axis: mirror(small(), axis), [*Axis]),
}  # fmt: skip


@pytest.mark.parametrize("name", CALLS)
def test_words_of_scenes_do_what_they_say(name: str) -> None:
    call, choices = CALLS[name]
    found = [content(call(str(choice))) for choice in choices]
    assert found == [content(call(choice)) for choice in choices]
    assert len(set(found)) == len(choices)


@pytest.mark.parametrize("name", CALLS)
def test_other_words_are_refused(name: str) -> None:
    with pytest.raises(OptionError) as caught:
        CALLS[name][0]("Q")
    assert caught.value.faults[0].code == "SCN025"


def test_options_of_passes_are_words_too() -> None:
    options: Any = {"mode": "fold"}
    context = PassContext(lambda _: small(), Path())
    with raises(OptionError, "SCN025", match="'fold'"):
        apply_pass(
            TakeStream.of(small()),
            find_pass("root_motion"),
            RootMotionOptions(**options),
            context,
        )


def test_one_pattern_needs_no_list() -> None:
    alone = layer(small(), other(), joints="arm_*")
    assert content(alone) == content(layer(small(), other(), joints=["arm_*"]))
