"""What a search takes in: epochs, order, and the table of lengths."""

from __future__ import annotations

import numpy as np

from estimator.slam.anchors.observations import gathered, observations_of
from estimator.slam.models.path_buffer import PathBuffer, Track
from tests.estimator.slam.anchors.scenes import NOISE, SEARCH


def buffer_of(epochs: int) -> PathBuffer:
    """Two anchors with two paths each in every epoch; epoch ``t`` shows ``10 + t`` and ``20 + t`` metres."""
    epoch = np.repeat(np.arange(epochs), 4)
    anchor = np.tile([0, 0, 1, 1], epochs)
    length = np.tile([20.0, 10.0, 40.0, 30.0], epochs) + epoch
    track = Track(
        np.arange(epochs), np.stack([np.arange(epochs), np.zeros(epochs)], axis=1), np.full(epochs, 0.2)
    )
    size = len(epoch)
    return PathBuffer(
        track, epoch, anchor, length, np.full(size, 0.5), np.full(size, np.nan), np.ones(size, dtype=bool)
    )


def observations(epochs: int, anchor: int = 0, loss: float = np.nan, offset: float = np.nan):
    """The observations of an epoch after so many."""
    now = np.array([7.0, 5.0]), np.array([0.01, 0.3]), np.array([loss, np.nan])
    return observations_of(anchor, np.array([9.0, 9.0]), 0.3, now, buffer_of(epochs), offset, NOISE, SEARCH)


def test_the_present_epoch_is_the_last_and_every_fourth_before_it_is_used():
    """The last epoch decides what is fresh; neighbouring epochs would count the same evidence twice."""
    seen = observations(9)
    np.testing.assert_array_equal(seen.position_m[:, 0], [0.0, 4.0, 8.0, 9.0])
    np.testing.assert_allclose(seen.covariance_m2[:, 0, 0], [0.04, 0.04, 0.04, 0.3])
    np.testing.assert_array_equal(seen.length_m[:, 0], [10.0, 14.0, 18.0, 5.0])


def test_the_first_epochs_are_all_used():
    """Early, one epoch after another has to do."""
    assert len(observations(3).paths) == 4


def test_only_the_anchors_own_paths_count():
    """Another anchor's paths would put this one where that one is."""
    np.testing.assert_array_equal(observations(1, anchor=1).length_m[0], [30.0, 40.0])


def test_a_std_is_never_believed_below_the_floor():
    """Paths said to be exact would outweigh the walls."""
    np.testing.assert_allclose(observations(0).length_variance_m2[0], [0.09, 0.01])


def test_losses_tell_lines_of_sight_only_where_the_gain_is_known():
    """An unknown gain must not make every path a line of sight, or none."""
    assert np.all(observations(0, loss=3.0).direct_ratio == 1.0)
    near, far = (observations(0, loss=loss, offset=3.0).direct_ratio[0, 1] for loss in (3.0, 20.0))
    assert near > 1.0 > far > 0.0
    assert observations(0, loss=3.0, offset=3.0).direct_ratio[0, 0] == 1.0


def test_the_table_leads_to_the_first_path_that_may_be_long_enough():
    """An entry too late would skip paths without a word."""
    rng = np.random.default_rng(1)
    lengths = rng.uniform(3.0, 90.0, 40)
    one = np.ones(40)
    seen = gathered(
        np.zeros((2, 2)),
        np.tile(np.eye(2), (2, 1, 1)),
        [(lengths, one, one), (lengths[:3], one[:3], one[:3])],
    )
    for e, own in enumerate((np.sort(lengths), np.sort(lengths[:3]))):
        for wanted in rng.uniform(0.0, 100.0, 200):
            bucket = min(int(wanted * seen.buckets_per_m), seen.first.shape[1] - 1)
            assert seen.first[e, bucket] <= np.searchsorted(own, wanted)
    assert seen.first[0, 0] == 0
