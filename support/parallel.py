"""Processes that train together. Each drives its own robots and learns from their episodes; the
gradient is averaged over all processes. `--workers 2` starts them, or torchrun does."""

import multiprocessing
import os
import signal
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from datetime import timedelta

import torch
from torch import distributed

from support.runs import ProcessLost

MAX_WAIT = timedelta(minutes=5)  # a process waits this long for the others
EXITED = "exited unexpectedly, perhaps out of memory"


def available_cores():
    """Returns the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()


def torchrun(name):
    """Returns an integer that torchrun sets in the environment; 0 if it is not used."""
    return int(os.environ.get(name, 0))


def rank():
    """Returns the number of this process. The first process, number 0, writes the files."""
    return distributed.get_rank() if distributed.is_initialized() else torchrun("RANK")


def count():
    """Returns the number of processes."""
    return distributed.get_world_size() if distributed.is_initialized() else 1


def total(tensor):
    """Returns the sum of a tensor over all processes. Raises ProcessLost."""
    if count() == 1:
        return tensor
    sums = tensor.cpu()  # gloo cannot sum on a GPU
    _with_others(distributed.all_reduce, sums)
    return sums.to(tensor.device)


def gather(item):
    """Returns the items of all processes, a list by rank. Raises ProcessLost."""
    items = [item] * count()
    if count() > 1:
        _with_others(distributed.all_gather_object, items, item)
    return items


def _with_others(call, *arguments):
    """Makes a call that involves all processes. Raises ProcessLost."""
    try:
        call(*arguments)
    except RuntimeError as error:
        raise ProcessLost(f"another training process {EXITED}") from error


def check_processes(config, parser):
    """Exits if the workers or the device are not available. A new run that torchrun starts has as
    many workers as torchrun has processes."""
    on_gpu = config.device == "cuda"
    started = torchrun("WORLD_SIZE")
    most = max(config.robots // 2, 1)  # two per process: one may be in a validation room
    if on_gpu and not torch.cuda.is_available():
        parser.error("--device is cuda, but torch finds no GPU; it must be cpu")
    if started and not config.resume and "workers" not in parser.given:
        config.workers = started
    given = f"--workers is {config.workers}"
    if started not in (0, config.workers):
        parser.error(f"{given}, but torchrun started {started} processes")
    if on_gpu and config.workers > 1 and not started:
        parser.error(f"{given}; with --device cuda it must be 1 unless torchrun starts them")
    if config.workers > most:
        parser.error(f"{given}; it must be at most {most}: each needs two robots")
    if config.workers > 1 and not started and not has_gloo():
        parser.error(f"{given}, but torch's gloo is missing or fails here; it must be 1")


def has_gloo():
    """Returns whether torch's processes can communicate; in some builds they cannot."""
    try:
        distributed.init_process_group("gloo", store=distributed.HashStore(), rank=0, world_size=1)
        distributed.destroy_process_group()
    except (AttributeError, RuntimeError, ValueError):  # a build without gloo lacks the names
        return False
    return True


def _context():
    """Returns the context that starts processes; by default it forks on Linux."""
    fastest = "fork" if sys.platform == "linux" else "spawn"  # safe with one thread of torch
    return multiprocessing.get_context(multiprocessing.get_start_method(True) or fastest)


def run_together(work, config, *arguments):
    """Calls work(config, *arguments) in several processes at once: in this one and in those that it
    or torchrun starts. Returns the result of this process."""
    torch.set_num_threads(1)  # torch's own threads spin while they wait for each other
    if config.device == "cuda":  # torchrun starts one process for each GPU
        torch.cuda.set_device(torchrun("LOCAL_RANK"))
    with tempfile.TemporaryDirectory() as folder:
        group = f"file://{folder}/meeting", MAX_WAIT, config.workers
        if torchrun("WORLD_SIZE"):
            distributed.init_process_group("gloo")
        elif config.workers > 1:
            for k in range(1, config.workers):
                _context().Process(target=_run_worker, args=(group, k, work, config, *arguments),
                                   daemon=True).start()
            _with_others(distributed.init_process_group, "gloo", *group, 0)
        try:
            return work(config, *arguments)
        finally:
            if distributed.is_initialized():
                distributed.destroy_process_group()


def _run_worker(group, number, work, *arguments):
    """Calls work(*arguments) in a process other than the first. The first one reports errors."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all; the first process handles it
    torch.set_num_threads(1)
    try:
        _with_others(distributed.init_process_group, "gloo", *group, number)
        work(*arguments)
    except (ProcessLost, FloatingPointError):
        pass
    os._exit(0)  # does not wait for the others


def in_processes(function, jobs, workers):
    """Yields function(*job) for each job, in order. Several processes compute the results.
    Raises ProcessLost."""
    if workers == 1 or len(jobs) == 1:
        yield from (function(*job) for job in jobs)
        return
    try:
        with ProcessPoolExecutor(workers, _context(), _start_worker) as pool:
            yield from pool.map(function, *zip(*jobs))
    except BrokenProcessPool:
        raise ProcessLost(f"a worker process {EXITED}") from None


def _start_worker():
    """Prepares a worker process of `in_processes`."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C ends it at once
    torch.set_num_threads(1)
    sys.stderr = open(os.devnull, "w")  # progress bars would overwrite each other
