"""The paper, reproduced: runs -> pictures, tables and claims -> one page."""

from comove.experiments.paper.reproduce import reproduce

__all__ = ["reproduce"]
