"""Bugs in C++, and which tests run its lines."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mutation.cpp_cover import Recording
from mutation.cpp_syntax import edits


def after(source: str) -> set[str]:
    return {edit.apply(source).strip() for edit in edits(source)}


@pytest.mark.parametrize(
    ("line", "bugs"),
    [
        ("x = a < b;", {"x = a <= b;", ";"}),
        ("f(a->b - c);", {"f(a->b + c);"}),
        ("f(a * b);", {"f(a / b);", "f(b);"}),
        ("f(a && !b);", {"f(a || !b);", "f(a && b);"}),
        ("f(std::min<int>(a, b));", {"f(std::max<int>(a, b));"}),
        ("return -a;", {"return a;"}),
        ("f(p[0]);", {"f(p[1]);"}),
        ("f(q[i + 1]);", {"f(q[i - 1]);", "f(q[i + 2]);", "f(q[i]);"}),
        ("sum += a;", {"sum -= a;", ";"}),
        ("continue;", {";"}),
        ("if (f(a)) g();", {"if (true) g();", "if (false) g();"}),
        ("while (f(a)) g();", {"while (false) g();"}),
        ("for (int i = 0; f(i); ++i)", {"for (int i = 1; f(i); ++i)"}),
        ("double d[3] = {f(p[1])};", {"double d[3] = {f(p[2])};"}),
    ],
)
def test_bugs_of_a_line(line: str, bugs: set[str]) -> None:
    assert after(line) == bugs


@pytest.mark.parametrize(
    "source",
    [
        "// a < b",
        "/* a < b\n   a - b */",
        "#if A > 1 && \\\n  B > 1",
        "f(\"a < b\", '-');",
        "template <int N, std::size_t M>",
        "const double* p;",
        "std::vector<In<double, 2>> a(b);",
        'check::shape("a", a, {check::ANY, 3});',
        "constexpr double SMALL = 2 * TINY;",
    ],
)
def test_what_is_left_alone(source: str) -> None:
    assert after(source) == set()


def test_lines_are_found_again_and_statements_by_their_first(tmp_path: Path) -> None:
    old = "int f() {\n  return a +\n      b;\n}\nint g() { return c; }"
    (tmp_path / "sources.json").write_text(json.dumps({"a.cpp": old}))
    lines = {"7": [["a.cpp", 2]], "9": [["a.cpp", 5]]}
    (tmp_path / "lines.json").write_text(json.dumps(lines))
    rows = [["t::one", 0.5, True, [7, 8]], ["t::two", 1.0, False, [7]]]
    text = "".join(json.dumps(row) + "\n" for row in rows)
    (tmp_path / "rows.jsonl").write_text(text)
    recording = Recording(tmp_path)
    new = "// Moved.\n" + old
    assert recording.tests("a.cpp", new, 3) == {"t::one", "t::two"}
    assert recording.tests("a.cpp", new, 4) == {"t::one", "t::two"}
    assert recording.tests("a.cpp", new, 2) == {"t::one", "t::two"}
    assert recording.tests("a.cpp", new, 1) == recording.tests("a.cpp", new, 6) == set()
    assert recording.missed() == [("a.cpp", 5, "int g() { return c; }")]
    assert recording.seconds == {"t::one": 0.5, "t::two": 1.0}
    assert recording.failed == {"t::two"}
