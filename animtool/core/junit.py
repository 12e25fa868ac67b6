"""Reports as JUnit XML, following Jenkins's schema ``junit-10.xsd``."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import PurePath
from typing import TYPE_CHECKING, Literal

from animtool.core.quantities import escaped, escaped_lines
from animtool.core.record import dataclass

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element


@dataclass(frozen=True, slots=True)
class JunitCase:
    """A JUnit test case: the result of one checked file."""

    name: str  # the file
    # Result of the test case.
    outcome: Literal["passed", "failure", "error", "skipped"] = "passed"
    code: str = ""  # fault codes
    message: str = ""  # the fault in one line
    text: str = ""  # the complete text
    output: str = ""  # additional output
    seconds: float | None = None  # duration; None if unknown


def junit_xml(name: str, cases: Iterable[JunitCase]) -> str:
    """Return a test suite as XML; the classname of a case is the folder of its file."""
    from xml.etree import ElementTree  # other reports do not load it

    suite = ElementTree.Element("testsuite", name=name)
    for case in cases:
        _add_case(suite, case)
    suite.attrib |= {
        "tests": str(len(suite)),
        "failures": str(len(suite.findall("testcase/failure"))),
        "errors": str(len(suite.findall("testcase/error"))),
        "skipped": str(len(suite.findall("testcase/skipped"))),
    }
    root = ElementTree.Element("testsuites", name=name)
    root.append(suite)
    ElementTree.indent(root)
    text = ElementTree.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'


def _add_case(suite: Element, case: JunitCase) -> None:
    from xml.etree.ElementTree import SubElement

    path = PurePath(case.name)
    folder = path.parent.as_posix()
    element = SubElement(
        suite, "testcase", classname=escaped(folder), name=escaped(path.name)
    )
    if case.seconds is not None:
        element.set("time", f"{case.seconds:.3f}")
    if case.outcome != "passed":
        result = SubElement(element, case.outcome)
        if case.code:
            result.set("type", case.code)
        if case.message:
            result.set("message", escaped(case.message))
        if case.text:
            result.text = escaped_lines(case.text)
    if case.output:
        SubElement(element, "system-out").text = escaped_lines(case.output)
