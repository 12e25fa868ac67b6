"""What a file says of findings that its author knows of and keeps."""

from __future__ import annotations

from pydantic import Field

from animtool.documents.check import FileModel


class IgnoreModel(FileModel):
    """A finding of `animtool validate` that is known and stays."""

    code: str = Field(min_length=1, description="Of the finding.", examples=["RIG201"])
    where: str | None = Field(
        default=None,
        min_length=1,
        description="Where it is, as the finding says it, or a place around that; an "
        "entry of a list by number or name, `*` for anything. Not given: anywhere in "
        "the file.",
        examples=["joints[knee_l].limits"],
    )
    why: str = Field(
        min_length=1,
        description="Why it stays: for those who read the file next.",
        examples=["this crouch is the rest pose"],
    )
