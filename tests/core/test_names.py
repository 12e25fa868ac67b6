"""Names that people write."""

from __future__ import annotations

import pytest

from animtool.core.errors import OptionError
from animtool.core.names import check_unused_variables, name_hint


def test_nearest() -> None:
    assert name_hint("x", []) == "none are defined"
    names = [f"n{i}" for i in range(20)]
    assert name_hint("zzz", names) == f"allowed: {', '.join(names)}"
    many = name_hint("zzz", [f"n{i}" for i in range(300)])
    assert many.endswith("n23 and 276 more")
    assert name_hint("position", ["at", "restitution"]) == "allowed: restitution, at"


def test_what_is_given_must_be_used() -> None:
    check_unused_variables([], [])
    with pytest.raises(OptionError) as caught:
        check_unused_variables(["shto", "shot", "x"], {"shot"})
    assert [f.code for f in caught.value.faults] == ["SCN031", "SCN031"]
    assert "'shot'" in (caught.value.faults[0].hint or "")
