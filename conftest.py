"""What holds for all tests. They share one process, in which torch keeps to one thread: its own
threads fall apart on a busy machine. It has other threads and must not be forked."""

import multiprocessing

import torch

multiprocessing.set_start_method("spawn", force=True)
torch.set_num_threads(1)
