"""Entry points that a test installs."""

from __future__ import annotations

from importlib.metadata import EntryPoint, EntryPoints

import pytest


def install(monkeypatch: pytest.MonkeyPatch, group: str, **places: str) -> None:
    """Let one group alone have entry points: ``module:object`` by name."""
    points = [EntryPoint(name, place, group) for name, place in places.items()]
    monkeypatch.setattr("animtool.core.plugins.may_have_plugins", lambda _: True)
    monkeypatch.setattr(
        "importlib.metadata.entry_points",
        lambda group: EntryPoints(point for point in points if point.group == group),
    )
