"""Small loops that order and gather, against NumPy's."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.slam.models.ordering import descending, taken


@pytest.mark.parametrize("size", [0, 1, 2, 17, 200])
def test_descending_is_a_stable_sort(size):
    """Equal weights keep their order, or two machines might keep other hypotheses."""
    values = np.random.default_rng(size).integers(0, 9, size).astype(np.float64)
    assert np.array_equal(descending(values), np.argsort(-values, kind="stable"))


def test_taken_copies_whole_rows():
    """As NumPy's index does, for every type in hypotheses."""
    index = np.array([2, 0, 2])
    for array in (np.arange(12.0).reshape(4, 3), np.arange(4), np.ones((4, 2, 2), dtype=bool)):
        found = taken(array, index)
        assert np.array_equal(found, array[index])
        assert found.dtype == array.dtype
        found[0] = 0
        assert array[2].any()
