"""Table of the node features of one robot, from which everything that depends on them is derived.

The observation, its reflection in the mirror, the exported contract, sensor noise and evaluation read this table.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gctd3.errors import ConfigError, suggest
from gctd3.robots.graph import KinematicGraph
from gctd3.robots.robot import Robot
from gctd3.tasks.features import KINDS, QUANTITIES, NodeFeature, Reading, Sensed
from gctd3.tasks.term_checks import called, reading


class FeatureTable:
    """Compose the features of one robot, and assign their numbers to its nodes.

    Numbers of several features of one kind of node follow one another; nodes with fewer numbers are padded with zeros.

    Args:
        features: Features by name, in order.
        robot: The robot.
        graph: The robot's graph, of which only the nodes are used.
        key: Key of the features, for messages.

    Attributes:
        width: ``F``, features of a node in one frame.
        readings: Readings of each node, a row of ``F``; ``None`` for a number that is always 0.

    Raises:
        ConfigError: If a feature has an unknown kind, does not name as many readings for each of its nodes, or no node
            has a feature.
    """

    def __init__(
        self, features: Mapping[str, NodeFeature], robot: Robot, graph: KinematicGraph, key: str = "task.features"
    ) -> None:
        self.graph, self.robot, self.key = graph, robot, key
        kinds = [kind if kind in KINDS else "joint" for kind in graph.kinds]
        filled = dict.fromkeys(KINDS, 0)
        self._placed: list[tuple[str, NodeFeature, list[int], int, int]] = []
        rows: list[list[Reading | None]] = [[] for _ in kinds]
        owners: dict[str, str] = {}
        for name, feature in features.items():
            where, asked = f"{key}.{name}", getattr(feature, "kind", None)
            if asked not in KINDS:
                raise ConfigError(f"{where}: there are no nodes of kind {asked!r}; kinds: {', '.join(KINDS)}.")
            nodes = [i for i, kind in enumerate(kinds) if kind == asked]
            if not nodes:
                continue
            readings = called(where, feature.readings, robot, tuple(graph.nodes[i] for i in nodes))
            _check_readings(where, readings, len(nodes))
            width, start = len(readings[0]), filled[asked]
            filled[asked] += width
            self._placed.append((name, feature, nodes, start, width))
            for node, row in zip(nodes, readings, strict=True):
                rows[node] += row
                _own(where, row, owners)
        self.width = max(map(len, rows))
        if not self.width:
            raise ConfigError(f"{key} must hold at least one feature that a node of the robot has, got none.")
        self.readings = [row + [None] * (self.width - len(row)) for row in rows]
        self._read = np.flatnonzero([one is not None for row in self.readings for one in row])

    def __call__(self, sensed: Sensed) -> np.ndarray:
        """Return the features of every node in one frame (section 2.3), ``float32 [*, N, F]``."""
        numbers = np.zeros((*sensed.now.position.shape, self.graph.num_nodes, self.width), dtype=np.float32)
        for name, feature, nodes, start, width in self._placed:
            values = called(f"{self.key}.{name}", feature, sensed)
            # Nodes of a kind follow one another.
            numbers[..., nodes[0] : nodes[-1] + 1, start : start + width] = values
        return numbers

    def named(self, sensed: Sensed) -> dict[str, np.ndarray]:
        """Return the value of each reading by name, in its unit, ``float64 [*]``."""
        values: dict[str, np.ndarray] = {}
        for name, feature, nodes, start, _ in self._placed:
            numbers = np.asarray(called(f"{self.key}.{name}", feature, sensed), dtype=np.float64)
            for i, node in enumerate(nodes):
                for k in range(numbers.shape[-1]):
                    one = self.readings[node][start + k]
                    if one is not None:
                        values[one.name] = numbers[..., i, k] + one.zero
        return values

    def place(self, reading: str) -> tuple[int, int]:
        """Return the node and the number of a reading.

        Raises:
            KeyError: If no feature has a reading of this name.
        """
        for node, row in enumerate(self.readings):
            for number, one in enumerate(row):
                if one is not None and one.name == reading:
                    return node, number
        raise KeyError(reading)

    def flat(self, sensed: Sensed) -> np.ndarray:
        """Return the numbers with a reading, node after node, ``float32 [*, K]``."""
        values = self(sensed)
        return values.reshape(*values.shape[:-2], -1)[..., self._read]

    def flat_reflection(self) -> tuple[np.ndarray, np.ndarray]:
        """Return source and sign, each ``[K]``: ``sign * flat[..., source]`` is the mirrored robot's :meth:`flat`."""
        source, sign = self.reflection()
        place = np.full(len(source), -1)
        place[self._read] = np.arange(len(self._read))
        return place[source[self._read]], sign[self._read]

    def check(self, sensed: Sensed) -> None:
        """Raise a :class:`.ConfigError` unless every feature returns finite numbers of the declared shape."""
        for name, feature, nodes, _, width in self._placed:
            values = np.asarray(reading(f"{self.key}.{name}", feature, sensed.memory, sensed))
            expected = (*sensed.now.position.shape, len(nodes), width)
            if values.shape != expected or not np.isfinite(values).all():
                raise ConfigError(
                    f"{self.key}.{name} must return finite numbers of shape {list(expected)}, got "
                    f"{list(values.shape)} {values.dtype}."
                )

    def reflection(self) -> tuple[np.ndarray, np.ndarray]:
        """Return source and sign, each ``[N * F]``: ``sign * frame[source]`` is the mirrored robot's frame."""
        graph, width = self.graph, self.width
        source = np.arange(graph.num_nodes * width).reshape(graph.num_nodes, width)[list(graph.mirror)]
        sign = np.ones(source.shape)
        for _, feature, nodes, start, count in self._placed:
            places = feature.mirror_places(self.robot, tuple(graph.nodes[i] for i in nodes))
            if places is not None:
                node, number = np.moveaxis(places, -1, 0)
                source[nodes, start : start + count] = (node + nodes[0]) * width + start + number
        for i, row in enumerate(self.readings):
            for k, one in enumerate(row):
                sign[i, k] = 1.0 if one is None else one.sign
        return source.reshape(-1), sign.reshape(-1)

    def own_deviations(self) -> np.ndarray:
        """Return the standard deviation of each number's own error in a frame, shape ``[N, F]``."""
        deviations = np.zeros((self.graph.num_nodes, self.width))
        for _, feature, nodes, start, width in self._placed:
            deviations[nodes, start : start + width] = feature.deviation()
        return deviations

    def encoders(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Locate the joints' angles: node, number and index among ``robot.joints`` of each, integers ``[K]``."""
        names = {joint.name: i for i, joint in enumerate(self.robot.joints)}
        found = [
            (node, number, names[name])
            for node, name in enumerate(self.graph.nodes)
            for number, one in enumerate(self.readings[node])
            if one is not None and one.quantity == "angle" and name in names
        ]
        node, number, joint = np.array(found, dtype=np.int64).reshape(-1, 3).T
        return node, number, joint

    def deviations(self, errors: Mapping[str, float]) -> np.ndarray:
        """Return the standard deviation of each number's error in a frame, shape ``[N, F]``.

        Args:
            errors: Standard deviation of each quantity's error; 0 for a quantity that is missing.
        """
        return np.array([[0.0 if r is None else errors.get(r.quantity, 0.0) for r in row] for row in self.readings])


def _check_readings(where: str, readings: object, nodes: int) -> None:
    """Raise a :class:`.ConfigError` unless a feature names as many readings of known quantities for each node."""
    sequence = readings if isinstance(readings, Sequence) else ()
    rows = [list(row) for row in sequence if isinstance(row, Sequence)]
    known = all(one is None or isinstance(one, Reading) for row in rows for one in row)
    if len(rows) != nodes or len({len(row) for row in rows}) != 1 or not known:
        raise ConfigError(f"{where} must say as many readings for each of {nodes} nodes, got {readings!r}.")
    for one in (one for row in rows for one in row if one is not None):
        if one.quantity not in QUANTITIES:
            raise ConfigError(
                f"{where}: the reading {one.name!r} has the quantity {one.quantity!r}, for which there is no sensor "
                f"noise.{suggest(one.quantity, QUANTITIES)} Quantities: {', '.join(QUANTITIES)}."
            )


def _own(feature: str, row: Sequence[Reading | None], owners: dict[str, str]) -> None:
    """Raise a :class:`.ConfigError` if a reading has the name of an earlier one: the robot knows them by name."""
    for one in row:
        if one is not None and one.name in owners:
            raise ConfigError(
                f"{feature} has a reading {one.name!r}, and so has {owners[one.name]}: "
                "each reading needs a name of its own."
            )
        if one is not None:
            owners[one.name] = feature
