"""Hooks, action and recipes for continuous integration, run on a scratch repository."""

from __future__ import annotations

import io
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml
from support.cli import animtool

from animtool.validation.subjects.open import DOCUMENT_SUFFIXES, INPUT_SUFFIXES

RIGHT = "rig: animtool/1\nname: right\njoints:\n- {name: hips, type: free}\n"
WARNED = RIGHT.replace("type: free", "type: pin, axis: [1, 0, 0], limits: [1, 9]")
WRONG = RIGHT.replace("free", "fre")
MENDABLE = RIGHT.replace("hips", '"hips.x"')
SHELL = ["bash", "--noprofile", "--norc", "-eo", "pipefail"]

pytestmark = [
    pytest.mark.skipif(shutil.which("bash") is None, reason="the recipes need bash"),
    pytest.mark.skipif(shutil.which("git") is None, reason="the recipes need git"),
]


@dataclass(frozen=True, slots=True)
class Ended:
    """How a process ended, and what it said."""

    code: int
    said: str


@dataclass(frozen=True, slots=True)
class Repository:
    """A scratch repository, and an environment with this animtool and no network.

    Attributes:
        folder: The repository.
        environment: In which processes run there.
        installed: Where the arguments of `pip install` are noted.
    """

    folder: Path
    environment: dict[str, str]
    installed: Path

    def run(self, *command: str | Path, stdin: str = "", **variables: str) -> Ended:
        """Run a command in it."""
        done = subprocess.run(
            list(map(str, command)),
            cwd=self.folder,
            env=self.environment | variables,
            input=stdin,
            capture_output=True,
            text=True,
            check=False,
        )
        return Ended(done.returncode, done.stdout + done.stderr)

    def write(self, files: Mapping[str, str]) -> None:
        """Write files, and have git know them."""
        for name, text in files.items():
            path = self.folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, "utf-8")
        self.run("git", "add", "-A")

    def record(self) -> Path:
        """Let animtool but note its arguments, then its stdin, in a file."""
        said = self.folder.parent / "said"
        script = f"#!/bin/sh\n{{ printf '%s\\0' \"$@\"; cat; }} > '{said}'\n"
        (self.folder.parent / "tools/animtool").write_text(script, "utf-8")
        return said


@pytest.fixture
def repository(tmp_path: Path) -> Repository:
    tools = tmp_path / "tools"
    tools.mkdir()
    installed = tmp_path / "installed.txt"
    python = f'exec "{sys.executable}" -P'
    scripts = {
        "animtool": f'{python} -m animtool "$@"\n',
        # Nothing is installed: this animtool is there.
        "pip": f'echo "$@" >> "{installed}"\n',
        "python": f'[ "$1 $2" != "-m pip" ] || {{ shift 2; exec pip "$@"; }}\n'
        f'{python} "$@"\n',
    }
    for name, text in scripts.items():
        (tools / name).write_text(f"#!/bin/sh\n{text}", "utf-8")
        (tools / name).chmod(0o755)
    environment = {
        **{k: v for k, v in os.environ.items() if not k.startswith(("GIT_", "PRE_"))},
        "PATH": f"{tools}{os.pathsep}{os.environ['PATH']}",
        "PRE_COMMIT_HOME": str(tmp_path / "pre-commit"),
        "GIT_CONFIG_GLOBAL": os.devnull,
        "GIT_CONFIG_NOSYSTEM": "1",
    }
    folder = tmp_path / "studio"
    folder.mkdir()
    found = Repository(folder, environment, installed)
    assert found.run("git", "init", "-q").code == 0
    return found


def hooks(root: Path) -> list[dict[str, Any]]:
    found = yaml.safe_load((root / ".pre-commit-hooks.yaml").read_text("utf-8"))
    assert [hook["id"] for hook in found] == ["animtool-validate", "animtool-fix"]
    return found


def test_hooks_are_for_the_files_that_are_checked(root: Path) -> None:
    checks, mends = (re.compile(hook["files"]) for hook in hooks(root))
    for suffix in INPUT_SUFFIXES:
        assert checks.search(f"a/b{suffix}")
        assert checks.search(f"b{suffix.upper()}")
        assert bool(mends.search(f"b{suffix}")) == (suffix in DOCUMENT_SUFFIXES)
    for name in ("a.yaml", "rig.yaml", "a.json", "a.usdx", "a.rig.yaml.md"):
        assert not checks.search(name)
        assert not mends.search(name)


