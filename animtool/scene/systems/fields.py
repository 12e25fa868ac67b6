"""Types of keys that several kinds of systems have."""

from __future__ import annotations

from typing import Annotated, Any

from annotated_types import Ge, Len
from pydantic import AfterValidator, Field

from animtool.documents.fields import Name, Real, check_numbers

# One name of a table, and its options.
Named = Annotated[
    dict[str, dict[str, Any] | None], Len(1, 1), AfterValidator(check_numbers)
]
# Seconds from the first frame on, and a vector.
TimedVector = Annotated[list[Real], Len(4, 4)]

PrimName = Annotated[str, Field(description="Name of the prim.")]
UsdFile = Annotated[Name, Field(description="The USD file.")]
PrimPath = Annotated[Name, Field(description="Path of the prim.")]
CharacterFile = Annotated[
    Name | None,
    Field(
        description="A clip or a scene; its first frame comes at 0 s.",
        examples=["walk.clip.yaml"],
    ),
]
OwnCharacter = Annotated[
    bool,
    Field(
        description="In place of a file: the character of this scene, behind its "
        "passes.",
        examples=[True],
    ),
]
Margin = Annotated[
    Real, Field(description="Distance that they keep [m].", examples=[0.01])
]
Preroll = Annotated[
    Real,
    Ge(0),
    Field(
        description="Seconds before the first frame that it begins in.", examples=[2]
    ),
]
