"""Files that people write: read by their loaders, and their faults as they print."""

from __future__ import annotations

import copy
import json
import re
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from animtool.batch.file import load_batch
from animtool.capture.cameras.file import load_cameras
from animtool.capture.face.file import face_model, load_landmarks
from animtool.capture.templates import load_template
from animtool.clip.file import check_clip, load_clip, open_clip
from animtool.core.errors import AnimtoolError, Fault
from animtool.core.quantities import printable_json
from animtool.ik.file import load_targets
from animtool.retarget.file import load_map
from animtool.rig.file import load_rig
from animtool.rig.remap import link_shapes, load_remap
from animtool.rig.skeleton import Rig
from animtool.scene.file.read import load_scene
from fuzz.mutations import spoil

ABOUT = "files of each kind that people write, spoiled as bytes or as values"

ROOT = Path(__file__).parents[3]
KINDS = (
    *("rig", "clip", "map", "markers", "scene", "targets", "batch", "cameras"),
    *("landmarks", "remap"),
)
# No sample has one.
REMAP = (
    "remap: animtool/1\nothers: none\nshapes:\n- {source: A, target: smile, gain: 2}\n"
    "- {source: B, target: jaw, offset: -0.1, clamp: [0, 1]}\n"
)
MAP = (
    "map: animtool/1\nothers: auto\njoints:\n"
    "- {source: 'mixamorig:Hips', target: hips}\n"
    "- {source: RightHand, target: hand_r}\nignored: {source: [Head], target: [neck]}\n"
)
# Keys in arrays, of which some are none.
ARM = (
    "rig: animtool/1\nname: arm\nup: Y\njoints:\n- {name: hip, type: free}\n"
    "- {name: knee, parent: hip, type: pin, axis: [0, 0, 1]}\n"
)
ARM_CLIP = (
    "clip: animtool/1\nrig: arm.rig.yaml\nfps: 24\nchannels:\n"
    "- {target: joint/knee.angle, keys: arm.npz#one, interp: linear}\n"
    "- {target: joint/hip.translation, keys: arm.npz#three}\n"
    "- {target: joint/hip.rotation, keys: arm.npz#four, post: cycle}\n"
)
ARM_ARRAYS = {
    **{"one": [[1, 0], [9, 30]], "three": [[1, 0, 0, 1], [5, 2, 0, 0]]},
    **{"four": [[0, 1, 0, 0, 0], [7, 0, 1, 0, 0]], "keys": [[2, 1], [1, 1]]},
    **{"flat": [0, 0, 0, 0, 0], "huge": [[0, 1e300]], "nan": [[0, float("nan")]]},
}
# Longer ones take more than some milliseconds, and say no more.
LONGEST = 3000
# What no line of a message may hold.
UNSEEN = re.compile("[\x00-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069\ud800-\udfff]|^::")
VALUES: list[Any] = [
    *(None, True, 0, -1, 1, 1e308, -1e308, 1e-320, 2**63, 10**40, 0.5, "", "?", " "),
    *("nan", ".inf", "1e999", "9" * 500, "a" * 5000, "\x1b]0;mine\x07", "\u202e"),
    *("a\n::error::mine", "##[error]", "\u2028", "é\u0301", "${a}", "${", "${a", "$${"),
    *("../../../../etc/passwd", "/dev/zero", "/", ".", "x.npz#a", "#", "x.bvh", "~"),
    *("arm.npz", "arm.npz#flat", "arm.npz#huge", "arm.npz#nan", "arm.npz#four"),
    *("1..9999999", "1..", "{stem}", "{", "joint/a.rotation", "control/a", "shape/"),
    *([], {}, [[]], [{}], {"a": {}}, {"": ""}, [0] * 300, ["a"] * 300, {"name": "a"}),
    *("(" * 90, "-" * 900 + "a", "9**9**9", "a.b", "f(x)", "1 if a else 2", "a/0"),
]


@dataclass(frozen=True, slots=True)
class Seed:
    """A valid file."""

    path: Path
    kind: str
    data: bytes
    value: Any


