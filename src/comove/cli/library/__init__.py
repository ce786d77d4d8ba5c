"""The verbs of `comove library`, one short file each."""

from comove.cli.library import add, combine, find, list, remove, show

__all__ = ["add", "combine", "find", "list", "remove", "show"]
