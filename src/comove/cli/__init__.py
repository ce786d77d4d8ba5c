"""Command line: one short file per verb. Only these files map names on the command line to objects."""

from comove.cli.app import main

__all__ = ["main"]
