"""`comove robot`: one short file a verb."""

from comove.cli.robot import export, send, simulate, solve

__all__ = ["export", "send", "simulate", "solve"]
