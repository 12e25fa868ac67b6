"""What the site has beside the pages in animtool/docs.

The README is its first page; samples and measured results that pages link to come
along, the reference of commands and codes is made of their records, and a tutorial has
the pages that play which its commands make.
"""

from __future__ import annotations

import re
import sys
import tempfile
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from animtool.cli.docs import codes_markdown, commands_markdown
from animtool.cli.explain import ignore_section
from animtool.core.rules import find_rule

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "animtool/docs"
# Files outside of the pages that come along, where a page links to them or shows them.
BESIDE = ("samples", "rigs", "tests/bench/results")
SUFFIXES = {".md", ".png", ".webp", ".svg", ".csv"}
LINK = re.compile(r"(!?\[(?:[^\[\]]|\[[^\]]*\])*\]\()([^)\s]+)\)")
# A block of commands of which one makes a page that plays.
PLAYER = re.compile(
    r"^```console\n(?:(?!```).*\n)*?\$ animtool preview .* -o (?P<out>\S+\.html)\n"
    r"(?:(?!```).*\n)*```\n",
    re.M,
)
FRONT = re.compile(r"\A---\n.*?\n---\n", re.S)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the README, samples, results, and pages that are made."""
    readme = (ROOT / "README.md").read_text("utf-8")
    made = {
        "index.md": readme,
        "reference/commands.md": commands_markdown(),
        "reference/codes.md": codes_markdown(),
    }
    for name, text in made.items():
        files.append(File.generated(config, name, content=text))
    for folder in BESIDE:
        for path in sorted((ROOT / folder).rglob("*")):
            name = _place(path)
            if name is not None and path.suffix in SUFFIXES:
                source = str(path)
                files.append(File.generated(config, name, abs_src_path=source))
    for name, content in _playable().items():
        files.append(File.generated(config, name, content=content))
    return files


def _playable() -> dict[str, bytes]:
    """Return the pages that play which tutorials make, by their place in the site."""
    sys.path.insert(0, str(ROOT / "tests"))
    from support.tutorials import TUTORIALS, follow, steps_of, workplace_of

    found: dict[str, bytes] = {}
    with tempfile.TemporaryDirectory() as work:
        for page in TUTORIALS:
            place = workplace_of(page, Path(work))
            for step in steps_of(page.read_text("utf-8")):
                if step.output.endswith(".webp"):
                    continue
                follow(step, place)
                if step.output.endswith(".html"):
                    name = f"tutorials/{page.stem}/{Path(step.output).name}"
                    found[name] = (place / step.output).read_bytes()
    return found


def on_page_markdown(
    markdown: str, page: Page, config: MkDocsConfig, files: Files
) -> str:
    """Let links lead to where files are in the site, and show pages that play."""
    del config
    name = page.file.src_uri
    origin = _origin(name)
    if name.startswith("rules/"):
        markdown = _rule_page(markdown, page)

    def linked(found: re.Match[str]) -> str:
        head, link = found.groups()
        target, _, anchor = link.partition("#")
        if not target or "://" in target or target.startswith("mailto:"):
            return found[0]
        path = (origin.parent / target).resolve()
        where = _place(path)
        if where is None or files.get_file_from_path(where) is None:
            # Of the sources: the site has its name alone.
            return found[0] if path.is_relative_to(DOCS) else head[:-1].strip("[]")
        near = "../" * name.count("/") + where
        return f"{head}{near}{'#' * bool(anchor)}{anchor})"

    markdown = LINK.sub(linked, markdown)
    return _with_players(markdown, name, files)


def _origin(name: str) -> Path:
    """Return the file that a page is made of."""
    if name == "index.md":
        return ROOT / "README.md"
    if name.startswith(tuple(f"{folder}/" for folder in BESIDE)):
        return ROOT / re.sub(r"index\.md$", "README.md", name)
    return DOCS / name


def _place(path: Path) -> str | None:
    """Return where a file of the project is in the site; None where it is not."""
    if path == ROOT / "README.md":
        return "index.md"
    if path.is_relative_to(DOCS):
        return path.relative_to(DOCS).as_posix()
    if path.is_relative_to(ROOT):
        return path.relative_to(ROOT).as_posix().replace("README.md", "index.md")
    return None


def _rule_page(markdown: str, page: Page) -> str:
    """Return the page of a code with the heading that `explain` gives it."""
    meta: dict[str, Any] = page.meta
    text = f"# {meta['code']}: {meta['title']}\n{FRONT.sub('', markdown)}"
    return text + ignore_section(find_rule(meta["code"]))


def _with_players(markdown: str, name: str, files: Files) -> str:
    """Show pages that play below the commands that make them."""
    folder = name.removesuffix(".md")

    def shown(found: re.Match[str]) -> str:
        player = Path(found["out"]).name
        if files.get_file_from_path(f"{folder}/{player}") is None:
            return found[0]
        source = f"{Path(folder).name}/{player}"
        frame = f'<iframe src="{source}" title="{player}" loading="lazy" '
        return f'{found[0]}\n{frame}style="width:100%;height:30em;border:0"></iframe>\n'

    return PLAYER.sub(shown, markdown)
