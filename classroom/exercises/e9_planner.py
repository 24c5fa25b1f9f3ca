"""Exercise 9, open: a planner of your own.

Before learning there were rules, and some are hard to beat: yours is told its pose and has 72 range
readings, and no map. The project's are in `evaluation/planners.py`; `Braitenberg` is the shortest.
"""

import scenes
from evaluation import Planned, evaluate, table
from evaluation.planners import PLANNERS, Planner

ROOMS = ("env1", "env2", "maze3")


class Mine(Planner):
    """Your rule, in a sentence."""

    senses = True

    def act(self, pose, readings):
        """The command (v [m/s] up to 0.3, w [rad/s] up to 1, to the left) of one step of 0.4 s.

        pose: (x, y, theta). readings: (72,) [m] how far it is from the robot's centre to what is
        around it, up to 3 m, in the directions `evaluation.planners.ANGLES` from the heading. Where
        it has to go is `self.goal`, (x, y). The robot is a disc of 0.178 m radius.
        """
        raise NotImplementedError("your turn")


# ----------------------------------------------- python -m pytest classroom/exercises/e9_planner.py
# How good it is, room by room:                          python -m classroom.exercises.e9_planner


def success(room, name):
    """How many of 60 episodes from anywhere to anywhere arrive."""
    result, _ = evaluate(Planned(name, seed=0), [scenes.load(room)], 60, "anywhere")
    return result["anywhere"]["success"]


def test_it_arrives_more_often_than_driving_straight():
    PLANNERS["mine"] = Mine
    assert success("env1", "mine") > success("env1", "straight") + 0.2


def main():
    """Your planner in three rooms, beside two of the project's."""
    PLANNERS["mine"] = Mine
    for room in ROOMS:
        for name in ("mine", "braitenberg", "bug"):
            result, _ = evaluate(Planned(name, seed=0), [scenes.load(room)], 60, "anywhere")
            print(f"{room}, {name}\n{table(result)}")


if __name__ == "__main__":
    main()
