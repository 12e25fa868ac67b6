"""Keys in arrays are what the same keys in the file are, and faults say where."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from animtool.clip.file import load_clip_of
from animtool.core.errors import FormatError
from animtool.rig.skeleton import Joint, JointType, Rig

RIG = Rig("arm", (Joint("hip", -1), Joint("knee", 0, JointType.PIN)))
ROWS = {
    "joint/knee.angle": [[1, 0], [2.5, 10], [9, -3]],
    "joint/hip.translation": [[1, 0, 1, 2], [3, 3, 4, 5.5]],
    "joint/hip.rotation": [[0, 1, 0, 0, 0], [1, 0, 2, 0, 0], [4, 0, 0, 1, 1]],
    "joint/hip.scale": [[0, 1], [5, 2]],
}


def clip_of(folder: Path, keys: Any, target: str, **more: Any) -> Path:
    channel = {"target": target, "keys": keys, **more}
    path = folder / "some.clip.json"
    text = {"clip": "animtool/1", "fps": 24, "channels": [channel]}
    path.write_text(json.dumps(text))
    return path


def stored(folder: Path, rows: Any) -> str:
    np.savez(folder / "some.npz", curve=np.array(rows))
    return "some.npz#curve"


@pytest.mark.parametrize("target", ROWS)
def test_an_array_is_the_list_of_its_keys(tmp_path: Path, target: str) -> None:
    rows = ROWS[target]
    values = [row[1:] if len(row) > 2 else row[1] for row in rows]
    keys = [{"t": row[0], "v": v} for row, v in zip(rows, values, strict=True)]
    expected = load_clip_of(clip_of(tmp_path, keys, target), RIG)
    found = load_clip_of(clip_of(tmp_path, stored(tmp_path, rows), target), RIG)
    assert (found.first, found.last) == (expected.first, expected.last)
    one, other = found.channels[0], expected.channels[0]
    for name in type(one).__dataclass_fields__:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


@pytest.mark.parametrize(
    ("rows", "target", "code", "text"),
    [
        ([1.0, 2.0], "joint/knee.angle", "CLIP016", "(2,)"),
        (np.zeros((0, 2)), "joint/knee.angle", "CLIP016", "(0, 2)"),
        ([[1.0], [2.0]], "joint/knee.angle", "CLIP016", "(2, 1)"),
        ([[1, 0], [2, np.nan]], "joint/knee.angle", "CLIP016", "not finite"),
        ([[1, 0], [2, 1e300]], "joint/knee.angle", "CLIP016", "beyond"),
        (["a", "b"], "joint/knee.angle", "CLIP016", "curve"),
        ([[1, 0, 0]], "joint/knee.angle", "CLIP007", "3 numbers instead of 2"),
        ([[1, 0], [1, 5]], "joint/knee.angle", "CLIP004", "row 1"),
        ([[1e15, 0]], "joint/knee.angle", "CLIP004", "row 0"),
        ([[0, 0, 0, 0, 0]], "joint/hip.rotation", "RIG006", "row 0"),
    ],
)
def test_what_is_no_keys_is_refused(
    tmp_path: Path, rows: Any, target: str, code: str, text: str
) -> None:
    with pytest.raises(FormatError) as caught:
        load_clip_of(clip_of(tmp_path, stored(tmp_path, rows), target), RIG)
    (fault,) = caught.value.faults
    assert fault.code == code
    assert text in fault.message
    assert fault.lines == (1,)


def test_a_missing_array_or_file_is_named(tmp_path: Path) -> None:
    stored(tmp_path, [[1, 0]])
    for name, code in (
        ("some.npz#other", "CLIP016"),
        ("none.npz#curve", "DOC015"),
        ("../../some.npz", "DOC014"),
    ):
        with pytest.raises(FormatError) as caught:
            load_clip_of(clip_of(tmp_path, name, "joint/knee.angle"), RIG)
        assert [fault.code for fault in caught.value.faults] == [code]


def test_settings_of_a_channel_apply(tmp_path: Path) -> None:
    name = stored(tmp_path, ROWS["joint/knee.angle"])
    path = clip_of(tmp_path, name, "joint/knee.angle", interp="linear", pre="cycle")
    (channel,) = load_clip_of(path, RIG).channels
    assert (set(channel.interps), channel.pre) == ({"linear"}, "cycle")
    with pytest.raises(FormatError, match="slerp does not apply"):
        load_clip_of(clip_of(tmp_path, name, "joint/knee.angle", interp="slerp"), RIG)


def test_a_key_that_is_wrong_is_still_located(tmp_path: Path) -> None:
    keys = [{"t": 1, "v": 0, "in": "flat"}, {"t": 2, "w": 0}]
    with pytest.raises(FormatError) as caught:
        load_clip_of(clip_of(tmp_path, keys, "joint/knee.angle"), RIG)
    assert {fault.where for fault in caught.value.faults} == {
        "channels[0].keys[1]",
        "channels[0].keys[1].w",
    }
