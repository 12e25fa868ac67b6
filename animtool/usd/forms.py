"""What a bake writes, and the files that it is."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path

from animtool.errors import Fault, OptionError
from animtool.output import is_text

SUFFIXES = (".usd", ".usda", ".usdc")
# What `convert` writes, and outputs of scenes too.
CONVERTED = (".bvh", ".yaml", ".yml")


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


def check_suffix(path: Path, source: Path | str = "SOURCE") -> None:
    """Refuse a path that is not that of a USD file."""
    suffix = path.suffix.lower()
    if suffix in SUFFIXES:
        if not is_text(str(path.absolute())):
            message = "has bytes in its path that are no UTF-8, which USD cannot open"
            raise OptionError(Fault("OUT006", message, str(path), (), "rename it"))
        return
    kind = f"suffix {path.suffix!r}" if path.suffix else "a name without suffix"
    message = f"{kind} is not a USD extension"
    hint = f"allowed: {', '.join(SUFFIXES)}"
    if suffix in CONVERTED:
        hint = f"write it with: animtool convert {source} {path}"
    raise OptionError(Fault("OUT004", message, str(path), (), hint))
