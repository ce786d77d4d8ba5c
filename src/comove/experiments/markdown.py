"""Tables in Markdown, for reports."""

from __future__ import annotations

from collections.abc import Sequence


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table with one line per row.

    >>> print(table(["system", "runs"], [["comove", "50"]]))
    | system | runs |
    | --- | --- |
    | comove | 50 |
    """
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows))
