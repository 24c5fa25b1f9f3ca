"""Every unsolved exercise fails its tests, and every solution passes them."""

import importlib
from pathlib import Path

import pytest

from evaluation.planners import PLANNERS

FOLDER = Path(__file__).parent
NAMES = sorted(path.stem for path in (FOLDER / "exercises").glob("e*.py"))
assert len(NAMES) == 10


@pytest.fixture(autouse=True)
def remove_planner(monkeypatch):
    """Removes the planner of exercise 9 after each test."""
    monkeypatch.setitem(PLANNERS, "mine", None)


@pytest.mark.parametrize("name", NAMES)
def test_an_unsolved_exercise_fails_all_its_tests_and_the_solution_passes_them(name, monkeypatch):
    exercise = importlib.import_module(f"classroom.exercises.{name}")
    solution = importlib.import_module(f"classroom.solutions.{name}")
    tests = [value for key, value in vars(exercise).items() if key.startswith("test_")]
    [gap] = [key for key, value in vars(solution).items() if key in vars(exercise)
              and getattr(value, "__module__", None) == solution.__name__]
    assert tests and len(NAMES) == 10
    for test in tests:
        with pytest.raises(NotImplementedError, match="your turn"):
            test()
    monkeypatch.setattr(exercise, gap, getattr(solution, gap))
    for test in tests:
        test()
