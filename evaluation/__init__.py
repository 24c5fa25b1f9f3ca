"""What a frozen driver can do: fresh episodes by a protocol, outcomes with intervals, path lengths.

`python -m evaluation runs/env1-seed0` examines a run, `python -m evaluation --planner bug` a
planner; `evaluate(driver, scenes)` does the same from a program. No part of it loads torch before a
network drives.
"""

import scenes  # first: it checks that no file of somebody else's stands in for one of ours
from evaluation.drivers import Planned, Policy
from evaluation.examine import evaluate, film_episode, report, rollouts, table
from evaluation.measures import ShortestPaths, spl, summarise, wilson
from evaluation.protocols import HIDDEN, PATCH, PROTOCOLS, Assignment, assign, validation_scene

__all__ = ["HIDDEN", "PATCH", "PROTOCOLS", "Assignment", "Planned", "Policy", "ShortestPaths",
           "assign", "evaluate", "film_episode", "report", "rollouts", "spl", "summarise", "table",
           "validation_scene", "wilson"]
