"""One thread for linear algebra: fits solve many small systems with a hundred unknowns.

With threads, BLAS waits for them longer than it computes. On two cores with one other process, a
fit of an action took 88 s of processor time instead of 20 s. Simulations have their own threads.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

#: Environment variables by which a user sets the number of threads; a set number is kept.
NUMBERS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def one_thread_from_the_start() -> None:
    """Limit the whole process; no effect after the import of NumPy."""
    if "numpy" not in sys.modules:
        for name in NUMBERS:
            os.environ.setdefault(name, "1")


#: Held by the block that has set the limit.
_limiting = threading.Lock()


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit a block of a process whose NumPy is already loaded, for example of a notebook.

    The limit holds for the whole process, and only the thread that set it can remove it. Blocks
    that begin within another one, in this or another thread, therefore change nothing.
    """
    if any(name in os.environ for name in NUMBERS) or not _limiting.acquire(blocking=False):
        yield
        return
    try:
        from threadpoolctl import threadpool_limits

        with threadpool_limits(limits=1, user_api="blas"):
            yield
    finally:
        _limiting.release()
