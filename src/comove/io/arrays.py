"""Arrays in NumPy archives, read without trusting their headers.

An archive of 1 MB can unpack to 1 GB, and a header can claim any shape: both are compared with a limit
before any data are read. Pickled objects are never loaded.
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from comove.errors import DemonstrationError, near_name
from comove.io.files import existing_file, telling

if TYPE_CHECKING:
    from zipfile import ZipFile

MAX_BYTES = 256 * 2**20
"""Largest archive, packed or unpacked [bytes]."""
_TOO_LARGE = "keep every n-th row"
_LAYOUT = "save it with numpy.savez(file, time=..., position=...)"


def read_arrays(
    path: str | os.PathLike[str], required: tuple[str, ...], optional: tuple[str, ...] = ()
) -> dict[str, NDArray]:
    """Read named arrays from an archive after checking their stated sizes.

    Parameters
    ----------
    path : archive of up to 256 MB unpacked
    required, optional : names of arrays; further arrays are ignored

    Raises
    ------
    DemonstrationError
        The archive cannot be read, is too large, holds pickled objects or misses a required array.
    """
    import lzma
    import struct
    import tokenize
    import zipfile
    import zlib

    path = existing_file(path, MAX_BYTES, _TOO_LARGE)
    broken = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error, tokenize.TokenError)
    unusable = (EOFError, ValueError, OverflowError, RuntimeError, SyntaxError, KeyError, TypeError)
    try:
        with telling(path), zipfile.ZipFile(path) as archive:
            _check_unpacked_size(path, archive)
            for member in archive.infolist():
                archive.open(member).close()  # a name is there twice: where they differ, one was damaged
            found = [name.removesuffix(".npy") for name in archive.namelist()]
            for key in required:
                if key not in found:
                    raise DemonstrationError(
                        "the array is missing",
                        file=path,
                        key=key,
                        way_out=f"{near_name(key, found)}; {_LAYOUT}",
                    )
            return {key: _read_array(path, archive, key) for key in (*required, *optional) if key in found}
    except (*broken, *unusable) as error:
        reason = " ".join(str(error).split())[:120]
        raise DemonstrationError(
            f"it is no whole archive of arrays ({reason})", file=path, way_out=_LAYOUT
        ) from error


def _check_unpacked_size(path: Path, archive: ZipFile) -> None:
    members = archive.infolist()
    size = sum(member.file_size for member in members)
    if size > MAX_BYTES:
        largest = max(members, key=lambda member: member.file_size)
        raise DemonstrationError(
            f"the archive unpacks to {size >> 20} MB, more than the {MAX_BYTES >> 20} MB that are read",
            file=path,
            key=largest.filename.removesuffix(".npy"),
            way_out=_TOO_LARGE,
        )


def _read_array(path: Path, archive: ZipFile, key: str) -> NDArray:
    """Read a member whose header agrees with its size."""
    member = archive.getinfo(f"{key}.npy")
    with archive.open(member) as stream:
        version = np.lib.format.read_magic(stream)
        short = version == (1, 0)
        read = np.lib.format.read_array_header_1_0 if short else np.lib.format.read_array_header_2_0
        shape, _, dtype = read(stream)
        remaining = member.file_size - stream.tell()
    if dtype.hasobject:
        raise DemonstrationError(
            "it holds pickled objects, which are never loaded",
            file=path,
            key=key,
            way_out="save plain numbers and names",
        )
    if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize != remaining:
        raise DemonstrationError(
            f"its header claims {dtype.name} of shape {shape}, and {remaining} bytes follow",
            file=path,
            key=key,
            way_out="save it again",
        )
    with archive.open(member) as stream:
        return np.lib.format.read_array(stream, allow_pickle=False)
