"""No text of a file, nor its name, moves a terminal's cursor or commands a service."""

from __future__ import annotations

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest
from support.bvh import HEADER, random_rows, small_bvh
from support.cli import animtool
from support.suite import some_quick

# As nasty for USD and for YAML, and harmless.
TAME = "[tame] one: two"
NASTY = [
    "\x1b]0;mine\x07\x1b[2J\x9b31m\r\n::error::mine[red]\u202e\u2028\ufeff",
    "::error::mine [red]a[bold]",
    "##vso[task.complete]mine: one",
    "##[error] mine:\u202egnp.\ufeff",
    "mine: \udcff",
]
# Some are refused where they are read, and nothing else is said.
REFUSED = {NASTY[0], NASTY[-1]}
# Nothing of this may reach a terminal: controls but the end of a line, marks of
# direction, what has no width, and what no text may hold.
UNSEEN = re.compile(
    "[\x00-\x09\x0b-\x1f\x7f-\x9f\u200b\u200e\u200f\u2028-\u202e\u2066-\u2069"
    "\ufeff\ud800-\udfff]"
)
CONTROL = re.compile("[\x00-\x09\x0b-\x1f\x7f-\x9f\ud800-\udfff]")
COMMAND = re.compile(r"(?m)^\s*::|##\w*\[")
OURS = re.compile(r"(?m)^::(?:error|warning|notice) (?:[a-z]+=[^,:\n]*,?)+::")


def made(folder: Path, name: str, word: str) -> Path:
    """Write files of every kind that have a name, and hold a word."""
    quoted, joint = json.dumps(word), re.sub(r"\s|\udcff", "", word)
    legal = re.sub(r"[\x00-\x1f\x7f-\x9f\u2028\udcff\ufeff]", "", word)
    (folder / "out").mkdir(parents=True)
    text = small_bvh(random_rows(2), header=HEADER.replace("Spine", joint))
    (folder / f"{name}.bvh").write_text(text, "utf-8")
    (folder / f"cut{name}.bvh").write_text(f"HIERARCHY\nROOT {joint}\n{joint}", "utf-8")
    (folder / f"{name}.rig.yaml").write_text(
        f"rig: animtool/1\nname: {quoted}\n{quoted}: 1\njoints:\n"
        f"- {{name: {quoted}, type: {quoted}, {quoted}: 2}}  # {legal}\n"
        f"- {{name: a, parent: {quoted}}}\n- {{name: a, x: [{quoted}]}}\n",
        "utf-8",
    )
    rig = {
        "rig": "animtool/1",
        "name": word,
        word: word,
        "joints": [{"name": word, "type": word}, {"name": "b", "parent": word}],
        "controls": [{"name": "c", "drives": [{"shape": word, "expr": word}]}],
    }
    (folder / f"{name}.rig.json").write_text(json.dumps(rig), "utf-8")
    for kind in ("clip", "map", "targets", "cameras", "scene", "batch"):
        (folder / f"{name}.{kind}.yaml").write_text(
            f"{kind}: animtool/1\nrig: {quoted}\nscene: {quoted}\ninputs: [{quoted}]\n"
            f"{quoted}: {quoted}\nchannels: [{{target: {quoted}, keys: []}}]\n"
            f"passes: [{{{quoted}: {{}}}}]\nvariables: {{{quoted}: '${{{legal}}}'}}\n",
            "utf-8",
        )
    (folder / "animtool.toml").write_text("", "utf-8")
    return folder


Counts = tuple[int, int, int]

