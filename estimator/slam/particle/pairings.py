"""Path lengths between paired particles, and what paths weigh them by: the loops of the messages.

The particles of agent, anchor and feature are paired by their index, in several *pairings*: in pairing
``s`` agent ``n`` meets anchor ``n - a_s`` and feature ``n - b_s`` (modulo N). Single precision throughout: a
length of 100 m is rounded by 4e-6 m, which at a standard deviation of 0.05 m changes a likelihood five
deviations out by 4e-4; sums over particles are taken in double precision. Work is done in pieces that stay in
the processor's cache. Time is of the order of N times pairings times (1 + paths in the gate).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimator.compiled import compiled
from estimator.slam.particle.exponential import exp_negative

__all__ = ["SIGHT", "VIRTUAL", "WALL", "likelihood_sum", "paired_lengths", "paired_weights"]

Single = NDArray[np.float32]
Whole = NDArray[np.int64]

SIGHT, WALL, VIRTUAL = 0, 1, 2
"""Kinds of feature: the line of sight, a wall (VRPs), a virtual anchor."""

_PIECE = 2048  # particles worked on at a time
_LANES = 32  # partial sums: a fixed order of addition that vector units can follow
_SMALLEST = np.float32(1e-6)  # squared distance of a VRP from RP, keeps the mirror image finite


@compiled
def _direct(agent: Single, source: Single, first: int, start: int, height2: np.float32, out: Single) -> None:
    """Lengths from ``agent[:, first:]`` to ``source[:, start:]``."""
    x, y, u, v = agent[0, first:], agent[1, first:], source[0, start:], source[1, start:]
    for i in range(out.size):
        east, north = x[i] - u[i], y[i] - v[i]
        out[i] = np.sqrt(east * east + north * north + height2)


@compiled
def _reflected(
    agent: Single, anchor: Single, wall: Single, first: int, i: int, j: int, height2: np.float32, out: Single
) -> None:
    """Lengths from ``agent[:, first:]`` over ``wall[:, j:]`` to ``anchor[:, i:]``.

    By the mirror image of :func:`estimator.geometry.mirror_xy`, (2), in single precision.
    """
    x, y, u, v = agent[0, first:], agent[1, first:], anchor[0, i:], anchor[1, i:]
    p, q = wall[0, j:], wall[1, j:]
    for n in range(out.size):
        square = p[n] * p[n] + q[n] * q[n]
        along = u[n] * p[n] + v[n] * q[n]
        scale = np.float32(1.0) - np.float32(2.0) * along / max(square, _SMALLEST)
        east, north = x[n] - u[n] - scale * p[n], y[n] - v[n] - scale * q[n]
        out[n] = np.sqrt(east * east + north * north + height2)


@compiled
def _lengths(
    agent: Single,
    anchor: Single,
    point: Single,
    kind: int,
    places: tuple[int, int, int],
    height2: np.float32,
    out: Single,
) -> None:
    """Lengths of the pairs from ``places`` (of agent, anchor and feature) on."""
    first, i, j = places
    if kind == SIGHT:
        _direct(agent, anchor, first, i, height2, out)
    elif kind == WALL:
        _reflected(agent, anchor, point, first, i, j, height2, out)
    else:
        _direct(agent, point, first, j, height2, out)


@compiled
def _piece(first: int, shift: Whole, particles: int) -> tuple[int, int, int]:
    """Places of anchor and feature that agent ``first`` meets, and how many pairs follow without a wrap."""
    i, j = (first - shift[0]) % particles, (first - shift[1]) % particles
    return i, j, min(_PIECE, particles - first, particles - i, particles - j)


@compiled
def paired_lengths(
    agent: Single,
    anchor: Single,
    point: Single,
    kind: int,
    shifts: Whole,
    height2: np.float32,
    length: Single,
) -> tuple[np.float32, np.float32]:
    """Fill in the path lengths of all pairings, and return the shortest and the longest.

    Parameters
    ----------
    agent, anchor, point : ndarray of float32, shape (2, N)
        Particles; of the feature, VRPs or virtual anchors.
    kind : int
        ``SIGHT``, ``WALL`` or ``VIRTUAL``.
    shifts : ndarray of int64, shape (S, 2)
        Shifts of anchor and feature.
    height2 : float32
        Squared height difference, square metres.
    length : ndarray of float32, shape (S, N)
        Where the lengths go, metres.
    """
    particles = agent.shape[1]
    least, most = np.int32(0x7F7FFFFF), np.int32(0)  # of positive numbers, bits order as the numbers do
    for s in range(shifts.shape[0]):
        first = 0
        while first < particles:
            i, j, count = _piece(first, shifts[s], particles)
            out = length[s, first : first + count]
            _lengths(agent, anchor, point, kind, (first, i, j), height2, out)
            bits = out.view(np.int32)
            for n in range(count):
                least, most = min(least, bits[n]), max(most, bits[n])
            first += count
    return np.int32(least).view(np.float32), np.int32(most).view(np.float32)


@compiled
def likelihood_sum(length: Single, path_m: np.float32, scale: np.float32) -> float:
    """Sum of ``exp(-((length - path) scale)^2)`` over all lengths (any number, flat).

    Parameters
    ----------
    length : ndarray of float32, shape (n,)
        Path lengths of paired particles, metres.
    path_m : float32
        Length of the path measured, metres.
    scale : float32
        1 / (sqrt(2) standard deviation), per metre.
    """
    partial = np.zeros(_LANES)
    whole = length.size - length.size % _LANES
    for first in range(0, whole, _LANES):
        for j in range(_LANES):
            off = (length[first + j] - path_m) * scale
            partial[j] += exp_negative(-off * off)
    total = 0.0
    for j in range(_LANES):
        total += partial[j]
    for n in range(whole, length.size):
        off = (length[n] - path_m) * scale
        total += float(exp_negative(-off * off))
    return total


@compiled
def paired_weights(
    agent: Single,
    anchor: Single,
    point: Single,
    kind: int,
    shifts: Whole,
    height2: np.float32,
    paths: tuple[Single, Single, Single],
    base: np.float32,
    existence: np.float32,
    weights: tuple[Single, Single, Single],
) -> None:
    """Mean weights of the particles of each node over the pairings.

    A pair weighs ``w = base + sum_m share_m exp(-((length - path_m) scale_m)^2)`` if the feature exists. It
    gives agent and anchor ``existence w + 1 - existence``, the feature ``w``.

    Parameters
    ----------
    agent, anchor, point, kind, shifts, height2
        As for :func:`paired_lengths`.
    paths : tuple of ndarray of float32, shape (m,)
        Paths in the gate: their lengths, 1 / (sqrt(2) standard deviation), and shares.
    base : float32
        Weight without any path.
    existence : float32
        Probability that the feature exists.
    weights : tuple of ndarray of float32, shape (N,)
        Where the weights of agent, anchor and feature go; empty where they are not wanted.
    """
    particles = agent.shape[1]
    path_m, scale, share = paths
    to_agent, to_anchor, to_point = weights
    to_agent[:], to_anchor[:], to_point[:] = 1.0 - existence, 1.0 - existence, 0.0
    length, weight = np.empty(_PIECE, np.float32), np.empty(_PIECE, np.float32)
    part = np.float32(1.0 / shifts.shape[0])
    for s in range(shifts.shape[0]):
        first = 0
        while first < particles:
            i, j, count = _piece(first, shifts[s], particles)
            near, row = length[:count], weight[:count]
            _lengths(agent, anchor, point, kind, (first, i, j), height2, near)
            row[:] = base
            for m in range(path_m.size):
                _add_path(near, path_m[m], scale[m], share[m], row)
            _add(to_agent[first : first + count], row, existence * part)
            if to_anchor.size:
                _add(to_anchor[i : i + count], row, existence * part)
            if to_point.size:
                _add(to_point[j : j + count], row, part)
            first += count


@compiled
def _add_path(
    length: Single, path_m: np.float32, scale: np.float32, share: np.float32, weight: Single
) -> None:
    """Add what one path weighs."""
    for n in range(weight.size):
        off = (length[n] - path_m) * scale
        weight[n] += share * exp_negative(-off * off)


@compiled
def _add(total: Single, weight: Single, part: np.float32) -> None:
    """Add ``part`` of the weights."""
    for n in range(weight.size):
        total[n] += part * weight[n]
