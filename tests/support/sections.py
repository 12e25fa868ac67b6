"""Commands of the documents by their headings, and what those of a heading need."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable

from support.printed import DOCUMENTS, ROOT, commands_in


def sections_of(text: str) -> dict[str, list[str]]:
    """Return the commands below each heading of a document that has any."""
    sections: dict[str, list[str]] = {}
    for section in re.split(r"^#+ ", text, flags=re.M)[1:]:
        if commands := commands_in(section):
            sections[section.splitlines()[0]] = commands
    return sections


TEXTS = {document: (ROOT / document).read_text("utf-8") for document in DOCUMENTS}
SECTIONS = {document: sections_of(text) for document, text in TEXTS.items()}


def output_of(command: str) -> str | None:
    """Return the name of the file that a command writes."""
    words = shlex.split(command)
    if "-o" in words:
        return words[words.index("-o") + 1]
    positional = [word for word in words if not word.startswith("-")]
    return positional[3] if words[1] == "convert" else None


def needed(document: str, title: str) -> list[str]:
    """Return the commands of earlier sections that a section needs, and what they need.

    A file is written by the command that names it as its output, or else, as a rig
    layer is, by those that write one of the same stem: of the same page, or else of any
    page in the folder of documents.
    """
    titles, own = list(SECTIONS[document]), SECTIONS[document][title]
    earlier = unique(
        command
        for each in titles[: titles.index(title)]
        for command in SECTIONS[document][each]
    )
    others = unique(
        command
        for page in DOCUMENTS
        if page != document and page.startswith("animtool/docs/")
        for commands in SECTIONS[page].values()
        for command in commands
    )
    order = unique([*others, *earlier])
    commands: list[str] = []
    pending = list(own)
    while pending:
        command = pending.pop()
        read = {word for word in shlex.split(command)[2:] if "." in word}
        for name in read - {output_of(command)}:
            if (ROOT / name).exists():
                continue
            writers: list[str] = []
            for stem in (False, True):
                if written_by(name, own, stem=stem):
                    break
                writers = written_by(name, earlier, stem=stem)
                writers = writers or written_by(name, others, stem=stem)[:1]
                if writers:
                    break
            pending += [each for each in writers if each not in commands]
            commands += [each for each in writers if each not in commands]
    return sorted(commands, key=order.index)


def unique(commands: Iterable[str]) -> list[str]:
    """Return commands in their order, each once."""
    return list(dict.fromkeys(commands))


def written_by(name: str, commands: list[str], *, stem: bool = False) -> list[str]:
    """Return those of some commands that write a file, or one of the same stem."""

    def key(file: str) -> str:
        return file.split(".", maxsplit=1)[0] if stem else file

    return [each for each in commands if key(output_of(each) or "") == key(name)]


def in_order(document: str) -> list[str]:
    """Return the commands of a document, each behind those whose files it needs."""
    return unique(
        command
        for title, own in SECTIONS[document].items()
        for command in [*needed(document, title), *own]
    )
