"""The drivers that the page can choose; for a run under way, also its success rates."""

import csv
from pathlib import Path

import numpy as np

import scenes
from evaluation.drivers import Planned
from evaluation.planners import PLANNERS
from evaluation.replay import RecordingPolicy
from support.runs import RunError, read_table
from support.weights import FILE, load_model

HERE = Path(__file__).parent.parent
FOLDERS = {"pretrained": HERE / "pretrained", "classroom/runs": HERE / "classroom" / "runs",
           "runs": Path("runs")}  # prefix of a driver's name -> folder
YOU = "you"
WINDOW = 100  # episodes in a success rate, as in training
MOST_POINTS = 300  # of a curve


class You:
    """Stands still. The session adds the arrow keys to every driver's actions."""

    def reset(self, env, robots):
        """Does nothing: this driver has no memory."""

    def act(self, env, observations):
        """Returns the action (1, 2) that stands still."""
        return np.zeros((1, 2))


def policies():
    """Returns the policies that exist now: name -> Path of a weights file or a run folder."""
    found = {}
    for prefix, folder in FOLDERS.items():
        files = [*folder.glob("*.safetensors"), *(path.parent for path in folder.glob(f"*/{FILE}"))]
        found |= {f"{prefix}/{path.name if path.is_dir() else path.stem}": path
                  for path in sorted(files)}
    return found


def drivers():
    """Returns the names of all drivers."""
    return [YOU, *policies(), *PLANNERS]


def make_driver(name):
    """Returns the driver with this name, and its Run if it is the policy of a run folder. Raises
    RunError."""
    if name == YOU:
        return You(), None
    if name in PLANNERS:
        return Planned(name, seed=0), None
    path = policies().get(name)
    if path is None:
        raise RunError(f"there is no driver {scenes.shown(name)} (any more)")
    return policy(path), Run(path) if path.is_dir() else None


def policy(path):
    """Returns the driver for a weights file or a run folder. Raises RunError."""
    return RecordingPolicy(load_model(path)[0], "mean", seed=0)


class Run:
    """A run folder, perhaps under way: whether its weights are newer, and its success rates."""

    def __init__(self, path):
        self.path = path
        self.curves = success_rates(path)
        self._time = self._modified()

    def _modified(self):
        """Returns when the weights were written, or None if there are none (any more)."""
        file = self.path / FILE
        return file.stat().st_mtime_ns if file.exists() else None

    def newer_driver(self):
        """Returns a driver with the weights written since the last call, or None, and reads the
        success rates. Raises RunError."""
        before, self._time = self._time, self._modified()
        if self._time in (None, before):
            return None
        self.curves = success_rates(self.path)
        return policy(self.path)


def success_rates(folder):
    """Returns the success rates of the last WINDOW episodes: kind -> list of [steps, rate]. A table
    that cannot be read has none."""
    curves = {}
    try:
        rows = read_table(folder / "episodes.csv")[:-1]  # the last one may be incomplete
        for kind in ("training", "new"):
            own = [row for row in rows if row["kind"] == kind]
            arrived = [row["outcome"] == "arrival" for row in own]
            if len(own) >= WINDOW:
                rates = np.convolve(arrived, np.full(WINDOW, 1 / WINDOW), "valid")
                every = 1 + len(rates) // MOST_POINTS
                curves[kind] = [[int(own[k + WINDOW - 1]["steps"]), float(rates[k])]
                                for k in range((len(rates) - 1) % every, len(rates), every)]
    except (OSError, ValueError, KeyError, TypeError, csv.Error):
        return {}
    return curves
