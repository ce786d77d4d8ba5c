"""The reproduction of the paper: runs, then pictures, tables and claims, then one page."""

from comove.experiments.paper.reproduction import reproduce

__all__ = ["reproduce"]
