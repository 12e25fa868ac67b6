"""The files of an output in chunks, joined as value clips: what they are called."""

from __future__ import annotations

import re
from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class ClipFiles:
    """The chunks and the manifest of one set of value clips.

    Attributes:
        output: The layer that joins them.
        name: Of the set.
        manifest: What states which attributes the chunks have.
    """

    output: Path
    name: str
    manifest: Path

    def chunk(self, number: int) -> Path:
        """Return a chunk, 0 being the first.

        >>> system_files(Path("shot.usdc")).chunk(0).name
        'shot.systems.0001.usdc'
        """
        stem = self.output.stem
        return self.output.with_name(f"{stem}.{self.name}.{number + 1:04d}.usdc")

    @property
    def defaults(self) -> str:
        """Asset path of the chunk with defaults, which the layer has as a sublayer.

        Defaults in the layer itself would win over the clips.
        """
        return f"./{self.chunk(0).name}"

    def there(self) -> list[Path]:
        """Return the chunks that are there, in order."""
        stem, folder = re.escape(self.output.stem), self.output.parent
        name = re.compile(rf"{stem}\.{self.name}\.\d{{4,}}\.usdc")
        paths = folder.iterdir() if folder.is_dir() else ()
        return sorted(path for path in paths if name.fullmatch(path.name))

    def remove_others(self, kept: Collection[Path]) -> None:
        """Remove chunks that an earlier, longer bake left."""
        for path in set(self.there()) - set(kept):
            # What cannot be removed is in nobody's way.
            with suppress(OSError):
                path.unlink()


def point_files(output: Path) -> ClipFiles:
    """Return the files of a character's point caches.

    >>> point_files(Path("shot.usdc")).manifest.name
    'shot.manifest.usda'
    """
    manifest = output.with_name(f"{output.stem}.manifest.usda")
    return ClipFiles(output, "points", manifest)


def system_files(output: Path) -> ClipFiles:
    """Return the files of what is simulated.

    >>> system_files(Path("shot.usdc")).manifest.name
    'shot.systems.manifest.usda'
    """
    manifest = output.with_name(f"{output.stem}.systems.manifest.usda")
    return ClipFiles(output, "systems", manifest)
