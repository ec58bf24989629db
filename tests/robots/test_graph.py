"""The paper's two graphs and its equations 1 to 7 by hand, the presets, and the mirror."""

import numpy as np
import pytest
from numpy.polynomial.chebyshev import chebval

from gctd3 import KinematicGraph
from gctd3.errors import RobotError
from gctd3.robots.graph import PRESETS

NODES = ("body", "hip_right", "hip_left", "knee_right", "knee_left", "ankle_right", "ankle_left", "ground")

# Figure 2: body-hips, hip-knee, knee-ankle, ankle-ground.
PAPER = np.array(
    [
        # b hr hl kr kl ar al g
        [0, 1, 1, 0, 0, 0, 0, 0],  # body
        [1, 0, 0, 1, 0, 0, 0, 0],  # hip_right
        [1, 0, 0, 0, 1, 0, 0, 0],  # hip_left
        [0, 1, 0, 0, 0, 1, 0, 0],  # knee_right
        [0, 0, 1, 0, 0, 0, 1, 0],  # knee_left
        [0, 0, 0, 1, 0, 0, 0, 1],  # ankle_right
        [0, 0, 0, 0, 1, 0, 0, 1],  # ankle_left
        [0, 0, 0, 0, 0, 1, 1, 0],  # ground
    ],
    dtype=float,
)

# Equation 1, the seven nodes of Figure 1.
LETTERS = "ABCDEFG"
EQUATION_1 = np.array(
    [
        [0, 0, 1, 1, 0, 0, 0],
        [0, 0, 0, 0, 0, 0, 1],
        [1, 0, 0, 1, 0, 0, 1],
        [1, 0, 1, 0, 1, 0, 0],
        [0, 0, 0, 1, 0, 1, 0],
        [0, 0, 0, 0, 1, 0, 0],
        [0, 1, 1, 0, 0, 0, 0],
    ],
    dtype=float,
)


@pytest.fixture(scope="module")
def figure_1() -> KinematicGraph:
    return KinematicGraph.from_edges(LETTERS, [tuple(edge) for edge in ("AC", "AD", "BG", "CD", "CG", "DE", "EF")])


def random_graph(seed: int, num_nodes: int = 9) -> KinematicGraph:
    upper = np.triu(np.random.default_rng(seed).random((num_nodes, num_nodes)) < 0.3, k=1).astype(float)
    return KinematicGraph(tuple(f"n{i}" for i in range(num_nodes)), upper + upper.T)


# The paper's graphs.


def test_tree_of_the_biped_is_the_papers_graph(graph):
    assert graph.nodes == NODES
    np.testing.assert_array_equal(graph.adjacency, PAPER)
    assert not graph.directed and graph.num_nodes == 8
    assert set(graph.edges) == {
        ("body", "hip_right"),
        ("body", "hip_left"),
        ("hip_right", "knee_right"),
        ("hip_left", "knee_left"),
        ("knee_right", "ankle_right"),
        ("knee_left", "ankle_left"),
        ("ankle_right", "ground"),
        ("ankle_left", "ground"),
    }
    assert "body -- hip_right" in str(graph)


def test_equation_1_from_its_edges(figure_1):
    assert figure_1.nodes == tuple(LETTERS)
    np.testing.assert_array_equal(figure_1.adjacency, EQUATION_1)


def test_normalized_adjacency_of_the_biped_by_hand(graph):
    normalized = graph.normalized_adjacency
    body, hip, knee, ground = (NODES.index(n) for n in ("body", "hip_right", "knee_right", "ground"))
    # The paper's graph is a ring of eight: every node has two neighbours and itself, so every entry of D^ is 3.
    assert normalized[body, hip] == pytest.approx(1 / np.sqrt(3 * 3))
    assert normalized[body, body] == pytest.approx(1 / np.sqrt(3 * 3))
    assert normalized[body, knee] == normalized[body, ground] == 0.0
    np.testing.assert_allclose(normalized, (PAPER + np.eye(8)) / 3, atol=1e-15)


