"""Paths of an epoch as a padded table."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.measurements import AnchorPaths, Epoch
from estimator.slam.models.epoch_paths import stack_paths
from estimator.waveform import SPEED_OF_LIGHT_M_S, free_space_loss_db


def test_lengths_losses_and_directions_stand_in_their_rows():
    """Delays become metres, gains losses beyond free space, azimuths those of the gauge frame."""
    length = np.array([30.0, 50.0])
    first = AnchorPaths(
        length / SPEED_OF_LIGHT_M_S,
        np.array([0.1, 0.2]) / SPEED_OF_LIGHT_M_S,
        gain_db=-free_space_loss_db(length, 6e9) - np.array([0.0, 7.0]),
        azimuth_rad=np.array([0.5, -0.5]),
        azimuth_std_rad=np.array([0.01, 0.02]),
    )
    epoch = Epoch(3, 3.0, (first, AnchorPaths.none()), heading_held=True)
    table = stack_paths(epoch, 6e9, 0.2)
    assert table.number.tolist() == [2, 0]
    assert table.valid.tolist() == [[True, True], [False, False]]
    assert table.length_m[0] == pytest.approx(length)
    assert table.std_m[0] == pytest.approx([0.1, 0.2])
    assert table.excess_loss_db[0] == pytest.approx([0.0, 7.0], abs=1e-9)
    assert table.azimuth_rad[0] == pytest.approx([0.3, -0.7])
    assert table.azimuth_std_rad[0] == pytest.approx([0.01, 0.02])
    assert table.heading_held
    assert np.isinf(table.azimuth_std_rad[1]).all()
    assert np.isnan(table.excess_loss_db[1]).all()


def test_an_epoch_without_paths_has_one_empty_column():
    """Compiled functions take a table of no paths as any other."""
    table = stack_paths(Epoch(0, 0.0, (AnchorPaths.none(),) * 3), 6e9)
    assert table.length_m.shape == (3, 1)
    assert not table.valid.any()
