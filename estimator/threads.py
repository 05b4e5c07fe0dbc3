"""One thread for linear algebra, so that results do not depend on the number of cores.

A BLAS that splits a product among threads adds in another order, and the last bits
differ: the same seed would give other bytes on another laptop, or beside a cluster's
settings. The matrices here are small enough that one thread is also the fastest.
Another kind of processor may still round differently.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

import scipy.linalg
from threadpoolctl import ThreadpoolController

__all__ = ["one_blas_thread"]


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Within this context, or the function it decorates, BLAS and LAPACK use one thread in this process."""
    with _libraries().limit(limits=1, user_api="blas"):
        yield


@cache
def _libraries() -> ThreadpoolController:
    """NumPy's and SciPy's BLAS; both are loaded by now, and looking for them takes a millisecond."""
    assert scipy.linalg is not None
    return ThreadpoolController()
