"""What a bake writes, and the files that it is."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path

from animtool.errors import Fault, OptionError

__all__ = ["Form", "check_suffix", "output_paths"]

SUFFIXES = (".usd", ".usda", ".usdc")


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


def check_suffix(path: Path) -> None:
    """Raise `OptionError` where a path is not that of a USD layer (OUT004)."""
    if path.suffix.lower() not in SUFFIXES:
        allowed = f"allowed: {', '.join(SUFFIXES)}"
        kind = f"suffix {path.suffix!r}" if path.suffix else "a name without suffix"
        message = f"{kind} is no kind of USD layer"
        raise OptionError(Fault("OUT004", message, str(path), (), allowed))
