"""Tables of variants and the texts of --vary, spoiled, and read."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from animtool.batch.file import load_batch
from animtool.batch.variants import MAX_VARIANTS, read_variants, variants_of_texts
from animtool.core.errors import AnimtoolError
from fuzz.mutations import pick, spoil, spoil_values

ABOUT = "tables of variants (CSV, TSV), values of --vary and of batch files: read"

TABLE = b'k,s,name\n1,0.5,"a, b"\n2,0.25,c\n\n3,1e-3,d\n'
TEXTS = [b"k=1..20/0.5,30", b"name=a,b,1..3", b"s=-1..1/1e-1", b"k=10..1/-3"]
BATCH = {
    "batch": "animtool/1",
    "inputs": ["a.scene.yaml"],
    "output": "out/{k}.usdc",
    "variants": {"k": [1, 2], "s": "0..1/0.25", "t": {"start": 0, "stop": 1}},
}


def make(folder: Path) -> Callable[[np.random.Generator], str]:
    """Return what runs a case in a folder."""
    tables = [("csv", TABLE), ("tsv", TABLE.replace(b",", b"\t"))]

    def run(rng: np.random.Generator) -> str:
        try:
            kind = int(rng.integers(3))
            if kind == 0:
                suffix, data = tables[int(rng.integers(len(tables)))]
                path = folder / f"table.{suffix}"
                path.write_bytes(spoil(rng, data))
                rows = read_variants(path).rows
            elif kind == 1:
                text = spoil(rng, pick(rng, TEXTS)).decode("utf-8", "surrogateescape")
                rows = variants_of_texts([text]).rows
            else:
                value = {**BATCH, "variants": spoil_values(rng, BATCH["variants"])}
                path = folder / "a.batch.json"
                path.write_text(json.dumps(value), "utf-8")
                variants = load_batch(path).variants
                rows = () if variants is None else variants.rows
        except AnimtoolError as error:
            return error.code
        assert len(rows) <= MAX_VARIANTS
        return "read"

    return run
