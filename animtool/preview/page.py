"""The HTML of a page: manifest, data blocks and viewer in one self-contained file."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from animtool.preview.streams import deflate_base64

VIEWER_FOLDER = Path(__file__).parent / "viewer"
ENTRY_MODULE = "main.js"
_IMPORT_PATTERN = re.compile(r"""(\bfrom\s*|\bimport\s*)(['"])\./([\w-]+\.js)\2""")
_OMITTED_PATTERNS = tuple(
    re.compile(pattern, re.M | re.S)
    for pattern in (
        r"^[ \t]*/\*.*?\*/[ \t]*\n",
        r"^[ \t]*//[^\n]*\n",
        r"^[ \t]+",
        r"^\n",
    )
)
# Characters that would end a script element or a line of it, escaped in JSON.
_SCRIPT_ESCAPES = {ord(c): f"\\u{ord(c):04x}" for c in "<>&\u2028\u2029"}

_SECURITY_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' blob:; style-src 'unsafe-inline'; "
    "img-src data: blob:; connect-src {connect}; base-uri 'none'; form-action 'none'"
)

# Inflates the modules, creates a URL for each after its imports, and starts the last.
_BOOTSTRAP_SCRIPT = """\
(async () => {
  const page = (window.animtool = window.animtool || {errors: []});
  page.errors = page.errors || [];
  const failed = (error) => {
    page.errors.push(String(error && error.message || error));
    const place = document.getElementById('failed');
    if (place) { place.textContent = page.errors.join('\\n'); place.hidden = false; }
  };
  window.addEventListener('error', (event) => failed(event.error || event.message));
  window.addEventListener('unhandledrejection', (event) => failed(event.reason));
  if (!window.DecompressionStream) {
    failed('This browser is too old for the page: it cannot inflate data.');
    return;
  }
  const packed = atob(document.getElementById('modules').textContent);
  const bytes = Uint8Array.from(packed, (letter) => letter.charCodeAt(0));
  const inflate = new DecompressionStream('deflate-raw');
  const stream = new Blob([bytes]).stream().pipeThrough(inflate);
  const urls = {};
  for (const [name, code] of Object.entries(await new Response(stream).json())) {
    const text = code.replace(
      /(\\bfrom\\s*|\\bimport\\s*)(['"])\\.\\/([\\w-]+\\.js)\\2/g,
      (_, word, quote, other) => word + quote + urls[other] + quote);
    urls[name] = URL.createObjectURL(new Blob([text], {type: 'text/javascript'}));
  }
  import(urls['main.js']).catch(failed);
})();
"""


def json_text(value: Any) -> str:
    r"""Return JSON that is safe inside an HTML script element.

    >>> json_text({"name": "</script>"})
    '{"name":"\\u003c/script\\u003e"}'
    """
    text = json.dumps(value, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    # Lone surrogates, which file names use for bytes that are not text, are replaced.
    text = text.encode("utf-8", "replace").decode("utf-8")
    return text.translate(_SCRIPT_ESCAPES)


def page_parts(
    manifest: Mapping[str, Any], blocks: Sequence[str], *, is_watched: bool = False
) -> Iterator[bytes]:
    """Yield the bytes of a page, block by block.

    Args:
        manifest: Description of the contents.
        blocks: Its streams, as text.
        is_watched: Whether the page may poll its server for changes.
    """
    insertions = {
        "title": html.escape(str(manifest["title"])),
        "csp": _SECURITY_POLICY.format(connect="'self'" if is_watched else "'none'"),
        "style": viewer_text("viewer.css"),
        "manifest": f'<script type="application/json" id="manifest">'
        f"{json_text(manifest)}</script>",
        "modules": f'<script type="text/plain" id="modules">'
        f"{deflate_base64([json.dumps(viewer_modules()).encode()])}</script>",
        "bootstrap": _BOOTSTRAP_SCRIPT,
    }
    template = viewer_text("page.html")
    # The template is split once, so that inserted text is never parsed.
    for template_part in re.split(r"(\{\{\w+\}\})", template):
        name = template_part.strip("{}")
        if template_part == "{{blocks}}":
            for block_index, block in enumerate(blocks):
                yield (
                    f'<script type="text/plain" class="block" id="b{block_index}">'
                    f"{block}</script>\n"
                ).encode()
        elif template_part.startswith("{{") and name in insertions:
            yield insertions[name].encode("utf-8", "replace")
        else:
            yield template_part.encode("utf-8")


@cache
def viewer_modules() -> dict[str, str]:
    """Return the viewer's modules by name, in import order."""
    paths = sorted(VIEWER_FOLDER.glob("*.js"))
    code_by_file = {path.name: compact_code(path.read_text("utf-8")) for path in paths}
    module_by_name: dict[str, str] = {}

    def add(name: str, importers: tuple[str, ...] = ()) -> None:
        """Append a module after all the modules that it imports."""
        if name in module_by_name or name in importers or name not in code_by_file:
            return
        for match in _IMPORT_PATTERN.finditer(code_by_file[name]):
            add(match[3], (*importers, name))
        module_by_name[name] = code_by_file[name]

    add(ENTRY_MODULE)
    return module_by_name


def compact_code(text: str) -> str:
    r"""Return source code without comment lines and indentation.

    >>> compact_code("/** Adds. */\nfunction add(a) {\n  // one\n  return a + 1;\n}\n")
    'function add(a) {\nreturn a + 1;\n}\n'
    """
    for pattern in _OMITTED_PATTERNS:
        text = pattern.sub("", text)
    return text


def viewer_text(name: str) -> str:
    """Return the text of a source file of the viewer."""
    path = VIEWER_FOLDER / name
    return path.read_text("utf-8")
