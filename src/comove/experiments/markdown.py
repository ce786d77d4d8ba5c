"""Tables of reports in Markdown."""

from __future__ import annotations

from collections.abc import Sequence


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table, a line a row.

    >>> print(table(["system", "runs"], [["comove", "50"]]))
    | system | runs |
    | --- | --- |
    | comove | 50 |
    """
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows))
