"""The command line. One short file a verb; the only place that maps names to objects."""

from comove.cli.app import main

__all__ = ["main"]
