"""Ctrl-C, SIGTERM and a closed terminal: a program says one line and ends with the signal's code.

A training first comes to the end of its update, where it is saved; the same signal once more ends
it at once. Everything else ends where it is: no file is ever half-written.

Signals come to the whole process, so what became of them stands here, in one place.
"""

import multiprocessing
import os
import signal
import sys

# The last one comes when the terminal is closed; Windows has none.
SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP")
           if hasattr(signal, name)]
END = 128  # and the signal's number: the exit code of what a signal ends, as shells have it


class Interruption:
    """What became of the signals of this process."""

    def __init__(self):
        self.line = ""  # what is said when a signal ends the program
        self.patient = False  # whether the first signal of a kind is left to the program
        self.signals = []  # those that were left to it
        self.programs = set()  # Popen: programs under way, which get the signal first

    def handle(self, line="interrupted: nothing was begun"):
        """From here on a signal ends this process with that line."""
        self.line = line
        self.patient = False
        for number in SIGNALS:
            signal.signal(number, self._receive)

    def _receive(self, number, frame):
        if number not in (signal.SIGINT, signal.SIGTERM):
            self._be_silent()
        # torchrun passes a Ctrl-C on as SIGTERM: one of each kind is one wish.
        if self.patient and number not in self.signals:
            self.signals.append(number)
        else:
            self._leave(number)

    def _be_silent(self):
        """What is printed goes nowhere from here on: the terminal is closed."""
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)

    def leave_if_asked(self):
        """Ends the program, if there was a signal, and from here on a signal does so at once."""
        self.patient = False
        if self.signals:
            self._leave(self.signals[0])

    def _leave(self, number):
        """Ends the program and the processes that it started, wherever it is."""
        for program in list(self.programs):
            program.send_signal(number)
        for program in list(self.programs):
            program.wait()  # each comes to its own good end
        for process in multiprocessing.active_children():
            process.kill()
        if self.line:
            # As bytes: the signal may have come while something else was printed.
            os.write(sys.__stderr__.fileno(), f"\n{self.line}\n".encode())
        os._exit(END + number)


interruption = Interruption()


def leave_signals_to_others():
    """To be called by a process that another one started: that one decides."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
