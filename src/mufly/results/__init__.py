"""Results: dataclasses with units and meanings, printed, tabulated, drawn and written to report pages."""

from mufly.results.result_class import (
    ResultColumn,
    ShownBlock,
    ShownLines,
    ShownTable,
    field_meaning,
    field_meanings,
    format_value,
    make_lines_block,
    make_table_block,
    result,
    result_rows,
    select_fields,
    tabulate_fields,
    tabulate_results,
    to_plain_data,
    to_records,
)

__all__ = [
    "ResultColumn",
    "ShownBlock",
    "ShownLines",
    "ShownTable",
    "field_meaning",
    "field_meanings",
    "format_value",
    "make_lines_block",
    "make_table_block",
    "result",
    "result_rows",
    "select_fields",
    "tabulate_fields",
    "tabulate_results",
    "to_plain_data",
    "to_records",
]
