"""What happened in a training so far: the rows of its tables, and its latest success rates."""

from collections import deque

WINDOW = 100  # episodes that a success rate is taken over, paper IV-B


class Record:
    """Every episode and every update."""

    def __init__(self):
        self.steps = 0
        self.seconds = 0.0  # of training
        self.episodes = []  # rows of episodes.csv
        self.updates = []  # rows of updates.csv
        self._last = {"training": deque(maxlen=WINDOW), "new": deque(maxlen=WINDOW)}

    def add_episode(self, row):
        """Adds an episode by its row of episodes.csv."""
        self.episodes.append(row)
        self._last[row["kind"]].append(row["outcome"] == "arrival")  # navbot_min.OUTCOMES

    def add_update(self, statistics):
        """Adds an update; returns its row of updates.csv."""
        row = {"steps": self.steps} | statistics
        row["steps_per_second"] = round(self.steps / self.seconds, 1)
        self.updates.append(row)
        return row

    def success(self, kind):
        """Success rate of the last 100 episodes to targets of that kind; None before the first."""
        last = self._last[kind]
        return sum(last) / len(last) if last else None

    def is_full(self, kind):
        """Whether there were 100 episodes to targets of that kind."""
        return len(self._last[kind]) == WINDOW

    def rates(self):
        """Both success rates, as the progress bar shows them."""
        return {f"{kind} reached": f"{self.success(kind):.0%}"
                for kind, last in self._last.items() if last}

    def state(self):
        """All that was recorded."""
        return {"steps": self.steps, "seconds": self.seconds,
                "episodes": list(self.episodes), "updates": list(self.updates)}

    def load_state(self, state):
        """Goes on from a state."""
        self.__init__()
        self.steps = state["steps"]
        self.seconds = state["seconds"]
        self.updates = list(state["updates"])
        for row in state["episodes"]:
            self.add_episode(row)