SERIAL = ("--executor", "serial")
COMMANDS = [
    *(["validate", ".", "--format", form] for form in ("text", "json", "github")),
    *(["validate", ".", "--format", form] for form in ("sarif", "junit")),
    ["validate", "{}.rig.yaml", "none{}.bvh", "-v"],
    ["validate", "{}.bvh", "--rules", "{}"],
    ["info", "{}.bvh", "{}.bvh", "{}.rig.yaml", "{}.rig.json", "{}.scene.yaml"],
    ["info", "{}.bvh", "cut{}.bvh", "--format", "json", "--log-format", "json"],
    ["info", "{}.targets.yaml", "{}.clip.yaml", "--set", "{}=1", "-v"],
    ["diff", "{}.bvh", "{}.bvh"],
    ["diff", "{}.bvh", "{}.bvh", "--format", "json", "--take", "{}"],
    ["bake", "{}.bvh", "-o", "out/{}.usda"],
    ["bake", "{}.bvh", "-o", "out/b{}.usda", "--format", "json", "-v"],
    ["bake", "{}.bvh", "-o", "-", "-v"],
    ["bake", "{}.bvh", "--table"],
    ["bake", "{}.bvh", "-o", "{}.{}"],
    ["bake", "{}.scene.yaml", "--steps", "--set", "{}"],
    ["bake", "{}.bvh", "-o", "out/c.usda", "--bones", "{}", "--{}"],
    ["convert", "{}.bvh", "out/{}.clip.yaml", "-v"],
    ["ik", "{}.rig.json", "--targets", "{}.targets.yaml", "-o", "out/ik.usda"],
    ["migrate", "{}.rig.json", "{}.clip.yaml", "--check"],
    ["batch", "*.bvh", "-o", "out/{{stem}}.usdc", "--dry-run"],
    ["batch", "{}.batch.yaml", "--format", "json"],
    *(
        ["batch", "cut*.bvh", *SERIAL, "-o", f"out/{form}/a.usdc", *words]
        for form, words in (
            ("text", ["-v"]),
            ("json", ["--format", "json"]),
            ("jsonl", ["--format", "jsonl"]),
            ("openjd", ["--lines", "openjd"]),
        )
    ),
    ["job", "{}.batch.yaml", "-o", "out/job"],
    ["job", "{}.bvh", "-o", "out/job"],
    ["explain", "{}"],
    ["schema", "{}"],
    ["completion", "{}"],
    ["{}"],
    ["plugins", "--format", "{}"],
]


@pytest.fixture(scope="module")
def tame(tmp_path_factory: pytest.TempPathFactory) -> list[Counts]:
    folder = made(tmp_path_factory.mktemp("tame"), TAME, TAME)
    return [checked(folder, TAME, words) for words in COMMANDS]


def checked(folder: Path, name: str, words: list[str]) -> Counts:
    """Check what a command writes; return its exit code and numbers of lines."""
    done = animtool(*(word.replace("{}", name) for word in words), cwd=folder)
    stdout = OURS.sub("", done.stdout) if "github" in words else done.stdout
    for text in (stdout, done.stderr):
        found = UNSEEN.search(text) or COMMAND.search(text)
        # A layer on stdout is what it would be in a file.
        if "-" in words and text is stdout:
            found = CONTROL.search(text)
        assert found is None, ascii((words, text[max(0, found.start() - 200) :][:200]))
        text.encode("utf-8")
    if stdout and "json" in words:
        json.loads(stdout)
    if stdout and "junit" in words:
        ElementTree.fromstring(stdout)
    return done.code, done.stdout.count("\n"), done.stderr.count("\n")


@pytest.fixture(autouse=True)
def no_color(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NO_COLOR", "1")


@pytest.mark.slow
@pytest.mark.parametrize("name", some_quick(NASTY, 2))
def test_names_of_files_are_not_obeyed(
    tmp_path: Path, name: str, tame: list[Counts]
) -> None:
    folder = made(tmp_path / "files", name, TAME)
    for words, expected in zip(COMMANDS, tame, strict=True):
        counts = checked(folder, name, words)
        # The name of a take that a file cannot hold is refused by what writes one.
        refused = name == NASTY[-1] or (words[0] == "convert" and counts[0] == 3)
        # What is printed of a failure has to reach another process.
        assert refused or counts == expected, ascii((words, counts, expected))


@pytest.mark.slow
@pytest.mark.parametrize("word", some_quick(NASTY, 2, 1))
def test_what_files_hold_is_not_obeyed(
    tmp_path: Path, word: str, tame: list[Counts]
) -> None:
    folder = made(tmp_path / "files", TAME, word)
    for words, expected in zip(COMMANDS, tame, strict=True):
        counts = checked(folder, TAME, words)
        refused = word in REFUSED
        assert refused or counts == expected, ascii((words, counts, expected))
