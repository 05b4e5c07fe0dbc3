"""Linear algebra of a chain with a border: block-tridiagonal plus arrowhead matrices.

The information of a whole run couples each epoch's agent state with its neighbours (motion) and
with what stands still (anchors, walls, rotation):

    [ A_0   B_0                C_0 ]        T blocks of size n along the chain,
    [ B_0'  A_1   B_1          C_1 ]        one border of size m;
    [       ...   ...   ...    ... ]        symmetric positive definite.
    [ C_0'  C_1'  ...   ...    D   ]

Eliminating the chain from its start gives ``S_t = A_t - B' S^-1 B`` and ``G_t = C_t - B' S^-1 G`` (with
``B, S, G`` of ``t - 1``) and leaves ``D - sum G_t' S_t^-1 G_t`` for the border. The conditional of ``x_t``
given ``x_{t+1}`` and the border is then Gaussian with information ``S_t``; running it backwards gives
solutions and the marginal covariances (a Rauch-Tung-Striebel pass in information form).
Cost and memory grow linearly with the length of the chain.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimator.errors import InputError

__all__ = ["Arrowhead", "Elimination", "Marginals", "eliminate"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Arrowhead:
    """A symmetric positive definite arrowhead matrix.

    Parameters
    ----------
    chain : ndarray, shape (T, n, n)
        Diagonal blocks ``A_t``.
    link : ndarray, shape (T - 1, n, n)
        Blocks ``B_t`` of row t and column t + 1.
    border : ndarray, shape (T, n, m)
        Blocks ``C_t``.
    corner : ndarray, shape (m, m)
        ``D``.
    """

    chain: Array
    link: Array
    border: Array
    corner: Array

    def damped(self, damping: float) -> Arrowhead:
        """The matrix with its diagonal raised by a fraction (Levenberg-Marquardt)."""
        chain, corner = self.chain.copy(), self.corner.copy()
        for blocks in (chain, corner):
            index = np.arange(blocks.shape[-1])
            blocks[..., index, index] *= 1.0 + damping
        return Arrowhead(chain, self.link, self.border, corner)


@dataclass(frozen=True, eq=False)
class Marginals:
    """Blocks of the inverse.

    Parameters
    ----------
    chain : ndarray, shape (T, n, n)
        Covariances of the chain's states.
    cross : ndarray, shape (T, n, m)
        Their covariances with the border.
    border : ndarray, shape (m, m)
        Covariance of the border.
    """

    chain: Array
    cross: Array
    border: Array


@dataclass(frozen=True, eq=False)
class Elimination:
    """A factorised :class:`Arrowhead`; made by :func:`eliminate`.

    Parameters
    ----------
    inverse : ndarray, shape (T, n, n)
        ``S_t^-1``.
    link : ndarray, shape (T - 1, n, n)
        ``B_t``.
    border : ndarray, shape (T, n, m)
        ``G_t``.
    corner : ndarray, shape (m, m)
        The border's information once the chain is eliminated.
    """

    inverse: Array
    link: Array
    border: Array
    corner: Array

    def solve(self, chain: Array, border: Array) -> tuple[Array, Array]:
        """Solution for a right-hand side.

        Parameters
        ----------
        chain : ndarray, shape (T, n)
            Right-hand side of the chain.
        border : ndarray, shape (m,)
            And of the border.

        Returns
        -------
        chain, border : ndarray, shapes (T, n) and (m,)
        """
        right = chain.copy()
        for t in range(1, len(right)):
            right[t] -= self.link[t - 1].T @ (self.inverse[t - 1] @ right[t - 1])
        left = border - np.einsum("tij,tik,tk->j", self.border, self.inverse, right)
        still = np.linalg.solve(self.corner, left) if left.size else left
        right -= self.border @ still
        moving = np.empty_like(right)
        for t in range(len(right) - 1, -1, -1):
            if t + 1 < len(right):
                right[t] -= self.link[t] @ moving[t + 1]
            moving[t] = self.inverse[t] @ right[t]
        return moving, still

    def marginals(self) -> Marginals:
        """Diagonal, border and corner blocks of the inverse matrix."""
        size, still = self.border.shape[1:]
        corner = np.linalg.inv(self.corner) if still else self.corner
        chain = np.empty_like(self.inverse)
        cross = np.empty_like(self.border)
        for t in range(len(chain) - 1, -1, -1):
            # x_t given (x_{t+1}, border) has the gain -S^-1 [B, G]
            by_border = -self.inverse[t] @ self.border[t]
            if t + 1 == len(chain):
                cross[t] = by_border @ corner
                chain[t] = self.inverse[t] + cross[t] @ by_border.T
                continue
            by_next = -self.inverse[t] @ self.link[t]
            cross[t] = by_next @ cross[t + 1] + by_border @ corner
            with_next = by_next @ chain[t + 1] + by_border @ cross[t + 1].T
            chain[t] = self.inverse[t] + with_next @ by_next.T + cross[t] @ by_border.T
        chain = 0.5 * (chain + np.swapaxes(chain, -1, -2))
        return Marginals(chain.reshape(-1, size, size), cross, 0.5 * (corner + corner.T))


def eliminate(matrix: Arrowhead) -> Elimination:
    """Eliminate the chain, from its first block to its last.

    Raises
    ------
    InputError
        If the matrix is not positive definite: something is not determined.
    """
    inverse = np.empty_like(matrix.chain)
    border = matrix.border.copy()
    corner = matrix.corner.copy()
    for t in range(len(inverse)):
        block = matrix.chain[t]
        if t > 0:
            gain = inverse[t - 1] @ matrix.link[t - 1]
            block = block - matrix.link[t - 1].T @ gain
            border[t] -= gain.T @ border[t - 1]
        inverse[t] = _inverse(block)
        corner -= border[t].T @ inverse[t] @ border[t]
    if corner.size:
        _inverse(corner)
    return Elimination(inverse, matrix.link, border, 0.5 * (corner + corner.T))


def _inverse(block: Array) -> Array:
    """Inverse of a symmetric positive definite block, scaled to a unit diagonal first."""
    scale = np.sqrt(np.maximum(np.diagonal(block), 1e-300))
    try:
        root = np.linalg.inv(np.linalg.cholesky(block / np.outer(scale, scale))) / scale
    except np.linalg.LinAlgError as error:
        raise InputError(
            "arrowhead: expected a positive definite matrix, got one that does not determine everything"
        ) from error
    return np.asarray(root.T @ root)
