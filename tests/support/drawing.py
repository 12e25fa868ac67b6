"""A context of OpenGL for tests, or a skip that says what is missing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from animtool.core.errors import AnimtoolError
from animtool.preview.pictures.device import Device

PACKAGES = ("moderngl", "PIL.Image", "av")


def need_drawing() -> None:
    """Skip a test where pictures cannot be drawn."""
    for name in PACKAGES:
        pytest.importorskip(name, reason=f"no {name} (extra: pictures)")
    try:
        Device().close()
    except AnimtoolError as error:
        pytest.skip(str(error))


def can_draw() -> bool:
    """Return whether pictures can be drawn."""
    try:
        need_drawing()
    except pytest.skip.Exception:
        return False
    return True


@contextmanager
def drawing() -> Iterator[Device]:
    """Give a context, or skip."""
    need_drawing()
    device = Device()
    try:
        yield device
    finally:
        device.close()
