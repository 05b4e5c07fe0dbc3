"""Belief propagation against enumeration of all associations."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from estimator.slam.association.belief_propagation import associate_all


def enumerate_all(ratio):
    """Exact marginals and log evidence by summing over every one-to-one association."""
    features, measurements = ratio.shape
    total, marginal = 0.0, np.zeros_like(ratio)
    for choice in product(range(-1, measurements), repeat=features):
        used = [j for j in choice if j >= 0]
        if len(set(used)) < len(used):
            continue
        weight = np.prod([ratio[i, j] for i, j in enumerate(choice) if j >= 0])
        total += weight
        for i, j in enumerate(choice):
            if j >= 0:
                marginal[i, j] += weight
    return marginal / total, np.log(total)


@pytest.mark.parametrize("seed", range(5))
def test_exact_where_the_graph_is_a_tree(seed):
    """Without loops the marginals and the Bethe evidence are exact."""
    rng = np.random.default_rng(seed)
    ratio = np.zeros((3, 3))
    for i, j in [(0, 0), (0, 1), (1, 1), (1, 2), (2, 2)]:
        ratio[i, j] = rng.exponential(3.0)
    probability, _, evidence = (each[0] for each in associate_all(ratio[None], 20))
    marginal, exact = enumerate_all(ratio)
    assert np.allclose(probability, marginal, atol=1e-6)
    assert evidence == pytest.approx(exact, abs=1e-6)


def test_close_on_loopy_graphs():
    """Fully connected three by three problems stay within five hundredths of the truth."""
    rng = np.random.default_rng(9)
    ratio = rng.exponential(2.0, size=(40, 3, 3))
    probability, _, found = associate_all(ratio, 50)
    for i in range(len(ratio)):
        marginal, evidence = enumerate_all(ratio[i])
        assert np.abs(probability[i] - marginal).max() < 0.05
        assert abs(found[i] - evidence) < 0.15


def test_nothing_to_associate():
    """Impossible pairs give zero probability and no evidence."""
    probability, message, evidence = associate_all(np.zeros((2, 4, 3)))
    assert np.all(probability == 0.0)
    assert np.all(message == 1.0)
    assert np.all(evidence == 0.0)
