from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.cli import animtool, animtool_process

from animtool.cli.console import Console
from animtool.cli.main import COMMANDS, COMMANDS_WITHOUT_USD
from animtool.core.errors import ExitCode, Fault, Severity
from animtool.core.process.signals import TerminatedError


def test_version_names_what_matters() -> None:
    done = animtool("--version")
    assert done.code == 0
    assert all(
        name in done.stdout for name in ("animtool", "usd-core", "numpy", "Python")
    )


@pytest.mark.parametrize("command", sorted(COMMANDS))
def test_every_command_has_help_with_an_example(command: str) -> None:
    done = animtool(command, "--help")
    assert done.code == 0
    assert "Example" in done.stdout
    assert f"animtool {command}" in done.stdout


def test_the_table_says_what_the_commands_say() -> None:
    listed = animtool("--help").stdout
    assert all(name in listed for name in COMMANDS)


def test_a_command_is_supervised_unless_it_reads_no_usd() -> None:
    assert set(COMMANDS) > COMMANDS_WITHOUT_USD


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["bak"], "did you mean 'bake'"),
        (["bake"], "Missing argument"),
        (["bake", "a.bvh", "--ovrwrite"], "--overwrite"),
        (["bake", "a.bvh", "--fps", "fast"], "24000/1001"),
        (["bake", "a.bvh", "--range", "9-1"], "is reversed"),
        (["bake", "a.bvh", "-s", "1", "-e", "12"], "did you mean '--range', such as"),
        (["validate", "a.clip.yaml", "--rig", "a.rig.yaml"], "the rig that it names"),
        (["bake", "a.bvh", "--samples", "0,1.5"], "not between -1 and 1"),
        (["bake", "a.bvh", "--rest", "bind"], "frame:N"),
        (
            ["bake", "a.bvh", "-o", "-", "--format", "json"],
            "-o - and --format json both write to stdout.",
        ),
        (["bake", "a.bvh", "--split", "--as", "layer"], "--split"),
        (["diff", "a.bvh"], "SECOND"),
        (["info"], "FILES"),
        (["mocap", "--clean", "a.bvh"], "animtool mocap clean"),
        (["mocap", "a.bvh"], "animtool mocap clean a.bvh"),
        (["a.bvh"], "animtool bake a.bvh"),
        (["convert", "a.bvh", "b.usdc", "--fps", "24"], "animtool bake has it"),
        (["validate", "a.bvh", "--units", "m"], "animtool bake has it"),
        (["loop", "a.bvh", "--start", "12"], "as --first and --last"),
        (["loop", "a.bvh", "--range", "12-44"], "as --first and --last"),
        (["preview", "a.bvh", "--end", "12"], "'--range'?"),
        (["retarget", "a.bvh", "--last", "12"], "'--range'?"),
        (["bake", "a.bvh", "--cutoff", "6"], "animtool mocap clean has it"),
        (["mocap", "label", "a.c3d", "--template", "b"], "animtool mocap fill has it"),
        (["bake", "a.bvh", "--rest-frame", "3"], "did you mean '--rest'?"),
        (["bake", "a.bvh", "--form", "layer"], "did you mean '--as'?"),
        (["mocap", "clean", "a.bvh", "--gaps", "fill"], "animtool mocap fill has it"),
        (["validate", "CLIP2"], "animtool explain CLIP2"),
        (
            ["validate", "--ignore", "rigs", "CLIP2"],
            "write animtool validate rigs --ignore CLIP2",
        ),
        (["validate", "--select", "rigs"], "'rigs' is a folder, not a code"),
        (
            ["validate", "rigs", "--ignore", "Clip9xx"],
            "--ignore: no code matches 'Clip9",
        ),
        (
            ["validate", "rigs", "--severity", "no/x=note"],
            "--severity: no code matches",
        ),
        (["explain", "rigs/biped"], "animtool validate rigs/biped"),
        (["batch", "a.batch.yaml", "--waves", "4"], "--set waves=VALUE"),
        (["batch", "a.batch.yaml", "--plan"], "--dry-run"),
        (["schema", "rig", "-o", "rig.json"], "> FILE"),
        (["schema", "rigs"], "did you mean 'rig'?"),
        (["docs", "--topic", "ik"], "animtool docs TOPIC"),
        (["ik", "a.rig.yaml", "b.targets.yaml"], "--targets b.targets.yaml"),
        (["retarget", "a.bvh", "b.usdc", "--to", "c.bvh"], "-o b.usdc"),
        (["bake", "a.bvh", "--range", "1,10,2"], "1-10x2"),
    ],
)
def test_usage_errors(arguments: list[str], said: str) -> None:
    done = animtool(*arguments)
    assert done.code == ExitCode.USAGE
    assert said in done.stderr
    assert done.stdout == ""


