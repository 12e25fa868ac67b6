"""A scene file as its rules see it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from animtool.documents.document import Document
from animtool.errors import AnimtoolError, Fault
from animtool.scene.file import Scene, scene_of_document
from animtool.validation.rule import Kind
from animtool.validation.subjects.subject import DocumentSubject, Opened

__all__ = ["SceneSubject", "open_scene"]


@dataclass(frozen=True, eq=False)
class SceneSubject(DocumentSubject):
    """A scene, and the file that says it.

    Attributes:
        scene: What it makes.
    """

    scene: Scene


def open_scene(document: Document) -> Opened:
    """Return a scene file as its rules see it; its source is read, its passes done.

    Raises:
        FormatError: With every fault of the file.
    """
    scene = scene_of_document(document)
    path = str(document.path)
    try:
        notices = scene.open().collect().notices
    except AnimtoolError as error:
        faults: Iterable[Fault] = error.faults
    else:
        # What is odd about another file is said of that one.
        faults = (fault for fault in notices if fault.path in {None, path})
    found = [f if f.path else replace(f, path=path) for f in faults]
    return Opened(Kind.SCENE, found, SceneSubject(document, scene))
