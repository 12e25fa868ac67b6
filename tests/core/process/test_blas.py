"""Linear algebra runs in one thread where that is asked, and as before after it."""

from __future__ import annotations

import pytest

from animtool.core.process import blas


def counts() -> list[int]:
    return [count() for count, _ in blas._libraries()]


def test_one_thread_and_back() -> None:
    before = counts()
    if not before:
        pytest.skip("numpy and scipy have no OpenBLAS of their own here")
    with blas.one_thread():
        assert set(counts()) == {1}
    assert counts() == before


def test_a_fault_inside_gives_them_back() -> None:
    before = counts()
    with pytest.raises(ZeroDivisionError), blas.one_thread():
        1 / 0  # noqa: B018
    assert counts() == before
