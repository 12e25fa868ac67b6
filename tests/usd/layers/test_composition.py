"""Sublayers, references and payloads that do not resolve."""

from __future__ import annotations

from pathlib import Path

import pytest
from pxr import Usd

from animtool.usd.layers.composition import unresolved_arcs
from animtool.usd.layers.stderr import without_usd_warnings

HEAD = '#usda 1.0\ndef "A" ({arc}) {{}}\n'


@pytest.mark.parametrize(
    ("arc", "text"),
    [
        ("references = @sets/a.usda@", "reference 'sets/a.usda' cannot be opened"),
        ("payload = @a.usda@", "payload 'a.usda' cannot be opened"),
        ("references = @./other.usda@</B>", "reference 'other.usda' has no prim /B"),
        (
            "references = @./other.usda@",
            "reference 'other.usda' names no prim, and it has no default prim",
        ),
        ("references = @./shot.usda@</A>", "its references lead back to itself"),
    ],
)
def test_arcs(
    tmp_path: Path, arc: str, text: str, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "other.usda").write_text('#usda 1.0\ndef "C" {}\n', "utf-8")
    (tmp_path / "shot.usda").write_text(HEAD.format(arc=arc), "utf-8")
    with without_usd_warnings():
        stage = Usd.Stage.Open(str(tmp_path / "shot.usda"))
    assert list(unresolved_arcs(stage)) == [("/A", text)]
    assert capfd.readouterr().err == ""


def test_sublayers(tmp_path: Path) -> None:
    shot = tmp_path / "shot.usda"
    shot.write_text("#usda 1.0\n(\n    subLayers = [@./gone.usda@]\n)\n", "utf-8")
    with without_usd_warnings():
        stage = Usd.Stage.Open(str(shot))
    assert list(unresolved_arcs(stage)) == [
        ("/", "sublayer 'gone.usda' cannot be opened")
    ]
