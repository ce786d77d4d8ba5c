"""The verbs of `comove robot`, one short file each."""

from comove.cli.robot import export, send, simulate, solve

__all__ = ["export", "send", "simulate", "solve"]
