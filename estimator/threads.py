"""One thread for linear algebra, so that results do not depend on the number of cores.

A BLAS that splits a product among threads adds in another order, and the last bits
differ: the same seed would give other bytes on another laptop, or beside a cluster's
settings. The matrices here are small enough that one thread is also the fastest.
Another kind of processor may still round differently.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

from threadpoolctl import ThreadpoolController

__all__ = ["one_blas_thread"]


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Within this context, or the function it decorates, BLAS and LAPACK use one thread in this process."""
    with _libraries("scipy.linalg" in sys.modules).limit(limits=1, user_api="blas"):
        yield


@cache
def _libraries(with_scipy: bool) -> ThreadpoolController:
    """NumPy's BLAS and, once it is loaded, SciPy's, a library of its own; looking takes a millisecond."""
    return ThreadpoolController()
