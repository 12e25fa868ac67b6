"""JUnit XML: counts, and text that XML cannot hold."""

from __future__ import annotations

from xml.etree import ElementTree

from animtool.core.junit import JunitCase, junit_xml


def test_cases_are_counted_and_described() -> None:
    text = junit_xml(
        "suite",
        [
            JunitCase("a/b.bvh", seconds=0.25),
            JunitCase("c.bvh", "failure", "BVH001", "is bad\0", "all of it", "a note"),
            JunitCase("d.bvh", "error", "IO001", "is gone"),
            JunitCase("e.bvh", "skipped", message="up to date"),
        ],
    )
    suite = ElementTree.fromstring(text).find("testsuite")
    assert suite is not None
    assert {k: suite.get(k) for k in ("tests", "failures", "errors", "skipped")} == {
        "tests": "4",
        "failures": "1",
        "errors": "1",
        "skipped": "1",
    }
    first, second, _, last = suite.findall("testcase")
    assert (first.get("classname"), first.get("name"), first.get("time")) == (
        "a",
        "b.bvh",
        "0.250",
    )
    failure = second.find("failure")
    assert failure is not None
    assert failure.get("message") == r"is bad\x00"
    assert second.findtext("system-out") == "a note"
    skipped = last.find("skipped")
    assert skipped is not None
    assert (skipped.get("message"), skipped.get("type")) == ("up to date", None)
