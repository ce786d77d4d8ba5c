"""Result folders, which are written as a whole and can be verified anew; and the store of runs."""

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
from comove.results.runs import RunStore, export_parquet

__all__ = [
    "Contents",
    "RunStore",
    "StoredResult",
    "check_target",
    "export_parquet",
    "filled_in",
    "read_result",
    "verify_result",
    "whole_folder",
    "write_solution",
]
