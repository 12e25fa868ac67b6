"""Reports in the forms of others, checked against what those forms demand."""

from __future__ import annotations

import json
import os
import re
from dataclasses import replace
from pathlib import Path, PurePath
from typing import Annotated, Any, Literal
from urllib.parse import unquote_to_bytes
from xml.etree import ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from animtool.core.errors import Fault, Severity
from animtool.core.quantities import escaped
from animtool.core.rules import builtin_rules
from animtool.core.source_lines import crop_line
from animtool.validation.formats import FORMATS, format_report
from animtool.validation.run import Report

RIG = "rig: animtool/1\nname: é\njoints:\n- {name: knee}\n"
TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=40)


def faults(path: str) -> list[Fault]:
    hint = "write one, or a mirror"
    return [
        Fault("RIG201", "100 %: out,\nof: range", path, (4,), hint, column=10,
              where="joints[0].name", severity=Severity.WARNING),
        Fault("RIG001", "twice", path, (4,), column=10),
        Fault("STU001", "no place\x07", path, severity=Severity.NOTE),
        Fault("VAL003", "no file"),
    ]  # fmt: skip


@pytest.fixture
def report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Report:
    monkeypatch.chdir(tmp_path)
    Path("a b").mkdir()
    rig, away = Path("a b/hero#1.rig.yaml"), Path("none.rig.yaml")
    rig.write_text(RIG, "utf-8")
    missing = Fault("IO001", "cannot be read: no such file", str(away))
    return Report((rig, away), (*faults(str(rig)), missing))


@pytest.mark.parametrize("form", FORMATS)
def test_the_same_findings_give_the_same_text(report: Report, form: str) -> None:
    text = format_report(report, form)
    assert text == format_report(report, form)
    assert text.endswith("\n")
    assert format_report(Report((), ()), form) == format_report(Report((), ()), form)


def test_text_shows_the_line(report: Report) -> None:
    text = format_report(report, "text")
    assert "    4 | - {name: knee}\n      |          ^\n" in text
    assert text.endswith("2 files: 3 errors, 1 warning, 1 note\n")


@given(TEXTS, st.integers(1, 400), st.integers(0, 300))
def test_a_line_is_cut_around_its_place(text: str, column: int, more: int) -> None:
    line = text.replace("\n", "") + "x" * more
    column = min(column, len(line) + 1)
    shown, caret = crop_line(line, column)
    assert len(shown) <= 96
    place = len(caret) - 1
    if column <= len(line) and line[column - 1] == "x" and place < len(shown):
        assert shown[place] in "x\N{HORIZONTAL ELLIPSIS}"


def test_a_long_line_is_cut_before_and_behind_its_place() -> None:
    line = "".join(chr(ord("a") + i % 26) for i in range(300))
    for column in (1, 33, 34, 150, 236, 237, 290, 300):
        shown, caret = crop_line(line, column)
        assert len(shown) == 96
        assert shown[len(caret) - 1] in {line[column - 1], "\N{HORIZONTAL ELLIPSIS}"}
    assert cut_text(line, 300).endswith(line[-90:])
    assert cut_text(line, 1).startswith(line[:90])


def cut_text(line: str, column: int) -> str:
    return next(iter(crop_line(line, column)))


def test_findings_that_repeat_one_of_their_file_are_counted(report: Report) -> None:
    """Those in lines of a text are not: each has its line."""
    path = str(report.files[0])
    alike = [Fault("USD206", f"joint {i}", path) for i in range(4)]
    lined = [Fault("RIG201", f"joint {i}", path, (4,)) for i in range(3)]
    other = Fault("USD206", "joint 9", "other.usda")
    found = Report(report.files, (*alike, *lined, other))
    lines = format_report(found, "text").splitlines()
    assert sum("USD206" in line for line in lines) == 2
    assert f"{alike[0]} (3 more like it)" in lines
    assert sum("RIG201" in line for line in lines) == 3
    whole = format_report(found, "text", shows_repeats=True).splitlines()
    assert sum("USD206" in line for line in whole) == 5


