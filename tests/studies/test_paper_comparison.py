"""The table of one case: rows, Markdown, and what a notebook shows."""

from mireach.studies.comparison import Comparison, Row


def test_a_comparison_is_shown_as_one_line_as_markdown_and_as_html():
    table = Comparison("pwa", True, [Row("iterations", 1, 2, "a < b")], {"safe_set": 0.1234})
    assert str(table) == "case pwa: 1 items compared with the paper"
    assert table.markdown().splitlines() == [
        "## Case `pwa`",
        "",
        "| item | paper | here | remark |",
        "| --- | --- | --- | --- |",
        "| iterations | 1 | 2 | a < b |",
        "",
        "Seconds: safe set 0.123 s.",
    ]
    assert "<td>a &lt; b</td>" in table._repr_html_()


def test_a_case_that_the_paper_lacks_has_no_column_of_the_paper():
    table = Comparison("tank", False, [Row("iterations", "-", 2, "few")], {})
    assert str(table) == "case tank: 1 items"
    assert table.markdown().splitlines()[:5] == [
        "## Case `tank`, beyond the paper",
        "",
        "| item | here | remark |",
        "| --- | --- | --- |",
        "| iterations | 2 | few |",
    ]
    assert "paper" not in table._repr_html_()
