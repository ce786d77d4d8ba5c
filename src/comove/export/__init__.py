"""Export: verified joint motions as files and messages that robots play."""

from comove.export.formats import FORMATS, Format, export
from comove.export.parts import ExportError, Part, Provenance, parts_of

__all__ = ["FORMATS", "ExportError", "Format", "Part", "Provenance", "export", "parts_of"]
