"""`comove bench`: one short file a verb."""

from comove.cli.bench import draw, export, report, run, scaling

__all__ = ["draw", "export", "report", "run", "scaling"]
