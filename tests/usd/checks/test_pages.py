"""The pages of the codes: each is there, and its example is what it says.

What is right stands in ``pages.usda``, once; with what is wrong in its place, the code
is found.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from support.suite import some_quick

from animtool.core.rules import builtin_rules
from animtool.usd.checks import check_layer

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


def test_the_layer_of_the_examples_is_good(folder: Path) -> None:
    path = folder / "good.usda"
    path.write_text(LAYER.read_text("utf-8"), "utf-8")
    assert [str(fault) for fault in check_layer(path)] == []


CODES = [code for code, rule in builtin_rules().items() if rule.hint]


@pytest.mark.parametrize("code", some_quick(filter(example, CODES), 4))
def test_an_example_is_true(code: str, folder: Path) -> None:
    wrong, right = example(code)
    layer = squashed(LAYER.read_text("utf-8"))
    assert layer.count(right) == 1
    path = folder / f"{code}.usda"
    path.write_text(layer.replace(right, wrong), "utf-8")
    assert code in {fault.code for fault in check_layer(path)}
