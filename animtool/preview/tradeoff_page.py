"""Writes a page of time against error: plots, tables, two settings side by side."""

from __future__ import annotations

import html
from collections.abc import Iterator, Sequence
from pathlib import Path

from animtool.core.arguments import ArgumentNamer, name_arguments, python_name
from animtool.core.files.output import check_outputs, write_parts
from animtool.preview.build import make_page
from animtool.preview.options import PreviewOptions
from animtool.preview.page import viewer_text
from animtool.preview.svg_plot import plot_svg
from animtool.preview.work_precision import panels_of
from animtool.report.tradeoffs import LEGEND, table_parts
from animtool.scene.tables.tradeoffs import StagePair, Tradeoffs

# Gap between two figures, relative to their size.
VIEWER_GAP = 0.6
_SECURITY_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' blob:; style-src 'unsafe-inline'; "
    "img-src data: blob:; frame-src 'self' about:; base-uri 'none'; form-action 'none'"
)


def write_tradeoff_page(
    report: Tradeoffs,
    output: Path,
    *,
    overwrite: bool = False,
    namer: ArgumentNamer = python_name,
) -> int:
    """Write the HTML page of a tradeoff report; return its size [byte].

    Pairs of settings are read and shown side by side.

    Args:
        report: The measurements.
        output: Path of the page.
        overwrite: Replace an existing page.
        namer: How texts refer to arguments: as options or in Python.
    """
    check_outputs([output], [report.source], overwrite=overwrite)
    write_parts(output, (part.encode() for part in page_parts(report, namer)))
    return output.stat().st_size


def page_parts(report: Tradeoffs, namer: ArgumentNamer = python_name) -> Iterator[str]:
    """Yield the self-contained HTML of the page in pieces."""
    style = viewer_text("tradeoffs.css")
    title = html.escape(f"{report.source.name}: time against error")
    yield (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{_SECURITY_POLICY}">\n'
        f"<title>{title}</title>\n<style>{style}</style>\n</head>\n<body>\n"
        f"<h1>{title}</h1>\n"
    )
    yield f'<p class="soft">{html.escape(LEGEND)}</p>\n'
    for notice in report.notices:
        message = name_arguments(notice.message, namer)
        text = f"{notice.severity}: {notice.code} {message}"
        yield f"<p>{html.escape(text)}</p>\n"
    pairs_by_table = {
        compared_pair.table_index: compared_pair for compared_pair in report.stage_pairs
    }
    panels = panels_of(report.tables)
    for i, (table, panel) in enumerate(zip(report.tables, panels, strict=True)):
        texts = table_parts(table)
        yield f"<h2>{html.escape(texts.header[0])}</h2>\n"
        for line in texts.header[1:]:
            yield f'<p class="soft">{html.escape(line.strip())}</p>\n'
        yield f"<figure>{plot_svg(panel)}</figure>\n"
        for line in texts.advice:
            yield f"<p>{html.escape(line.strip())}</p>\n"
        if table.lines:
            lines = name_arguments("\n".join(table.lines), namer)
            yield f"<pre>{html.escape(lines)}</pre>\n"
        yield from _table_html(texts.rows, texts.left_columns, texts.classes)
        if i in pairs_by_table:
            yield from _viewer_html(pairs_by_table[i])
    yield "</body>\n</html>\n"


def _table_html(
    rows: Sequence[Sequence[str]], left_columns: set[int], classes: Sequence[str]
) -> Iterator[str]:
    """Yield a table as HTML; the first row is its header."""
    yield '<div class="wide"><table>\n'
    for k, row in enumerate(rows):
        cell_tag = "td" if k else "th"
        class_attribute = f' class="{classes[k - 1]}"' if k and classes[k - 1] else ""
        yield f"<tr{class_attribute}>"
        for j, text in enumerate(row):
            cell_class = ' class="left"' if j in left_columns else ""
            yield f"<{cell_tag}{cell_class}>{html.escape(text)}</{cell_tag}>"
        yield "</tr>\n"
    yield "</table></div>\n"


def _viewer_html(compared_pair: StagePair) -> Iterator[str]:
    """Yield an iframe with the viewer of two settings."""
    current_text, alternative_text = (
        html.escape(str(setting)) for setting in compared_pair.settings
    )
    yield f"<p>Side by side: {current_text} (current) and {alternative_text}.</p>\n"
    page = make_page([*compared_pair.files], PreviewOptions(findings=False))
    for i, take in enumerate(page.manifest["takes"]):
        take["offset"] = [i * VIEWER_GAP * compared_pair.size, 0.0, 0.0]
    page_html = html.escape(page.html(), quote=True)
    title = f"{current_text}, {alternative_text}"
    yield f'<iframe title="{title}" srcdoc="{page_html}"></iframe>\n'
