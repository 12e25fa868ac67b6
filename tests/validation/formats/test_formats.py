"""Reports in the forms of others, checked against what those forms demand."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Annotated, Literal
from urllib.parse import unquote
from xml.etree import ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel, ConfigDict, Field

from animtool.errors import Fault, Severity
from animtool.validation.formats import FORMATS, written
from animtool.validation.formats.source import cut
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
    text = written(report, form)
    assert text == written(report, form)
    assert text.endswith("\n")
    assert written(Report((), ()), form) == written(Report((), ()), form)


def test_text_shows_the_line(report: Report) -> None:
    text = written(report, "text")
    assert "    4 | - {name: knee}\n      |          ^\n" in text
    assert text.endswith("2 files: 3 errors, 1 warning, 1 note\n")


@given(TEXTS, st.integers(1, 400), st.integers(0, 300))
def test_a_line_is_cut_around_its_place(text: str, column: int, more: int) -> None:
    line = text.replace("\n", "") + "x" * more
    column = min(column, len(line) + 1)
    shown, caret = cut(line, column)
    assert len(shown) <= 96
    place = len(caret) - 1
    if column <= len(line) and line[column - 1] == "x" and place < len(shown):
        assert shown[place] in "x\N{HORIZONTAL ELLIPSIS}"


def test_json(report: Report) -> None:
    value = json.loads(written(report, "json"))
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
    lines = written(report, "github").splitlines()
    assert len(lines) == len(report.findings)
    for line, fault in zip(lines, report.findings, strict=True):
        found = COMMAND.fullmatch(line)
        assert found, line
        given = dict(part.split("=", 1) for part in found[2].split(","))
        assert unescaped(given["title"]) == fault.code
        assert unescaped(given.get("file", "")) == (fault.path or "").replace("\\", "/")
        assert fault.message in unescaped(found[3])
    assert lines[0].startswith("::warning file=a b/hero#1.rig.yaml,line=4,col=10,title")


@given(TEXTS)
def test_github_escapes_come_back(text: str) -> None:
    report = Report((), (Fault("RIG001", text, text),))
    (line, rest) = written(report, "github").split("\n", 1)
    found = COMMAND.fullmatch(line)
    assert rest == ""
    assert found
    assert unescaped(found[3]) == text


class Strict(BaseModel):
    """An object of the standard, with the properties that are used and no others."""

    model_config = ConfigDict(extra="forbid", strict=True)


class Message(Strict):
    """Section 3.11 and 3.12."""

    text: str
    markdown: str | None = None


class ArtifactLocation(Strict):
    """Section 3.4."""

    uri: Annotated[str, Field(pattern=r"^[A-Za-z0-9._~:/?@!$&'()*+,;=%-]+$")]


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

    id: str
    shortDescription: Message  # noqa: N815
    defaultConfiguration: Configuration  # noqa: N815
    help: Message | None = None


class Driver(Strict):
    """Section 3.19."""

    name: str
    version: str
    rules: list[Descriptor]


class Tool(Strict):
    """Section 3.18."""

    driver: Driver


class Artifact(Strict):
    """Section 3.24."""

    location: ArtifactLocation


class Run(Strict):
    """Section 3.14."""

    tool: Tool
    artifacts: list[Artifact]
    results: list[Result]
    columnKind: Literal["utf16CodeUnits", "unicodeCodePoints"]  # noqa: N815


class Log(Strict):
    """Section 3.13."""

    schema_: Annotated[str, Field(alias="$schema")]
    version: Literal["2.1.0"]
    runs: list[Run]


def test_sarif(report: Report) -> None:
    text = written(report, "sarif")
    (run,) = Log.model_validate_json(text).runs
    rules = run.tool.driver.rules
    assert len({rule.id for rule in rules}) == len(rules)
    assert len(run.results) == len(report.findings)
    for result, fault in zip(run.results, report.findings, strict=True):
        assert result.ruleId == fault.code
        if result.ruleIndex is not None:
            assert rules[result.ruleIndex].id == fault.code
        if fault.path:
            assert result.locations
            place = result.locations[0].physicalLocation
            assert unquote(place.artifactLocation.uri) == Path(fault.path).as_posix()
    assert run.results[0].locations
    region = run.results[0].locations[0].physicalLocation.region
    assert region == Region(
        startLine=4, startColumn=10, snippet=Message(text="- {name: knee}")
    )
    prints = [result.partialFingerprints["animtool/v1"] for result in run.results]
    assert len(set(prints)) == len(prints)
    documented = next(rule for rule in rules if rule.id == "RIG201")
    assert documented.help
    assert documented.help.markdown
    assert "#" not in documented.help.text


def test_sarif_of_absolute_paths(tmp_path: Path) -> None:
    path = tmp_path / "a b.rig.yaml"
    value = json.loads(written(Report((path,), ()), "sarif"))
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
    root = ElementTree.fromstring(written(report, "junit"))
    check_junit(root)
    (suite,) = root
    cases = list(suite)
    assert suite.attrib["tests"] == str(len(cases)) == "3"
    assert suite.attrib["failures"] == str(len(suite.findall("*/failure"))) == "2"
    assert suite.attrib["errors"] == str(len(suite.findall("*/error"))) == "1"
    assert cases[0].attrib["name"] == "hero#1.rig.yaml"
    said = cases[0].find("system-out")
    assert said is not None
    assert "RIG201" in (said.text or "")


@given(st.text(max_size=60))
def test_junit_takes_any_text(text: str) -> None:
    made = written(Report((), (Fault("RIG001", text, "a"),)), "junit")
    ElementTree.fromstring(made.encode("utf-8", "surrogatepass"))
