"""Template files: what is wrong is said where it is, and what is written is read."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.cli import animtool
from support.marked import FIGURE, TEMPLATE

from animtool.capture.templates import MarkerTemplate, TemplateMarker, load_template
from animtool.capture.templates.template import template_text
from animtool.core.errors import FormatError, OptionError
from animtool.rig.skeleton import Joint, Rig
from animtool.rig.write import rig_text


def written(folder: Path, text: str) -> Path:
    """Return a template file with a text."""
    path = folder / "t.markers.yaml"
    path.write_text(f"markers: animtool/1\n{text}", "utf-8")
    return path


def test_what_is_written_is_read(tmp_path: Path) -> None:
    (tmp_path / "f.rig.yaml").write_text(rig_text(FIGURE), "utf-8")
    odd = TemplateMarker("no: 1", "arm_l", (1e-6, -2.5, 0.0), 0.25, True, ("a b", "é"))
    template = MarkerTemplate((*TEMPLATE.markers, odd))
    path = tmp_path / "t.markers.yaml"
    path.write_text(template_text(template, "all", "f.rig.yaml"), "utf-8")
    found = load_template(path)
    assert found.markers == template.markers
    assert found.rig == tmp_path / "f.rig.yaml"
    assert found.joints(FIGURE).tolist() == template.joints(FIGURE).tolist()


@pytest.mark.parametrize(
    ("text", "code", "line"),
    [
        ("marker_set: []\n", "DOC022", 2),
        ("marker_set:\n- {name: A, joint: b}\n- {name: A, joint: b}\n", "MKT002", 4),
        (
            "marker_set:\n- {name: A, joint: b}\n- {name: B, joint: b, aliases: [A]}\n",
            "MKT002",
            4,
        ),
        # The alias is what is wrong, and not the name after it.
        (
            "marker_set:\n- {name: B, joint: b, aliases: [A]}\n- {name: A, joint: b}\n",
            "MKT002",
            3,
        ),
        ("marker_set:\n- {name: A, joint: b, aliases: [A]}\n", "MKT002", 3),
        ("marker_set:\n- {name: A, joint: b, aliases: [B, B]}\n", "MKT002", 3),
        ("marker_set:\n- {name: A, joint: b, weight: 0}\n", "MKT004", 3),
        ("marker_set:\n- {name: A, joint: b, weight: -1}\n", "", 3),
        ("marker_set:\n- {name: A, joint: b, offset: [1, 2]}\n", "", 3),
        ("marker_set:\n- {name: A, joint: b, offset: [.nan, 0, 0]}\n", "", 3),
        ("rig: nowhere.rig.yaml\nmarker_set:\n- {name: A, joint: b}\n", "DOC015", 2),
        ("marker_set:\n- {name: A, joint: b, offset: [0, 0, 0], size: 1}\n", "", 3),
    ],
)
def test_faults_have_their_line(
    tmp_path: Path, text: str, code: str, line: int
) -> None:
    if "offset" not in text:
        text = text.replace("joint: b", "joint: b, offset: [0, 0, 0]")
    with pytest.raises(FormatError) as caught:
        load_template(written(tmp_path, text))
    assert caught.value.faults[0].lines == (line,)
    assert code in {"", caught.value.code}


def test_an_alias_that_is_a_name_is_located(tmp_path: Path) -> None:
    text = """\
