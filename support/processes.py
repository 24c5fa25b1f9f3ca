"""What several processes share that train together: the robots, the episodes, the gradients.

A reader of the lesson can skip this file: `OneProcess` does nothing. The others have the same
methods. `Worker` is one of several processes on this machine, as `--workers 2` starts them;
`TorchrunOnOneMachine` and `Torchrun` are those that `torchrun --nproc-per-node 2 train.py` starts.

Every process drives its own robots for `steps_alone` steps at a time. Then they tell each other how
many episodes they have; at an update they give each other these episodes, and each minibatch is cut
into parts, one for each process. Every sum is taken in the same order everywhere, so that the same
number of processes gives the same bytes.

Why processes, and not threads? Python runs one thread at a time, and the world and the camera are
Python: two threads drive no faster than one.
"""

import atexit
import mmap
import multiprocessing
import os
import pickle
import sys
import tempfile

import numpy as np
import torch
from torch import distributed

from support.cores import context, give_memory_back, one_thread
from support.interruption import interruption, leave_signals_to_others
from support.run_folder import RunError

STEPS_ALONE = 4  # from one count of the episodes to the next
SLOT = 2 ** 22  # bytes that a process can show the others at once, enough for a gradient
PATIENCE = 1.0  # [s] of waiting for the others, after which it looks whether they are alive


class OneProcess:
    """A process on its own: what all processes have is what it has."""

    rank = 0  # which of the processes this is
    count = 1  # how many there are
    steps_alone = 1  # steps of all robots from one count of the episodes to the next

    def gather(self, mine):
        """What every process has, in the order of their ranks."""
        give_memory_back()  # here, since it comes once in an update
        return [mine]

    def count_all(self, mine):
        """How many all processes have together, where this one has so many."""
        return mine

    def share(self, items, sizes):
        """Those of the items that are this process's. sizes: how much work each is, by item."""
        return items

    def average(self, gradient, statistics, weight):
        """The means of gradient and statistics over all processes, whose weights add up to 1."""
        return gradient, statistics

    def close(self):
        """Ends the other processes, if this one started them."""


class _OneOfMany:
    """One of several processes that drive robots of their own and cut minibatches into parts."""

    steps_alone = STEPS_ALONE

    def count_all(self, mine):
        """How many all processes have together, where this one has so many."""
        return self.sum(torch.tensor([float(mine)])).item()

    def share(self, items, sizes):
        """Those of the items that are this process's: the largest first, each goes to the process
        that has the least to do so far."""
        work = np.zeros(self.count)
        mine = []
        for item in sorted(items, key=lambda item: -sizes[item]):
            least = work.argmin()
            work[least] += sizes[item]
            if least == self.rank:
                mine.append(item)
        return np.array(mine)

    def average(self, gradient, statistics, weight):
        """The means of gradient and statistics over all processes, whose weights add up to 1."""
        total = self.sum(torch.cat([gradient, statistics]).mul_(weight))
        return total.split([len(gradient), len(statistics)])

    def close(self):
        """Nothing is left to do."""


class Gone(Exception):
    """The first process has ended, or needs the others no more."""


class Board:
    """Shared memory in which processes show each other what they have, and meet."""

    def __init__(self, context, count):
        self.memory = context.RawArray("B", 2 * count * SLOT)
        self.closed = context.RawValue("B", 0)
        self.arrived = [[context.Semaphore(0) for _ in range(count)] for _ in range(count)]


class _OnOneMachine(_OneOfMany):
    """One of several processes on this machine, which show each other what they have in memory that
    they share. They meet by `_meet`."""

    def __init__(self, rank, count, memory):
        """memory: 2 x count x SLOT bytes that all see."""
        self.rank = rank
        self.count = count
        # Two slots for each process, used in turn: nobody writes into what others may still read.
        self._slots = np.frombuffer(memory, np.uint8).reshape(2, count, SLOT)
        self._turn = 0

    def gather(self, mine):
        """What every process has, in the order of their ranks."""
        give_memory_back()
        content = pickle.dumps(mine, protocol=pickle.HIGHEST_PROTOCOL)
        sizes = self._show(np.array([len(content)])).view(np.int64)[:, 0].copy()
        parts = [bytearray() for _ in range(self.count)]
        others = [rank for rank in range(self.count) if rank != self.rank]
        for start in range(0, max(sizes), SLOT):
            shown = self._show(np.frombuffer(content[start:start + SLOT], np.uint8), SLOT)
            for other in others:
                parts[other] += shown[other, :max(min(sizes[other] - start, SLOT), 0)].data
        return [mine if rank == self.rank else pickle.loads(parts[rank])
                for rank in range(self.count)]

    def sum(self, tensor):
        """The sum of that tensor over all processes."""
        mine = tensor.numpy().reshape(-1)
        total = np.empty_like(mine)
        most = SLOT // mine.itemsize
        for start in range(0, len(mine), most):
            shown = self._show(mine[start:start + most]).view(mine.dtype)  # (processes, values)
            shown.sum(0, out=total[start:start + most])
        return torch.from_numpy(total).view_as(tensor)

    def _show(self, array, size=None):
        """Shows the others an array (n,), and returns what all show, (processes, bytes). They
        may change what is shown as soon as this process shows something else."""
        size = array.nbytes if size is None else size
        slots = self._slots[self._turn]
        self._turn = 1 - self._turn
        slots[self.rank, :array.nbytes] = array.view(np.uint8)
        self._meet()
        return slots[:, :size]


