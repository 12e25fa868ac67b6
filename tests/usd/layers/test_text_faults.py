"""What USD says of a text layer: place and remedy in words of the file."""

from __future__ import annotations

from pathlib import Path

import pytest

from animtool.core.errors import FormatError
from animtool.usd.layers.sdf import open_layer

HEAD = "#usda 1.0\n"


@pytest.mark.parametrize(
    ("text", "place", "where", "hint"),
    [
        ("#usda 1\n", (1, 1), None, "#usda 1.0"),
        ('def Xform "a" {}\n', (1, 1), None, "#usda 1.0"),
        ("\n", (1, 1), None, "#usda 1.0"),
        ("#usda 9.0\n", (1, 1), None, "usd-core"),
        (HEAD + 'def Xform "a" {\n', (3, 1), "/a", "add '}'"),
        (HEAD + "def Xform a {}\n", (2, 1), None, 'def Xform "a"'),
        (HEAD + 'def "a" {\n double3 x = (1, 2)\n}\n', (3, 14), "/a.x", ""),
        (HEAD + "(\n defaultPrim = a\n)\n", (3, 16), None, "double quotes"),
    ],
)
def test_a_fault_has_its_place_and_a_remedy(
    tmp_path: Path, text: str, place: tuple[int, int], where: str | None, hint: str
) -> None:
    path = tmp_path / "a.usda"
    path.write_text(text, "utf-8")
    with pytest.raises(FormatError) as caught:
        open_layer(path)
    [fault] = caught.value.faults
    assert (fault.code, fault.path) == ("USD001", str(path))
    assert (fault.lines[0], fault.column) == place
    assert fault.where == where
    assert hint in (fault.hint or "")


def test_a_binary_layer_that_is_cut_off(tmp_path: Path) -> None:
    path = tmp_path / "a.usdc"
    path.write_bytes(b"PXR-USDC" + bytes(40))
    with pytest.raises(FormatError) as caught:
        open_layer(path)
    assert "write or copy it again" in (caught.value.faults[0].hint or "")
