"""Several sources on one rig: what each brings, when, and what is said of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.cli import animtool
from support.takes import takes

from animtool import open_source
from animtool.core.clock import Clock
from animtool.core.errors import Fault, FormatError, OptionError, Severity
from animtool.maths import so3
from animtool.maths.curves import cubic_curves
from animtool.motion.motion import Channel, Motion
from animtool.motion.take import Take, TakeStream
from animtool.rig.controls import Control, Drive
from animtool.rig.parts import Shape
from animtool.rig.skeleton import Joint, Rig
from animtool.scene.file.entries import EntryLocation, SceneSource
from animtool.scene.file.read import load_scene
from animtool.scene.file.tracks import TrackNames
from animtool.scene.sources.joining import JoinedSource, join_sources
from animtool.scene.sources.onto_rig import map_to_rig
from animtool.scene.sources.open import SourceOptions

GRIN = Control("grin", drives=(Drive("shape/smile"), Drive("joint/jaw.rotation.x")))
HERO = Rig(
    "hero",
    (Joint("hips", -1), Joint("head", 0, translation=(0, 1, 0)), Joint("jaw", 1)),
    shapes=(Shape("smile"), Shape("blink")),
    controls=(GRIN, Control("other", default=0.5)),
)


SMILE = TrackNames(shapes=("smile",))


def note(
    code: str,
    message: str,
    hint: str | None = None,
    severity: Severity = Severity.ERROR,
) -> Fault:
    return Fault(code, message, hint=hint, severity=severity)


def entry(**given: object) -> SceneSource:
    location = EntryLocation(Path("a.scene.yaml"), 1, 1, "source")
    return SceneSource(Path("a.bvh"), SourceOptions(), location, **given)


def part(take: Take, **given: object) -> JoinedSource:
    return JoinedSource(TakeStream.of(take), entry(**given))


def numbered(
    rig: Rig, count: int, fps: Fraction | int = 24, *, bare: bool = False
) -> Take:
    """Return a take in which everything goes up by its own step, frame by frame."""
    frame = np.arange(float(count))[:, None, None]

    def going(many: int, width: int) -> Channel:
        steps = 1.0 + np.arange(float(many))[:, None] * np.ones(width)
        return Channel.from_dense(frame * steps)

    turns = np.tile([0.0, 0, 0, 1], (count, len(rig.joints), 1))
    motion = Motion(
        going(len(rig.joints), 3),
        Channel.from_dense(turns),
        weights=None if bare or not rig.shapes else going(len(rig.shapes), 1),
        controls=None if bare or not rig.controls else going(len(rig.controls), 1),
    )
    clock = Clock(Fraction(fps), Fraction(1001), Fraction(1), count)
    return Take(rig, clock, motion)


def still(rig: Rig, count: int) -> Take:
    """Return a take at rest."""
    rows = [rig.rest_translations, rig.rest_rotations]
    channels = [Channel.from_dense(np.repeat(row[None], count, 0)) for row in rows]
    clock = Clock(Fraction(24), Fraction(1001), Fraction(1), count)
    return Take(rig, clock, Motion(*channels))


def codes(stream: TakeStream) -> list[str]:
    stream.collect()
    return [fault.code for fault in stream.notices]


def test_named_tracks_are_taken_and_others_stay() -> None:
    body = numbered(HERO, 5, bare=True)
    face = numbered(HERO, 5)
    wanted = TrackNames(joints=("jaw",), shapes=("*",))
    made = join_sources(part(still(HERO, 5)), [part(face, tracks=wanted)]).collect()
    np.testing.assert_array_equal(
        made.motion.translations.dense()[:, 2], face.motion.translations.dense()[:, 2]
    )
    assert made.motion.translations.animated.tolist() == [2]
    assert made.motion.weights is not None
    assert face.motion.weights is not None
    np.testing.assert_array_equal(
        made.motion.weights.dense(), face.motion.weights.dense()
    )
    assert made.motion.controls is None
    assert made.clock == body.clock


def test_a_control_brings_what_it_drives() -> None:
    face = numbered(HERO, 4)
    wanted = TrackNames(controls=("grin",))
    made = join_sources(part(still(HERO, 4)), [part(face, tracks=wanted)]).collect()
    motion = made.motion
    assert motion.translations.animated.tolist() == [2]
    assert motion.weights is not None
    assert motion.weights.animated.tolist() == [0]
    assert motion.controls is not None
    assert motion.controls.animated.tolist() == [0]
    # What the first source has no value of is at its default.
    assert motion.controls.rest[1] == 0.5


def test_without_names_a_source_brings_what_it_moves() -> None:
    face = still(HERO, 4)
    weights = np.zeros((4, 2, 1))
    weights[:, 1, 0] = 0.25
    held = replace(face.motion, weights=Channel.from_dense(weights))
    made = join_sources(part(numbered(HERO, 4)), [part(replace(face, motion=held))])
    motion = made.collect().motion
    assert motion.weights is not None
    np.testing.assert_array_equal(motion.weights.dense()[:, 0, 0], np.arange(4.0))
    np.testing.assert_array_equal(motion.weights.dense()[:, 1, 0], 0.25)
    assert motion.translations.animated.tolist() == [0, 1, 2]
    assert made.notices == []


@pytest.mark.parametrize(
    ("stated", "first"),
    [
        (("01:00:00:00", "01:00:00:00"), 0),
        (("01:00:00:00", "01:00:00:02"), -2),
        (("01:00:00:02", "01:00:00:00"), 2),
        (("23:59:59:23", "00:00:00:01"), -2),
        (("01:00:00:00.5", "01:00:00:00"), 0.5),
        ((None, None), 0),
    ],
)
def test_time_codes_say_where_a_source_starts(
    stated: tuple[str | None, str | None], first: float
) -> None:
    others = [part(numbered(HERO, 6), timecode=stated[1], tracks=SMILE)]
    stream = join_sources(part(numbered(HERO, 6), timecode=stated[0]), others)
    weights = stream.collect().motion.weights
    assert weights is not None
    wanted = np.clip(np.arange(6) + first, 0, 5)
    np.testing.assert_allclose(weights.dense()[:, 0, 0], wanted, atol=1e-12)
    said = [fault.code for fault in stream.notices]
    # Half a frame is within the last one's time.
    lacking = ["SCN103"] if abs(first) > 1 else []
    assert said == ([*lacking, "SCN104"] if first else [])


def test_rates_that_differ() -> None:
    face = part(
        numbered(HERO, 41, 120),
        tracks=SMILE,
        timecode="01:00:00:06",
        timecode_fps=Fraction(30),
    )
    base = part(numbered(HERO, 8, 24), timecode="01:00:00:03")
    stream = join_sources(base, [face])
    weights = stream.collect().motion.weights
    assert weights is not None
    # 0.2 s and 0.125 s behind the hour: 0.075 s, or 9 frames at 120 fps.
    wanted = np.clip(np.arange(8) * 5 - 9, 0, 40)
    np.testing.assert_allclose(weights.dense()[:, 0, 0], wanted, atol=1e-9)


def test_frames_that_are_lacking_are_named() -> None:
    tracks = TrackNames(shapes=("*",))
    others = [part(numbered(HERO, 3), timecode="01:00:00:02", tracks=tracks)]
    stream = join_sources(part(numbered(HERO, 9), timecode="01:00:00:00"), others)
    assert codes(stream) == ["SCN103"]
    assert "1001 to 1002 and 1006 to 1009" in stream.notices[0].message


def test_a_last_frame_lasts_until_the_next_would_come() -> None:
    tracks = TrackNames(shapes=("*",))
    stream = join_sources(
        part(numbered(HERO, 10, 120)), [part(numbered(HERO, 5, 60), tracks=tracks)]
    )
    assert codes(stream) == []


def refused(*parts: JoinedSource) -> list[str]:
    with pytest.raises(OptionError) as caught:
        join_sources(parts[0], parts[1:]).collect()
    return [fault.code for fault in caught.value.faults]


def test_what_is_refused() -> None:
    strange = Rig("strange", (Joint("tail", -1),))
    first = part(numbered(HERO, 4))
    timed = replace(first, entry=entry(timecode="01:00:00:00"))
    assert refused(first, part(numbered(strange, 4))) == ["SCN036"]
    assert refused(first, part(still(HERO, 4))) == ["SCN036"]
    assert refused(timed, part(numbered(HERO, 4))) == ["SCN034"]
    assert refused(first, part(numbered(HERO, 4), timecode="01:00:00:00")) == ["SCN034"]
    assert refused(timed, part(numbered(HERO, 4), timecode="1 o'clock")) == ["SCN033"]
    late = part(numbered(HERO, 4), timecode="01:00:00:04")
    assert refused(replace(timed, stream=TakeStream.of(numbered(HERO, 4))), late) == [
        "SCN035"
    ]
    nothing = TrackNames(joints=("jar",), shapes=("*", "smlie"))
    assert refused(first, part(numbered(HERO, 4), tracks=nothing)) == ["SCN037"] * 2


def test_two_that_bring_the_same_are_named() -> None:
    faces = [part(numbered(HERO, 4)) for _ in range(2)]
    stream = join_sources(part(numbered(HERO, 4)), faces)
    assert codes(stream) == ["SCN105"]
    jaw = TrackNames(joints=("jaw",))
    named = [part(numbered(HERO, 4), tracks=jaw) for _ in faces]
    assert codes(join_sources(part(numbered(HERO, 4)), named)) == []


def in_blocks(take: Take, size: int) -> Iterator[Motion]:
    for first in range(0, take.clock.count, size):
        yield take.motion.select(slice(first, first + size))


@given(takes(least=4), st.integers(1, 3), st.integers(0, 3))
def test_blocks_are_the_whole(take: Take, size: int, late: int) -> None:
    rig = take.rig
    rate = Fraction(24)
    take = replace(take, clock=replace(take.clock, fps=rate, step=Fraction(1)))
    other = numbered(rig, 3)
    stated = {"timecode": f"00:00:00:0{late}"}
    first = part(take, timecode="00:00:00:00")
    whole = join_sources(first, [part(other, **stated)]).collect()
    blocks = replace(TakeStream.of(take), blocks=in_blocks(take, size))
    made = join_sources(
        replace(first, stream=blocks), [part(other, **stated)]
    ).collect()
    for ours, theirs in zip(made.motion.dense(), whole.motion.dense(), strict=True):
        if ours is not None or theirs is not None:
            np.testing.assert_array_equal(ours, theirs)


@given(takes(least=2))
def test_a_source_of_the_same_rig_replaces_all_that_it_moves(take: Take) -> None:
    made = join_sources(
        part(still(take.rig, take.clock.count)), [part(numbered(take.rig, 3))]
    )
    motion = made.collect().motion
    assert len(motion.translations.animated) == len(take.rig.joints)


def test_another_rig_is_met_by_name() -> None:
    head = Rig("cap", (Joint("jaw", -1), Joint("cap_head", 0, source_name="head")))
    placed, names = map_to_rig(TakeStream.of(numbered(head, 3)), HERO, note)
    assert names.joints.tolist() == [-1, 1, 0]
    motion = placed.collect().motion
    assert motion.translations.animated.tolist() == [1, 2]
    np.testing.assert_array_equal(motion.translations.rest[0], [0, 0, 0])


RIG = """rig: animtool/1
name: hero
joints:
- {name: hips, type: free, translate: [0, 1, 0]}
- {name: head, parent: hips, type: ball, translate: [0, 0.5, 0]}
- {name: jaw, parent: head, type: pin, axis: [1, 0, 0], translate: [0, 0.1, 0]}
controls:
- {name: open, range: [0, 1], drives: [{joint: jaw.angle, expr: open * 30}]}
"""
BODY = """clip: animtool/1
rig: hero.rig.yaml
fps: 24
channels:
- {target: joint/hips.translation, keys: [{t: 1, v: [0, 0, 0]}, {t: 25, v: [0, 0, 2]}]}
- {target: control/open, keys: [{t: 1, v: 0}]}
"""
FACE = """clip: animtool/1
rig: hero.rig.yaml
fps: 60
channels:
- {target: control/open, keys: [{t: 1, v: 0}, {t: 61, v: 1}]}
"""
SCENE = """scene: animtool/1
source:
- {file: body.clip.yaml, timecode: "10:00:00:00"}
- {file: face.clip.yaml, timecode: "10:00:00:00"}
output: {file: joined.usda, keep_curves: true}
"""


@pytest.fixture
def place(tmp_path: Path) -> Path:
    for name, text in (
        ("hero.rig.yaml", RIG),
        ("body.clip.yaml", BODY),
        ("face.clip.yaml", FACE),
        ("shot.scene.yaml", SCENE),
    ):
        (tmp_path / name).write_text(text, "utf-8")
    return tmp_path


def test_clips_are_evaluated_between_frames(place: Path) -> None:
    stream = load_scene(place / "shot.scene.yaml").open()
    assert stream.curve is not None
    found = stream.curve(np.array([7.0, 7.5]))
    assert found.controls is not None
    np.testing.assert_allclose(
        found.controls.dense()[:, 0, 0], [0.25, 6.5 / 24], atol=1e-12
    )
    np.testing.assert_allclose(
        found.translations.dense()[:, 0, 2], [0.5, 6.5 / 12], atol=1e-12
    )


def test_body_and_face_are_one_animation(place: Path) -> None:
    done = animtool("bake", place / "shot.scene.yaml", "--fps", "48")
    assert done.code == 0, done.stderr
    text = (place / "joined.usda").read_text("utf-8")
    assert text.count("def SkelAnimation") == 1
    assert "open.spline = {" in text
    take = open_source(place / "joined.usda").collect()
    jaw = take.rig.index("jaw")
    assert jaw in take.motion.rotations.animated


def test_a_bvh_meets_the_rig_that_the_scene_names(place: Path) -> None:
    body = open_source(place / "body.clip.yaml").collect()
    assert animtool("convert", place / "body.clip.yaml", place / "body.bvh").code == 0
    text = SCENE.replace("body.clip.yaml", "body.bvh").replace(
        "source:", "rig: hero.rig.yaml\nsource:"
    )
    text = text.replace('bvh, timecode: "10', 'bvh, units: m, timecode: "10')
    (place / "shot.scene.yaml").write_text(text, "utf-8")
    take = load_scene(place / "shot.scene.yaml").open().collect()
    assert [control.name for control in take.rig.controls] == ["open"]
    np.testing.assert_allclose(
        take.motion.translations.dense()[:, 0],
        body.motion.translations.dense()[:, 0],
        atol=1e-5,
    )


@pytest.mark.parametrize(
    ("old", "new", "code", "line"),
    [
        ("face.clip.yaml", "none.clip.yaml", "DOC015", 4),
        ("10:00:00:00", "25:00:00:00", "SCN033", 3),
        ("10:00:00:00", "10:00:00;10", "SCN033", 3),
        (', timecode: "10:00:00:00"', "", "SCN034", 3),
        ('"10:00:00:00"}\noutput', '"11:00:00:00"}\noutput', "SCN035", 4),
        ("face.clip.yaml,", "face.clip.yaml, tracks: {shapes: [x]},", "SCN037", 4),
        ("face.clip.yaml,", "face.clip.yaml, track: {shapes: [x]},", "DOC020", 4),
        ("body.clip.yaml,", "body.clip.yaml, tracks: {joints: [x]},", "SCN038", 3),
        ("face.clip.yaml,", "face.clip.yaml, timecode_fps: fast,", "SCN022", 4),
    ],
)
def test_faults_have_the_place_of_their_source(
    place: Path, old: str, new: str, code: str, line: int
) -> None:
    path = place / "shot.scene.yaml"
    path.write_text(SCENE.replace(old, new, 1), "utf-8")
    with pytest.raises(FormatError) as caught:
        load_scene(path).open().collect()
    said = [(fault.code, fault.path, fault.lines) for fault in caught.value.faults]
    assert said == [(code, str(path), (line,))]


@pytest.mark.parametrize(
    "source", ["[]", "[walk.bvh]", "[{file: body.clip.yaml}, {}]", "7", "{timecode: x}"]
)
def test_a_source_of_another_form(place: Path, source: str) -> None:
    path = place / "shot.scene.yaml"
    path.write_text(f"scene: animtool/1\nsource: {source}\n", "utf-8")
    with pytest.raises(FormatError) as caught:
        load_scene(path)
    assert {f.code for f in caught.value.faults} <= {"DOC021", "DOC022", "SCN038"}


def test_one_source_has_no_tracks_of_several(place: Path) -> None:
    path = place / "shot.scene.yaml"
    path.write_text(
        'scene: animtool/1\nsource: {file: body.clip.yaml, timecode: "10:00:00:00"}\n',
        "utf-8",
    )
    with pytest.raises(FormatError) as caught:
        load_scene(path)
    assert caught.value.code == "SCN038"


def keyed_grin(fps: int, delay: str) -> TakeStream:
    """Return a body and a face with a keyed control that starts at a time code."""
    face = numbered(HERO, 61, fps)
    ends = np.array([[0.0], [1.0]])
    curves = cubic_curves(np.array([1003.0, 1033.5]), ends, 0 * ends, 0 * ends)
    stream = replace(TakeStream.of(face), control_curves={"grin": curves})
    grin = TrackNames(controls=("grin",))
    source = JoinedSource(stream, entry(tracks=grin, timecode=delay))
    base = replace(TakeStream.of(still(HERO, 20)), start=Fraction(7010, 7))
    return join_sources(JoinedSource(base, entry(timecode="23:59:59:22")), [source])


@pytest.mark.parametrize(
    ("fps", "timecode", "seconds"),
    [
        (24, "23:59:59:22", 0.0),
        (24, "00:00:00:04", 6 / 24),
        (60, "00:00:00:00", 2 / 24),
        (30, "23:59:59:15", -22 / 24 + 15 / 30),
    ],
)
def test_curves_of_a_face_start_when_its_frames_do(
    fps: int, timecode: str, seconds: float
) -> None:
    stream = keyed_grin(fps, timecode)
    (curves,) = stream.control_curves.values()
    since = (np.array([1003.0, 1033.5]) - 1001) / fps + seconds
    np.testing.assert_allclose(curves.times, 7010 / 7 + 24 * since, atol=1e-9)


SLOWED = """scene: animtool/1
source:
- {file: body.bvh, units: m}
- {file: face.clip.yaml}
rig: hero.rig.yaml
passes: [PASSES]
output: {file: joined.usda}
"""


def jaw_of(path: Path, *options: str) -> np.ndarray:
    done = animtool("bake", path, "--overwrite", *options)
    assert done.code == 0, done.stderr
    take = open_source(path.parent / "joined.usda").collect()
    turns = take.motion.rotations.gather(np.array([take.rig.index("jaw")]))[:, 0]
    return np.degrees(so3.log(turns)[:, 0])


@pytest.mark.parametrize("first", ["clip", "bvh"])
@pytest.mark.parametrize(
    ("passes", "options", "speed"),
    [
        ("time_scale: {speed: 0.25}", (), 0.25),
        ("trim: {first: 1}", ("--fps", "96"), 0.25),
        ("time_scale: {speed: 0.5}", ("--fps", "48"), 0.25),
        ("resample: {fps: 30}", (), 0.8),
    ],
)
def test_keys_of_a_source_are_evaluated_behind_passes(
    place: Path, first: str, passes: str, options: tuple[str, ...], speed: float
) -> None:
    """Whether the first has curves or samples: an ease has its polynomial."""
    ease = "keys: [{t: 1, v: 0, out: flat}, {t: 61, v: 1, in: flat}]"
    face = FACE.replace("keys: [{t: 1, v: 0}, {t: 61, v: 1}]", ease)
    (place / "face.clip.yaml").write_text(face, "utf-8")
    text = SLOWED.replace("PASSES", f"{{{passes}}}")
    if first == "clip":
        text = text.replace("body.bvh, units: m", "body.clip.yaml")
    else:
        done = animtool("convert", place / "body.clip.yaml", place / "body.bvh")
        assert done.code == 0, done.stderr
    path = place / "slow.scene.yaml"
    path.write_text(text, "utf-8")
    found = jaw_of(path, *options)
    u = np.minimum(np.arange(len(found)) * speed / 24, 1)
    np.testing.assert_allclose(found, 30 * (3 * u**2 - 2 * u**3), atol=1e-4)
