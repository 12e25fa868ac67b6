"""Layers that are saved while they grow: memory stays the same, however long they get.

A crate that is saved now and then has its samples on disk.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pxr import Sdf, Tf

from animtool.output import replacing
from animtool.placing import output_error
from animtool.usd.layers import save_layer, usd_reason

# Samples in memory before they go to the disk [byte].
HELD = 32_000_000


class Growing:
    """A layer that samples are put into.

    Attributes:
        layer: The layer.
    """

    def __init__(self, layer: Any, path: Path | None = None) -> None:
        """Begin.

        Args:
            layer: A crate of its own file, or a layer in memory.
            path: What the file will be called; None keeps all in memory.
        """
        self.layer = layer
        self._path = path
        self._held = 0

    def added(self, size: int) -> None:
        """Note samples of a size [byte]; bring them to the disk where they are many.

        Raises:
            OutputError: The file cannot be written.
        """
        self._held += size
        if self._path is not None and self._held > HELD:
            self.save()

    def save(self) -> None:
        """Bring to the disk what is not there.

        Raises:
            OutputError: The file cannot be written.
        """
        assert self._path is not None
        with _written(self._path):
            self.layer.Save()
        self._held = 0


@contextmanager
def growing_crate(temporary: Path, path: Path) -> Iterator[Growing]:
    """Give a crate that is whole at the end of the block.

    Args:
        temporary: Its file.
        path: What that will be called.

    Raises:
        OutputError: The file cannot be written.
    """
    with _written(path):
        layer = Sdf.Layer.CreateNew(str(temporary), args={"format": "usdc"})
    growing = Growing(layer, path)
    yield growing
    growing.save()


def save_grown(layer: Any, path: Path | None, grow: Callable[[Growing], object]) -> int:
    """Write a layer and what is put into it then, whole or not at all.

    Args:
        layer: In memory.
        path: The file; None is usda on stdout.
        grow: Puts samples into it; what it raises leaves nothing behind.

    Returns:
        The bytes written.

    Raises:
        OutputError: It cannot be written.
    """
    if path is None or path.suffix.lower() == ".usda":
        grow(Growing(layer))
        return save_layer(layer, path)
    with replacing(path) as temporary:
        with growing_crate(temporary, path) as growing:
            growing.layer.TransferContent(layer)
            grow(growing)
        return temporary.stat().st_size


@contextmanager
def _written(path: Path) -> Iterator[None]:
    """Turn what USD raises where it writes into an `OutputError`."""
    try:
        yield
    except Tf.ErrorException as error:
        raise output_error(path, usd_reason(error)) from error
