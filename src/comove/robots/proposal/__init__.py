"""Descriptions that URDFs suggest, and what can be said of a description before anything is carried."""

from comove.robots.proposal.examination import ArmFindings, Examination, examine
from comove.robots.proposal.proposal import Proposal, propose

__all__ = ["ArmFindings", "Examination", "Proposal", "examine", "propose"]
