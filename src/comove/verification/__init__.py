"""Motion checks and the continuous-time certificate, independent of optimisers and planners."""

from comove.verification.verify import Check, Report, Verdict, VerifiedMotion, verify

__all__ = ["Check", "Report", "Verdict", "VerifiedMotion", "verify"]
