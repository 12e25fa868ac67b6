"""Keys of times and values alone are what keys with models are."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from animtool.clip.file import load_clip_of
from animtool.clip.schema import PlainKeys
from animtool.core.errors import FormatError
from animtool.rig.skeleton import Joint, JointType, Rig

RIG = Rig("arm", (Joint("hip", -1), Joint("knee", 0, JointType.PIN)))


def written(tmp_path: Path, **channel: Any) -> Path:
    clip = {"clip": "animtool/1", "fps": 24, "channels": [channel]}
    path = tmp_path / "some.clip.json"
    path.write_text(json.dumps(clip))
    return path


@pytest.mark.parametrize(
    ("target", "values", "more"),
    [
        ("joint/knee.angle", [0, 10.5, -3], {}),
        ("joint/knee.angle", [[0], [10.5], [-3]], {"interp": "linear"}),
        (
            "joint/hip.translation",
            [[0, 1, 2], [3, 4, 5.5], [6, 7, 8]],
            {"pre": "cycle"},
        ),
        ("joint/hip.rotation", [[1, 0, 0, 0], [0, 2, 0, 0], [0, 0, 1, 1]], {}),
        ("joint/hip.rotation", [[0, 1, 2], [9, 4, 5], [6, 7, 8]], {"euler": "ZXY"}),
        ("joint/hip.scale", [1, 2, 0.5], {"tangents": "flat"}),
    ],
)
def test_channels_are_the_same(
    tmp_path: Path, target: str, values: list[Any], more: dict[str, Any]
) -> None:
    keys = [{"t": 1.5 * k, "v": value} for k, value in enumerate(values)]
    plain = written(tmp_path, target=target, keys=keys, **more)
    (found,) = load_clip_of(plain, RIG).channels
    # The first says what the others do not.
    keys[-1]["interp"] = more.get("interp", str(found.interps[0]))
    (expected,) = load_clip_of(
        written(tmp_path, target=target, keys=keys, **more), RIG
    ).channels
    for name in type(found).__dataclass_fields__:
        one, other = getattr(found, name), getattr(expected, name)
        if isinstance(one, np.ndarray):
            np.testing.assert_array_equal(one, other)
        else:
            assert one == other


@pytest.mark.parametrize(
    ("target", "keys", "code", "where"),
    [
        (
            "joint/knee.angle",
            [{"t": 1, "v": [1, 2]}],
            "CLIP007",
            "channels[0].keys[0].v",
        ),
        (
            "joint/knee.angle",
            [{"t": 2, "v": 1}, {"t": 1, "v": 2}],
            "CLIP004",
            "channels[0].keys[1].t",
        ),
        (
            "joint/hip.rotation",
            [{"t": 1, "v": [0, 0, 0, 0]}],
            "RIG006",
            "channels[0].keys[0].v",
        ),
        ("joint/knee.angle", [{"t": 1, "v": True}], "DOC009", None),
        ("joint/knee.angle", [{"t": 1, "v": 1e200}], "DOC009", None),
    ],
)
def test_faults_of_plain_keys_name_their_place(
    tmp_path: Path, target: str, keys: list[Any], code: str, where: str | None
) -> None:
    with pytest.raises(FormatError) as caught:
        load_clip_of(written(tmp_path, target=target, keys=keys), RIG)
    fault = caught.value.faults[0]
    if where is not None:
        assert (fault.code, fault.where) == (code, where)


@pytest.mark.parametrize(
    "entries",
    [
        [],
        None,
        [1],
        [{"t": 1}],
        [{"t": 1, "w": 2}],
        [{"t": 1, "v": []}],
        [{"t": 1, "v": [1]}, {"t": 2, "v": [1, 2]}],
        [{"t": 1, "v": 1}, {"t": 2, "v": [1]}],
        [{"t": True, "v": 1}],
        [{"t": "1", "v": 1}],
        [{"t": 1, "v": float("nan")}],
        [{"t": 1, "v": 10**400}],
        [{"t": 1, "v": 1, "out": "flat"}],
    ],
)
def test_what_is_more_or_faulty_is_not_plain(entries: Any) -> None:
    assert PlainKeys.from_entries(entries) is None
