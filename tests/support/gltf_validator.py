"""The reference validator of glTF, where node and its package are installed."""

from __future__ import annotations

import json
import shutil
import subprocess
from functools import cache
from pathlib import Path
from typing import Any

import pytest

_SCRIPT = """
const validator = require('gltf-validator');
const fs = require('fs');
const files = process.argv.slice(1);
Promise.all(files.map(f => validator.validateBytes(
  new Uint8Array(fs.readFileSync(f)), {maxIssues: 100})))
  .then(all => console.log(JSON.stringify(all.map(one => one.issues.messages))));
"""
# Severities: errors and warnings; those beyond are information and hints.
WARNING = 1


@cache
def _missing() -> str:
    """Return why there is no validator; empty where there is one."""
    node = shutil.which("node")
    if node is None:
        return "node is not installed"
    test = "require.resolve('gltf-validator')"
    done = subprocess.run([node, "-e", test], capture_output=True, check=False)
    if done.returncode:
        return "npm's gltf-validator is not installed where NODE_PATH leads"
    return ""


def issues(*paths: Path) -> list[dict[str, Any]]:
    """Return the errors and warnings that the validator finds; skip without it."""
    if reason := _missing():
        pytest.skip(reason)
    command = ["node", "-e", _SCRIPT, "--", *map(str, paths)]
    done = subprocess.run(command, capture_output=True, check=True, text=True)
    return [
        issue
        for messages in json.loads(done.stdout)
        for issue in messages
        if issue["severity"] <= WARNING
    ]
