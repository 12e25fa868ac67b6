"""Keys of outputs that scenes and batches share."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

FormName = Annotated[
    Literal["stage", "split", "layer"] | None,
    Field(
        alias="as",
        description="One file, three, or an animation layer. Not given: `layer` with "
        "`rig_layer`, else `stage`.",
        examples=["split"],
    ),
]
RigLayer = Annotated[
    str | None,
    Field(
        description="The rig in USD, or a shot that holds it, that a layer goes over.",
        examples=["hero.usda"],
    ),
]
ForceFit = Annotated[
    bool,
    Field(
        description="Write a take that does not fit the rig all the same.",
        examples=[True],
    ),
]
Sparse = Annotated[
    bool,
    Field(description="Write only joints that leave their rest pose.", examples=[True]),
]
Bones = Annotated[
    bool,
    Field(description="Add geometry that shows the joints.", examples=[True]),
]
ReduceAt = Annotated[
    dict[str, str],
    Field(
        description="Other tolerances, by joint or pattern.",
        examples=[{"hand_*": "0.1mm"}],
    ),
]
