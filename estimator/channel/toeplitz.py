"""Noise of a Toeplitz covariance over the tones: whitening, its inverse, and the energy it leaves of atoms.

Noise that is stationary over the tones has the covariance ``R_ij = c_{i-j}``. Levinson's recursion gives its
predictors of all orders in O(N^2): their errors whiten (:func:`whiten`), and the last one, ``R a = E e_0``
with ``a_0 = 1``, holds the whole inverse (I. Gohberg and A. Semencul, 1972),

    E R^-1 = L(a) L(a)^H - L(b) L(b)^H,   b = (0, conj(a_{N-1}), ..., conj(a_1)),

``L(v)`` the lower triangular Toeplitz matrix with the first column ``v``. So ``R^-1 y`` takes a few FFTs, and
the energy ``a(x)^H R^-1 a(x)`` of an atom is a trigonometric polynomial of the delay, whose coefficients are

    mu_d = (1 / E) sum_m (N - d - 2 m) a_{m+d} conj(a_m)

(B. Musicus, "Fast MLM power spectrum estimation from uniformly spaced correlations", IEEE Trans. ASSP 33,
1985).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from estimator.compiled import compiled

__all__ = ["Inverse", "Whitened", "inverse_of", "whiten"]

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


_LEAST_ERROR = 1e-15  # of a sample's variance: what rounding leaves of what can be predicted


class Whitened(NamedTuple):
    """Vectors whose noise is white, of variance 1.

    Parameters
    ----------
    values : ndarray of complex128, shape (V, N)
        The vectors times the inverse of Cholesky's factor of the covariance.
    log_determinant : float
        Of the covariance.
    predictor : ndarray of complex128, shape (N,)
        The last one.
    error : float
        Its variance.
    """

    values: Complex
    log_determinant: float
    predictor: Complex
    error: float


@compiled
def whiten(column: Complex, vectors: Complex) -> Whitened:
    """Whiten vectors (V, N) by the Toeplitz covariance with the first column (N,); O(V N^2).

    The covariance is to be positive definite. With no vector the predictor alone is computed.
    """
    size, count = column.size, vectors.shape[0]
    a, turned = np.zeros(size, np.complex128), np.zeros(size, np.complex128)
    values = np.empty_like(vectors)
    a[0], error, log_determinant = 1.0, column[0].real, 0.0
    least = _LEAST_ERROR * error
    for m in range(size):
        if m > 0:
            delta = 0j
            for i in range(m):
                delta += a[i] * column[m - i]
            reflection = -delta / error
            for i in range(m + 1):
                turned[i] = np.conj(a[m - i])
            for i in range(m + 1):
                a[i] += reflection * turned[i]
            error = max(error * (1.0 - (reflection.real**2 + reflection.imag**2)), least)
        log_determinant += np.log(error)
        over = 1.0 / np.sqrt(error)
        for v in range(count):
            total = 0j
            for i in range(m + 1):
                total += a[i] * vectors[v, m - i]
            values[v, m] = over * total
    return Whitened(values, log_determinant, a, error)


class Inverse:
    """The inverse of a Toeplitz covariance, from its last predictor; see the head of this module.

    Parameters
    ----------
    predictor : ndarray of complex128, shape (N,)
        As in :class:`Whitened`.
    error : float
        Its variance.
    """

    def __init__(self, predictor: Complex, error: float) -> None:
        self._size, self._error, self._predictor = len(predictor), error, predictor
        self._bins = scipy.fft.next_fast_len(2 * self._size)
        other = np.concatenate([[0.0], np.conj(predictor[:0:-1])])
        self._spectra = [scipy.fft.fft(v, self._bins) for v in (predictor, other)]

    def apply(self, vector: Complex) -> Complex:
        """``R^-1`` times vectors (..., N)."""
        first, second = (self._squared(vector, spectrum) for spectrum in self._spectra)
        return np.asarray((first - second) / self._error)

    def _squared(self, vector: Complex, spectrum: Complex) -> Complex:
        """``L L^H`` times vectors, ``L`` given by the spectrum of its first column."""
        upper = scipy.fft.ifft(np.conj(spectrum) * scipy.fft.fft(vector, self._bins))[..., : self._size]
        return np.asarray(scipy.fft.ifft(spectrum * scipy.fft.fft(upper, self._bins))[..., : self._size])

    def atom_energy(self, bins: int) -> Real:
        """``a(x)^H R^-1 a(x)`` of the atoms of the delays ``0, 1 / bins, ...`` turns, shape (bins,).

        ``bins`` is at least twice the number of tones.
        """
        place = np.arange(self._size)
        weighted = scipy.fft.fft(place * self._predictor, self._bins)
        plain, moment = (
            scipy.fft.ifft(self._spectra[0] * np.conj(other))[: self._size]
            for other in (self._spectra[0], weighted)
        )
        coefficients = ((self._size - place) * plain - 2.0 * moment) / self._error
        coefficients[0] *= 0.5
        return np.asarray(2.0 * scipy.fft.ifft(coefficients, bins, norm="forward").real)


def inverse_of(column: Complex) -> Inverse:
    """The inverse of the Toeplitz covariance with the first column (N,)."""
    none = whiten(column, np.empty((0, column.size), dtype=np.complex128))
    return Inverse(none.predictor, none.error)
