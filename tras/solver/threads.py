"""Processors: how many threads a fit takes, and BLAS held to one, so that sums have the same bits."""

import os
from functools import cache
from multiprocessing import parent_process

from threadpoolctl import ThreadpoolController

_MOST = 8  # threads of a fit; each has a panel of rows of its own
_libraries = cache(ThreadpoolController)  # looking for the libraries takes milliseconds


def processors() -> int:
    """Threads that a fit takes by default: one per processor that this process may use; one in a child process."""
    if parent_process() is not None:  # one among others, which share the processors
        return 1
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(usable, _MOST)


def one_blas_thread():
    """A context in which BLAS has one thread: sums depend on their number, and small matrices are faster so."""
    return _libraries().limit(limits=1, user_api="blas")
