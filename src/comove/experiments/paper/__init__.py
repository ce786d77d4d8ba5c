"""The paper, reproduced: runs -> pictures, tables and claims -> one page."""

from comove.experiments.paper.reproduction import reproduce

__all__ = ["reproduce"]
