"""``docs``: which pages there are, what is printed, and what is opened."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from support.cli import animtool

from animtool.cli.docs import SITE_FOLDER, codes_markdown, commands_markdown
from animtool.cli.main import COMMANDS
from animtool.core.errors import ExitCode
from animtool.core.pages import (
    MOVED_PAGES,
    PAGE_KINDS,
    all_pages,
    find_page,
    page_markdown,
)
from animtool.core.rules import builtin_rules


def test_every_page_is_listed_below_its_kind() -> None:
    done = animtool("docs", "--list")
    assert done.code == 0
    lines = done.stdout.splitlines()
    kinds = [line for line in lines if not line.startswith(" ")]
    assert kinds == [kind for kind in PAGE_KINDS.values() if kind in kinds]
    listed = {line.split()[0] for line in lines if line.startswith(" ")}
    assert listed == {page.name for page in all_pages()} | {
        "reference/codes", "reference/commands",
    }  # fmt: skip
    assert animtool("docs").stdout == done.stdout


def test_a_page_is_printed_by_its_name_or_its_last_part(root: Path) -> None:
    text = (root / "animtool/docs/tutorials/desk-lamp.md").read_text("utf-8")
    for topic in ("desk-lamp", "tutorials/desk-lamp", "Desk-Lamp"):
        assert animtool("docs", topic).stdout == text


@pytest.mark.parametrize(("old", "new"), MOVED_PAGES.items())
def test_pages_that_moved_are_found(old: str, new: str) -> None:
    assert find_page(old).name == new


def test_a_code_and_a_command_are_topics() -> None:
    assert animtool("docs", "rig201").stdout == animtool("explain", "RIG201").stdout
    bake = animtool("docs", "bake").stdout
    assert bake.startswith("## animtool bake\n")
    assert "`--rig-layer" in bake
    assert bake in animtool("docs", "commands").stdout


@pytest.mark.parametrize(
    ("topic", "hint"),
    [
        ("desk-lmap", "did you mean 'desk-lamp'"),
        ("layers", "howto/"),
        ("qqqqqqqq", "--list"),
        ("", "--list"),
    ],
)
def test_unknown_topics(topic: str, hint: str) -> None:
    done = animtool("docs", topic)
    assert done.code == ExitCode.USAGE
    assert done.stdout == ""
    assert "CLI009" in done.stderr
    assert hint in done.stderr


def test_an_unknown_code_is_one() -> None:
    assert "VAL005" in animtool("docs", "RIG999").stderr


def test_json() -> None:
    listed = json.loads(animtool("docs", "--format", "json").stdout)
    assert len(listed["pages"]) == len(all_pages()) + 2
    page = json.loads(animtool("docs", "desk-lamp", "--format", "json").stdout)
    assert page["pages"][0]["page"] == page_markdown(find_page("desk-lamp"))
    assert page["pages"][0]["kind"] == "Tutorials"


@pytest.mark.parametrize(
    ("words", "built", "display", "opened"),
    [
        (["desk-lamp"], True, True, "tutorials/desk-lamp.html"),
        (["bake"], True, True, "reference/commands.html#animtool-bake"),
        ([], True, True, "index.html"),
        (["desk-lamp", "--print"], True, True, None),
        (["desk-lamp"], False, True, None),
        (["desk-lamp"], True, False, None),
    ],
)
def test_the_local_build_is_opened(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    words: list[str],
    built: bool,
    display: bool,
    opened: str | None,
) -> None:
    from animtool.cli.main import run

    for name in ("index", "tutorials/desk-lamp", "reference/commands"):
        path = tmp_path / f"{name}.html"
        path.parent.mkdir(exist_ok=True)
        if built:
            path.touch()
    shown: list[str] = []

    def show(address: str) -> bool:
        shown.append(address)
        return True

    monkeypatch.setattr("animtool.cli.docs.SITE_FOLDER", tmp_path)
    monkeypatch.setattr("animtool.preview.show.has_browser", lambda: display)
    monkeypatch.setattr("animtool.preview.show.open_browser", show)
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    assert run(["docs", *words]) == 0
    expected = [] if opened is None else [f"{tmp_path.as_uri()}/{opened}"]
    assert shown == expected
    assert bool(capsys.readouterr().out) == (opened is None)


def test_the_site_is_built_where_it_is_looked_for(root: Path) -> None:
    settings = (root / "mkdocs.yml").read_text("utf-8")
    assert re.search(r"^site_dir: build/site$", settings, re.M)
    assert root / "build/site" == SITE_FOLDER


def test_the_reference_of_commands_has_all_of_them() -> None:
    text = commands_markdown()
    heads = re.findall(r"^## animtool ([\w-]+)$", text, re.M)
    assert heads == sorted(COMMANDS)
    assert "### animtool mocap solve" in text
    assert "`--overwrite`" in text


def test_the_reference_of_codes_has_all_of_them() -> None:
    listed = re.findall(r"^\| \[(\w+)\]\(\.\./rules/\1\.md\)", codes_markdown(), re.M)
    assert listed == sorted(builtin_rules())
