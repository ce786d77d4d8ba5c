"""Descriptions suggested by URDFs, their examination, and a first scene."""

from comove.robots.proposal.bodies import scene_of
from comove.robots.proposal.examination import ArmFindings, Examination, examine
from comove.robots.proposal.first_scene import SceneProposal, propose_scene
from comove.robots.proposal.proposal import Proposal, propose

__all__ = [
    "ArmFindings",
    "Examination",
    "Proposal",
    "SceneProposal",
    "examine",
    "propose",
    "propose_scene",
    "scene_of",
]