marker_set:
- {name: A, joint: b, offset: [0, 0, 0], aliases: [C, D]}
- {name: B, joint: b, offset: [0, 0, 0], aliases: [D]}
- {name: C, joint: b, offset: [0, 0, 0]}
"""
    with pytest.raises(FormatError) as caught:
        load_template(written(tmp_path, text))
    locations = [(fault.code, fault.where) for fault in caught.value.faults]
    assert locations == [
        ("MKT002", "marker_set[0].aliases[0]"),
        ("MKT002", "marker_set[1].aliases[0]"),
    ]
    assert "marker_set[2]" in caught.value.faults[0].message


def test_offsets_in_another_unit_are_pointed_out(tmp_path: Path) -> None:
    path = written(tmp_path, "marker_set:\n- {name: A, joint: b, offset: [70, 0, 0]}\n")
    document = load_template(path).document
    assert document is not None
    assert [notice.code for notice in document.notices] == ["MKT003"]
    # Ten metres, on either side and along any axis; in centimetres a thousand.
    for offset, unit, count in (
        ("[0, -10.1, 0]", "m", 1),
        ("[0, 0, 10.5]", "m", 1),
        ("[-10, 10, 9.9]", "m", 0),
        ("[0, 1001, 0]", "cm", 1),
        ("[0, 999, 0]", "cm", 0),
    ):
        text = f"units: {{length: {unit}}}\nmarker_set:\n"
        text += f"- {{name: A, joint: b, offset: {offset}}}\n"
        document = load_template(written(tmp_path, text)).document
        assert document is not None
        assert len(document.notices) == count


@pytest.mark.parametrize(
    ("unit", "offsets", "hint"),
    [
        ("m", [70, 420, 30, 90], "{length: mm} in the template: then it is 420 mm"),
        ("mm", [0.07, 0.42, 0.03, 0.09], "{length: m} in the template: then it is 420"),
        ("m", [7e-5, 4.2e-4, 3e-5, 9e-5], "divided by 1000 twice?"),
        ("mm", [70, 420, 30, 90], ""),
        ("m", [0.07, 0.0005, 0.0, 0.09], ""),
        ("m", [0, 0, 0, 0], ""),
        ("m", [0, 0, 0, 1e-4], ""),
        ("in", [2.8, 16, 1, 3], ""),
    ],
)
def test_offsets_are_pointed_out_once(
    tmp_path: Path, unit: str, offsets: list[float], hint: str
) -> None:
    text = f"units: {{length: {unit}}}\nmarker_set:\n"
    for i, offset in enumerate(offsets):
        text += f"- {{name: M{i}, joint: b, offset: [0, {offset:f}, 0]}}\n"
    document = load_template(written(tmp_path, text)).document
    assert document is not None
    assert len(document.notices) == bool(hint)
    for notice in document.notices:
        assert (notice.code, notice.where) == ("MKT003", "marker_set[1].offset")
        assert hint in (notice.hint or "")


def test_a_joint_that_the_rig_lacks_is_named_with_its_line(tmp_path: Path) -> None:
    path = written(
        tmp_path, "marker_set:\n- {name: A, joint: arm_x, offset: [0, 0, 0]}\n"
    )
    with pytest.raises(FormatError) as caught:
        load_template(path).joints(FIGURE)
    (fault,) = caught.value.faults
    assert (fault.code, fault.lines) == ("MKT001", (3,))
    assert "arm_" in (fault.hint or "")
    with pytest.raises(OptionError):
        MarkerTemplate((TemplateMarker("A", "arm_x"),)).joints(FIGURE)


def test_validate_checks_against_the_rig(tmp_path: Path) -> None:
    (tmp_path / "f.rig.yaml").write_text(rig_text(FIGURE), "utf-8")
    path = written(
        tmp_path,
        "rig: f.rig.yaml\nmarker_set:\n- {name: A, joint: arms, offset: [0, 0, 0]}\n",
    )
    done = animtool("validate", path)
    assert done.code == 1
    assert "MKT001" in done.stdout + done.stderr


def test_a_template_of_another_rig_is_one_fault(tmp_path: Path) -> None:
    (tmp_path / "f.rig.yaml").write_text(rig_text(FIGURE), "utf-8")
    path = tmp_path / "t.markers.yaml"
    path.write_text(template_text(TEMPLATE, "all", "f.rig.yaml"), "utf-8")
    other = Rig("other", (Joint("hips", -1), Joint("chest", 0)))
    with pytest.raises(FormatError) as caught:
        load_template(path).joints(other)
    (fault,) = caught.value.faults
    assert (fault.code, fault.where) == ("MKT001", "rig")
    text = path.read_text("utf-8").replace("joint: arm_l", "joint: arm_x")
    path.write_text(text, "utf-8")
    with pytest.raises(FormatError) as caught:
        load_template(path).joints(other)
    assert len(caught.value.faults) > 2


SIDES = """\
markers: animtool/1
marker_set:
- {name: C7, joint: spine, offset: [0, 0.1, 0]}
- {name: LKNE, joint: LEFT, offset: [0.05, 0, 0]}
- {name: RKNE, joint: RIGHT, offset: [-0.05, 0, 0]}
- {name: LASI, joint: hips, offset: [0.1, 0, 0]}
- {name: RASI, joint: hips, offset: [-0.1, 0, 0]}
"""


@pytest.mark.parametrize(
    ("left", "right", "found"),
    [
        ("knee_r", "knee_l", True),
        ("RightLeg", "LeftLeg", True),
        ("knee_l", "knee_r", False),
        ("LeftLeg", "RightLeg", False),
        ("knee_l", "knee_l", False),
        ("a", "b", False),
    ],
)
def test_markers_on_the_joints_of_the_other_side(
    tmp_path: Path, left: str, right: str, found: bool
) -> None:
    path = tmp_path / "a.markers.yaml"
    path.write_text(SIDES.replace("LEFT", left).replace("RIGHT", right), "utf-8")
    document = load_template(path).document
    assert document is not None
    assert [one.code for one in document.notices] == ["MKT005"] * found
    for notice in document.notices:
        assert notice.where == "marker_set[1].joint"
        assert notice.message.startswith("2 of 5 markers")
        assert notice.hint == f"for LKNE write joint: {right}"
