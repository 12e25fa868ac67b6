"""Values as YAML or JSON text, and the comment lines of a text."""

from __future__ import annotations

import json
import sys
from typing import Any

import yaml

from animtool.documents.yaml_values import masked_variables, plain_scalar

LINE_WIDTH = 88


class _Dumper(yaml.SafeDumper):
    """A YAML dumper that quotes texts that would be read as another type."""

    def ignore_aliases(self, data: Any) -> bool:
        """Disable aliases, which documents cannot have."""
        del data
        return True

    def serialize(self, node: yaml.Node) -> None:
        """Write the outermost mapping with one key per line."""
        if isinstance(node, yaml.MappingNode):
            node.flow_style = False
        super().serialize(node)


def _represent_text(dumper: _Dumper, value: str) -> yaml.ScalarNode:
    try:
        is_plain = value != "" and isinstance(plain_scalar(value), str)
    except OverflowError:
        is_plain = False
    style = None if is_plain else '"'
    return dumper.represent_scalar("tag:yaml.org,2002:str", value, style=style)


_Dumper.add_representer(str, _represent_text)


def yaml_text(value: dict[str, Any]) -> str:
    """Return values as YAML text that parses to equal values.

    >>> print(yaml_text({"rig": "animtool/1", "bind": {"a": [1, 2.5]}}), end="")
    rig: animtool/1
    bind:
      a: [1, 2.5]
    """
    return _dump(value, LINE_WIDTH, is_flow=None)


def flow_text(key: str, value: Any) -> str:
    """Return a key with its value as YAML on one line.

    >>> flow_text("keys", [{"t": 1.0, "v": 0.5}])
    'keys: [{t: 1, v: 0.5}]'
    """
    return _dump({key: _integral_values(value)}, sys.maxsize, is_flow=True).strip()


def _dump(value: Any, width: int, *, is_flow: bool | None) -> str:
    text: str = yaml.dump(
        value,
        Dumper=_Dumper,
        default_flow_style=is_flow,
        allow_unicode=True,
        sort_keys=False,
        width=width,
    )
    return text


def _integral_values(value: Any) -> Any:
    """Return a value with integer-valued floats converted to integers."""
    if isinstance(value, dict):
        return {key: _integral_values(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_integral_values(item) for item in value]
    is_integer = isinstance(value, float) and value.is_integer()
    return int(value) if is_integer and abs(value) < 1e15 else value


def json_text(value: dict[str, Any]) -> str:
    """Return values as indented JSON that ends in a newline."""
    return json.dumps(value, indent=2, ensure_ascii=False) + "\n"


def comments_in(text: str) -> list[int]:
    r"""Return the 1-based numbers of the lines of a YAML text that have comments.

    >>> comments_in("a: 1  # one\nb: '# none'\n# two\n")
    [1, 3]
    """
    lines: list[int] = []
    token_end, line = 0, 1
    for token in yaml.scan(masked_variables(text), yaml.CSafeLoader):
        text_between = text[token_end : token.start_mark.index]
        lines += [
            line + i
            for i, line_text in enumerate(text_between.split("\n"))
            if "#" in line_text
        ]
        token_end, line = token.end_mark.index, token.end_mark.line + 1
    return sorted(set(lines))
