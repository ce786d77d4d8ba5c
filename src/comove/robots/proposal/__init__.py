"""Descriptions that URDFs suggest, what can be said of them before anything is carried, and a first scene."""

from comove.robots.proposal.examination import ArmFindings, Examination, examine
from comove.robots.proposal.first_scene import SceneProposal, propose_scene
from comove.robots.proposal.proposal import Proposal, propose
from comove.robots.proposal.surroundings import scene_of

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
