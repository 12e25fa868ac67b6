"""What a bake writes, and the files that it is."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path

__all__ = ["Form", "output_paths"]


class Form(StrEnum):
    """What to write.

    ``stage`` is one file with skeleton and animation; ``split`` the same in three
    layers; ``layer`` only the animation, over a rig that lives elsewhere; ``library`` a
    take of a clip library, beside those that this has.
    """

    STAGE = "stage"
    SPLIT = "split"
    LAYER = "layer"
    LIBRARY = "library"


def output_paths(output: Path, form: Form) -> list[Path]:
    """Return the files that a form writes, in the order written, ``output`` last."""
    if form is not Form.SPLIT:
        return [output]
    return [
        output.with_name(f"{output.stem}.rig.usda"),
        output.with_name(f"{output.stem}.anim.usdc"),
        output,
    ]
