"""What a batch is asked to do, as a file or the command line says it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from animtool.batch.limits import Limits
from animtool.batch.variants import Variants
from animtool.scene.options import BakeOptions

BATCH_SUFFIXES = (".batch.yaml", ".batch.yml", ".batch.json")


@dataclass(frozen=True, slots=True)
class BatchSpec:
    """What a batch is asked to do.

    Attributes:
        inputs: Files, folders and globs, seen from ``folder``; a timeline among them
            is that of ``cuts``.
        folder: Where relative names start.
        name: What its records are called.
        exclude: What of the inputs is left out.
        scene: A scene that says what is done to each; None bakes each as it is.
        variables: What names in the scene and the output stand for.
        options: How to bake, where there is no scene.
        output: Pattern of the files to write; None is beside each input.
        limits: What each may take.
        jobs: How many processes; None is one for each processor.
        path: The file that says it; None where there is none.
        cuts: A timeline whose clips are the items; None has one for each input.
        handles: Shot frames before and after the cuts of a timeline; None is as that
            says, else 0.
        variants: A table of values of which each row makes an item of each input; None
            makes one.
        roots: Folders that outputs may be in, as a batch file is of a project; empty is
            any.
    """

    inputs: tuple[str, ...]
    folder: Path = Path()
    name: str = "batch"
    exclude: tuple[str, ...] = ()
    scene: Path | None = None
    variables: Mapping[str, str] = field(default_factory=dict)
    options: BakeOptions = field(default_factory=BakeOptions)
    output: str | None = None
    limits: Limits = field(default_factory=Limits)
    jobs: int | None = None
    path: Path | None = None
    cuts: Path | None = None
    handles: int | None = None
    variants: Variants | None = None
    roots: tuple[Path, ...] = ()

    @property
    def rows(self) -> Sequence[Mapping[str, str]]:
        """The variants; one without values where there are none."""
        return ({},) if self.variants is None else self.variants.rows


def is_batch(path: Path) -> bool:
    """Return whether a path is that of a batch file.

    >>> is_batch(Path("nightly.batch.yaml")), is_batch(Path("takes"))
    (True, False)
    """
    return path.name.lower().endswith(BATCH_SUFFIXES)