def test_json_says_what_can_be_fixed(report: Report) -> None:
    first, *_, last = report.findings
    found = replace(report, fixable=frozenset({first}), mended=((last, "written"),))
    value = json.loads(format_report(found, "json"))
    assert [entry["fixable"] for entry in value["findings"]] == [True, *[False] * 4]
    assert [(f["code"], f["done"]) for f in value["mended"]] == [("IO001", "written")]
    assert format_report(found, "text").endswith(", fix=True repairs 1\n")


def test_json(report: Report) -> None:
    value = json.loads(format_report(report, "json"))
    assert value["summary"] == {"error": 3, "warning": 1, "note": 1}
    assert [f["code"] for f in value["findings"]] == [f.code for f in report.findings]


COMMAND = re.compile(
    r"::(error|warning|notice) "
    r"((?:(?:file|line|col|title)=[^,:\r\n]*,?)+)::([^\r\n]*)"
)


def unescaped(text: str) -> str:
    for code, char in (("%3A", ":"), ("%2C", ","), ("%0D", "\r"), ("%0A", "\n")):
        text = text.replace(code, char)
    return text.replace("%25", "%")


def test_github(report: Report) -> None:
    lines = format_report(report, "github").splitlines()
    assert len(lines) == len(report.findings)
    for line, fault in zip(lines, report.findings, strict=True):
        found = COMMAND.fullmatch(line)
        assert found, line
        given = dict(part.split("=", 1) for part in found[2].split(","))
        assert unescaped(given["title"]) == fault.code
        assert unescaped(given.get("file", "")) == (fault.path or "").replace("\\", "/")
        assert escaped(fault.message) in unescaped(found[3])
    assert lines[0].startswith("::warning file=a b/hero#1.rig.yaml,line=4,col=10,title")
    assert lines[0].endswith("; write one, or a mirror")
    assert [line.split()[0] for line in lines] == [
        *("::warning", "::error", "::notice", "::error", "::error")
    ]
    several = Report((), (replace(report.findings[0], lines=(4, 2, 9)),))
    assert ",line=4," in format_report(several, "github")


@given(TEXTS)
def test_github_escapes_come_back(text: str) -> None:
    report = Report((), (Fault("RIG001", text, text),))
    (line, rest) = format_report(report, "github").split("\n", 1)
    found = COMMAND.fullmatch(line)
    assert rest == ""
    assert found
    assert unescaped(found[3]) == escaped(text)


UNRESERVED = r"[A-Za-z0-9._~!$&'()*+,;=@-]|%[0-9A-F]{2}"
ABSOLUTE = re.compile(rf"file:///(?:{UNRESERVED}|[:/])*")
# A colon before the first slash would end a scheme.
RELATIVE = re.compile(rf"(?!/)(?:{UNRESERVED})+(?:/(?:{UNRESERVED}|:)*)*")


def uri_reference(text: str) -> str:
    """Check that text is a URI of a file, or relative to one, by RFC 3986."""
    assert ABSOLUTE.fullmatch(text) or RELATIVE.fullmatch(text), text
    return text


def unique(values: list[Any]) -> list[Any]:
    """Check that no value is there twice."""
    assert all(value not in values[:i] for i, value in enumerate(values))
    return values


def plain(text: str) -> str:
    """Return a message as it is shown: section 3.11.5, and no placeholder in it."""
    assert not re.search(r"(?<!\{)(?:\{\{)*\{(?!\{)", text), text
    assert not re.search(r"(?<!\})(?:\}\})*\}(?!\})", text), text
    return text.replace("{{", "{").replace("}}", "}")


class Strict(BaseModel):
    """An object of the standard, with the properties that are used and no others."""

    model_config = ConfigDict(extra="forbid", strict=True)


class Message(Strict):
    """Section 3.11 and 3.12."""

    text: str
    markdown: str | None = None


class ArtifactLocation(Strict):
    """Section 3.4."""

    uri: Annotated[str, AfterValidator(uri_reference)]


class Region(Strict):
    """Section 3.30."""

    startLine: Annotated[int, Field(ge=1)]  # noqa: N815
    startColumn: Annotated[int, Field(ge=1)] | None = None  # noqa: N815
    snippet: Message | None = None


class PhysicalLocation(Strict):
    """Section 3.29."""

    artifactLocation: ArtifactLocation  # noqa: N815
    region: Region | None = None


class LogicalLocation(Strict):
    """Section 3.33."""

    fullyQualifiedName: str  # noqa: N815


