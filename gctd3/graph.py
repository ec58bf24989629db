"""The kinematic graph of a robot, and the matrices that graph convolutions multiply by.

Stage two of the data flow. Pure NumPy. Symbols used throughout the library:

* ``N``: nodes of the graph, ``F``: features of a node (per frame times frames), ``A``: actions, ``J``: joints,
* ``*``: any number of leading (batch) dimensions.

Sources: Phan Bui et al. 2022 (GCTD3), equations 1 to 7; Kipf and Welling 2017 (arXiv:1609.02907).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from gctd3.errors import RobotError
from gctd3.robot import Robot

GROUND = "ground"
PRESETS = ("tree", "authors", "edgeless", "complete", "random")


@dataclass(frozen=True, eq=False)
class KinematicGraph:
    """Named nodes and the adjacency between them.

    Build it with :meth:`from_mjcf` or :meth:`from_robot`; the constructor takes any named graph.

    Attributes:
        nodes: Names; a robot's are its root body, its joints by depth (equal depths in the MJCF's order), the ground.
        adjacency: ``A``, shape ``[N, N]``, zeros and ones, no self-loops. ``A[i, j] = 1`` if node ``i`` takes in
            node ``j``; symmetric for an undirected graph.
        mirror: For each node the index of the node on the other side of the robot (its own if it has none).

    Example:
        >>> graph = KinematicGraph.from_mjcf("biped")
        >>> graph.nodes[:3]
        ('body', 'hip_right', 'hip_left')
        >>> graph.edges[0]
        ('body', 'hip_right')
    """

    nodes: tuple[str, ...]
    adjacency: np.ndarray
    mirror: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        n = len(self.nodes)
        if self.adjacency.shape != (n, n):
            raise RobotError(f"The adjacency of {n} nodes must have shape ({n}, {n}), got {self.adjacency.shape}.")
        if len(set(self.nodes)) != n:
            raise RobotError(f"Node names must differ, got {', '.join(self.nodes)}.")
        if np.diag(self.adjacency).any() or not np.isin(self.adjacency, (0, 1)).all():
            raise RobotError("An adjacency holds zeros and ones, and zeros on its diagonal.")
        if not self.mirror:
            object.__setattr__(self, "mirror", tuple(range(n)))

    # Construction.

    @classmethod
    def from_mjcf(cls, path: str | Path, preset: str = "tree", seed: int = 0) -> KinematicGraph:
        """The graph of the robot in an MJCF file, or of one that ships with the library (``"biped"``).

        Raises:
            RobotError: If the file is not a robot, or the preset is unknown.
        """
        return cls.from_robot(Robot.from_mjcf(path), preset, seed)

    @classmethod
    def from_robot(cls, robot: Robot, preset: str = "tree", seed: int = 0) -> KinematicGraph:
        """The graph of a robot.

        Args:
            robot: The robot.
            preset: ``tree``: root to joints along the kinematic tree, every foot's last joint to the ground, undirected
                (the paper's Figure 2). ``authors``: the released script's, see :func:`_authors`. ``edgeless``: no edge.
                ``complete``: every pair. ``random``: as many undirected edges as ``tree``, drawn with ``seed``.
            seed: For ``random``.

        Raises:
            RobotError: If the preset is unknown.
        """
        nodes = _nodes(robot)
        tree = _tree(robot, nodes)
        if preset == "tree":
            adjacency = tree
        elif preset == "authors":
            adjacency = _authors(robot, nodes)
        elif preset == "edgeless":
            adjacency = np.zeros_like(tree)
        elif preset == "complete":
            adjacency = np.ones_like(tree) - np.eye(len(nodes))
        elif preset == "random":
            adjacency = _random(len(nodes), int(tree.sum()) // 2, seed)
        else:
            raise RobotError(f"No graph preset {preset!r}: expected one of {', '.join(PRESETS)}.")
        mirror = tuple(nodes.index(n) if n == GROUND else nodes.index(robot.mirror_name(n)) for n in nodes)
        return cls(tuple(nodes), adjacency, mirror)

    @classmethod
    def from_edges(
        cls, nodes: Sequence[str], edges: Sequence[tuple[str, str]], directed: bool = False
    ) -> KinematicGraph:
        """A graph from its edges: ``(i, j)`` sets ``A[i, j]``, and ``A[j, i]`` too unless ``directed``.

        Raises:
            RobotError: If an edge names no node, or joins a node to itself.
        """
        unknown = sorted({name for edge in edges for name in edge} - set(nodes))
        if unknown:
            raise RobotError(f"No node {', '.join(unknown)} for an edge: the nodes are {', '.join(nodes)}.")
        adjacency = np.zeros((len(nodes), len(nodes)))
        for i, j in ((nodes.index(a), nodes.index(b)) for a, b in edges):
            adjacency[i, j] = 1.0
            if not directed:
                adjacency[j, i] = 1.0
        return cls(tuple(nodes), adjacency)

    # What it is made of.

    @property
    def num_nodes(self) -> int:
        """``N``."""
        return len(self.nodes)

    @property
    def directed(self) -> bool:
        """Whether some edge has no counterpart."""
        return not np.array_equal(self.adjacency, self.adjacency.T)

    @property
    def edges(self) -> tuple[tuple[str, str], ...]:
        """Pairs of names; of an undirected graph each edge once."""
        pairs = np.argwhere(self.adjacency if self.directed else np.triu(self.adjacency))
        return tuple((self.nodes[i], self.nodes[j]) for i, j in pairs)

    # What networks multiply by.

    @cached_property
    def normalized_adjacency(self) -> np.ndarray:
        r""":math:`\hat D^{-1/2} \hat A \hat D^{-1/2}` with :math:`\hat A = A + I` (equation 7). Shape ``[N, N]``."""
        return _symmetric_normalize(self.adjacency + np.eye(self.num_nodes))

    @cached_property
    def laplacian(self) -> np.ndarray:
        r""":math:`\Delta = I - D^{-1/2} A D^{-1/2}` (section 2.1). Shape ``[N, N]``; isolated nodes keep the 1."""
        return np.eye(self.num_nodes) - _symmetric_normalize(self.adjacency)

    def scaled_laplacian(self, largest_eigenvalue: float | None = None) -> np.ndarray:
        r""":math:`\tilde\Delta = (2 / \lambda_{max}) \Delta - I`, eigenvalues in [-1, 1] (below equation 4).

        Args:
            largest_eigenvalue: :math:`\lambda_{max}`; computed if ``None``. The paper's derivation sets it to 2.
        """
        largest = largest_eigenvalue
        if largest is None:
            largest = float(np.abs(np.linalg.eigvals(self.laplacian)).max())
        return 2.0 / largest * self.laplacian - np.eye(self.num_nodes)

    def chebyshev(self, order: int, largest_eigenvalue: float | None = None) -> np.ndarray:
        r""":math:`T_0(\tilde\Delta), \dots, T_K(\tilde\Delta)` (equation 4). Shape ``[K + 1, N, N]``.

        Raises:
            ValueError: If ``order`` is negative.
        """
        if order < 0:
            raise ValueError(f"The order of a Chebyshev expansion must be at least 0, got {order}.")
        scaled = self.scaled_laplacian(largest_eigenvalue)
        terms = [np.eye(self.num_nodes), scaled]
        for _ in range(2, order + 1):
            terms.append(2.0 * scaled @ terms[-1] - terms[-2])
        return np.stack(terms[: order + 1])

    def __str__(self) -> str:
        arrow = " <- " if self.directed else " -- "
        lines = [f"{self.num_nodes} nodes: {', '.join(self.nodes)}"]
        lines += [f"  {a}{arrow}{b}" for a, b in self.edges]
        return "\n".join(lines)


def _symmetric_normalize(matrix: np.ndarray) -> np.ndarray:
    """``D^-1/2 M D^-1/2`` with ``D`` the row sums of ``M``; rows that sum to zero stay zero."""
    degree = matrix.sum(axis=1)
    scale = np.where(degree > 0, 1.0 / np.sqrt(np.maximum(degree, 1e-12)), 0.0)
    return scale[:, None] * matrix * scale[None, :]


def _nodes(robot: Robot) -> list[str]:
    depth: dict[str, int] = {}
    for joint in robot.joints:
        depth[joint.name] = depth[joint.parent] + 1 if joint.parent else 1
    return [robot.root, *sorted(depth, key=depth.__getitem__), GROUND]


def _tree(robot: Robot, nodes: Sequence[str]) -> np.ndarray:
    edges = [(joint.parent or robot.root, joint.name) for joint in robot.joints]
    edges += [(leg[-1].name if leg else robot.root, GROUND) for leg in robot.legs]
    return KinematicGraph.from_edges(list(nodes), edges).adjacency


def _authors(robot: Robot, nodes: Sequence[str]) -> np.ndarray:
    """Each joint takes in its parent, the hips one another, the ground is joined to nothing (released script)."""
    edges = [(joint.name, joint.parent or robot.root) for joint in robot.joints]
    hips = [joint.name for joint in robot.joints if joint.parent is None]
    edges += [(a, b) for a in hips for b in hips if a != b]
    return KinematicGraph.from_edges(list(nodes), edges, directed=True).adjacency


def _random(num_nodes: int, num_edges: int, seed: int) -> np.ndarray:
    rows, columns = np.triu_indices(num_nodes, k=1)
    chosen = np.random.default_rng(seed).choice(len(rows), size=num_edges, replace=False)
    adjacency = np.zeros((num_nodes, num_nodes))
    adjacency[rows[chosen], columns[chosen]] = 1.0
    return adjacency + adjacency.T
