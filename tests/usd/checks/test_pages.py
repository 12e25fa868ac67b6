"""The pages of the codes: each is there, and its example is what it says.

What is right stands in ``pages.usda``, once; with what is wrong in its place, the code
is found.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from animtool.usd.checks import check_layer
from animtool.usd.checks.table import CODES

LAYER = Path(__file__).with_name("pages.usda")
FOLDER = Path(__file__).parents[3] / "animtool/docs/rules"
CLIP = """\
#usda 1.0
(
    defaultPrim = "cache"
)
def Scope "cache"
{{
    float size{}
}}
"""
PROPS = """\
#usda 1.0
(
    metersPerUnit = 0.01
    timeCodesPerSecond = 24
)
def Scope "lamp"
{
    float size.timeSamples = { 1: 1, 2: 3 }
}
"""
SAMPLES = ".timeSamples = { 1: 1, 4: 4 }"
FILES = {
    "cache.1.usda": CLIP.format(SAMPLES),
    "cache.2.usda": CLIP.format(SAMPLES),
    "manifest.usda": CLIP.format(""),
    "empty.usda": "#usda 1.0\n",
    "prop.usda": CLIP.format(""),
    "props.usda": PROPS,
    "hero.png": "",
}


def page(code: str) -> str:
    return (FOLDER / f"{code}.md").read_text("utf-8")


def squashed(text: str) -> str:
    """Return text without the indents of its lines."""
    return "\n".join(line.strip() for line in text.strip().splitlines())


def example(code: str) -> list[str]:
    return [squashed(t) for t in re.findall(r"```usda\n(.*?)```", page(code), re.S)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("pages")
    for name, text in FILES.items():
        (made / name).write_text(text, "utf-8")
    return made


def test_every_code_has_a_page() -> None:
    pages = {path.stem for path in FOLDER.glob("USD*.md")}
    assert set(CODES) <= pages
    assert {code for code in pages if code >= "USD2"} <= set(CODES)


@pytest.mark.parametrize("code", CODES)
def test_the_form_of_a_page(code: str) -> None:
    lines = page(code).splitlines()
    assert lines[0] == f"# {code}: {CODES[code].title}"
    headings = [line for line in lines if line.startswith("## ")]
    wanted = ["## What", "## Why", "## How to mend", "## Example"]
    assert headings == wanted[: len(headings)]
    assert len(headings) >= 3
    assert len(example(code)) in {0, 2}


def test_the_layer_of_the_examples_is_good(folder: Path) -> None:
    path = folder / "good.usda"
    path.write_text(LAYER.read_text("utf-8"), "utf-8")
    assert [str(fault) for fault in check_layer(path)] == []


@pytest.mark.parametrize("code", [code for code in CODES if example(code)])
def test_an_example_is_true(code: str, folder: Path) -> None:
    wrong, right = example(code)
    layer = squashed(LAYER.read_text("utf-8"))
    assert layer.count(right) == 1
    path = folder / f"{code}.usda"
    path.write_text(layer.replace(right, wrong), "utf-8")
    assert code in {fault.code for fault in check_layer(path)}
