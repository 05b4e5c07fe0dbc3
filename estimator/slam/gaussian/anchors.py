"""Anchors enter the hypotheses: what the engine tells the search (:mod:`estimator.slam.anchors`)."""

from __future__ import annotations

from estimator.slam.anchors import SearchInput, is_due, locate_anchors
from estimator.slam.gaussian.config import GaussianConfig
from estimator.slam.gaussian.phase import Phase
from estimator.slam.gaussian.state import GaussianState
from estimator.slam.mixture_reduction import reduce_mixture
from estimator.slam.models.epoch_paths import EpochPaths
from estimator.slam.models.hypotheses import Hypotheses
from estimator.slam.models.path_loss import known_gain_offsets
from estimator.slam.models.visibility import prior_visibility

__all__ = ["initialise_anchors"]


def initialise_anchors(
    state: GaussianState, paths: EpochPaths, config: GaussianConfig, phase: Phase
) -> GaussianState:
    """Start the anchors that the likeliest hypothesis has not located, where the paths allow it.

    Parameters
    ----------
    state : GaussianState
        State with corrected hypotheses; its buffer ends with the epoch before.
    paths : EpochPaths
        The epoch's paths.
    config : GaussianConfig
        Models.
    phase : Phase
        Limits of this epoch.
    """
    hypotheses, layout = state.hypotheses, state.layout
    if not is_due(state.epoch, state.buffer.epochs, bool(hypotheses.located.all()), config.search):
        return state
    model = config.reduce_model(phase, layout)

    def reduce(many: Hypotheses) -> Hypotheses:
        return reduce_mixture(many, model)

    given = SearchInput(
        layout=layout,
        confirmed=state.slots.confirmed,
        epoch=state.epoch,
        paths=paths,
        heard=state.buffer,
        gain_offset_db=known_gain_offsets(state.losses_db, config.path_loss),
        noise=config.heard,
        fresh_visibility=prior_visibility(layout, config.visibility),
        prune_nats=phase.prune_nats,
        reduce=reduce,
    )
    return state.but(hypotheses=locate_anchors(hypotheses, given, config.search))
