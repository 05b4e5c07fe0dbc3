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

from estimator.compiled import compiled
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
        right, left = _forward(self.inverse, self.link, self.border, chain, border)
        still = np.asarray(np.linalg.solve(self.corner, left) if left.size else left, dtype=np.float64)
        return _backward(self.inverse, self.link, self.border, right, still), still

    def marginals(self) -> Marginals:
        """Diagonal, border and corner blocks of the inverse matrix."""
        inverted = np.linalg.inv(self.corner) if self.corner.size else self.corner
        corner = np.asarray(inverted, dtype=np.float64)
        chain, cross = _covariances(self.inverse, self.link, self.border, corner)
        return Marginals(chain, cross, 0.5 * (corner + corner.T))


def eliminate(matrix: Arrowhead) -> Elimination:
    """Eliminate the chain, from its first block to its last.

    Raises
    ------
    InputError
        If the matrix is not positive definite: something is not determined.
    """
    link = np.ascontiguousarray(matrix.link)
    inverse, border, corner, determined = _eliminate(matrix.chain, link, matrix.border, matrix.corner)
    if not determined or (corner.size and not _inverted(corner, np.empty_like(corner))):
        raise InputError(
            "arrowhead: expected a positive definite matrix, got one that does not determine everything"
        )
    return Elimination(inverse, link, border, corner)


@compiled
def _eliminate(chain: Array, link: Array, border: Array, corner: Array) -> tuple[Array, Array, Array, bool]:
    """``S^-1`` (T, n, n), ``G`` (T, n, m), the border's information (m, m), and whether all is determined."""
    epochs, n, m = border.shape
    inverse, block = np.empty_like(chain), np.empty((n, n))
    left, below = border.copy(), corner.copy()
    gain, weighted = np.empty((n, n)), np.empty((n, m))
    for t in range(epochs):
        block[:, :] = chain[t]
        if t > 0:
            _product(inverse[t - 1], link[t - 1], gain)
            for i in range(n):
                for k in range(n):
                    for j in range(n):
                        block[i, j] -= link[t - 1, k, i] * gain[k, j]
                    for j in range(m):
                        left[t, i, j] -= gain[k, i] * left[t - 1, k, j]
        if not _inverted(block, inverse[t]):
            return inverse, left, below, False
        _product(inverse[t], left[t], weighted)
        for k in range(n):
            for i in range(m):
                for j in range(m):
                    below[i, j] -= left[t, k, i] * weighted[k, j]
    return inverse, left, 0.5 * (below + below.T), True


@compiled
def _forward(inverse: Array, link: Array, border: Array, chain: Array, below: Array) -> tuple[Array, Array]:
    """Right-hand sides of the chain (T, n) and of the border (m,) once the chain is eliminated."""
    epochs, n, m = border.shape
    right, left, weighted = chain.copy(), below.copy(), np.empty(n)
    for t in range(epochs):
        if t > 0:
            for k in range(n):
                for i in range(n):
                    right[t, i] -= link[t - 1, k, i] * weighted[k]
        for i in range(n):
            weighted[i] = 0.0
            for j in range(n):
                weighted[i] += inverse[t, i, j] * right[t, j]
        for k in range(n):
            for j in range(m):
                left[j] -= border[t, k, j] * weighted[k]
    return right, left


@compiled
def _backward(inverse: Array, link: Array, border: Array, right: Array, still: Array) -> Array:
    """Solution of the chain (T, n), given that of the border (m,)."""
    epochs, n, m = border.shape
    moving, rest = np.zeros((epochs, n)), np.empty(n)
    for t in range(epochs - 1, -1, -1):
        for i in range(n):
            rest[i] = right[t, i]
            for j in range(m):
                rest[i] -= border[t, i, j] * still[j]
            if t + 1 < epochs:
                for j in range(n):
                    rest[i] -= link[t, i, j] * moving[t + 1, j]
        for i in range(n):
            for j in range(n):
                moving[t, i] += inverse[t, i, j] * rest[j]
    return moving


@compiled
def _covariances(inverse: Array, link: Array, border: Array, corner: Array) -> tuple[Array, Array]:
    """Covariances of the chain (T, n, n) and with the border (T, n, m): Rauch, Tung and Striebel's pass.

    ``x_t`` given ``x_t+1`` and the border has the gain ``-S^-1 [B, G]``.
    """
    epochs, n, m = border.shape
    chain, cross = np.empty_like(inverse), np.empty_like(border)
    by_border, by_next, with_next = np.empty((n, m)), np.empty((n, n)), np.empty((n, n))
    for t in range(epochs - 1, -1, -1):
        _product(inverse[t], border[t], by_border)
        by_border *= -1.0
        _product(by_border, corner, cross[t])
        chain[t] = inverse[t]
        if t + 1 < epochs:
            _product(inverse[t], link[t], by_next)
            by_next *= -1.0
            _product(by_next, chain[t + 1], with_next)
            for i in range(n):
                for k in range(n):
                    for j in range(m):
                        cross[t, i, j] += by_next[i, k] * cross[t + 1, k, j]
                        with_next[i, k] += by_border[i, j] * cross[t + 1, k, j]
            for i in range(n):
                for j in range(n):
                    for k in range(n):
                        chain[t, i, j] += with_next[i, k] * by_next[j, k]
        for i in range(n):
            for j in range(n):
                for k in range(m):
                    chain[t, i, j] += cross[t, i, k] * by_border[j, k]
        for i in range(n):
            for j in range(i):
                chain[t, i, j] = chain[t, j, i] = 0.5 * (chain[t, i, j] + chain[t, j, i])
    return chain, cross


@compiled
def _product(a: Array, b: Array, out: Array) -> None:
    """``out = a b``."""
    out[:, :] = 0.0
    for i in range(a.shape[0]):
        for k in range(a.shape[1]):
            for j in range(b.shape[1]):
                out[i, j] += a[i, k] * b[k, j]


@compiled
def _inverted(block: Array, out: Array) -> bool:
    """Inverse of a symmetric positive definite block, scaled to a unit diagonal; False if it is not one."""
    n = block.shape[0]
    root, scale = np.zeros((n, n)), np.empty(n)
    for i in range(n):
        scale[i] = np.sqrt(max(block[i, i], 1e-300))
    for i in range(n):  # Cholesky
        for j in range(i + 1):
            total = block[i, j] / (scale[i] * scale[j])
            for k in range(j):
                total -= root[i, k] * root[j, k]
            if i > j:
                root[i, j] = total / root[j, j]
            elif total > 0.0:
                root[i, i] = np.sqrt(total)
            else:
                return False
    lower = np.zeros((n, n))  # its inverse
    for j in range(n):
        lower[j, j] = 1.0 / root[j, j]
        for i in range(j + 1, n):
            total = 0.0
            for k in range(j, i):
                total -= root[i, k] * lower[k, j]
            lower[i, j] = total / root[i, i]
    for i in range(n):
        for j in range(i + 1):
            total = 0.0
            for k in range(i, n):
                total += lower[k, i] * lower[k, j]
            out[i, j] = out[j, i] = total / (scale[i] * scale[j])
    return True
