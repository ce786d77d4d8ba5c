"""Command line: one short file per verb. Only these files map names on the command line to objects."""

import gc

__all__ = ["main"]


def main() -> None:
    """Run the `comove` command, which ends in a documented exit code."""
    gc.set_threshold(100_000)  # most objects are modules', also those of the application, and stay
    from comove.cli.app import main as run

    run()
