"""The verbs of `comove bench`, one short file each."""

from comove.cli.bench import ablation, draw, export, report, run, scaling

__all__ = ["ablation", "draw", "export", "report", "run", "scaling"]
