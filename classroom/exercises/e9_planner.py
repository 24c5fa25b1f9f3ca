"""Exercise 9, open: a planner of your own.

Before learning there were rules, and some are hard to beat: yours is told its pose and has 72 range
readings, and no map. The project's are in `evaluation/planners.py`; `Braitenberg` is the shortest.
"""

import scenes
from evaluation import Planned, evaluate, table
from evaluation.planners import ANGLES, PLANNERS, Planner  # noqa: F401  ANGLES (72,) is for you

ROOMS = ("env1", "env2", "maze3")
BETTER = 0.2  # than driving straight, as a share of the episodes: 20 points


class Mine(Planner):
    """Your rule, in a sentence."""

    senses = True

    def act(self, pose, readings):
        """The command of one step of 0.4 s: v [m/s] from 0 to 0.3, ahead, and w [rad/s] from -1 to
        1, to the left.

        pose: (x [m], y [m], theta [rad]). readings: (72,) [m] how far it is from the robot's centre
        to what is around it, 3 where nothing is nearer, in the directions `ANGLES` [rad] from the
        heading, to the left positive: 36 is straight ahead. Where it has to go is `self.goal`,
        (x, y). The robot is a disc of 0.178 m radius. `polar`, `room_ahead` and `turn_and_go` of
        `evaluation/planners.py` may help.
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
    assert Mine.__bases__ == (Planner,)  # those of the project that have a map know more
    assert success("env1", "mine") > success("env1", "straight") + BETTER


def main():
    """Your planner in three rooms, beside two of the project's."""
    PLANNERS["mine"] = Mine
    for room in ROOMS:
        for name in ("mine", "braitenberg", "bug"):
            result, _ = evaluate(Planned(name, seed=0), [scenes.load(room)], 60, "anywhere")
            print(f"{room}, {name}\n{table(result)}")


if __name__ == "__main__":
    main()
