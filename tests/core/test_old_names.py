"""Old names of public attributes and arguments warn, and do what the new ones do."""

from __future__ import annotations

import numpy as np
import pytest

from animtool.core.old_names import renamed_arguments
from animtool.motion import passes
from animtool.motion.motion import Channel


def test_an_old_attribute_is_the_new_one() -> None:
    with pytest.warns(DeprecationWarning, match=r"Channel\.still is now called static"):
        old = Channel.__dict__["still"].__get__(None, Channel)
    assert old(np.ones((1, 3)), 2).dense().shape == (2, 1, 3)


def test_an_old_argument_is_the_new_one() -> None:
    @renamed_arguments(extent="size")
    def half(size: float) -> float:
        return size / 2

    old: dict[str, float] = {"extent": 3.0}
    with pytest.warns(DeprecationWarning, match="extent"):
        assert half(**old) == 1.5


def test_old_names_of_passes_warn() -> None:
    with pytest.warns(DeprecationWarning, match="FrameScope"):
        from animtool.motion.passes import Scope
    from animtool.motion.passes import FrameScope, Pass

    assert Scope is FrameScope
    with pytest.warns(DeprecationWarning, match="needs_preroll"):
        made = Pass("x", "y", dict, FrameScope.CLIP, lambda *_: None, settles=True)
    assert made.needs_preroll
    with pytest.warns(DeprecationWarning, match="needs_preroll"):
        assert made.settles
    with pytest.raises(AttributeError, match="Unknown"):
        passes.Unknown  # noqa: B018