@pytest.fixture
def committing(root: Path, repository: Repository) -> Repository:
    """Return the repository with the hooks, run with this animtool."""
    pytest.importorskip("pre_commit", reason="pre-commit is not installed")
    local = [hook | {"language": "system"} for hook in hooks(root)]
    config = {"repos": [{"repo": "local", "hooks": local}]}
    repository.write({".pre-commit-config.yaml": yaml.safe_dump(config)})
    return repository


def pre_commit(repository: Repository, *arguments: str | Path) -> Ended:
    return repository.run(sys.executable, "-P", "-m", "pre_commit", *arguments)


@pytest.mark.slow
def test_pre_commit_knows_the_hooks_and_the_recipe(
    root: Path, committing: Repository
) -> None:
    config = root / "samples/ci/pre-commit-config.yaml"
    for command, path in (
        ("validate-manifest", root / ".pre-commit-hooks.yaml"),
        ("validate-config", config),
    ):
        ended = pre_commit(committing, command, path)
        assert ended.code == 0, ended.said
    (repo,) = yaml.safe_load(config.read_text("utf-8"))["repos"]
    known = {hook["id"] for hook in hooks(root)}
    assert {hook["id"] for hook in repo["hooks"]} <= known


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "code", "word"),
    [(WARNED, 0, "Passed"), (WRONG, 1, "DOC022")],
)
def test_a_commit_is_checked(
    committing: Repository, text: str, code: int, word: str
) -> None:
    committing.write({"rigs/a.rig.yaml": text, "notes.yaml": "rig: none\n"})
    ended = pre_commit(committing, "run", "animtool-validate", "--all-files")
    assert ended.code == code, ended.said
    assert word in ended.said
    assert "notes.yaml" not in ended.said


@pytest.mark.slow
def test_a_commit_is_mended(committing: Repository) -> None:
    committing.write({"a.rig.yaml": MENDABLE, "b.rig.yaml": RIGHT})
    first = pre_commit(committing, "run", "animtool-fix", "--all-files")
    assert first.code == 1
    assert "files were modified by this hook" in first.said
    assert "RIG221 fixed" in first.said
    mended = (committing.folder / "a.rig.yaml").read_text("utf-8")
    assert mended == MENDABLE.replace("hips.x", "hips_x")
    committing.run("git", "add", "-A")
    second = pre_commit(committing, "run", "--all-files")
    assert second.code == 0, second.said


def action(root: Path) -> dict[str, Any]:
    path = root / ".github/actions/validate/action.yml"
    return yaml.safe_load(path.read_text("utf-8"))


def run_action(root: Path, repository: Repository, **inputs: str) -> dict[str, Ended]:
    """Run the steps of the action that its inputs ask for, as GitHub would."""
    found = action(root)
    assert set(inputs) <= set(found["inputs"])
    given = {name: entry["default"] for name, entry in found["inputs"].items()}
    given |= inputs
    context = {f"inputs.{name}": value for name, value in given.items()}
    context["github.action_path"] = str(root / ".github/actions/validate")
    ended = {}
    for step in found["runs"]["steps"]:
        if "run" not in step or (
            "inputs.sarif" in step.get("if", "") and not given["sarif"]
        ):
            continue
        variables = {
            name: re.sub(r"\$\{\{ (.*?) \}\}", lambda f: context[f[1]], value)
            for name, value in step["env"].items()
        }
        script = repository.folder.parent / "step.sh"
        script.write_text(step["run"], "utf-8")
        ended[step["name"]] = repository.run(*SHELL, script, **variables)
    return ended


@pytest.mark.slow
def test_the_action_checks(root: Path, repository: Repository) -> None:
    repository.write(
        {"a b/a.rig.yaml": WRONG, "b.rig.yaml": WARNED, "c.rig.yaml": RIGHT}
    )
    ended = run_action(root, repository)
    assert list(ended) == ["Install animtool", "Validate"]
    assert ended["Install animtool"].code == 0
    source = repository.installed.read_text("utf-8").split(maxsplit=1)[1].strip()
    assert Path(source).resolve() == root
    assert ended["Validate"].code == 1
    assert "::error file=a b/a.rig.yaml,line=4,col=" in ended["Validate"].said
    assert "::warning file=b.rig.yaml,line=4,col=" in ended["Validate"].said


