"""Tables as Markdown and HTML."""

from mireach.studies.tables import html_table, markdown_table


def test_markdown_has_one_line_per_row_below_its_head():
    assert markdown_table(("k", "area"), [(1, 0.5), (2, "-")]) == [
        "| k | area |",
        "| --- | --- |",
        "| 1 | 0.5 |",
        "| 2 | - |",
    ]


def test_special_characters_are_escaped_in_html():
    table = html_table(("a & b",), [("x < 1",)])
    assert table == "<table><tr><th>a &amp; b</th></tr><tr><td>x &lt; 1</td></tr></table>"
