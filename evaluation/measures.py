"""What is measured of driven episodes: success with its interval, path length, time."""

import math

from evaluation.planners import visibility_graph
from support.traces import OUTCOMES

Z95 = 1.959963984540054  # standard normal quantile of a two-sided 95 % interval


def wilson(successes, n):
    """The 95 % interval (low, high) of a proportion (Wilson 1927). n = 0 gives (0, 1)."""
    if n == 0:
        return 0.0, 1.0
    p = successes / n
    z2 = Z95 ** 2
    centre = p + z2 / (2 * n)
    spread = Z95 * math.sqrt(p * (1 - p) / n + z2 / (4 * n * n))
    low = (centre - spread) / (1 + z2 / n)
    high = (centre + spread) / (1 + z2 / n)
    return max(0.0, low), min(1.0, high)


class ShortestPaths:
    """How far a robot has to drive at least, in the scenes of one evaluation.

    The visibility graph of each scene is made once, when the scene is first asked for, and a path
    that was asked for before is not searched again: most episodes of a scene start at one place.
    """

    def __init__(self):
        self.lengths = {}  # (scene, start, goal) -> metres
        self._graphs = {}  # scene -> its graph

    def metres(self, scene, start, goal):
        """Metres that the robot's disc has to drive at least from start (x, y) until it arrives at
        the goal (x, y); inf where it cannot."""
        start = float(start[0]), float(start[1])
        goal = float(goal[0]), float(goal[1])
        key = scene, start, goal
        if key not in self.lengths:
            if scene not in self._graphs:
                self._graphs[scene] = visibility_graph(scene)
            _, self.lengths[key] = self._graphs[scene].path(start, goal)
        return self.lengths[key]

    def learn(self, lengths):
        """Takes over what others have measured, their `lengths`."""
        self.lengths |= lengths


def spl(success, shortest, metres):
    """Success weighted by path length of one episode (Anderson et al. 2018, Eq. 1): the shortest
    path over what was driven. 1 where nothing had to be driven."""
    if not success or shortest == math.inf:
        return 0.0
    if shortest == 0:
        return 1.0
    return shortest / max(shortest, metres)


def summarise(traces, paths=None):
    """Outcomes of those episodes as fractions that sum to 1, success with its 95 % interval, mean
    SPL, and the mean time to arrive [s], None where none arrived. No episodes give None.

    paths: a ShortestPaths, where several summaries are to share one.
    """
    paths = paths or ShortestPaths()
    n = len(traces)
    if n == 0:
        return None
    counts = {outcome: sum(trace.outcome == outcome for trace in traces) for outcome in OUTCOMES}
    low, high = wilson(counts["arrival"], n)
    times = [trace.seconds for trace in traces if trace.arrived]
    weighted = []
    for trace in traces:
        shortest = paths.metres(trace.scene, trace.start, trace.goal)
        weighted.append(spl(trace.arrived, shortest, trace.metres))
    return {"n": n, "success": counts["arrival"] / n, "low": low, "high": high,
            "collision": counts["collision"] / n, "timeout": counts["timeout"] / n,
            "standing": counts["standing"] / n,
            "stops": sum(trace.stops for trace in traces) / n,  # of the ring, an episode
            "spl": sum(weighted) / n,
            "seconds_to_arrive": sum(times) / len(times) if times else None}
