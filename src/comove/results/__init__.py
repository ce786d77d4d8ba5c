"""Result folders: written as a whole, read with care, judged anew."""

from comove.results.folder import (
    Contents,
    StoredResult,
    check_target,
    read_result,
    verify_result,
    whole_folder,
    write_solution,
)

__all__ = [
    "Contents",
    "StoredResult",
    "check_target",
    "read_result",
    "verify_result",
    "whole_folder",
    "write_solution",
]