def make(
    folder: Path, kinds: tuple[str, ...] = KINDS
) -> Callable[[np.random.Generator], str]:
    """Return what runs a case in a folder, of some kinds of files."""
    seeds = [seed for seed in _seeds(folder) if seed.kind in kinds]
    rigs: dict[Path, Rig] = {}
    words = sorted({key for seed in seeds for key in _keys(seed.value)})

    def run(rng: np.random.Generator) -> str:
        seed = seeds[int(rng.integers(len(seeds)))]
        if rng.random() < 0.5:
            suffix, data = "yaml", spoil(rng, seed.data)
        else:
            value = copy.deepcopy(seed.value)
            for _ in range(int(min(rng.geometric(0.5), 6))):
                value = _changed(rng, value, words)
            suffix, data = "json", json.dumps(value).encode()
            suffix = suffix if rng.integers(2) else "yaml"
        path = seed.path.with_name(f"case.{seed.kind}.{suffix}")
        path.write_bytes(data)
        try:
            _load(path, seed, rigs)
        except AnimtoolError as error:
            _check(error.faults)
            return f"{seed.kind} {error.code[:3]}"
        finally:
            path.unlink()
        return f"{seed.kind} read"

    return run


def _check(faults: Sequence[Fault]) -> None:
    """Check that faults are few, and print as lines that nothing obeys."""
    assert len(faults) <= 201
    for fault in faults:
        assert not UNSEEN.search(str(fault)), ascii(str(fault))
        printable_json(fault.as_dict()).encode()


def _seeds(folder: Path) -> Iterator[Seed]:
    """Yield copies of the shipped files, each beside the files that it names."""
    folder = folder / "project"
    for name in ("rigs", "samples"):
        shutil.copytree(ROOT / name, folder / name)
    (folder / "animtool.toml").write_text("", "utf-8")
    (folder / "hero.remap.yaml").write_text(REMAP, "utf-8")
    (folder / "hero.map.yaml").write_text(MAP, "utf-8")
    (folder / "arm.rig.yaml").write_text(ARM, "utf-8")
    (folder / "arm.clip.yaml").write_text(ARM_CLIP, "utf-8")
    arrays = {name: np.array(rows, float) for name, rows in ARM_ARRAYS.items()}
    np.savez(folder / "arm.npz", **arrays)
    for path in sorted(folder.rglob("*.yaml")):
        kind = path.name.split(".")[-2]
        if kind in KINDS and path.stat().st_size <= LONGEST:
            data = path.read_bytes()
            yield Seed(path, kind, data, yaml.safe_load(data))


def _load(path: Path, seed: Seed, rigs: dict[Path, Rig]) -> None:
    if seed.kind == "rig":
        load_rig(path)
    elif seed.kind == "scene":
        load_scene(path, {})
    elif seed.kind == "batch":
        load_batch(path)
    elif seed.kind == "targets":
        load_targets(path)
    elif seed.kind == "map":
        load_map(path)
    elif seed.kind == "cameras":
        load_cameras(path)
    elif seed.kind == "markers":
        load_template(path)
    elif seed.kind == "remap":
        made = link_shapes(("A", "B"), ("smile", "jaw"), load_remap(path))
        assert np.isfinite([(link.gain, link.offset) for link in made.links]).all()
    else:
        if seed.path not in rigs:
            named = seed.path.parent / str(seed.value["rig"])
            rigs[seed.path] = load_rig(named)
        if seed.kind == "landmarks":
            face_model(load_landmarks(path), rigs[seed.path])
            return
        clip = open_clip(path)
        check_clip(clip)
        load_clip(clip, rigs[seed.path])


def _keys(node: Any) -> Iterator[str]:
    if isinstance(node, dict):
        yield from node
    for inner in _inside(node):
        yield from _keys(inner)


def _inside(node: Any) -> list[Any]:
    if isinstance(node, dict):
        return list(node.values())
    return node if isinstance(node, list) else []


def _changed(rng: np.random.Generator, value: Any, words: list[str]) -> Any:
    """Return a value in which something is replaced, removed, moved or renamed."""
    nodes = [value]
    for node in nodes:
        nodes += _inside(node)
    holders = [node for node in nodes if _inside(node)]
    if not holders:
        return value
    holder = holders[int(rng.integers(len(holders)))]
    keys = list(holder) if isinstance(holder, dict) else list(range(len(holder)))
    key = keys[int(rng.integers(len(keys)))]
    other = copy.deepcopy(nodes[int(rng.integers(len(nodes)))])
    nasty = copy.deepcopy(VALUES[int(rng.integers(len(VALUES)))])
    match int(rng.integers(6)):
        case 0:
            del holder[key]
        case 1:
            holder[key] = other
        case 2 if isinstance(holder, list):
            holder.insert(key, other)
        case 3 if isinstance(holder, dict):
            holder[words[int(rng.integers(len(words)))]] = holder.pop(key)
        case 4 if isinstance(holder, dict):
            holder[nasty if isinstance(nasty, str) else "extra"] = other
        case _:
            holder[key] = nasty
    return value
