"""MCAP files: encoding of messages, and checksums.

Checksums are written and verified where the library does not. The format has one for each chunk of messages (CRC-32
of its uncompressed records; the library verifies it), one for everything before the summary, and one for the summary;
0 means none. See https://mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from comove.dmp.demonstrations.samples import fault
from comove.errors import DemonstrationError, listed

MAGIC = b"\x89MCAP0\r\n"
MAX_DATA = 256 * 2**20
"""Largest file whose messages are compared with the checksum of all of them [bytes]; chunks have their own."""
_HEADER, _FOOTER, _CHANNEL, _CHUNK, _DATA_END = 0x01, 0x02, 0x04, 0x06, 0x0F
_MAX_HEADER = 4096
_HEAD = struct.Struct("<BQ")  # of a record: its kind and length
_DATA = struct.Struct("<BQI")  # the record that ends the data, with their checksum
_STARTS = struct.Struct("<QQ")  # of the summary, and of its offsets
_CRC = struct.Struct("<I")
_TAIL = _HEAD.size + _STARTS.size + _CRC.size + len(MAGIC)


def check_mcap(path: Path) -> bool:
    """Verify a file's checksums; return whether its messages are JSON.

    Raises
    ------
    DemonstrationError
        If a checksum does not match its bytes, or the messages are of another kind: Protobuf, ROS 1.
    """
    with open(path, "rb") as file:
        size = file.seek(0, 2)
        if size < len(MAGIC) + _DATA.size + _TAIL:
            return False  # the library tells
        start, said = _footer(file, size)
        if start and said and start < size and said != _crc(file, start, size - len(MAGIC) - _CRC.size):
            raise _damaged(path, "its summary")
        is_json = _is_json(path, file, start, size)
        at = (start or size - _TAIL) - _DATA.size  # where the record stands that ends the data
        if size > MAX_DATA or at < len(MAGIC):
            return is_json
        file.seek(at)
        kind, length, said = _DATA.unpack(file.read(_DATA.size))
        if (kind, length) == (_DATA_END, _CRC.size) and said and said != _crc(file, 0, at):
            raise _damaged(path, "its data")
        return is_json


def _is_json(path: Path, file: IO[bytes], start: int, size: int) -> bool:
    """Return whether messages are JSON; raise unless JSON or ROS 2. `start` is the place of the file's summary."""
    file.seek(0)
    content = file.read(_MAX_HEADER)
    if not content.startswith(MAGIC) or content[len(MAGIC) : len(MAGIC) + 1] != bytes([_HEADER]) or not start:
        return False  # damaged, or without a summary: the library tells
    profile = text_at(content, len(MAGIC) + _HEAD.size)
    if profile == "ros2":
        return False
    encodings, topics = set(), []
    for at, kind, length in records(file, size, start):
        if kind == _CHANNEL:
            file.seek(at + _HEAD.size)
            body = file.read(length)
            topics.append(text_at(body, 4))
            encodings.add(text_at(body, 8 + len(topics[-1].encode())))
    if encodings <= {"json"}:
        return bool(encodings)
    known = {"json": "JSON", "protobuf": "Protobuf", "ros1": "ROS 1", "cdr": "CDR without the profile ros2"}
    named = listed(sorted(known.get(encoding, encoding) for encoding in encodings))
    raise fault(
        path,
        None,
        f"it is whole, but its messages are {named}, not those of ROS 2: {listed(sorted(topics), 10)}",
        "convert it: ros2 bag convert"
        if encodings == {"cdr"}
        else "give the .bag from which it was converted"
        if encodings == {"ros1"}
        else "write the movement as CSV with the header time,x,y,z, or record it as messages of ROS 2",
    )


def text_at(content: bytes, at: int) -> str:
    """Return the text at a place, behind its length."""
    (length,) = struct.unpack_from("<I", content, at)
    return content[at + 4 : at + 4 + length].decode(errors="replace")


def seal_mcap(path: Path) -> None:
    """Write the checksums of a file whose chunks are not compressed."""
    with open(path, "rb+") as file:
        size = file.seek(0, 2)
        places = list(records(file, size))
        for at, kind, length in places:
            if kind == _CHUNK:
                file.seek(at + _HEAD.size)
                body = file.read(length)
                # Times of the first and last message, size, checksum, compression, records with their size.
                (name,) = _CRC.unpack_from(body, 28)
                if name == 0:
                    file.seek(at + _HEAD.size + 24)
                    file.write(_CRC.pack(zlib.crc32(body[40:])))
        for at, kind, _ in places:
            if kind == _DATA_END:
                crc = _crc(file, 0, at)
                file.seek(at + _HEAD.size)
                file.write(_CRC.pack(crc))
        start, _ = _footer(file, size)
        end = size - len(MAGIC) - _CRC.size
        crc = _crc(file, start or end, end)
        file.seek(end)
        file.write(_CRC.pack(crc))


def records(file: IO[bytes], size: int, at: int = len(MAGIC)) -> Iterator[tuple[int, int, int]]:
    """Iterate over position, kind and length of complete records from `at`."""
    while at + _HEAD.size <= size - len(MAGIC):
        file.seek(at)
        kind, length = _HEAD.unpack(file.read(_HEAD.size))
        if at + _HEAD.size + length > size:
            return
        yield at, kind, length
        at += _HEAD.size + length


def _footer(file: IO[bytes], size: int) -> tuple[int, int]:
    """Return the position of the summary and its checksum; 0 if there is none."""
    file.seek(size - _TAIL)
    tail = file.read(_TAIL)
    start, _ = _STARTS.unpack_from(tail, _HEAD.size)
    (crc,) = _CRC.unpack_from(tail, _HEAD.size + _STARTS.size)
    return (start, crc) if tail[0] == _FOOTER else (0, 0)


def _crc(file: IO[bytes], start: int, end: int) -> int:
    file.seek(start)
    crc, left = 0, end - start
    while left > 0 and (part := file.read(min(left, 2**20))):
        crc, left = zlib.crc32(part, crc), left - len(part)
    return crc


def _damaged(path: Path, what: str) -> DemonstrationError:
    return fault(
        path, None, f"{what} has another checksum than the file says", "copy it again: it is damaged"
    )
