"""What a result folder holds, verified anew against a trusted scene and robot, or against the folder's own."""

from typing import TYPE_CHECKING

from comove._doors import lazily

if TYPE_CHECKING:
    from comove.stored.parts import Part as Part, parts_of as parts_of
    from comove.stored.verification import (
        Verification as Verification,
        verify_folder as verify_folder,
        verify_part as verify_part,
    )

__all__, __getattr__, __dir__ = lazily(
    __name__,
    {
        "stored.parts": ["Part", "parts_of"],
        "stored.verification": ["Verification", "verify_folder", "verify_part"],
    },
)
