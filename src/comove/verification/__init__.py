"""Checks and the continuous-time certificate; knows no optimiser and no planner."""

from comove.verification.verify import Check, Report, Verdict, VerifiedMotion, verify

__all__ = ["Check", "Report", "Verdict", "VerifiedMotion", "verify"]
