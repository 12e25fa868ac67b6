"""The shape of the package: who may import whom, and what is loaded when."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from collections import defaultdict
from functools import cache
from pathlib import Path

import pytest

import animtool

PACKAGE = Path(animtool.__file__).parent
# A package imports from those above it only.
LAYERS = [
    {"core", "_kernels"},
    {"maths"},
    {"documents"},
    {"rig"},
    {"motion"},
    {"clip"},
    {"skin"},
    {"ik"},
    {"formats"},
    {"usd"},
    {"edit", "retarget", "capture", "sim"},
    {"systems"},
    {"scene"},
    {"batch"},
    {"preview", "report", "validation"},
    {"cli"},
]
# Passes of one kind know nothing of those of another.
APART = {"edit", "retarget", "capture", "sim"}
RANK = {name: i for i, names in enumerate(LAYERS) for name in names}


def rank(module: str) -> int:
    """Return how far down a module of animtool stands."""
    name = module.removeprefix("animtool.")
    for key in (".".join(name.split(".")[:2]), name.split(".")[0]):
        if key in RANK:
            return RANK[key]
    raise AssertionError(f"{module} is in no layer")


@cache
def syntax(path: Path) -> tuple[set[str], bool]:
    """Return what a file imports, inside functions too, and whether it reads files."""
    found: set[str] = set()
    reads = False
    # The tree is not kept: while it lives, each collection of garbage goes through it.
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Call):
            reads |= _opens(node)
    return found, reads


# By folder; the modules that are in none have a name each.
MODULES: dict[str, list[Path]] = defaultdict(list)
for _path in sorted(PACKAGE.rglob("*.py")):
    if _path not in {PACKAGE / "__main__.py", PACKAGE / "__init__.py"}:
        MODULES[_path.relative_to(PACKAGE).parts[0]].append(_path)


@pytest.mark.slow
@pytest.mark.parametrize("folder", MODULES)
def test_imports_point_one_way(folder: str) -> None:
    faults = []
    for path in MODULES[folder]:
        module = dotted(path)
        for name in syntax(path)[0]:
            first, _, rest = name.partition(".")
            if first == "animtool" and rest:
                apart = folder in APART and rest.split(".")[0] in APART - {folder}
                wrong = apart or rank(name) > rank(module)
            else:
                wrong = folder != {"pxr": "usd", "click": "cli", "rich": "cli"}.get(
                    first, folder
                )
            if wrong:
                faults.append(f"{module} imports {name}")
    assert not faults


def dotted(path: Path) -> str:
    """Return the name of a module."""
    parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
    return ".".join(parts).removesuffix(".__init__")


# Who opens a file without `animtool.core.files.reading`, and which.
OPENED = {
    "animtool.core.files.reading": "what is named, once it was looked at",
    "animtool.batch.ledger": "a lock that it writes",
    "animtool.batch.records": "a record that it writes",
    "animtool.batch.timeline": "a cut list that timeline_text has looked at",
    "animtool.batch.work": "/proc",
    "animtool.core.files.leftovers": "/proc",
    "animtool.core.files.commit": "files that it writes, and their folders",
    "animtool.scene.bake.progress": "/proc and cgroups",
    "animtool.usd.checks.value_clips": "layers that dependencies has looked at",
    "animtool.usd.layers.dependencies": "layers that it has looked at",
    "animtool.usd.layers.package": "a package that it writes",
    "animtool.usd.takes.extents": "a layer in memory",
    "animtool.usd.fixes.target": "a copy of a file that open_layer has looked at",
    "animtool.usd.layers.sdf": "a layer that it has looked at",
    "animtool.usd.rigs.skinned": "a file that was just written",
    "animtool.usd.rigs.layer": "a layer in memory",
    "animtool.usd.caches.info": "layers that dependencies has looked at",
    "animtool.preview.page": "the viewer, which is part of animtool",
    "animtool.retarget.names": "a table that is part of animtool",
    "animtool.core.files.spool": "what it has written itself",
    "animtool.core.plugins": "what packages say that they have",
    "animtool.core.pages": "pages that are part of animtool",
    "animtool.core.rules": "pages that are part of animtool",
}
READS = {
    *("read_bytes", "FindOrOpen", "OpenAsAnonymous", "read_from_file", "FileIO"),
    *("copyfile", "copy2", "copytree", "fromfile", "memmap", "loadtxt", "genfromtxt"),
}

NUMPY = {"np", "numpy", "tomllib"}


def _opens(call: ast.Call) -> bool:
    match call.func:
        case ast.Attribute(value, name):
            pass
        case ast.Name(name):
            value = None
        case _:
            return False
    if name not in {"open", "Open", "load", "read_text"} | READS:
        return False
    owner = ast.unparse(value) if value else ""
    given = [arg.value for arg in call.args if isinstance(arg, ast.Constant)]
    mode = next((value for value in given if isinstance(value, str)), "")
    if owner == "os" and name == "open":
        whole = ast.unparse(call)
        return not ("O_WRONLY" in whole or "O_CREAT" in whole)
    if name == "open":
        # Other things that are opened have no mode.
        return mode[:1] not in {"w", "x", "a"} if not owner else mode[:1] == "r"
    if name in {"Open", "load", "read_text"}:
        return (
            owner.endswith("Stage")
            or owner in NUMPY
            or (name == "read_text" and bool(owner))
        )
    return name in READS


@pytest.mark.slow
def test_what_is_named_is_opened_in_one_place() -> None:
    found = {dotted(path) for path in PACKAGE.rglob("*.py") if syntax(path)[1]}
    assert found == set(OPENED)


def test_no_modules_import_each_other_in_a_circle() -> None:
    files = [*PACKAGE.rglob("*.py"), *PACKAGE.glob("*.pyi")]
    modules = {dotted(path): syntax(path)[0] for path in files}
    left = {
        name: {
            found if found in modules else found.rpartition(".")[0] for found in names
        }
        - {name}
        for name, names in modules.items()
    }
    # What imports nothing that is left, or is imported by nothing, is in no circle.
    while left:
        used = set().union(*left.values())
        kept = {n: found & left.keys() for n, found in left.items() if n in used}
        kept = {name: found for name, found in kept.items() if found}
        if kept == left:
            break
        left = kept
    assert not left


# Records that are still made by the standard library.
COMPILED = {"animtool.core.record"}


def test_records_are_made_without_code_at_import() -> None:
    modules = {dotted(path): syntax(path)[0] for path in PACKAGE.rglob("*.py")}
    compiled = {n for n, found in modules.items() if "dataclasses.dataclass" in found}
    left = {n for n in compiled if not any(n.startswith(one) for one in COMPILED)}
    assert left == set()


def loaded(code: str) -> set[str]:
    """Return the modules that a fresh interpreter has after some code."""
    script = f"{code}\nimport sys, json\nprint(json.dumps(sorted(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-P", "-c", script], capture_output=True, text=True, check=True
    )
    return set(json.loads(done.stdout.splitlines()[-1]))


def test_importing_animtool_loads_nothing_heavy() -> None:
    assert not loaded("import animtool") & {"numpy", "pxr", "scipy", "click", "rich"}


def test_importing_ik_loads_none_of_it() -> None:
    assert "animtool.ik.solving" not in loaded("import animtool.ik")
    code = (
        "import animtool.ik.clip_solver\nfrom animtool.ik import follow\n"
        "follow.__code__"
    )
    assert "animtool.ik.clip_solver" in loaded(code)


def test_importing_sim_loads_none_of_it() -> None:
    assert "animtool.sim.integrating" not in loaded("import animtool.sim")
    code = "from animtool.sim import find_integrator\nfind_integrator('rk4')"
    assert not loaded(code) & {"scipy", "pydantic", "animtool.sim.integrators.adaptive"}


def test_help_loads_nothing_heavy() -> None:
    code = (
        "from animtool.cli.main import COMMANDS, run\nrun(['--help'])\n"
        "for name in COMMANDS: run([name, '--help'])"
    )
    assert not loaded(code) & {"numpy", "pxr", "scipy", "rich", "pydantic"}


def test_a_bvh_is_described_without_usd(walk: Path) -> None:
    code = f"from animtool.cli.main import run\nrun(['info', {str(walk)!r}])"
    # The names of joints by which persons are told are a table in YAML.
    assert not loaded(code) & {"pxr", "scipy", "rich", "pydantic"}


@pytest.mark.slow
def test_a_rig_is_checked_without_usd_scipy_or_kernels(root: Path) -> None:
    path = root / "rigs/head/head.rig.yaml"
    code = f"from animtool.cli.main import run\nrun(['validate', {str(path)!r}])"
    heavy = {"pxr", "scipy", "rich", "animtool._kernels", "numpy.ma", "multiprocessing"}
    assert not loaded(code) & heavy


def test_a_capture_is_checked_without_the_models_of_files(walk: Path) -> None:
    code = f"from animtool.cli.main import run\nrun(['validate', {str(walk)!r}])"
    assert not loaded(code) & {"pxr", "scipy", "rich", "pydantic", "animtool.batch"}


def test_a_bake_loads_no_more_usd_than_it_needs(walk: Path, tmp_path: Path) -> None:
    code = (
        "from animtool.cli.main import run\n"
        f"run(['bake', {str(walk)!r}, '-o', {str(tmp_path / 'o.usdc')!r}])"
    )
    heavy = {"pxr.UsdSkel", "pxr.UsdGeom", "pxr.Usd", "scipy", "rich", "animtool.sim"}
    assert not loaded(code) & heavy


@pytest.mark.slow
def test_meshes_without_a_rig_layer_need_no_skeletons_of_usd(
    root: Path, tmp_path: Path
) -> None:
    clip, output = root / "samples/speech/speech.clip.yaml", tmp_path / "o.usdc"
    code = (
        "from animtool.cli.main import run\n"
        f"run(['bake', {str(clip)!r}, '--deform', '-o', {str(output)!r}])"
    )
    heavy = {"pxr.UsdSkel", "pxr.UsdUtils", "pxr.UsdShade", "scipy", "rich"}
    assert not loaded(code) & heavy
    assert output.exists()


def test_a_batch_is_planned_without_what_makes_it(walk: Path, tmp_path: Path) -> None:
    code = (
        "from animtool.cli.main import run\n"
        f"run(['batch', {str(walk)!r}, '-n', '-o', {str(tmp_path / 'o.usdc')!r}])"
    )
    assert not loaded(code) & {"pxr", "numpy", "scipy", "rich", "pydantic"}


def test_every_public_name_exists() -> None:
    for name in animtool.__all__:
        assert getattr(animtool, name) is not None
    with pytest.raises(AttributeError, match="nothing_such"):
        _ = animtool.nothing_such


# What writes command lines that others run.
WRITES_COMMANDS = {PACKAGE / "batch/bundle.py"}
FLAG = re.compile(r"(?<![\w-])--[a-z]")


def documented(node: ast.AST) -> ast.expr | None:
    """Return the docstring of what has one."""
    kinds = ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef
    if isinstance(node, kinds) and node.body and isinstance(node.body[0], ast.Expr):
        return node.body[0].value
    return None


@pytest.mark.parametrize("folder", [name for name in MODULES if name != "cli"])
def test_texts_of_the_library_name_arguments(folder: str) -> None:
    faults = []
    for path in MODULES[folder]:
        text = path.read_text("utf-8")
        if path in WRITES_COMMANDS or not FLAG.search(text):
            continue
        nodes = [*ast.walk(ast.parse(text))]
        docstrings = {id(found) for node in nodes if (found := documented(node))}
        faults += [
            f"{path.relative_to(PACKAGE)}:{node.lineno} {node.value!r}"
            for node in nodes
            if isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and id(node) not in docstrings
            and FLAG.search(node.value)
        ]
    assert faults == []
