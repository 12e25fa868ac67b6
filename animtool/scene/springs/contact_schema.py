"""The keys of contact of a surface with itself, as a model."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Ge, Gt
from pydantic import Field

from animtool.documents.check import FileModel
from animtool.documents.fields import Real


class SelfContactModel(FileModel):
    """How a surface keeps apart from itself, in folds and layers."""

    thickness: Annotated[Real, Gt(0)] = Field(
        description="Least distance of its particles from its faces [m], such as half "
        "the length of an edge.",
        examples=[0.01],
    )
    friction: Annotated[Real, Ge(0)] = Field(
        default=0.2, description="Coulomb's coefficient.", examples=[0.4]
    )
    speed: Annotated[Real, Gt(0)] = Field(
        default=0.2,
        description="What is nearer at the start comes apart this fast [m/s].",
        examples=[0.1],
    )


SelfContactField = Annotated[
    SelfContactModel | None,
    Field(
        description="How it keeps apart from itself. Not given: it goes through.",
        examples=[{"thickness": 0.01}],
    ),
]
