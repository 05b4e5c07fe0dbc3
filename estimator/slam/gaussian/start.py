"""The state before the first epoch, from the walls sensed at the start or from known anchors.

If the anchors are known, they fix the frame. If not, the reference wall (the one whose
bearing is known best) defines the gauge frame (:mod:`estimator.slam.models.state_vector`): its
bearing error becomes the state ``theta``, the rotation of the whole map about RP, which
passive measurements cannot see.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from estimator.errors import InputError
from estimator.geometry import rotation_matrix
from estimator.measurements import GaussianVrp
from estimator.slam.gaussian.config import GaussianConfig
from estimator.slam.gaussian.integrity import no_indicators
from estimator.slam.gaussian.recalled_track import RecalledTrack
from estimator.slam.gaussian.state import GaussianState, Outset, Slots
from estimator.slam.models.clocks import clock_prior
from estimator.slam.models.hypotheses import Hypotheses
from estimator.slam.models.noise_level import first_levels
from estimator.slam.models.path_buffer import PathBuffer
from estimator.slam.models.path_loss import first_losses
from estimator.slam.models.state_vector import ECHO_BIAS, HEADING, NOWHERE_M, THETA, Layout
from estimator.slam.models.sweeps import own_covariance
from estimator.slam.models.visibility import prior_visibility

__all__ = ["begun_again", "start", "state_of"]

Array = NDArray[np.float64]


def start(
    walls: Sequence[GaussianVrp],
    anchor_names: Sequence[str],
    carrier_hz: float,
    config: GaussianConfig,
    anchors_m: Array | None = None,
    shared: bool = True,
    sweeps: bool = False,
) -> GaussianState:
    """The state before the first epoch.

    Parameters
    ----------
    walls : sequence of GaussianVrp
        Walls sensed at the start, estimator's frame; at least one if the anchors are not
        known and no sweeps come, for nothing else fixes the direction of the map.
    anchor_names : sequence of str
        The anchors that epochs will report on, in order.
    carrier_hz : float
        Carrier frequency, hertz.
    config : GaussianConfig
        Models.
    anchors_m : ndarray, shape (K, 2), optional
        The anchors, estimator's frame, if they are known.
    shared : bool
        Whether features are walls common to all anchors, or else virtual anchors of each, of which
        none is known at the start.
    sweeps : bool
        Whether sweeps will show walls on the way.

    Returns
    -------
    GaussianState

    Raises
    ------
    InputError
        If no anchor is given, or neither a wall nor the anchors' places nor sweeps; if walls are given where
        features are virtual anchors.
    """
    if not anchor_names or not (walls or anchors_m is not None or sweeps):
        raise InputError(
            "SLAM: expected at least one anchor, and a wall sensed at the start, sweeps, or known anchors, "
            f"got {len(anchor_names)} anchors and {len(walls)} walls"
        )
    if walls and not shared:
        raise InputError(f"SLAM with virtual anchors: expected no walls at the start, got {len(walls)}")
    walls = sorted(walls, key=_bearing_std)
    layout = Layout(len(anchor_names), len(walls), shared)
    bearing = 0.0
    gauge = anchors_m is None and bool(walls)  # the reference wall's; otherwise the estimator's frame
    if gauge:
        reference = walls[0].mean_m
        bearing = float(np.arctan2(reference[1], reference[0]))
    to_gauge = rotation_matrix(-bearing)
    vrps = np.array([wall.mean_m for wall in walls]).reshape(-1, 2) @ to_gauge.T

    mean = np.zeros(layout.size)
    common = config.sweeps.echo_bias_std_m
    covariance = _wall_prior(walls, vrps, to_gauge, layout, common, turning=gauge)
    mean[HEADING] = -bearing
    if gauge:
        vrps[0, 1] = 0.0
    mean[layout.walls] = vrps.ravel()
    covariance[0:2, 0:2] = config.motion.start_std_m**2 * np.eye(2)
    covariance[2:4, 2:4] = config.motion.start_velocity_std_m_s**2 * np.eye(2)
    for k in range(layout.anchors):
        place = (NOWHERE_M, 0.0) if anchors_m is None else anchors_m[k]
        mean[layout.anchor(k)] = *place, config.noise.height2_mean_m2, 0.0
        covariance[layout.height2(k), layout.height2(k)] = config.noise.height2_std_m2**2
    clock_prior(covariance, layout, config.clocks)

    return state_of(
        layout,
        mean,
        covariance,
        tuple(anchor_names),
        np.full(layout.anchors, anchors_m is not None),
        carrier_hz,
        config,
        bearing,
    )


def state_of(
    layout: Layout,
    mean: Array,
    covariance: Array,
    anchor_names: tuple[str, ...],
    located: NDArray[np.bool_],
    carrier_hz: float,
    config: GaussianConfig,
    bearing_rad: float = 0.0,
) -> GaussianState:
    """A state without a past, of one hypothesis: what a Gaussian tells of agent, anchors and walls.

    Parameters
    ----------
    layout : Layout
        Positions in the state vector.
    mean, covariance : ndarray, shape (n,), (n, n)
        The Gaussian; the walls count as found.
    anchor_names : tuple of str
        The K anchors.
    located : ndarray of bool, shape (K,)
        Which of them have been located.
    carrier_hz : float
        Carrier frequency, hertz.
    config : GaussianConfig
        Models.
    bearing_rad : float
        Direction of the x axis in the estimator's frame.
    """
    anchors, count = layout.anchors, layout.slots
    hypotheses = Hypotheses(
        log_weight=np.zeros(1),
        mean=mean[None],
        covariance=covariance[None],
        located=located[None],
        present=np.ones((1, count), dtype=bool),
        visibility=np.tile(prior_visibility(layout, config.visibility), (1, anchors, 1)),
        support=np.zeros((1, count), dtype=np.int64),
    )
    nobody = np.full(count, -1)
    slots = Slots(
        np.arange(count),
        nobody,
        np.ones(count, dtype=bool),
        np.zeros((count, 2)),
        nobody.copy(),
        np.full((count, anchors, 2, 2), np.nan),
        np.zeros(count),
        np.zeros(count, dtype=np.int64),
        _flashes_at_start(layout, mean),
    )
    return GaussianState(
        anchor_names=anchor_names,
        carrier_hz=float(carrier_hz),
        bearing_rad=bearing_rad,
        epoch=-1,
        time_s=0.0,
        log_evidence=0.0,
        next_wall_id=count,
        shared=layout.shared,
        hypotheses=hypotheses,
        slots=slots,
        buffer=PathBuffer.empty(),
        surveyed=PathBuffer.empty(),
        recalled=RecalledTrack.empty(mean.size),
        swept_epoch=-1,
        tracked_epoch=-1,
        indicators=no_indicators(config.integrity),
        echo_residuals=np.full((2, 2), config.sweeps.residual_flashes),
        first_time_s=0.0,
        outset=Outset(mean.copy(), covariance.copy(), located.copy()),
        losses_db=first_losses(anchors, config.noise.gain_offset_std_db, config.path_loss),
        levels=first_levels(anchors, config.noise_level.levels_weighed),
    )


def begun_again(state: GaussianState, config: GaussianConfig) -> GaussianState:
    """The state as it was at the first epoch, before anything was guessed from paths; those are kept."""
    outset = state.outset
    layout = Layout(state.layout.anchors, state.layout.slots, state.shared)
    again = state_of(
        Layout(layout.anchors, (outset.mean.size - layout.walls.start) // layout.per_slot, state.shared),
        outset.mean,
        outset.covariance,
        state.anchor_names,
        outset.located,
        state.carrier_hz,
        config,
        state.bearing_rad,
    )
    first = state.surveyed.epochs == 1
    return again.but(
        epoch=state.epoch,
        time_s=state.first_time_s,
        first_time_s=state.first_time_s,
        surveyed=state.surveyed if first else again.surveyed,
        recalled=state.recalled.unlinked(outset.mean.size) if first else again.recalled,
    )


def _flashes_at_start(layout: Layout, mean: Array) -> Array:
    """The agent at RP and its mirror images (L, 2, 2, 2) in the walls sensed there, gauge frame."""
    flash = np.full((layout.slots, 2, 2, 2), np.nan)
    if layout.shared:
        flash[:, :, 0], flash[:, :, 1] = 0.0, mean[layout.walls].reshape(-1, 1, 2)
    return flash


def _bearing_std(wall: GaussianVrp) -> float:
    """Standard deviation of a VRP's bearing, radians."""
    square = float(wall.mean_m @ wall.mean_m)
    tangent = np.array([-wall.mean_m[1], wall.mean_m[0]]) / np.sqrt(square)
    return float(np.sqrt(tangent @ wall.covariance_m2 @ tangent / square))


