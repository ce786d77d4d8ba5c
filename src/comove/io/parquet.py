"""Tables as Parquet files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from comove.errors import ExtraError, ResultError
from comove.io.files import whole_path


def write_parquet(path: str | Path, columns: Mapping[str, Sequence[Any]], kinds: Mapping[str, str]) -> None:
    """Write a table to a Parquet file, whole or not at all.

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
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise ExtraError("a Parquet file", "data") from error
    table = {name: pyarrow.array(values, type=kinds[name]) for name, values in columns.items()}
    with whole_path(path, ResultError) as draft:
        pyarrow.parquet.write_table(pyarrow.table(table), draft)