@pytest.mark.parametrize(
    ("inputs", "code"),
    [
        ({"paths": "rigs"}, 0),
        ({"paths": "rigs", "strict": "true"}, 1),
        ({"paths": "rigs\nwrong dir\n", "strict": "false"}, 1),
        ({"paths": "**/*.rig.yaml"}, 1),
        ({"paths": "rigs", "strict": "true", "ignore": "RIG2,CLIP"}, 0),
        ({"paths": "rigs", "strict": "true", "select": "CLIP"}, 0),
        ({"paths": "rigs", "select": "; touch x"}, 2),
        ({"paths": "$(touch x)"}, 3),
        ({"paths": "*.bvh"}, 5),
    ],
)
def test_inputs_of_the_action(
    root: Path,
    repository: Repository,
    monkeypatch: pytest.MonkeyPatch,
    inputs: dict[str, str],
    code: int,
) -> None:
    repository.write({"rigs/a.rig.yaml": WARNED, "wrong dir/a.rig.yaml": WRONG})
    said = repository.record()
    run_action(root, repository, version="1.2.3", **inputs)
    *arguments, paths = said.read_text("utf-8").split("\0")
    monkeypatch.setattr("sys.stdin", io.StringIO(paths))
    done = animtool(*arguments, cwd=repository.folder)
    assert done.code == code, done.stderr
    assert "animtool==1.2.3" in repository.installed.read_text("utf-8")
    assert not (repository.folder / "x").exists()


@pytest.mark.slow
def test_the_action_writes_sarif(root: Path, repository: Repository) -> None:
    repository.write({"a.rig.yaml": WRONG})
    ended = run_action(root, repository, sarif="out.sarif")
    assert [entry.code for entry in ended.values()] == [0, 1, 0]
    sarif = json.loads((repository.folder / "out.sarif").read_text("utf-8"))
    assert [r["ruleId"] for r in sarif["runs"][0]["results"]] == ["DOC022"]
    upload = action(root)["runs"]["steps"][-1]
    assert upload["with"]["sarif_file"] == "${{ inputs.sarif }}"


def test_the_workflow_gives_inputs_that_there_are(root: Path) -> None:
    text = (root / "samples/ci/github.yml").read_text("utf-8")
    step = yaml.safe_load(text)["jobs"]["validate"]["steps"][-1]
    assert step["uses"].split("@")[0].endswith("/.github/actions/validate")
    assert set(step["with"]) <= set(action(root)["inputs"])


def commands(root: Path, name: str) -> list[str]:
    """Return the shell commands of a recipe."""
    text = (root / "samples/ci" / name).read_text("utf-8")
    if name == "Jenkinsfile":
        found = re.findall(r"sh '(.*)'", text)
        return [command.replace(".venv/bin/", "") for command in found]
    job = yaml.safe_load(text)["animtool"]
    return [*job["before_script"], *job["script"]]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "text", "code"), [("gitlab-ci.yml", RIGHT, 0), ("Jenkinsfile", WARNED, 1)]
)
def test_recipes_with_junit(
    root: Path, repository: Repository, name: str, text: str, code: int
) -> None:
    repository.write({"rigs/a.rig.yaml": RIGHT, "shots/b.rig.yaml": text})
    *install, check = commands(root, name)
    for command in install:
        # No environment is made: the one of the tests has what is needed.
        plain = command.replace("python -m venv .venv && ", "")
        assert repository.run(*SHELL, "-c", plain).code == 0
    assert "install animtool" in repository.installed.read_text("utf-8")
    ended = repository.run(*SHELL, "-c", check)
    assert ended.code == code, ended.said
    tree = ElementTree.parse(repository.folder / "animtool.xml")
    assert len(tree.findall(".//testcase")) == 2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("files", "code", "word"),
    [
        (["right.rig.yaml"], 0, ""),
        (["right.rig.yaml", "wrong.rig.yaml"], 1, "errors"),
        (["none.rig.yaml"], 1, "cannot be read"),
        (["*.bvh"], 0, ""),
        (["right.txt"], 2, "could not be run"),
    ],
)
def test_the_script_for_a_farm(
    root: Path, repository: Repository, files: list[str], code: int, word: str
) -> None:
    repository.write(
        {"right.rig.yaml": RIGHT, "wrong.rig.yaml": WRONG, "right.txt": ""}
    )
    repository.write({"files.txt": "\n".join(files) + "\n"})
    script = root / "samples/ci/farm.sh"
    ended = repository.run("sh", script, "files.txt", "report.json")
    assert ended.code == code, ended.said
    assert word in ended.said


def test_every_recipe_is_in_the_readme(root: Path) -> None:
    folder = root / "samples/ci"
    text = (folder / "README.md").read_text("utf-8")
    listed = set(re.findall(r"^\| `([\w.-]+)` \|", text, re.M))
    assert listed == {path.name for path in folder.iterdir()} - {"README.md"}
