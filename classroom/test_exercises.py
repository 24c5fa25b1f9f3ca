"""Every hole of the exercises fails, and every solution passes."""

import importlib
import inspect
from pathlib import Path

import pytest

from evaluation.planners import PLANNERS

FOLDER = Path(__file__).parent
NAMES = sorted(path.stem for path in (FOLDER / "exercises").glob("e*.py"))


def parts(name):
    """An exercise's module, its tests, and what its solution puts into its hole."""
    exercise = importlib.import_module(f"classroom.exercises.{name}")
    solution = importlib.import_module(f"classroom.solutions.{name}")
    tests = [value for key, value in vars(exercise).items() if key.startswith("test_")]
    filled = {key: value for key, value in vars(solution).items()
              if getattr(value, "__module__", None) == solution.__name__ and key in vars(exercise)}
    return exercise, tests, filled


@pytest.fixture(autouse=True)
def planners():
    """The planners stay as they are."""
    before = dict(PLANNERS)
    yield
    PLANNERS.clear()
    PLANNERS.update(before)


@pytest.mark.parametrize("name", NAMES)
def test_a_hole_fails_every_test_of_its_exercise(name):
    _, tests, filled = parts(name)
    assert tests and len(filled) == 1
    for test in tests:
        with pytest.raises(NotImplementedError, match="your turn"):
            test()


@pytest.mark.parametrize("name", NAMES)
def test_a_solution_passes_them(name, monkeypatch):
    exercise, tests, filled = parts(name)
    for key, value in filled.items():
        monkeypatch.setattr(exercise, key, value)
    for test in tests:
        test()


def test_there_are_ten_and_each_says_what_it_teaches_and_where_the_project_does_it():
    assert len(NAMES) == 10
    for name in NAMES:
        exercise, _, _ = parts(name)
        title, teaches = inspect.getdoc(exercise).split("\n\n")
        assert title.startswith(f"Exercise {name[1:].split('_')[0]}")
        assert ".py`" in teaches
        assert f"classroom/exercises/{name}.py" in inspect.getsource(exercise)
