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


LAYER = """#usda 1.0
def Xform "A" (
    prepend apiSchemas = ["SkelBindingAPI"]
    customData = {
        double a = 1
    }
)
{
    double x = 1
    float3 v = (1, 2, 3)
    token[] joints = ["a", "b"]
    float y.timeSamples = {
        1: 0,
        2: 1,
    }
    rel r = </A/B>
    asset f = @./a.usda@
    string s = "hi"
}
"""


@pytest.mark.parametrize(
    ("old", "new", "line", "hint"),
    [
        ('"b"]', '"b"', 11, "add ']' at the end"),
        ('"a", "b"', '"a" "b"', 11, "a comma"),
        ('"a",', '"a",,', 11, "remove the comma"),
        ('["a"', '"a"', 11, "between [ and ]"),
        (", 3)", ", 3", 10, "add ')' at the end"),
        (", 3)", " 3)", 10, "a comma"),
        ('API"]', 'API"', 3, "add ']' at the end"),
        ("        2: 1,\n    }", "        2: 1,", 15, "add '}' before"),
        ("1: 0,", "1: 0", 13, "at the end of the line"),
        ("1: 0,", "1 0,", 13, "time: value"),
        ("a = 1\n    }", "a = 1", 6, "add '}' before"),
        ('"hi"\n}', '"hi"\n', 20, "add '}' at its end"),
        ('"hi"', '"hi', 18, "double quote"),
        ('"hi"', "'hi", 18, "single quote"),
        ("B>", "B", 16, "'>'"),
        ("</A/B>", "/A/B", 16, "</A/B>"),
        ("usda@", "usda", 17, "@"),
        ("x = 1", "x = 1,5", 9, "1.5"),
        ("x = 1", "x = true", 9, "a number"),
        ("x = 1", "x 1", 9, "double x = 1"),
        ("x = 1", "x =", 9, "value after ="),
        ("double x", "x", 9, "its type first"),
        ('s = "hi"\n}\n', "s =", 18, "copy or export"),
        ('"hi"\n}\n', '"hi"\n}\n}\n', 20, "remove this '}'"),
    ],
)
def test_slips_of_an_edit_have_their_line_and_a_remedy(
    tmp_path: Path, old: str, new: str, line: int, hint: str
) -> None:
    path = tmp_path / "a.usda"
    path.write_text(LAYER.replace(old, new), "utf-8")
    with pytest.raises(FormatError) as caught:
        open_layer(path)
    [fault] = caught.value.faults
    assert (fault.code, fault.lines) == ("USD001", (line,))
    assert hint in (fault.hint or "")


def test_a_slip_before_a_long_line_has_its_place(tmp_path: Path) -> None:
    path = tmp_path / "a.usda"
    numbers = ", ".join(map(str, range(2000)))
    path.write_text(LAYER.replace('"b"]', f'"b"\n    int[] i = [{numbers}]'), "utf-8")
    with pytest.raises(FormatError) as caught:
        open_layer(path)
    [fault] = caught.value.faults
    assert (fault.lines, fault.column) == ((11,), 30)
