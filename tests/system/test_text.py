import pytest

from lerobot_gloves.system.text import markdown_table


def test_columns_line_up() -> None:
    assert markdown_table([["method", "%"], ["raw agent", "4.0"], ["FEEG", "70.0"]]).splitlines() == [
        "| method    | %    |",
        "| --------- | ---- |",
        "| raw agent | 4.0  |",
        "| FEEG      | 70.0 |",
    ]


def test_a_line_of_another_length_is_refused() -> None:
    with pytest.raises(ValueError, match="shorter"):
        markdown_table([["method", "%"], ["raw agent"]])
