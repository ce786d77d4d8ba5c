"""Results in folders, which are written as a whole, sealed by checksums, and can be verified anew."""

from comove.results.sealed import ResultKind
from comove.results.solution import (
    RESULT,
    StoredResult,
    changes_to,
    filled_in,
    read_result,
    verify_result,
    write_solution,
)

__all__ = [
    "RESULT",
    "ResultKind",
    "StoredResult",
    "changes_to",
    "filled_in",
    "read_result",
    "verify_result",
    "write_solution",
]
