"""Tables of texts, as Markdown for reports and as HTML for notebooks."""

from collections.abc import Iterable
from html import escape

Row = Iterable[object]


def markdown_table(head: Row, rows: Iterable[Row]) -> list[str]:
    """The lines of a Markdown table."""
    cells = list(head)
    return [_markdown_line(cells), _markdown_line(["---"] * len(cells)), *map(_markdown_line, rows)]


def html_table(head: Row, rows: Iterable[Row]) -> str:
    """An HTML table, for `_repr_html_`; special characters are escaped."""
    return "<table>" + _html_line(head, "th") + "".join(_html_line(row, "td") for row in rows) + "</table>"


def _markdown_line(cells: Row) -> str:
    return "| " + " | ".join(map(str, cells)) + " |"


def _html_line(cells: Row, tag: str) -> str:
    return "<tr>" + "".join(f"<{tag}>{escape(str(cell))}</{tag}>" for cell in cells) + "</tr>"
