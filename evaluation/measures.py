"""Measures of episodes: success rate with its interval, path length, time."""

import functools
import math

from evaluation.planners import visibility_graph

Z95 = 1.959963984540054  # standard normal quantile of a two-sided 95 % interval


def wilson(successes, n):
    """Returns the 95 % interval (low, high) of a proportion (Wilson 1927); (0, 1) for n = 0."""
    if n == 0:
        return 0.0, 1.0
    p = successes / n
    z2 = Z95 ** 2
    scale = 1 + z2 / n
    centre = p + z2 / (2 * n)
    spread = Z95 * math.sqrt(p * (1 - p) / n + z2 / (4 * n * n))
    return max(0.0, (centre - spread) / scale), min(1.0, (centre + spread) / scale)


class ShortestPaths:
    """Lengths of shortest paths. Each graph is made once, and each path is searched once."""

    def __init__(self):
        self.graph = functools.cache(visibility_graph)
        self.length = functools.cache(lambda scene, *ends: self.graph(scene).path(*ends)[1])

    def metres(self, scene, start, goal):
        """Returns the length [m] of the shortest path from (x, y, ...) to arrival, or inf."""
        return self.length(scene, tuple(map(float, start[:2])), tuple(map(float, goal)))


def spl(success, shortest, metres):
    """Returns the success of one episode weighted by path length (Anderson et al. 2018, Eq. 1)."""
    if not success or shortest == math.inf:
        return 0.0
    return shortest / max(shortest, metres) if shortest > 0 else 1.0


def summarise(traces, paths=None):
    """Returns the fractions of outcomes, the success rate with its 95 % interval, the mean SPL and
    the mean time to arrive [s]; None if there are no episodes. paths: a ShortestPaths to share."""
    if not traces:
        return None
    paths = paths or ShortestPaths()
    n = len(traces)
    outcomes = [trace.outcome for trace in traces]
    times = [trace.seconds for trace in traces if trace.arrived]
    low, high = wilson(len(times), n)
    weighted = sum(spl(trace.arrived, paths.metres(trace.scene, trace.start, trace.goal),
                       trace.metres) for trace in traces)
    return {"n": n, "success": len(times) / n, "low": low, "high": high,
            "collision": outcomes.count("collision") / n, "timeout": outcomes.count("timeout") / n,
            "standing": outcomes.count("standing") / n,  # only in `robot.environment`, like `stops`
            "stops": sum(trace.stops for trace in traces) / n,  # by the ring of range sensors
            "spl": weighted / n,
            "seconds_to_arrive": sum(times) / len(times) if times else None}
