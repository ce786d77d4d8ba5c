"""The outline of a robot's arms about a resting payload, as capsules."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from comove.arrays import Array, Integers
from comove.contacts.displaced import RESTING
from comove.model.scene import Scene
from comove.robots.model import Robot
from comove.robots.search.chains import Chains, chains_of
from comove.robots.search.links import (
    STATIC,
    Links,
    LinkSurroundings,
    all_links,
    clearances_at,
    links_near,
    load_lines,
    pair_distances,
)


@dataclass(frozen=True, eq=False)
class Outline:
    """The arms as capsules, which classify configurations as free or blocked.

    Attributes
    ----------
    chains, links, around : the arms and their surroundings, for kernels
    columns : array, shape (n_moving,), joints of the robot in the chains' order
    nodes : array, shape (n_nodes, 3), the resting payload's keypoints [m]
    bodies : name of the body that each link is of
    names : names of both bodies of each pair of links
    untold : names of both bodies of pairs without information
    """

    chains: Chains
    links: Links
    around: LinkSurroundings
    columns: Integers
    nodes: Array
    bodies: list[str]
    names: list[frozenset[str]]
    untold: frozenset[frozenset[str]]

    @classmethod
    def between(
        cls, robot: Robot, scene: Scene, ends: Array, nodes: Array | None, *, keep: float, eased: float
    ) -> Outline:
        """Return the outline of all arms for paths between two configurations.

        Pairs of links whose capsules are nearer than `keep` [m] at one of them are left out.

        Parameters
        ----------
        ends : array, shape (2, n_joints)
        nodes : the resting payload's keypoints, None without one
        eased : reduction of the required clearance between links [m]
        """
        arms, items = robot.arms, robot.collision.geometryObjects
        chains, columns = chains_of(robot, arms), np.concatenate([arm.columns for arm in arms])
        links, body = all_links(robot, arms)
        near = pair_distances(chains, links, np.ascontiguousarray(ends[:, columns])) < keep
        names = [frozenset(items[k].name for k in pair) for pair in body[links.pairs].tolist()]
        untold = frozenset(name for name, is_near in zip(names, near, strict=True) if is_near)
        told = np.array([name not in untold for name in names], dtype=bool)
        still = links.joint == STATIC  # which a load that lies still may touch
        links = links.some(told)._replace(holds=still)
        edges, radii = load_lines(scene)
        if nodes is None:
            edges, radii, nodes = edges[:0], radii[:0], np.zeros((1, 3))
        around = LinkSurroundings(scene.obstacles, edges, radii, scene.clearance, eased)
        return cls(
            chains=chains,
            links=links,
            around=around,
            columns=columns,
            nodes=nodes,
            bodies=[items[k].name for k in body.tolist()],
            names=[name for name in names if name not in untold],
            untold=untold,
        )

    def clearances(self, q: Array, enough: float, blocked: float) -> Array:
        """Compute the capsules' least distances up to a blocked configuration. It is the first not above `blocked`.

        Parameters
        ----------
        q : array, shape (n_configurations, n_joints)
        enough : distance above which distances are not told apart [m]

        Returns
        -------
        array, shape (n_configurations,) [m]; -inf from the blocked configuration on
        """
        of_arms = np.ascontiguousarray(q[:, self.columns])
        arms = self.chains, self.links, self.around
        return clearances_at(*arms, RESTING, of_arms, self.nodes, enough, blocked)

    def near(self, q: Array, enough: float) -> tuple[frozenset[str], set[frozenset[str]]]:
        """Return bodies near obstacles or payload, and pairs of near bodies. Near is within `enough` [m]."""
        of_arms = np.ascontiguousarray(q[None, self.columns])
        about = links_near(self.chains, self.links, self.around, of_arms[0], self.nodes, enough)
        pairs = pair_distances(self.chains, self.links, of_arms) < enough
        return (
            frozenset(self.bodies[k] for k in np.flatnonzero(about)),
            {self.names[k] for k in np.flatnonzero(pairs)},
        )