class Worker(_OnOneMachine):
    """One of the processes that `start_workers` started, or the first, which called it."""

    def __init__(self, rank, count, board):
        super().__init__(rank, count, board.memory)
        self.started = []  # the processes that this one started
        self._board = board

    def _meet(self):
        """Waits until all processes are here."""
        others = [other for other in range(self.count) if other != self.rank]
        for other in others:
            self._board.arrived[self.rank][other].release()
        for other in others:
            while not self._board.arrived[other][self.rank].acquire(timeout=PATIENCE):
                self._check_others()

    def _check_others(self):
        """Ends this process, too, where another one has ended. The first says so."""
        parent = multiprocessing.parent_process()
        if parent is None and not all(process.is_alive() for process in self.started):
            self.close()
            # On a line of its own, after the progress bar.
            sys.exit("\nerror: a worker of this training has ended, killed or out of memory; "
                     "--workers 1 needs the least memory")
        if parent is not None and (self._board.closed.value or not parent.is_alive()):
            raise Gone

    def close(self):
        """Ends the processes that this one started."""
        self._board.closed.value = 1
        for process in self.started:
            process.kill()  # it has nothing to save


def _start_worker(work, arguments, rank, count, board):
    """What a process does that was started to work along."""
    leave_signals_to_others()  # Ctrl-C goes to all; the first process decides
    one_thread()
    work_along(work, *arguments, Worker(rank, count, board))


def start_workers(count, work, *arguments):
    """Starts processes that call work(*arguments, processes), count - 1 of them. Returns the
    `processes` of this one, the first."""
    start = context()
    board = Board(start, count)
    first = Worker(0, count, board)
    for rank in range(1, count):
        process = start.Process(target=_start_worker, daemon=True,
                                  args=(work, arguments, rank, count, board))
        process.start()
        first.started.append(process)
    atexit.register(first.close)  # else, after a fault, they would wait for this one
    return first


class Torchrun(_OneOfMany):
    """One of the processes that torchrun started, on several machines or GPUs."""

    def __init__(self):
        self.rank = distributed.get_rank()
        self.count = distributed.get_world_size()

    def gather(self, mine):
        """What every process has, in the order of their ranks."""
        everyone = [None] * self.count
        distributed.all_gather_object(everyone, mine)
        return everyone

    def sum(self, tensor):
        """The sum of that tensor over all processes."""
        distributed.all_reduce(tensor)
        return tensor


class TorchrunOnOneMachine(_OnOneMachine):
    """One of the processes that torchrun started on this machine, without a GPU: memory is much
    faster than torch's network."""

    def __init__(self):
        count = distributed.get_world_size()
        name = [None]
        if distributed.get_rank() == 0:
            with tempfile.NamedTemporaryFile(prefix="navbot", delete=False) as file:
                file.truncate(2 * count * SLOT)
            name = [file.name]
        distributed.broadcast_object_list(name)
        with open(name[0], "r+b") as file:
            memory = mmap.mmap(file.fileno(), 0)
        super().__init__(distributed.get_rank(), count, memory)
        self._meet()
        if self.rank == 0:
            os.unlink(name[0])  # those who have it open keep it

    def _meet(self):
        """Waits until all processes are here."""
        distributed.barrier()


def join_torchrun(device):
    """This process among those that torchrun started."""
    distributed.init_process_group()
    atexit.register(distributed.destroy_process_group)  # else its threads may abort the exit
    if device == "cpu" and int(os.environ["LOCAL_WORLD_SIZE"]) == distributed.get_world_size():
        return TorchrunOnOneMachine()
    return Torchrun()


def join_processes(work, config, *arguments):
    """The first of the processes that share a training: those that torchrun started, or
    `config.workers`, which it starts. The others call work(config, *arguments, processes), and
    end."""
    one_thread()
    if config.device == "cuda":
        torch.cuda.set_device(int(os.environ.get("LOCAL_RANK", 0)))
    if torchrun_count() > 1:
        processes = join_torchrun(config.device)
        if processes.rank > 0:
            interruption.line = ""  # the first process says it
            work_along(work, config, *arguments, processes)
            sys.exit()
        return processes
    if config.workers > 1:
        return start_workers(config.workers, work, config, *arguments)
    return OneProcess()


def work_along(work, *arguments):
    """Calls work(*arguments), in another process than the first."""
    try:
        work(*arguments)
    except Gone:
        pass
    except (FloatingPointError, RunError):  # the first process meets it, too, and says so
        sys.exit(1)


def torchrun_rank():
    """Which of the processes that torchrun started this is; 0 without it."""
    return int(os.environ.get("RANK", 0))


def torchrun_count():
    """How many processes torchrun started; 0 without it."""
    return int(os.environ.get("WORLD_SIZE", 0))