def test_normalized_adjacency_of_equation_1_by_hand(figure_1):
    normalized = figure_1.normalized_adjacency
    a, b, c, d, e, f, g = range(7)
    # Neighbours and itself: A 3, B 2, C 4, D 4, E 3, F 2, G 3.
    expected = {
        (a, a): 1 / 3,
        (b, b): 1 / 2,
        (c, c): 1 / 4,
        (f, f): 1 / 2,
        (a, c): 1 / np.sqrt(3 * 4),
        (b, g): 1 / np.sqrt(2 * 3),
        (c, d): 1 / np.sqrt(4 * 4),
        (d, e): 1 / np.sqrt(4 * 3),
        (e, f): 1 / np.sqrt(3 * 2),
        (a, b): 0.0,
        (d, g): 0.0,
    }
    for (i, j), value in expected.items():
        assert normalized[i, j] == pytest.approx(value)
        assert normalized[j, i] == pytest.approx(value)


# Laplacian and Chebyshev terms, equations 4 to 6.


def test_laplacian_of_equation_1_by_hand(figure_1):
    a, b, c, g = (LETTERS.index(letter) for letter in "ABCG")
    # Without self-loops: A 2, B 1, C 3, G 2 neighbours.
    assert figure_1.laplacian[a, a] == 1.0
    assert figure_1.laplacian[a, c] == pytest.approx(-1 / np.sqrt(2 * 3))
    assert figure_1.laplacian[b, g] == pytest.approx(-1 / np.sqrt(1 * 2))


@pytest.mark.parametrize("seed", range(5))
def test_laplacian_is_positive_semidefinite_up_to_2(seed):
    eigenvalues = np.linalg.eigvalsh(random_graph(seed).laplacian)
    assert eigenvalues.min() > -1e-12 and eigenvalues.max() < 2 + 1e-12


def test_laplacian_of_the_ring_has_the_largest_eigenvalue_that_the_paper_assumes(graph):
    # A ring of n has 1 - cos(2 pi k / n); at k = n / 2 that is 2.
    np.testing.assert_allclose(
        np.linalg.eigvalsh(graph.laplacian), np.sort(1 - np.cos(2 * np.pi * np.arange(8) / 8)), atol=1e-12
    )
    np.testing.assert_allclose(graph.scaled_laplacian(), graph.scaled_laplacian(2.0), atol=1e-12)


def test_isolated_nodes_keep_their_own_features_only():
    graph = KinematicGraph.from_edges(["a", "b", "alone"], [("a", "b")])
    np.testing.assert_allclose(graph.normalized_adjacency, [[0.5, 0.5, 0], [0.5, 0.5, 0], [0, 0, 1]])
    np.testing.assert_allclose(graph.laplacian, [[1, -1, 0], [-1, 1, 0], [0, 0, 1]])


def test_first_order_filter_is_equation_6(figure_1):
    theta = 0.7
    theta_0, theta_1 = theta, -theta
    terms = figure_1.chebyshev(1, largest_eigenvalue=2.0)
    degree = np.diag(EQUATION_1.sum(axis=1) ** -0.5)
    np.testing.assert_allclose(
        theta_0 * terms[0] + theta_1 * terms[1], theta * (np.eye(7) + degree @ EQUATION_1 @ degree), atol=1e-12
    )


