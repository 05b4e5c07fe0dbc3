"""When anchors are searched: early, every few epochs while one is missing, and where one is doubtful."""

from __future__ import annotations

import numpy as np

from estimator.slam.anchors.config import AnchorSearchConfig

__all__ = ["is_doubtful", "is_due", "is_early"]


def is_early(epochs_before: int, config: AnchorSearchConfig) -> bool:
    """Whether so few epochs were taken in that each of them is searched."""
    return epochs_before < config.search_stride


def is_due(epoch: int, epochs_before: int, all_located: bool, config: AnchorSearchConfig) -> bool:
    """Whether an epoch has to be searched for anchors.

    Parameters
    ----------
    epoch : int
        Its number.
    epochs_before : int
        Epochs that are remembered.
    all_located : bool
        Whether every hypothesis has located every anchor.
    config : AnchorSearchConfig
        Strides.
    """
    if is_early(epochs_before, config) or epoch % config.recheck_stride == 0:
        return True
    return epoch % config.search_stride == 0 and not all_located


def is_doubtful(
    unassociated: int,
    epochs_before: int,
    clutter_mean: float,
    visible_features: int,
    config: AnchorSearchConfig,
) -> bool:
    """Whether so much of a located anchor goes unexplained that it should be searched again.

    Parameters
    ----------
    unassociated : int
        Its unassociated paths in the remembered epochs.
    epochs_before : int
        These epochs.
    clutter_mean : float
        Clutter expected in each.
    visible_features : int
        Features of up to one bounce that are probably visible.
    config : AnchorSearchConfig
        What is too much.
    """
    expected = clutter_mean * epochs_before
    excess = config.doubt_sigma * float(np.sqrt(expected)) + config.doubt_paths * epochs_before
    return unassociated > expected + excess and visible_features < config.start_matches - 1
