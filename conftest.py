"""Tests share one process, which has had several threads: it must not be forked."""

import multiprocessing

multiprocessing.set_start_method("spawn", force=True)