class Location(Strict):
    """Section 3.28."""

    physicalLocation: PhysicalLocation  # noqa: N815
    logicalLocations: list[LogicalLocation] | None = None  # noqa: N815


Level = Literal["none", "note", "warning", "error"]


class Result(Strict):
    """Section 3.27."""

    ruleId: str  # noqa: N815
    ruleIndex: Annotated[int, Field(ge=0)] | None = None  # noqa: N815
    level: Level
    message: Message
    locations: list[Location] | None = None
    partialFingerprints: dict[str, str]  # noqa: N815


class Configuration(Strict):
    """Section 3.50."""

    level: Level


class Descriptor(Strict):
    """Section 3.49."""

    id: Annotated[str, Field(min_length=1)]
    shortDescription: Message  # noqa: N815
    defaultConfiguration: Configuration  # noqa: N815
    help: Message | None = None


class Driver(Strict):
    """Section 3.19."""

    name: Annotated[str, Field(min_length=1)]
    version: Annotated[str, Field(min_length=1)]
    rules: Annotated[list[Descriptor], AfterValidator(unique)]


class Tool(Strict):
    """Section 3.18."""

    driver: Driver


class Artifact(Strict):
    """Section 3.24."""

    location: ArtifactLocation


class Run(Strict):
    """Section 3.14."""

    tool: Tool
    artifacts: Annotated[list[Artifact], AfterValidator(unique)]
    results: list[Result]
    columnKind: Literal["utf16CodeUnits", "unicodeCodePoints"]  # noqa: N815


class Log(Strict):
    """Section 3.13."""

    schema_: Annotated[str, Field(alias="$schema")]
    version: Literal["2.1.0"]
    runs: list[Run]


def checked(report: Report) -> Run:
    """Return the one run of a report, checked as the standard has it."""
    (run,) = Log.model_validate_json(format_report(report, "sarif")).runs
    rules = run.tool.driver.rules
    assert len({rule.id for rule in rules}) == len(rules)
    assert {rule.id for rule in rules} <= {result.ruleId for result in run.results}
    assert len(run.results) == len(report.findings)
    for result, fault in zip(run.results, report.findings, strict=True):
        check_result(result, fault, [rule.id for rule in rules])
    prints = [result.partialFingerprints["animtool/v1"] for result in run.results]
    assert len(set(prints)) == len(prints)
    return run


def check_result(result: Result, fault: Fault, rules: list[str]) -> None:
    """Check a result against the finding that it is of."""
    assert result.ruleId == fault.code
    # 3.27.6: the index is of the rule with that id, and only such have one.
    known = fault.code in rules
    assert result.ruleIndex == (rules.index(fault.code) if known else None)
    assert result.level == str(fault.severity)
    said = plain(result.message.text)
    assert said == fault.message + (f"; {fault.hint}" if fault.hint else "")
    assert bool(result.locations) == (fault.path is not None)
    for location in result.locations or ():
        place = location.physicalLocation
        assert fault.path is not None
        check_uri(place.artifactLocation.uri, fault.path)
        if place.region is not None:
            check_region(place.region, Path(fault.path))


def check_uri(uri: str, path: str) -> None:
    """Check that a URI leads to a file."""
    if Path(path).is_absolute():
        assert uri == Path(path).as_uri()
    else:
        assert os.fsdecode(unquote_to_bytes(uri)) == PurePath(path).as_posix()


def check_region(region: Region, path: Path) -> None:
    """Check that a region is in the text of a file, and its snippet what is there."""
    if region.snippet is None:
        return
    lines = path.read_text("utf-8").split("\n")
    assert region.startLine <= len(lines)
    assert region.snippet.text == lines[region.startLine - 1]
    # 3.30.6: the column behind the last character is that of the end of the line.
    assert (region.startColumn or 1) <= len(region.snippet.text) + 1


def test_sarif(report: Report) -> None:
    run = checked(report)
    assert run.results[0].locations
    region = run.results[0].locations[0].physicalLocation.region
    assert region == Region(
        startLine=4, startColumn=10, snippet=Message(text="- {name: knee}")
    )
    rules = run.tool.driver.rules
    documented = next(rule for rule in rules if rule.id == "RIG201")
    assert documented.help
    assert documented.help.markdown
    assert "#" not in documented.help.text
    levels = {rule.id: rule.defaultConfiguration.level for rule in rules}
    assert levels == {code: str(builtin_rules()[code].severity) for code in levels}
    assert set(levels.values()) > {"warning"}
    assert run.columnKind == "unicodeCodePoints"


