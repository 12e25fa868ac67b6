"""Types of keys that files of several kinds have."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Len
from pydantic import Field

__all__ = ["Name", "Pair", "Quaternion", "Vector"]

# On one line: control characters are in no text that is read.
Name = Annotated[str, Field(min_length=1, pattern=r"^[^\n\t]*$")]
Pair = Annotated[list[float], Len(2, 2)]
Vector = Annotated[list[float], Len(3, 3)]
# w, x, y, z.
Quaternion = Annotated[list[float], Len(4, 4)]
