"""Result folders: written as a whole, read with care, judged anew."""

from comove.results.folder import (
    StoredResult,
    check_target,
    read_result,
    verify_result,
    whole_folder,
    write_solution,
)

__all__ = ["StoredResult", "check_target", "read_result", "verify_result", "whole_folder", "write_solution"]
