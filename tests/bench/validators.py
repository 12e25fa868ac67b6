"""What NVIDIA's asset validator says of the USD that animtool writes.

Every shipped rig becomes a rig layer and a physics layer, every sample a stage, in
crate files; the validator runs in an environment of its own; see README.md beside
this file.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

from figures import HERE, Row, Wanted, machine, table, verdicts, write_csv

ROOT = HERE.parents[1]


def animtool(*arguments: str | Path) -> None:
    """Run animtool, which must succeed."""
    command = [sys.executable, "-m", "animtool", *map(str, arguments)]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{' '.join(command)}\n{done.stderr}")


def written(folder: Path) -> list[Path]:
    """Write every shipped rig and sample; return the files."""
    made = []
    for rig in sorted(ROOT.glob("rigs/*/*.rig.yaml")):
        name = rig.name.removesuffix(".rig.yaml")
        animtool("convert", rig, folder / f"{name}.usdc", "--physics", "-q")
        made += [folder / f"{name}.usdc", folder / f"{name}.physics.usda"]
    samples = [*ROOT.glob("samples/*/*.clip.yaml"), *ROOT.glob("samples/*/*.bvh")]
    for sample in sorted(samples):
        output = folder / f"sample_{sample.name.split('.')[0]}.usdc"
        animtool("bake", sample, "-o", output, "-q")
        made.append(output)
    return made


def findings(validator: Path, path: Path) -> Counter[str]:
    """Return how often each rule spoke, as ``severity rule``."""
    report = path.with_suffix(".json")
    command = [str(validator), str(path), "--json-output", str(report)]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    if not report.is_file():
        raise SystemExit(f"{' '.join(command)}\n{done.stderr[-2000:]}")
    issues = json.loads(report.read_text("utf-8"))
    return Counter(said(issues))


def said(node: object) -> list[str]:
    """Return severity and rule of every issue, wherever the report holds it."""
    if isinstance(node, dict):
        severity = node.get("severity")
        if isinstance(severity, str):
            rule = node.get("rule")
            name = rule.get("name") if isinstance(rule, dict) else rule
            return [f"{severity} {name}"]
        return [found for value in node.values() for found in said(value)]
    if isinstance(node, list):
        return [found for value in node for found in said(value)]
    return []


def main() -> None:
    """Write, validate, print and store."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--validator", type=Path, required=True)
    parser.add_argument("--csv", type=Path, default=HERE / "results/validators.csv")
    given = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for path in written(Path(folder)):
            found = findings(given.validator, path)
            for name, count in sorted(found.items()):
                print(f"{path.name}: {count} x {name}", file=sys.stderr)
            count = float(sum(found.values()))
            rows.append(Row("NVIDIA", path.name, "findings", [count], Wanted(False, 0)))
    print("\n".join([*table(rows), *verdicts(rows)]))
    python = str(given.validator.with_name("python"))
    packages = ["omniverse-asset-validator", "usd-validation-nvidia", "usd-core"]
    write_csv(given.csv, machine((python, packages)), rows)


if __name__ == "__main__":
    main()
