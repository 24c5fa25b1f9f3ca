"""The cores of this machine, and jobs that are shared among them."""

import ctypes
import itertools
import multiprocessing
import os
import sys
import threading
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool

from support.interruption import leave_signals_to_others

UPDATES_PER_TRIM = 8  # from one time that free memory goes back to the system to the next


class ProcessLost(RuntimeError):
    """A process that shares work with others has ended before its time."""


def available_cores():
    """The cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count()))


def one_thread():
    """To be called by a program before it computes anything: torch keeps to one thread.

    Its own threads spin while they wait for each other, and where something else keeps a core busy
    they wait long. A program whose torch never had several threads can also be forked safely
    (numpy's are made for it), which spares the processes that it starts a second of importing and a
    copy of all modules.
    """
    import torch  # here, for planners do without it
    global _can_fork
    _can_fork = sys.platform == "linux"
    # Kernels that oneDNN keeps for another input of the same shape; hardly any comes, and its own
    # limit of 1,024 takes 300 MB.
    os.environ.setdefault("ONEDNN_PRIMITIVE_CACHE_CAPACITY", "16")
    torch.set_num_threads(1)


_can_fork = False
_updates = itertools.count(1)


def give_memory_back():
    """To be called at every update: at every eighth, gives the system back what this process has
    freed. Of itself glibc keeps the gaps between blocks of many sizes, 150 MB after a while of
    training; elsewhere there is nothing to do. At every update it would cost 7 % of the speed, for
    the system hands out no page that it has not cleared."""
    if sys.platform == "linux" and next(_updates) % UPDATES_PER_TRIM == 0:
        libc = ctypes.CDLL(None)
        if hasattr(libc, "malloc_trim"):  # other libraries for C have none
            libc.malloc_trim(0)


def context():
    """How this program starts processes: as was set by `multiprocessing.set_start_method`, or else
    as fast as is safe."""
    chosen = multiprocessing.get_start_method(allow_none=True)
    return multiprocessing.get_context(chosen or ("fork" if _can_fork else "spawn"))


def in_processes(function, jobs, workers):
    """What function(*job) returns for each of the jobs, in their order, from so many processes."""
    if workers == 1 or len(jobs) == 1:
        yield from (function(*job) for job in jobs)
        return
    try:
        with ProcessPoolExecutor(workers, context(), _start_job_worker) as pool:
            yield from pool.map(function, *zip(*jobs))
    except BrokenProcessPool:
        raise ProcessLost("one of the processes that share the work has ended, killed or out of "
                          "memory; --workers 1 needs the least memory") from None


def _start_job_worker():
    """What a process of `in_processes` does first."""
    leave_signals_to_others()
    threading.Thread(target=_end_with_parent, daemon=True).start()
    one_thread()
    sys.stderr = open(os.devnull, "w")  # the progress bars of several would overwrite each other


def _end_with_parent():
    """Waits for the process that started this one to end, killed perhaps, and ends this one too."""
    multiprocessing.parent_process().join()
    os._exit(1)
