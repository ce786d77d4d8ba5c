"""Tables as Parquet files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from comove.errors import ResultError
from comove.io.files import installed, whole_path


def write_parquet(path: str | Path, columns: Mapping[str, Sequence[Any]], kinds: Mapping[str, str]) -> None:
    """Write a table to a Parquet file atomically.

    Parameters
    ----------
    columns : values of each column, by its name; None where there is none
    kinds : types of the columns as pyarrow names them, such as "float64"

    Raises
    ------
    ExtraError
        If pyarrow is not installed.
    ResultError
        If the file cannot be written.
    """
    pyarrow, parquet = (installed(name, "a Parquet file", "data") for name in ("pyarrow", "pyarrow.parquet"))
    table = {name: pyarrow.array(values, type=kinds[name]) for name, values in columns.items()}
    with whole_path(path, ResultError) as draft:
        parquet.write_table(pyarrow.table(table), draft)