@pytest.mark.parametrize("group", [(), ("mocap",)], ids=["animtool", "mocap"])
def test_a_command_left_out_prints_the_help(group: tuple[str, ...]) -> None:
    done = animtool(*group)
    assert done.code == ExitCode.USAGE
    assert done.stdout == ""
    assert done.stderr == animtool(*group, "--help").stdout


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (KeyboardInterrupt(), 130),
        (MemoryError(), 3),
        (ZeroDivisionError("oh"), 70),
        (TerminatedError(), 143),
    ],
)
def test_what_ends_a_command(
    monkeypatch: pytest.MonkeyPatch, error: BaseException, code: int
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("animtool.report.describe.describe", fail)
    done = animtool("info", "a.bvh")
    assert done.code == code
    assert "Traceback" not in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    "command", [("schema", "scene"), ("bake", "{walk}", "-o", "-")], ids=lambda c: c[0]
)
def test_a_reader_that_leaves_is_no_fault(walk: Path, command: tuple[str, ...]) -> None:
    """What is left in a pipe that is closed early, as by ``head -1``, may be all."""
    read, write = os.pipe()
    os.close(read)
    words = [word.format(walk=walk) for word in command]
    done = subprocess.run(
        [sys.executable, "-P", "-m", "animtool", *words],
        stdout=write,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )
    os.close(write)
    assert done.returncode == 0
    assert "error" not in done.stderr.lower()


def test_debug_lets_the_traceback_through() -> None:
    done = animtool_process("info", "none.bvh", "--debug")
    assert "Traceback" in done.stderr


def test_log_format_json() -> None:
    done = animtool("bake", "none.bvh", "--log-format", "json")
    entry = json.loads(done.stderr)
    assert (entry["code"], entry["level"], entry["path"]) == (
        "IO001",
        "error",
        "none.bvh",
    )
    usage = animtool_process("bake", "--log-format", "json", "--nope")
    assert usage.code == ExitCode.USAGE
    assert json.loads(usage.stderr)["level"] == "error"


def test_environment_sets_the_log_format() -> None:
    done = animtool_process("info", "none.bvh", ANIMTOOL_LOG_FORMAT="json")
    assert json.loads(done.stderr.splitlines()[0])["code"] == "IO001"


@pytest.mark.parametrize(
    ("environment", "asked", "is_json"),
    [
        ("json", (), True),
        ("json", ("--log-format", "text"), False),
        ("json", ("--log-format=text",), False),
        ("text", ("--log-format", "json"), True),
        ("text", ("--log-format=json",), True),
        ("text", (), False),
    ],
)
@pytest.mark.parametrize("more", [(), ("--nope",)], ids=["done", "misspelt"])
def test_the_log_format_of_the_command_line_comes_first(
    monkeypatch: pytest.MonkeyPatch,
    environment: str,
    asked: tuple[str, ...],
    is_json: bool,
    more: tuple[str, ...],
) -> None:
    monkeypatch.setenv("ANIMTOOL_LOG_FORMAT", environment)
    monkeypatch.setenv("NO_COLOR", "1")
    said = animtool("info", "none.bvh", *asked, *more).stderr
    assert said.startswith("{") is is_json
    assert "\x1b" not in said


def test_colors(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    console, warning = Console(), Fault("X1", "odd", severity=Severity.WARNING)
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.delenv("NO_COLOR", raising=False)
    console.faults([warning])
    assert "\x1b[33m" in capsys.readouterr().err
    monkeypatch.setenv("NO_COLOR", "1")
    console.faults([warning])
    assert "\x1b" not in capsys.readouterr().err


def test_quiet_keeps_errors_only(capsys: pytest.CaptureFixture[str]) -> None:
    console = Console(verbosity=-1)
    console.say("summary")
    console.faults([Fault("W1", "w", severity=Severity.WARNING), Fault("E1", "e")])
    assert capsys.readouterr().err == "E1 e\n"


def test_the_usual_console_keeps_details_to_itself(
    capsys: pytest.CaptureFixture[str],
) -> None:
    Console().detail("timings")
    Console().say("summary")
    Console(verbosity=1).detail("seconds")
    assert capsys.readouterr().err == "summary\nseconds\n"


def test_progress_shows_unless_a_result_goes_to_the_same_terminal(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def shown(**options: bool) -> bool:
        with Console().progress("bake", **options) as progress:
            return progress is not None

    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    assert (shown(), shown(is_stdout=True)) == (True, False)
    monkeypatch.setattr(sys.stdout, "isatty", lambda: False, raising=False)
    assert shown(is_stdout=True)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: False, raising=False)
    assert not shown()


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion(shell: str) -> None:
    done = animtool("completion", shell)
    assert done.code == 0
    assert "_ANIMTOOL_COMPLETE" in done.stdout


def test_an_interrupt_while_loading_is_one() -> None:
    code = (
        "import sys\n"
        "class Stop:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'animtool.cli.main': raise KeyboardInterrupt\n"
        "sys.meta_path.insert(0, Stop())\n"
        "from animtool.__main__ import main\n"
        "main()\n"
    )
    done = subprocess.run(
        [sys.executable, "-P", "-c", code], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (130, "interrupted\n")
