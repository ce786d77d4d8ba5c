"""Formats of recordings, one module each, and their register."""

from typing import TYPE_CHECKING

from comove._doors import lazily

if TYPE_CHECKING:
    from comove.dmp.demonstrations.formats.register import (
        FORMATS as FORMATS,
        chosen_name as chosen_name,
        format_of as format_of,
        is_format as is_format,
        load as load,
        load_recordings as load_recordings,
        select as select,
        write as write,
    )

__all__, __getattr__, __dir__ = lazily(
    __name__,
    {
        "dmp.demonstrations.formats.register": [
            "FORMATS",
            "chosen_name",
            "format_of",
            "is_format",
            "load",
            "load_recordings",
            "select",
            "write",
        ]
    },
)
