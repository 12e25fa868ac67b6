"""The examples on the pages of codes that reading and writing USD gives.

What is right stands in ``pages.usda``, or in the shot that refers to it, once; with
what is wrong in its place, the code is said. Of two commands, the first says it.
"""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from support.cli import animtool
from support.suite import some_quick

from animtool.core.rules import builtin_rules, page_text

LAYER = Path(__file__).with_name("pages.usda").read_text("utf-8")
SHOT = """\
#usda 1.0
(
    endTimeCode = 4
    startTimeCode = 1
    metersPerUnit = 0.01
    timeCodesPerSecond = 24
    upAxis = "Y"
)

def Xform "World"
{
    def "hero" (
        prepend references = @./hero.usda@
    )
    {
    }

    def "extra" (
        prepend references = @./hero.usda@
    )
    {
    }
}
"""
OVER = """\
#usda 1.0
(
    endTimeCode = 4
    startTimeCode = 1
    subLayers = [@./layer.usda@, @./hero.usda@]
    timeCodesPerSecond = 24
)
"""
BVH = """\
HIERARCHY
ROOT hips
{
  OFFSET 0 10 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT chest
  {
    OFFSET 0 5 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0 5 0
    }
  }
}
MOTION
Frames: 4
Frame Time: 0.0416667
0 10 0 0 0 0 0 0 0
1 10 0 0 0 0 0 0 10
2 10 0 0 0 0 0 0 20
3 10 0 0 0 0 0 0 30
"""
NAME = "rel skel:animationSource = </hero/Rig/Anim>"
FILES = {
    "hero.usda": LAYER,
    "face.usda": LAYER,
    "rig.usda": LAYER.replace(NAME, ""),
    "props.usda": '#usda 1.0\ndef Scope "lamp"\n{\n}\n',
    "shot.usda": SHOT,
    "over.usda": OVER,
    "walk.bvh": BVH,
    "run.bvh": BVH.replace("0.0416667", "0.0333333"),
    "tail.bvh": BVH.replace("chest", "tail"),
    "studio.bvh": BVH.replace("ROOT ", "ROOT actor:").replace("JOINT ", "JOINT actor:"),
}
READ = "info hero.usda"
CONVERT = "convert hero.usda out.rig.yaml"
LAYER_OVER = "bake walk.bvh -o out.usda --rig-layer "
IN_SHOT = LAYER_OVER + "shot.usda --prim-path /World/hero"
# What says a code; the rest are said by what reads a take.
COMMANDS = {
    "USD008": CONVERT,
    "USD009": LAYER_OVER + "hero.usda",
    "USD011": IN_SHOT,
    "USD017": CONVERT,
    "USD018": CONVERT,
    "USD035": "convert hero.usda out.bvh",
    "USD042": IN_SHOT + " --deform",
    "USD043": LAYER_OVER + "hero.usda --deform",
    "USD108": LAYER_OVER + "hero.usda",
    "USD110": IN_SHOT,
    "USD114": "bake face.usda -o out.usda --rig-layer hero.usda",
    "USD116": CONVERT,
    "USD120": CONVERT,
    "USD132": IN_SHOT,
    "USD143": LAYER_OVER + "hero.usda --deform",
    "USD144": CONVERT,
}


def squashed(text: str) -> str:
    """Return text without the indents of its lines."""
    return "\n".join(line.strip() for line in text.strip().splitlines())


def examples(code: str, language: str) -> list[str]:
    text = page_text(code) or ""
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.M | re.S)


# Examples of codes of checks are checked with these. A crash would end the tests.
CODES = [
    code
    for code in builtin_rules()
    if re.match("USD[01]", code) and not builtin_rules()[code].hint and code != "USD160"
]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, text in FILES.items():
        (tmp_path / name).write_text(squashed(text) + "\n", "utf-8")
    return tmp_path


def said(command: str, folder: Path) -> str:
    done = animtool(*shlex.split(command), cwd=folder)
    return done.stdout + done.stderr


@pytest.mark.parametrize(
    "code", some_quick((c for c in CODES if examples(c, "usda")), 3)
)
def test_what_an_example_holds_is_said(code: str, folder: Path) -> None:
    wrong, right = map(squashed, examples(code, "usda"))
    command = COMMANDS.get(code, READ)
    path = folder / ("shot.usda" if "shot.usda" in command else "hero.usda")
    text = path.read_text("utf-8")
    assert text.count(right) == 1
    assert code not in said(command, folder)
    path.write_text(text.replace(right, wrong), "utf-8")
    assert code in said(command.replace("out.", "wrong."), folder)


@pytest.mark.parametrize("code", [c for c in CODES if examples(c, "console")])
def test_what_a_command_says(code: str, folder: Path) -> None:
    wrong, right = examples(code, "console")
    for text, expected in ((wrong, True), (right, False)):
        lines = [line.removeprefix("$ animtool ") for line in text.splitlines()]
        assert (code in [said(line, folder) for line in lines][-1]) is expected
