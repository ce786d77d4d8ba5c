"""A reader of XML that is safe against hostile files: no document type, limited depth, limited number of elements.

Namespaces are not resolved: names are kept as they are written, as in ``drake:acceleration``. So prefixes need not be
declared, which many robot models omit.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from typing import Any
from xml.parsers import expat

from comove.errors import MeshError

MAX_DEPTH = 64  # levels of elements
MAX_ELEMENTS = 300_000
MAX_ATTRIBUTES = 64  # of one element


def elements_of(data: bytes) -> ET.Element:
    """Return the root element of a document; names keep their prefixes.

    Raises
    ------
    MeshError
        If it is not XML, has a document type, or exceeds a limit of size.
    """
    builder, parser = _Builder(), expat.ParserCreate()
    parser.buffer_text = True
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
    parser.CharacterDataHandler, parser.StartDoctypeDeclHandler = builder.data, _refuse_doctype
    try:
        parser.Parse(data, True)
        return builder.close()
    except expat.ExpatError as error:
        raise MeshError(f"it is not XML: {error}", way_out="correct it") from None
    except (ValueError, LookupError) as error:  # an encoding that is not known
        raise MeshError(f"it cannot be read: {error}", way_out="write it in UTF-8") from None


def _refuse_doctype(*_: Any) -> None:
    """Refuse a document type, in which entities would be defined."""
    raise MeshError("it has a document type (<!DOCTYPE>)", way_out="leave it out, and write entities out")


class _Builder(ET.TreeBuilder):
    """A builder of trees of limited size."""

    depth = n_elements = 0

    def start(self, tag: Any, attributes: Any) -> ET.Element:
        """Open an element, and refuse it where a limit is exceeded."""
        self.depth += 1
        self.n_elements += 1
        if self.depth > MAX_DEPTH:
            raise MeshError(f"the nesting is deeper than {MAX_DEPTH} levels", way_out="flatten it")
        if self.n_elements > MAX_ELEMENTS:
            raise MeshError(
                f"it has more than {MAX_ELEMENTS} elements", way_out="leave out what is not needed"
            )
        if len(attributes) > MAX_ATTRIBUTES:
            raise MeshError(
                f"an element has {len(attributes)} attributes", way_out=f"write at most {MAX_ATTRIBUTES}"
            )
        return super().start(tag, attributes)

    def end(self, tag: Any) -> ET.Element:
        """Close an element."""
        self.depth -= 1
        return super().end(tag)
