"""A document as a PDF, by typst. All texts go there as data, so nothing in them is read as markup."""

from __future__ import annotations

import json
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

from placement_env.report.pages.document import Document

TEMPLATE = Path(__file__).with_name("report.typ")


def pdf_of(document: Document) -> bytes:
    """The PDF: the same document gives the same bytes. Raises ValueError where a drawing is no SVG."""
    import typst

    with tempfile.TemporaryDirectory(prefix="coview-report-") as folder:
        _write_project(document, Path(folder))
        try:
            pages = typst.compile(str(Path(folder, "report.typ")), root=folder, ignore_system_fonts=True, timestamp=0)
        except typst.TypstError as error:
            raise ValueError(f"the PDF cannot be set: {error.message}: the drawings must be SVG") from error
    assert isinstance(pages, bytes)
    return pages


def _write_project(document: Document, folder: Path) -> None:
    """Template, data and drawings, which typst reads from a folder of their own."""
    drawings = 0
    content: dict[str, Any] = {"title": document.title, "subtitle": document.subtitle, "language": document.language}
    content["sections"] = []
    for section in document.sections:
        blocks = []
        for block in section.blocks:
            described = _described(block)
            svg = described.pop("svg", None)
            if svg is not None:
                described["file"] = f"drawing{drawings}.svg"
                Path(folder, described["file"]).write_text(svg, encoding="utf-8")
                drawings += 1
            blocks.append(described)
        content["sections"].append({"title": section.title, "conclusion": section.conclusion, "blocks": blocks})
    Path(folder, "content.json").write_text(json.dumps(content), encoding="utf-8")
    Path(folder, "report.typ").write_bytes(TEMPLATE.read_bytes())


def _described(block: Block) -> dict[str, Any]:
    described = {"kind": block.kind, **asdict(block)}
    for described_column, column in zip(described.get("columns", ()), getattr(block, "columns", ()), strict=True):
        described_column["heading"] = column.heading
    return described
