"""Result folders, which are written as a whole and can be verified anew."""

from comove.results.folder import (
    Contents,
    StoredResult,
    check_target,
    filled_in,
    read_result,
    verify_result,
    whole_folder,
    write_solution,
)

__all__ = [
    "Contents",
    "StoredResult",
    "check_target",
    "filled_in",
    "read_result",
    "verify_result",
    "whole_folder",
    "write_solution",
]