def _wall_prior(
    walls: Sequence[GaussianVrp],
    vrps: Array,
    to_gauge: Array,
    layout: Layout,
    echo_bias_std_m: float,
    turning: bool,
) -> Array:
    """Covariance (n, n) of theta, the heading, the echo bias and the VRPs in the gauge frame.

    If the first wall is the gauge's reference (``turning``), an error of its bearing turns all
    the others the other way. The echo bias made all walls too far by it, in range.
    """
    count = len(walls)
    errors = np.zeros((2 * count + 1, 2 * count + 1))
    errors[-1, -1] = echo_bias_std_m**2
    linear = np.zeros((layout.size, 2 * count + 1))
    linear[ECHO_BIAS, -1] = 1.0
    for i, wall in enumerate(walls):
        own = to_gauge @ own_covariance(wall, echo_bias_std_m) @ to_gauge.T
        errors[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = own
        linear[layout.wall(i), -1] = -2.0 * vrps[i] / np.linalg.norm(vrps[i])
    if turning:
        linear[THETA, 1] = 1.0 / vrps[0, 0]
        linear[HEADING] = -linear[THETA]
    for i in range(count):
        wall_columns = layout.wall(i)
        linear[wall_columns, 2 * i : 2 * i + 2] += np.eye(2)
        quarter_turn = np.array([-vrps[i, 1], vrps[i, 0]])
        linear[wall_columns, :] -= np.outer(quarter_turn, linear[THETA])
    if turning:
        linear[layout.wall(0).start + 1] = 0.0
    return np.asarray(linear @ errors @ linear.T)