@pytest.mark.parametrize(("letters", "shown"), [(1000, True), (1001, False)])
def test_sarif_shows_no_long_lines(tmp_path: Path, letters: int, shown: bool) -> None:
    path = tmp_path / "a.rig.yaml"
    path.write_text("x" * letters, "utf-8")
    (result,) = checked(
        Report((path,), (Fault("RIG001", "twice", str(path), (1,)),))
    ).results
    (location,) = result.locations or ()
    region = location.physicalLocation.region
    assert region is not None
    assert (region.snippet is not None) is shown


NAMES = st.text(
    st.characters(exclude_categories=["Cs"], exclude_characters="/\\\0"),
    min_size=1,
    max_size=12,
).filter(lambda name: name not in {".", ".."})


@given(TEXTS, st.lists(NAMES, min_size=1, max_size=3), st.sampled_from(Severity))
def test_sarif_takes_any_text(text: str, parts: list[str], severity: Severity) -> None:
    path = "/".join(parts)
    fault = Fault("RIG201", text, path, (3,), text, severity=severity, where=text)
    checked(Report((Path(path), Path(path)), (fault, fault)))


def test_sarif_of_names_that_are_no_text() -> None:
    path = os.fsdecode(b"a\xff.rig.yaml")
    checked(Report((Path(path),), (Fault("RIG001", "twice", path),)))


def test_sarif_of_absolute_paths(tmp_path: Path) -> None:
    path = tmp_path / "a b.rig.yaml"
    value = json.loads(format_report(Report((path,), ()), "sarif"))
    assert value["runs"][0]["artifacts"][0]["location"]["uri"] == path.as_uri()


# Attributes and children of Jenkins's junit-10.xsd, those that must be first.
JUNIT = {
    "testsuites": ({"name", "tests", "failures", "errors"}, {"testsuite"}),
    "testsuite": (
        {"name", "tests", "failures", "errors", "skipped"},
        {"testcase"},
    ),
    "testcase": (
        {"name", "classname"},
        {"failure", "error", "system-out", "system-err", "skipped"},
    ),
    "failure": ({"type", "message"}, set()),
    "error": ({"type", "message"}, set()),
    "system-out": (set(), set()),
}


def check_junit(element: ElementTree.Element) -> None:
    attributes, children = JUNIT[element.tag]
    assert set(element.attrib) <= attributes
    assert element.tag in {"failure", "error", "system-out"} or "name" in element.attrib
    for child in element:
        assert child.tag in children
        check_junit(child)


def test_junit(report: Report) -> None:
    root = ElementTree.fromstring(format_report(report, "junit"))
    check_junit(root)
    (suite,) = root
    cases = list(suite)
    assert suite.attrib["tests"] == str(len(cases)) == "3"
    assert suite.attrib["failures"] == str(len(suite.findall("*/failure"))) == "2"
    assert suite.attrib["errors"] == str(len(suite.findall("*/error"))) == "1"
    assert cases[0].attrib["name"] == "hero#1.rig.yaml"
    said = cases[0].find("system-out")
    assert said is not None
    assert "RIG201" in (said.text)


@given(st.text(max_size=60), st.sampled_from(Severity))
def test_junit_takes_any_text(text: str, severity: Severity) -> None:
    fault = Fault("RIG001", text, "a", severity=severity)
    made = format_report(Report((Path("a"),), (fault,)), "junit")
    root = ElementTree.fromstring(made.encode("utf-8"))
    check_junit(root)
    ((case,),) = root
    (entry,) = case
    assert entry.text == str(fault)
    failed = severity is Severity.ERROR
    assert entry.tag == ("failure" if failed else "system-out")
    if failed:
        assert entry.attrib["type"] == "RIG001"
        assert entry.get("message", "") == escaped(text)


def test_junit_of_names_that_are_no_text() -> None:
    path = os.fsdecode(b"a\xff.rig.yaml")
    made = format_report(
        Report((Path(path),), (Fault("RIG001", "twice", path),)), "junit"
    )
    check_junit(ElementTree.fromstring(made.encode("utf-8")))
