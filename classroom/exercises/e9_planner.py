"""Exercise 9, open: write a planner.

Robots were driven by rules before they were trained, and some rules are hard to beat. Your planner
gets its pose and 72 range readings, but no map. In the project: `evaluation/planners.py`, in which
`Braitenberg` is the shortest.
"""

import scenes
from evaluation import Planned, evaluate, table
from evaluation.planners import ANGLES, PLANNERS, Planner  # noqa: F401  ANGLES (72,) is for you

ROOMS = ("env1", "env2", "maze3")
BETTER = 0.2  # success rate above that of driving straight: 20 percentage points


class Mine(Planner):
    """Describe your rule here in one sentence."""

    senses = True

    def act(self, pose, readings):
        """Returns the command of one step of 0.4 s: v [m/s] from 0 to 0.3, forwards, and w [rad/s]
        from -1 to 1, positive to the left.

        pose: (x [m], y [m], theta [rad]). readings: (72,) [m] distances from the robot's centre to
        the nearest obstacle, at most 3, in the directions `ANGLES` [rad] from the heading, positive
        to the left; index 36 is straight ahead. `self.goal` is the target (x, y). The robot is a
        disc with a radius of 0.178 m. `polar`, `room_ahead` and `turn_and_go` from
        `evaluation/planners.py` may help.
        """
        raise NotImplementedError("your turn")


# ----------------------------------------------- python -m pytest classroom/exercises/e9_planner.py
# Success in three rooms:                                python -m classroom.exercises.e9_planner


def success(room, name):
    """Returns the success rate in 60 episodes with random starts and random targets."""
    result, _ = evaluate(Planned(name, seed=0), [scenes.load(room)], 60, "anywhere")
    return result["anywhere"]["success"]


def test_it_arrives_more_often_than_driving_straight():
    PLANNERS["mine"] = Mine
    assert Mine.__bases__ == (Planner,)  # a planner of the project may have a map
    assert success("env1", "mine") > success("env1", "straight") + BETTER


def main():
    """Compares your planner with two planners of the project in three rooms."""
    PLANNERS["mine"] = Mine
    for room in ROOMS:
        for name in ("mine", "braitenberg", "bug"):
            result, _ = evaluate(Planned(name, seed=0), [scenes.load(room)], 60, "anywhere")
            print(f"{room}, {name}\n{table(result)}")


if __name__ == "__main__":
    main()
