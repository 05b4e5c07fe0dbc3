"""The path buffer: what is kept, in order, and what is marked."""

from __future__ import annotations

import numpy as np

from estimator.measurements import AnchorPaths, Epoch
from estimator.slam.models.epoch_paths import stack_paths
from estimator.slam.models.path_buffer import PathBuffer
from estimator.waveform import SPEED_OF_LIGHT_M_S


def filled(epochs, window):
    """A buffer of epochs with ``t % 3`` paths of the first anchor and one of the second, half associated."""
    buffer = PathBuffer.empty()
    for t in epochs:
        paths = tuple(
            AnchorPaths(
                np.arange(1.0, 1.0 + n) * (t + 1.0) / SPEED_OF_LIGHT_M_S, np.full(n, 0.1 / SPEED_OF_LIGHT_M_S)
            )
            for n in (t % 3, 1)
        )
        table = stack_paths(Epoch(t, float(t), paths), 6e9)
        associated = np.zeros(table.length_m.shape, dtype=bool)
        associated[1] = True
        buffer = buffer.with_epoch(t, np.array([t, -t]), 0.1 * t, table, associated, window)
    return buffer


def test_the_window_is_kept_and_no_more():
    """An epoch ``window`` back is forgotten with its paths: memory is bounded, gaps in time count."""
    buffer = filled([0, 1, 2, 3, 7, 8], 6)
    assert buffer.track.epoch.tolist() == [3, 7, 8]
    assert set(buffer.epoch.tolist()) == {3, 7, 8}
    assert buffer.epochs == 3
    assert buffer.track.position_m[:, 0].tolist() == [3.0, 7.0, 8.0]
    long = filled(range(500), 20)
    assert long.epochs == 20
    assert len(long.epoch) == sum(t % 3 + 1 for t in range(480, 500))


def test_paths_stand_with_their_epoch_and_anchor():
    """Columns of one path must stay together."""
    buffer = filled(range(8), 100)
    assert np.all(np.diff(buffer.epoch) >= 0)
    assert np.array_equal(buffer.unassociated, buffer.anchor == 0)
    second = buffer.anchor == 1
    np.testing.assert_allclose(buffer.length_m[second], buffer.epoch[second] + 1.0)
    assert np.array_equal(buffer.track.epoch[buffer.row_of(buffer.epoch)], buffer.epoch)


def test_marking_changes_a_copy():
    """A buffer is a value: marking paths leaves the one before as it was."""
    buffer = filled(range(8), 100)
    marked = buffer.with_associated(np.flatnonzero(buffer.epoch == 5))
    assert not marked.unassociated[marked.epoch == 5].any()
    assert np.array_equal(marked.unassociated[marked.epoch != 5], buffer.unassociated[buffer.epoch != 5])
    assert buffer.unassociated[buffer.epoch == 5].any()
    assert buffer.with_associated(buffer.anchor >= 0).unassociated.sum() == 0
