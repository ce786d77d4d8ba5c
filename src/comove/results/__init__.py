"""Result folders: written as a whole, sealed by checksums, verified anew."""

from typing import TYPE_CHECKING

from comove._doors import lazily

if TYPE_CHECKING:
    from comove.results.reference import changes_to as changes_to, filled_in as filled_in
    from comove.results.sealed import ResultKind as ResultKind
    from comove.results.solution import (
        RESULT as RESULT,
        StoredResult as StoredResult,
        read_result as read_result,
        verify_result as verify_result,
    )
    from comove.results.writing import write_solution as write_solution

__all__, __getattr__, __dir__ = lazily(
    __name__,
    {
        "results.reference": ["changes_to", "filled_in"],
        "results.sealed": ["ResultKind"],
        "results.solution": [
            "RESULT",
            "StoredResult",
            "read_result",
            "verify_result",
        ],
        "results.writing": ["write_solution"],
    },
)
