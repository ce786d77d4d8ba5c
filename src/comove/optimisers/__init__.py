"""Black-box optimisers; they know no robot."""

from comove.optimisers.separable import SeparableCMAES

__all__ = ["SeparableCMAES"]
