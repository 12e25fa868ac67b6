"""The variables of a scene."""

from __future__ import annotations

from collections.abc import Iterator

from animtool.errors import Fault
from animtool.validation.subjects.scene import SceneSubject


def idle(subject: SceneSubject) -> Iterator[Fault]:
    """Yield variables that no text uses (SCN209)."""
    for name in sorted(subject.scene.idle_variables):
        message = f"no text of the scene uses ${{{name}}}"
        yield subject.fault("SCN209", ("variables", name), message, "leave it out")
