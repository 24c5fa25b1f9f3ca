"""Settings for all tests. They share one process, in which torch uses one thread: on a busy machine
more threads waste time waiting for each other. The process has more, so it must not be forked."""

import multiprocessing

import torch

multiprocessing.set_start_method("spawn", force=True)
torch.set_num_threads(1)
