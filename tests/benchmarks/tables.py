"""One table in three shapes: for the terminal, as Markdown for the documentation and as data for bench.json."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rich.table import Table as RichTable


@dataclass(frozen=True)
class Column:
    key: str
    """of the rows' dicts, with its unit"""
    heading: str
    pattern: str = "{}"
    """how a value is shown, e.g. '{:.0f}'"""

    def show(self, row: dict[str, Any]) -> str:
        value = row.get(self.key)
        return "" if value is None else self.pattern.format(value)


@dataclass(frozen=True)
class BenchTable:
    title: str
    """what was measured, sizes included"""
    compared: str
    """what is compared with what, in a sentence or two"""
    columns: tuple[Column, ...]
    rows: list[dict[str, Any]]
    """may hold more than the columns show, e.g. every round's time"""

    def to_rich(self) -> RichTable:
        table = RichTable(title=self.title, caption=self.compared, title_justify="left", caption_justify="left")
        for index, column in enumerate(self.columns):
            table.add_column(column.heading, justify="left" if index == 0 else "right", no_wrap=index == 0)
        for row in self.rows:
            table.add_row(*(column.show(row) for column in self.columns))
        return table

    def line(self, row: dict[str, Any]) -> str:
        """One row by itself."""
        shown = ((column.heading, column.show(row)) for column in self.columns)
        return ", ".join(f"{heading} {value}" for heading, value in shown if value)

    def to_markdown(self) -> str:
        head = "| " + " | ".join(column.heading for column in self.columns) + " |"
        rule = "|" + "|".join("---" if index == 0 else "---:" for index in range(len(self.columns))) + "|"
        rows = ["| " + " | ".join(column.show(row) for column in self.columns) + " |" for row in self.rows]
        return "\n".join([f"### {self.title}", "", self.compared, "", head, rule, *rows, ""])

    def to_data(self) -> dict[str, Any]:
        return {"title": self.title, "compared": self.compared, "markdown": self.to_markdown(), "rows": self.rows}
