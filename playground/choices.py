"""The drivers that the page can choose; for a run under way, also its success rates."""

import csv
from pathlib import Path

import numpy as np

import scenes
from evaluation.drivers import Planned
from evaluation.planners import PLANNERS
from evaluation.replay import RecordingPolicy
from support.runs import RunError
from support.weights import FILE, load_model

HERE = Path(__file__).parent.parent
FOLDERS = {"pretrained": HERE / "pretrained", "classroom/runs": HERE / "classroom" / "runs",
           "runs": Path("runs")}  # prefix of a driver's name -> folder
YOU = "you"
WINDOW = 100  # episodes in a success rate, as in training
SPACING = 20  # episodes between two points of a curve
MOST_POINTS = 300


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
        found |= {f"{prefix}/{path.stem if path.suffix else path.name}": path
                  for path in sorted(files)}
    return found


def drivers():
    """Returns the names of all drivers."""
    return [YOU, *policies(), *PLANNERS]


def make_driver(name):
    """Returns the driver with this name, and its Run if it is one of `runs/`. Raises RunError."""
    if name == YOU:
        return You(), None
    if name in PLANNERS:
        return Planned(name, seed=0), None
    path = policies().get(name)
    if path is None:
        raise RunError(f"there is no driver {scenes.shown(name)} (any more)")
    run = Run(path) if path.is_dir() else None
    return RecordingPolicy(load_model(path)[0], "mean", seed=0), run


class Run:
    """A run folder, perhaps under way: whether its weights are newer, and its success rates."""

    def __init__(self, path):
        self.path = path
        self._time = self._modified()
        self._read = 0  # number of bytes of episodes.csv
        self._columns = []  # their names
        self._arrivals = {"training": [], "new": []}
        self._points = {"training": [], "new": []}

    def _modified(self):
        """Returns when the weights were written, or None if there are none (any more)."""
        file = self.path / FILE
        return file.stat().st_mtime_ns if file.exists() else None

    def newer_driver(self):
        """Returns a driver with the weights written since the last call, or None. Raises
        RunError."""
        before, self._time = self._time, self._modified()
        if self._time in (None, before):
            return None
        return RecordingPolicy(load_model(self.path)[0], "mean", seed=0)

    def curves(self):
        """Returns the success rates of the last WINDOW episodes: kind -> list of [steps, rate]."""
        try:
            with open(self.path / "episodes.csv", "rb") as file:
                file.seek(self._read)
                text = file.read()
        except OSError:
            text = b""
        text = text[:text.rfind(b"\n") + 1]  # a last line may be unfinished
        self._read += len(text)
        lines = text.decode().splitlines()
        if lines and not self._columns:
            self._columns = lines.pop(0).split(",")
        for row in csv.DictReader(lines, self._columns):
            arrivals = self._arrivals[row["kind"]]
            arrivals.append(row["outcome"] == "arrival")
            if len(arrivals) >= WINDOW and len(arrivals) % SPACING == 0:
                rate = sum(arrivals[-WINDOW:]) / WINDOW
                self._points[row["kind"]].append([int(row["steps"]), rate])
        return {kind: points[::-(-len(points) // MOST_POINTS) or 1]
                for kind, points in self._points.items()}
