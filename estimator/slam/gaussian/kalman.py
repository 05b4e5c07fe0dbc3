"""The joint Kalman update of many hypotheses at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["kalman"]

Array = NDArray[np.float64]
_LOG_2PI = float(np.log(2.0 * np.pi))


def kalman(
    mean: Array,
    covariance: Array,
    jacobian: Array,
    innovation: Array,
    variance: Array,
    shared: Array | None = None,
    cross: Array | None = None,
) -> tuple[Array, Array, Array]:
    """Joint Kalman update of rows; also the log density of the innovations.

    Shapes: mean (R, n), covariance (R, n, n), jacobian (R, m, n), innovation and
    variance (R, m). A measurement a row does not use has a zero jacobian row and
    innovation and a variance of ``1 / (2 pi)``, so that it adds nothing at all.
    ``shared`` (R, m), if given, is an error all measurements have in common: its standard
    deviation in each of them. ``cross`` (R, m, n) is ``jacobian @ covariance``, if it is known.
    """
    cross = jacobian @ covariance if cross is None else cross
    size = innovation.shape[1]
    s = cross @ jacobian.transpose(0, 2, 1)
    np.einsum("rii->ri", s)[...] += variance  # a view of the diagonals
    if shared is not None:
        s += shared[:, :, None] * shared[:, None, :]
    root = np.linalg.cholesky(s)
    whiten = np.linalg.inv(root)
    gain = whiten @ cross  # (R, m, n)
    white = np.einsum("rij,rj->ri", whiten, innovation)
    mean = mean + np.einsum("rmn,rm->rn", gain, white)
    covariance = covariance - gain.transpose(0, 2, 1) @ gain
    log_determinant = 2.0 * np.log(np.einsum("rii->ri", root)).sum(axis=1)
    distance = np.einsum("ri,ri->r", white, white)
    return mean, covariance, -0.5 * (log_determinant + distance + size * _LOG_2PI)
