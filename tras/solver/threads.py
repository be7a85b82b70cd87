"""Processors: how many threads a fit takes, and BLAS held to one, so that sums have the same bits."""

import contextlib
import os
import threading
from functools import cache
from multiprocessing import parent_process

from threadpoolctl import ThreadpoolController

_SMALL = 500  # functions up to which threads of BLAS cost more than they bring
_MOST = 8  # threads of a fit; each has a panel of rows of its own
_libraries = cache(ThreadpoolController)  # looking for the libraries takes milliseconds


def processors() -> int:
    """Threads that a fit takes by default: one per processor that this process may use; one in a child process."""
    if parent_process() is not None:  # one among others, which share the processors
        return 1
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(usable, _MOST)


class _OneThread:
    """A context that the first of several users at a time enters, and the last one leaves.

    Each on its own would restore what it found, which is one thread if another one is still inside.
    """

    def __init__(self):
        self.lock, self.users, self.limiter = threading.Lock(), 0, None

    def __enter__(self):
        with self.lock:
            if not self.users:
                self.limiter = _libraries().limit(limits=1, user_api="blas")
            self.users += 1

    def __exit__(self, *error):
        with self.lock:
            self.users -= 1
            if not self.users:
                self.limiter.restore_original_limits()


_one_thread = _OneThread()


def one_blas_thread():
    """A context in which BLAS has one thread: sums depend on their number, and small matrices are faster so.

    The number is one of the process: fits of several threads share the context, and the last one to leave restores it.
    """
    return _one_thread


def few_blas_threads(size: int) -> contextlib.AbstractContextManager:
    """A context for matrices of this size: one thread of BLAS up to 500 rows, beyond that as many as there are.

    Threads wait for each other between small products, and that waiting takes processor time.
    """
    return one_blas_thread() if size <= _SMALL else contextlib.nullcontext()
