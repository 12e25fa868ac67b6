"""What a USD file brings in is looked at before USD opens it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from pxr import Sdf, Usd
from support.faults import raises

from animtool.cli.main import run
from animtool.core.errors import FormatError
from animtool.core.files.reading import FileState, recorded_inputs
from animtool.usd.checks import check_layer
from animtool.usd.layers import sdf as layers
from animtool.usd.layers.dependencies import open_composed, unresolved_arcs
from animtool.usd.layers.sdf import open_layer
from animtool.usd.layers.stderr import without_usd_warnings

HEAD = '#usda 1.0\n(\nupAxis = "Y"\nmetersPerUnit = 1\n{}\n)\n'
CLIPS = """(clips = {{dictionary default = {{
    asset[] assetPaths = [{}]
    string primPath = "/A"
    double2[] active = [(0, 0)]
    double2[] times = [(0, 0)]
}}}})"""
TEMPLATE = """(clips = {dictionary default = {
    string templateAssetPath = "./evil.###.usda"
    double templateStartTime = 1
    double templateEndTime = 1
    double templateStride = 1
    string primPath = "/A"
}})"""
ARCS = {
    "sublayer": (HEAD.format("subLayers = [@./evil.usda@]"), "evil.usda"),
    "expression": (
        HEAD.format(
            'subLayers = [@`"./${X}.usda"`@]\nexpressionVariables = {string X = "evil"}'
        ),
        "evil.usda",
    ),
    "reference": (
        HEAD.format("") + 'def "A" (references = @./evil.usda@</A>) {}',
        "evil.usda",
    ),
    "payload": (
        HEAD.format("") + 'def "A" (payload = @./evil.usdc@</A>) {}',
        "evil.usdc",
    ),
    "arguments": (
        HEAD.format("")
        + 'def "A" (references = @./evil.usda:SDF_FORMAT_ARGS:a=1@</A>) {}',
        "evil.usda",
    ),
    "package": (
        HEAD.format("") + 'def "A" (references = @./evil.usdz[a.usda]@</A>) {}',
        "evil.usdz",
    ),
    "variant": (
        HEAD.format("")
        + 'def "A" (\nvariantSets = "v"\nvariants = {\nstring v = "x"\n}\n)\n{\n'
        + 'variantSet "v" = {\n"x" (references = @./evil.usda@</A>) {\n}\n}\n}\n',
        "evil.usda",
    ),
    "clip": (
        HEAD.format("") + f'def "A" {CLIPS.format("@./evil.usda@")} {{}}',
        "evil.usda",
    ),
    "template": (HEAD.format("") + f'def "A" {TEMPLATE} {{}}', "evil.001.usda"),
}


@pytest.mark.skipif(os.name == "nt", reason="has no such files")
@pytest.mark.parametrize("kind", ["fifo", "device"])
@pytest.mark.parametrize("arc", ARCS)
def test_what_is_no_file_is_not_opened(tmp_path: Path, arc: str, kind: str) -> None:
    text, name = ARCS[arc]
    if kind == "fifo":
        os.mkfifo(tmp_path / "pipe")
        (tmp_path / name).symlink_to(tmp_path / "pipe")
    else:
        (tmp_path / name).symlink_to("/dev/zero")
    (tmp_path / "inner.usda").write_text(text)
    # It is brought in by a layer that is brought in.
    shot = tmp_path / "shot.usda"
    shot.write_text(HEAD.format("subLayers = [@./inner.usda@]"))
    for path in (tmp_path / "inner.usda", shot):
        (fault,) = check_layer(path)
        assert fault.code == "USD155"
        assert "not a file" in fault.message
    assert run(["info", str(shot)]) == 3


@pytest.mark.skipif(os.name == "nt", reason="has no such files")
def test_variables_of_a_stronger_layer_name_files(tmp_path: Path) -> None:
    (tmp_path / "evil.usda").symlink_to("/dev/zero")
    inner = HEAD.format('subLayers = [@`"./${X}.usda"`@]')
    (tmp_path / "inner.usda").write_text(inner)
    shot = tmp_path / "shot.usda"
    variables = 'expressionVariables = {string X = "evil"}'
    shot.write_text(HEAD.format(f"subLayers = [@./inner.usda@]\n{variables}"))
    assert [fault.code for fault in check_layer(shot)] == ["USD155"]


def test_what_is_too_large(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text, name = ARCS["sublayer"]
    (tmp_path / name).write_text(HEAD.format("") + "#" * 500)
    shot = tmp_path / "shot.usda"
    shot.write_text(text)
    monkeypatch.setattr(layers, "MAX_TEXT_LAYER_BYTES", 400)
    with raises(FormatError, "USD155"):
        open_composed(open_layer(shot), shot)
    monkeypatch.setattr(layers, "MAX_TEXT_LAYER_BYTES", 10)
    with raises(FormatError, "IO010"):
        open_layer(shot)


def test_what_is_missing_or_a_folder_is_named_by_composition(tmp_path: Path) -> None:
    shot = tmp_path / "shot.usda"
    shot.write_text(ARCS["sublayer"][0])
    assert "USD261" in {fault.code for fault in check_layer(shot)}
    (tmp_path / "evil.usda").mkdir()
    assert "USD261" in {fault.code for fault in check_layer(shot)}


def test_layers_that_lead_to_each_other(tmp_path: Path) -> None:
    for one, other in (("a", "b"), ("b", "a")):
        arc = f'def "A" (references = @./{other}.usda@</A>) {{}}'
        (tmp_path / f"{one}.usda").write_text(HEAD.format("") + arc)
    assert "USD261" in {fault.code for fault in check_layer(tmp_path / "a.usda")}


def test_a_layer_that_changes_after_it_was_opened_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    inner, shot = tmp_path / "evil.usda", tmp_path / "shot.usda"
    inner.write_text(HEAD.format(""))
    shot.write_text(ARCS["sublayer"][0])
    opened = Usd.Stage.Open

    def late(layer: Sdf.Layer) -> Usd.Stage:
        inner.write_text(HEAD.format("") + "\n")
        return opened(layer)

    monkeypatch.setattr(Usd.Stage, "Open", late)
    with recorded_inputs() as inputs:
        open_composed(open_layer(shot), shot)
    assert inputs.states[inner.resolve()] != FileState.of(inner)
    with raises(FormatError, "IO004"):
        inputs.check()


ARC = '#usda 1.0\ndef "A" ({arc}) {{}}\n'


@pytest.mark.parametrize(
    ("arc", "text"),
    [
        ("references = @sets/a.usda@", "reference 'sets/a.usda' cannot be opened"),
        ("payload = @a.usda@", "payload 'a.usda' cannot be opened"),
        ("references = @./other.usda@</B>", "reference 'other.usda' has no prim /B"),
        (
            "references = @./other.usda@",
            "reference 'other.usda' names no prim, and it has no default prim",
        ),
        ("references = @./shot.usda@</A>", "its references lead back to itself"),
    ],
)
def test_arcs(
    tmp_path: Path, arc: str, text: str, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "other.usda").write_text('#usda 1.0\ndef "C" {}\n', "utf-8")
    (tmp_path / "shot.usda").write_text(ARC.format(arc=arc), "utf-8")
    with without_usd_warnings():
        stage = Usd.Stage.Open(str(tmp_path / "shot.usda"))
    assert list(unresolved_arcs(stage)) == [("/A", text)]
    assert capfd.readouterr().err == ""


def test_sublayers(tmp_path: Path) -> None:
    shot = tmp_path / "shot.usda"
    shot.write_text("#usda 1.0\n(\n    subLayers = [@./gone.usda@]\n)\n", "utf-8")
    with without_usd_warnings():
        stage = Usd.Stage.Open(str(shot))
    assert list(unresolved_arcs(stage)) == [
        ("/", "sublayer 'gone.usda' cannot be opened")
    ]
