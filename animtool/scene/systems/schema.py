"""The kinds of systems that a scene file may name, as a model."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pydantic import Field, create_model

from animtool.documents.check import FileModel
from animtool.plugins import load_object
from animtool.systems.kinds import SYSTEM_KINDS


class _SystemModel(FileModel):
    """One simulation, of one kind."""


if TYPE_CHECKING:
    SystemModel = _SystemModel
else:
    # Of an entry's kinds one is given; that one may not be nothing.
    _NOT_GIVEN: Any = None
    SystemModel = create_model(
        "SystemModel",
        __base__=_SystemModel,
        __module__=__name__,
        __doc__=_SystemModel.__doc__,
        **{
            name: (
                load_object(kind.spec),
                Field(
                    default=_NOT_GIVEN,
                    description=kind.description,
                    examples=[kind.example],
                ),
            )
            for name, kind in SYSTEM_KINDS.items()
        },
    )
