"""Evaluates a frozen driver on fresh episodes: `python -m evaluation`, or in a program
`evaluate(driver, scenes)`. torch is loaded only if a network drives."""

from evaluation.drivers import Planned, Policy  # noqa: F401  the public names
from evaluation.examine import evaluate, film_episode, report, rollouts, table  # noqa: F401
from evaluation.measures import ShortestPaths, spl, summarise, wilson  # noqa: F401
from evaluation.protocols import PATCH, Assignment, assign, validation_scene  # noqa: F401
