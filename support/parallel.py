"""Processes that train together. Each drives its own robots and learns from their episodes; the
gradient is the mean over all of them. `--workers 2` starts the processes, or torchrun does."""

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

PATIENCE = timedelta(minutes=5)  # of a process that waits for the others
MOST_WORKERS = 4  # by default: each takes memory, and more were not tried
LOST = "has ended, perhaps out of memory"


def available_cores():
    """Returns how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()


def torchrun(name):
    """Returns a number that torchrun has set; 0 without torchrun."""
    return int(os.environ.get(name, 0))


def rank():
    """Returns which of the processes this is. The first, which writes the files, is 0."""
    return distributed.get_rank() if distributed.is_initialized() else torchrun("RANK")


def count():
    """Returns how many processes there are."""
    return distributed.get_world_size() if distributed.is_initialized() else 1


def total(tensor):
    """Returns the sum of a tensor over all processes. Raises ProcessLost."""
    if count() == 1:
        return tensor
    sums = tensor.cpu()  # gloo has no sums on a GPU
    _with_others(distributed.all_reduce, sums)
    return sums.to(tensor.device)


def gather(mine):
    """Returns what every process has, a list by rank. Raises ProcessLost."""
    everyone = [mine] * count()
    if count() > 1:
        _with_others(distributed.all_gather_object, everyone, mine)
    return everyone


def _with_others(call, *arguments):
    """Calls what needs all processes. Raises ProcessLost."""
    try:
        call(*arguments)
    except RuntimeError as error:
        raise ProcessLost(f"another process of this training {LOST}") from error


def check_processes(config, parser):
    """Exits if a config's processes or device cannot be had. Sets `config.workers` if it is 0."""
    on_gpu = config.device == "cuda"
    started = torchrun("WORLD_SIZE")
    most = max(config.robots // 2, 1)  # of two robots, one is learned from at least
    if on_gpu and not torch.cuda.is_available():
        parser.error("--device is cuda, but torch finds no GPU here; it must be cpu")
    if config.workers == 0:
        config.workers = started or (1 if on_gpu else min(available_cores(), MOST_WORKERS, most))
    given = f"--workers is {config.workers}"
    if started not in (0, config.workers):
        parser.error(f"{given}, but torchrun started {started}")
    if on_gpu and config.workers > 1 and not started:
        parser.error(f"{given}, with --device cuda it must be 1, or started by torchrun")
    if config.workers > most:
        parser.error(f"{given}, it must be at most {most}: each needs two robots")
    if config.workers > 1 and not started and not has_gloo():
        if config.resume:
            parser.error(f"the run was begun with {config.workers} processes, gloo fails here")
        print("torch's gloo is missing or fails here: one process trains", file=sys.stderr)
        config.workers = 1


def has_gloo():
    """Returns whether torch's processes can talk to each other; in some builds they cannot."""
    try:
        distributed.init_process_group("gloo", store=distributed.HashStore(), rank=0, world_size=1)
        distributed.destroy_process_group()
    except (AttributeError, RuntimeError, ValueError):  # without gloo, torch lacks names too
        return False
    return True


def _context():
    """Returns how processes start: as `set_start_method` says, else by a fork on Linux."""
    fastest = "fork" if sys.platform == "linux" else "spawn"  # safe with one thread of torch
    return multiprocessing.get_context(multiprocessing.get_start_method(True) or fastest)


def run_together(work, config, *arguments):
    """Calls work(config, *arguments) in this process, the first, and at the same time in those
    that it starts, or in those of torchrun. Returns this one's result."""
    torch.set_num_threads(1)  # torch's own threads spin while they wait for each other
    if config.device == "cuda":  # torchrun starts one process for each GPU
        torch.cuda.set_device(torchrun("LOCAL_RANK"))
    with tempfile.TemporaryDirectory() as folder:
        how = f"file://{folder}/meeting", PATIENCE, config.workers
        if torchrun("WORLD_SIZE"):
            distributed.init_process_group("gloo")
        elif config.workers > 1:
            for k in range(1, config.workers):
                _context().Process(target=_work_along, args=(how, k, work, config, *arguments),
                                   daemon=True).start()
            _with_others(distributed.init_process_group, "gloo", *how, 0)
        try:
            return work(config, *arguments)
        finally:
            if distributed.is_initialized():
                distributed.destroy_process_group()


def _work_along(how, number, work, *arguments):
    """Works as one of several processes. The first process reports errors."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all; the first process decides
    torch.set_num_threads(1)
    try:
        _with_others(distributed.init_process_group, "gloo", *how, number)
        work(*arguments)
    except (ProcessLost, FloatingPointError):
        pass
    os._exit(0)  # without waiting for the others


def in_processes(function, jobs, workers):
    """Yields function(*job) for each of the jobs, in their order, computed by several processes.
    Raises ProcessLost."""
    if workers == 1 or len(jobs) == 1:
        yield from (function(*job) for job in jobs)
        return
    try:
        with ProcessPoolExecutor(workers, _context(), _start_worker) as pool:
            yield from pool.map(function, *zip(*jobs))
    except BrokenProcessPool:
        raise ProcessLost(f"a process that shares the work {LOST}") from None


def _start_worker():
    """Prepares a process of `in_processes`."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # Ctrl-C ends it at once
    torch.set_num_threads(1)
    sys.stderr = open(os.devnull, "w")  # several progress bars would overwrite each other