def test_renormalisation_replaces_a_by_a_plus_i(figure_1):
    def propagation(adjacency: np.ndarray) -> np.ndarray:
        degree = np.diag(adjacency.sum(axis=1) ** -0.5)
        return degree @ adjacency @ degree

    # Equation 6 without its identity, then the same expression with self-loops in the place of that identity.
    np.testing.assert_allclose(np.eye(7) - figure_1.laplacian, propagation(EQUATION_1), atol=1e-12)
    np.testing.assert_allclose(figure_1.normalized_adjacency, propagation(EQUATION_1 + np.eye(7)), atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_chebyshev_recursion_against_numpy_on_the_eigenvalues(seed):
    graph, order = random_graph(seed), 5
    eigenvalues, vectors = np.linalg.eigh(graph.scaled_laplacian())
    assert np.abs(eigenvalues).max() < 1 + 1e-12
    terms = graph.chebyshev(order)
    assert terms.shape == (order + 1, 9, 9)
    for k, term in enumerate(terms):
        np.testing.assert_allclose(
            term, vectors @ np.diag(chebval(eigenvalues, np.eye(order + 1)[k])) @ vectors.T, atol=1e-9
        )


def test_chebyshev_of_order_0_is_the_identity(graph):
    np.testing.assert_array_equal(graph.chebyshev(0), np.eye(8)[None])
    with pytest.raises(ValueError, match="at least 0, got -1"):
        graph.chebyshev(-1)


# Presets.


def test_authors_graph_is_the_released_scripts():
    graph = KinematicGraph.from_mjcf("biped", "authors")
    pairs = {(1, 0), (2, 0), (1, 2), (2, 1), (3, 1), (4, 2), (5, 3), (6, 4)}
    assert graph.nodes == NODES and graph.directed
    assert {(int(i), int(j)) for i, j in np.argwhere(graph.adjacency)} == pairs
    assert set(graph.edges) == {(NODES[i], NODES[j]) for i, j in pairs}
    # Row sums with self-loops: body 1, a hip 3, a knee 2, the ground 1.
    assert graph.normalized_adjacency[1, 0] == pytest.approx(1 / np.sqrt(3 * 1))
    assert graph.normalized_adjacency[3, 1] == pytest.approx(1 / np.sqrt(2 * 3))
    assert graph.normalized_adjacency[0, 1] == 0.0 and graph.normalized_adjacency[7, 7] == 1.0
    assert "hip_right <- body" in str(graph)


def test_edgeless_and_complete():
    edgeless, complete = (KinematicGraph.from_mjcf("biped", preset) for preset in ("edgeless", "complete"))
    assert edgeless.edges == ()
    np.testing.assert_array_equal(edgeless.normalized_adjacency, np.eye(8))
    assert len(complete.edges) == 8 * 7 // 2
    np.testing.assert_allclose(complete.normalized_adjacency, np.full((8, 8), 1 / 8))


def test_random_has_as_many_edges_as_the_tree_and_follows_its_seed(graph):
    drawn = [KinematicGraph.from_mjcf("biped", "random", seed) for seed in (0, 0, 1)]
    assert [len(one.edges) for one in drawn] == [len(graph.edges)] * 3 == [8] * 3
    assert not any(one.directed for one in drawn)
    np.testing.assert_array_equal(drawn[0].adjacency, drawn[1].adjacency)
    assert not np.array_equal(drawn[0].adjacency, drawn[2].adjacency)
    assert not np.array_equal(drawn[0].adjacency, graph.adjacency)


@pytest.mark.parametrize("preset", PRESETS)
def test_mirror_swaps_right_and_left(robot, preset):
    graph = KinematicGraph.from_robot(robot, preset)
    mirror = list(graph.mirror)
    assert mirror == [0, 2, 1, 4, 3, 6, 5, 7]
    if preset != "random":  # random edges are not symmetric
        np.testing.assert_array_equal(graph.adjacency[np.ix_(mirror, mirror)], graph.adjacency)


def test_graph_without_sides_is_its_own_mirror(figure_1):
    assert figure_1.mirror == tuple(range(7))


# Errors.


def test_errors_say_what_was_expected():
    with pytest.raises(RobotError, match=r"'star'.*tree, authors, edgeless, complete, random"):
        KinematicGraph.from_mjcf("biped", "star")
    with pytest.raises(RobotError, match=r"2 nodes must have shape \(2, 2\), got \(3, 3\)"):
        KinematicGraph(("a", "b"), np.zeros((3, 3)))
    with pytest.raises(RobotError, match="must differ, got a, a"):
        KinematicGraph(("a", "a"), np.zeros((2, 2)))
    for adjacency in (np.eye(2), np.array([[0, 0.5], [0.5, 0]])):
        with pytest.raises(RobotError, match="zeros and ones"):
            KinematicGraph(("a", "b"), adjacency)
    with pytest.raises(RobotError, match="No node c for an edge: the nodes are a, b"):
        KinematicGraph.from_edges(("a", "b"), [("a", "c")])
    with pytest.raises(RobotError, match="zeros on its diagonal"):
        KinematicGraph.from_edges(("a", "b"), [("a", "a")])
