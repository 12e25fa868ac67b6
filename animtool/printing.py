r"""Text of files as it is printed: on one line, with nothing that a terminal obeys.

What names, paths and messages hold may come from anyone. Control characters move the
cursor or set a title, bidirectional marks show a name backwards, and a line that
begins with ``::`` is a command to some services of continuous integration.

References:
    Unicode Technical Report 36, "Unicode Security Considerations".
    GitHub Docs, "Workflow commands for GitHub Actions"; Microsoft, "Logging commands"
    of Azure Pipelines, which are read anywhere in a line.
"""

from __future__ import annotations

import json
import re

# A class of a regular expression: what no name has a use for.
CONTROL = "\x00-\x1f\x7f-\x9f\ud800-\udfff"
# Controls, what ends a line, what has no width, what turns the direction of text, and
# joiners, save between letters that are joined.
_UNSEEN = (
    f"{CONTROL}\xad\u061c\u180e\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f"
    "\ufeff\ufff9-\ufffb\ufffe\uffff\U000e0000-\U000e007f"
)
_JOINER = "(?<![^\x00-\x7f])[\u200c\u200d]|[\u200c\u200d](?![^\x00-\x7f])"
_COMMAND = r"#(?=#\w{0,9}\[)"
_ESCAPED = re.compile(f"[{_UNSEEN}]|{_JOINER}|{_COMMAND}")
_FIRST = re.compile(r"\A(\s*):(?=:)")
_SHORT = {"\n": r"\n", "\r": r"\r", "\t": r"\t"}


def escaped(text: str) -> str:
    r"""Return text as a line prints it, with escapes for what is not shown as it is.

    Text without such characters comes back as it is, and so does what was escaped.

    >>> escaped("hip\x1b]0;mine\x07"), escaped("a\n::error::b"), escaped("::error::b")
    ('hip\\x1b]0;mine\\x07', 'a\\n::error::b', '\\x3a:error::b')
    """
    if text.isascii() and text.isprintable() and ":" not in text and "#" not in text:
        return text
    return _FIRST.sub(r"\1\\x3a", _ESCAPED.sub(_escape, text))


def escaped_lines(text: str) -> str:
    r"""Return text of several lines, each as `escaped` returns it.

    >>> escaped_lines("one\n::two\n")
    'one\n\\x3a:two\n'
    """
    return "\n".join(map(escaped, text.split("\n")))


def json_printed(
    value: object, *, indent: int | None = None, ascii_only: bool = False
) -> str:
    r"""Return a value as JSON in UTF-8, which has escapes where `escaped` has some.

    Raises:
        ValueError: It holds NaN or infinity.

    >>> json_printed("\x9b\udcff##[error]")
    '"\\u009b\\udcff\\u0023#[error]"'
    """
    text = json.dumps(value, indent=indent, ensure_ascii=ascii_only, allow_nan=False)
    # Ends of lines are those between values: json escapes all others.
    return _ESCAPED.sub(_escape_json, text)


def _escape(found: re.Match[str]) -> str:
    code = ord(found[0])
    if found[0] in _SHORT:
        return _SHORT[found[0]]
    if code < 0x100:
        return f"\\x{code:02x}"
    return f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


def _escape_json(found: re.Match[str]) -> str:
    if found[0] == "\n":
        return "\n"
    return json.dumps(found[0])[1:-1] if found[0] != "#" else "\\u0023"
