"""The kinematic graph of a robot, and the matrices that graph convolutions multiply by.

Stage two of the data flow. NumPy, except for the conversions to other libraries. Symbols used throughout the library:

* ``N``: nodes of the graph, ``F``: features of a node (per frame times frames), ``A``: actions, ``J``: joints,
* ``*``: any number of leading (batch) dimensions.

Sources: Phan Bui et al. 2022 (GCTD3), equations 1 to 7; Kipf and Welling 2017 (arXiv:1609.02907).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from gctd3.errors import RobotError
from gctd3.robots.floating_base import Axis
from gctd3.robots.nodes import GROUND as GROUND
from gctd3.robots.nodes import PRESETS as PRESETS
from gctd3.robots.nodes import adjacency_of, read_adjacency, read_nodes
from gctd3.robots.robot import Robot

if TYPE_CHECKING:
    from torch import Tensor


@dataclass(frozen=True, eq=False)
class KinematicGraph:
    """Represent a robot as a graph of named nodes and the adjacency between them.

    Build it with :meth:`from_mjcf` or :meth:`from_robot`; the constructor takes any named graph.

    Attributes:
        nodes: Names; for a robot: root body, other coordinates of its base, joints by depth (equal depths in the
            MJCF's order), ground; see :mod:`gctd3.robots.nodes`.
        adjacency: ``A``, shape ``[N, N]``, zeros and ones, no self-loops. ``A[i, j] = 1`` if node ``i`` aggregates
            node ``j``; symmetric for an undirected graph.
        mirror: For each node the index of the node on the other side of the robot (its own if it has none).
        kinds: For each node ``root``, ``base``, ``hinge``, ``slide``, ``ball`` or ``ground``; empty if not a robot's.
        parents: For each node, names of those above it in the kinematic tree; empty if not a robot's.
        actuated: For each action the index of the node that it moves; empty if the actions are unknown.

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
    kinds: tuple[str, ...] = ()
    parents: tuple[tuple[str, ...], ...] = ()
    actuated: tuple[int, ...] = ()

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
    def from_mjcf(
        cls,
        source: str | Path | mujoco.MjModel | mujoco.MjSpec,
        preset: str = "tree",
        seed: int = 0,
        feet: Sequence[str] | None = None,
        forward: Axis | None = None,
    ) -> KinematicGraph:
        """Build the graph of any robot: an MJCF file, a model in memory, or one shipped with the library (``"biped"``).

        Args:
            source: The robot; its joints may be of any kind and driven by anything.
            preset: See :meth:`from_robot`.
            seed: See :meth:`from_robot`.
            feet: Names of the bodies (or of their geoms) that may touch the ground; see :func:`.find_feet` if ``None``.
            forward: Forward direction: ``x``, ``-x``, ``y`` or ``-y``; see :func:`.find_forward` if ``None``.

        Raises:
            RobotError: If the source is not a robot, or the preset is unknown.
        """
        return cls.from_robot(Robot.from_mjcf(source, feet, forward), preset, seed)

    @classmethod
    def from_robot(cls, robot: Robot, preset: str = "tree", seed: int = 0) -> KinematicGraph:
        """Build the graph of a robot.

        Args:
            robot: The robot.
            preset: ``tree``: root to joints along the kinematic tree, every foot's last joint to the ground, undirected
                (the paper's Figure 2). ``authors``: the released script's: each joint aggregates its parent, the hips
                one another, the ground nothing. ``edgeless``: no edge. ``complete``: every pair. ``random``: as many
                undirected edges as ``tree``, drawn with ``seed``.
            seed: Seed of ``random``.

        Raises:
            RobotError: If the preset is unknown.
        """
        nodes = read_nodes(robot)
        names = tuple(node.name for node in nodes)
        mirror = tuple(names.index(node.mirror) for node in nodes)
        kinds, parents = tuple(node.kind for node in nodes), tuple(node.parents for node in nodes)
        actuated = tuple(names.index(name) for name in robot.actuated)
        return cls(names, read_adjacency(nodes, preset, seed), mirror, kinds, parents, actuated)

    @classmethod
    def from_edges(
        cls,
        nodes: Sequence[str],
        edges: Sequence[tuple[str, str]],
        directed: bool = False,
        actuated: Sequence[str] = (),
    ) -> KinematicGraph:
        """Build a graph from its edges: ``(i, j)`` sets ``A[i, j]``, and ``A[j, i]`` too unless ``directed``.

        Args:
            nodes: Names.
            edges: Pairs of names.
            directed: Whether ``(i, j)`` lets only ``i`` aggregate ``j``.
            actuated: For each action the name of the node that it moves.

        Raises:
            RobotError: If an edge or an action names no node, or an edge joins a node to itself.
        """
        for what, names in (("an edge", {name for edge in edges for name in edge}), ("an action", set(actuated))):
            if unknown := sorted(names - set(nodes)):
                raise RobotError(f"No node {', '.join(unknown)} for {what}: the nodes are {', '.join(nodes)}.")
        order = tuple(nodes.index(name) for name in actuated)
        return cls(tuple(nodes), adjacency_of(nodes, edges, directed), actuated=order)

    # Nodes and edges.

    @property
    def num_nodes(self) -> int:
        """Return the number of nodes ``N``."""
        return len(self.nodes)

    @property
    def directed(self) -> bool:
        """Tell whether some edge has no counterpart."""
        return not np.array_equal(self.adjacency, self.adjacency.T)

    @property
    def edges(self) -> tuple[tuple[str, str], ...]:
        """Return the edges as pairs of names; of an undirected graph each edge once."""
        pairs = np.argwhere(self.adjacency if self.directed else np.triu(self.adjacency))
        return tuple((self.nodes[i], self.nodes[j]) for i, j in pairs)

    # Matrices by which networks multiply.

    @cached_property
    def normalized_adjacency(self) -> np.ndarray:
        r"""Return :math:`\hat D^{-1/2} \hat A \hat D^{-1/2}`, :math:`\hat A = A + I` (equation 7). Shape ``[N, N]``."""
        return _symmetric_normalize(self.adjacency + np.eye(self.num_nodes))

    @cached_property
    def laplacian(self) -> np.ndarray:
        r"""Return :math:`\Delta = I - D^{-1/2} A D^{-1/2}` (section 2.1). Shape ``[N, N]``; isolated nodes keep 1."""
        return np.eye(self.num_nodes) - _symmetric_normalize(self.adjacency)

    def scaled_laplacian(self, largest_eigenvalue: float | None = None) -> np.ndarray:
        r"""Scale the Laplacian to eigenvalues in [-1, 1] (below equation 4).

        :math:`\tilde\Delta = (2 / \lambda_{max}) \Delta - I`.

        Args:
            largest_eigenvalue: :math:`\lambda_{max}`; computed if ``None``. The paper's derivation sets it to 2.
        """
        largest = largest_eigenvalue
        if largest is None:
            largest = float(np.abs(np.linalg.eigvals(self.laplacian)).max())
        return 2.0 / largest * self.laplacian - np.eye(self.num_nodes)

    def chebyshev(self, order: int, largest_eigenvalue: float | None = None) -> np.ndarray:
        r"""Compute the Chebyshev polynomials of the scaled Laplacian (equation 4). Shape ``[K + 1, N, N]``.

        :math:`T_0(\tilde\Delta), \dots, T_K(\tilde\Delta)` with the order :math:`K`.

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

    # For other libraries and for people.

    def edge_index(self) -> Tensor:
        """Return the edges for torch_geometric: sources over targets, an undirected edge both ways. ``int64 [2, E]``.

        Example:
            >>> KinematicGraph.from_edges(["a", "b"], [("a", "b")]).edge_index().tolist()
            [[1, 0], [0, 1]]
        """
        import torch  # late: a graph needs it for nothing else

        # A[i, j]: node i takes in node j, so j is the source.
        return torch.from_numpy(np.ascontiguousarray(np.argwhere(self.adjacency).T[::-1], dtype=np.int64))

    def to_networkx(self) -> Any:  # noqa: ANN401 - networkx is optional
        """Convert to a ``networkx.Graph`` (``DiGraph``, source to target, if directed) with nodes' kinds and mirrors.

        Raises:
            ImportError: If networkx is not installed.
        """
        try:
            networkx = import_module("networkx")
        except ImportError as error:
            raise ImportError("to_networkx needs networkx: pip install 'gctd3[networkx]'.") from error
        graph = networkx.DiGraph() if self.directed else networkx.Graph()
        for i, name in enumerate(self.nodes):
            graph.add_node(name, kind=self.kinds[i] if self.kinds else "", mirror=self.nodes[self.mirror[i]])
        graph.add_edges_from((b, a) for a, b in self.edges)
        return graph

    def __repr__(self) -> str:
        shown = ", ".join(self.nodes[:8]) + (", ..." if self.num_nodes > 8 else "")
        return f"KinematicGraph({self.num_nodes} nodes, {len(self.edges)} edges: {shown})"

    def __str__(self) -> str:
        arrow = " <- " if self.directed else " -- "
        header = ("#", "node", "kind", "parent", "mirror")
        rows = [header]
        for i, name in enumerate(self.nodes):
            kind, parents = (self.kinds[i], ", ".join(self.parents[i])) if self.kinds else ("", "")
            rows.append((str(i), name, kind, parents, self.nodes[self.mirror[i]] if self.mirror[i] != i else ""))
        columns = [c for c, cells in enumerate(zip(*rows[1:], strict=True)) if any(cells)]
        widths = [max(len(row[c]) for row in rows) for c in columns]
        table = ["  ".join(row[c].ljust(w) for c, w in zip(columns, widths, strict=True)).rstrip() for row in rows]
        lines = [f"{self.num_nodes} nodes, {len(self.edges)} edges", "", *table, ""]
        return "\n".join([*lines, *(f"{a}{arrow}{b}" for a, b in self.edges)]).rstrip()


def _symmetric_normalize(matrix: np.ndarray) -> np.ndarray:
    """Compute ``D^-1/2 M D^-1/2`` with ``D`` the row sums of ``M``; rows that sum to zero stay zero."""
    degree = matrix.sum(axis=1)
    scale = np.where(degree > 0, 1.0 / np.sqrt(np.maximum(degree, 1e-12)), 0.0)
    return scale[:, None] * matrix * scale[None, :]
