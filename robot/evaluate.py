"""Evaluation with a robot's errors: `python -m robot.evaluate pretrained/lab.safetensors --ring`
does what `python -m evaluation` does, in an environment with the errors of the room, and
`--simulator mujoco` in a simulator that is not ours."""

from dataclasses import dataclass

from evaluation import __main__ as evaluation
from robot.environment import environment_of
from support.cli import option
from support.runs import RunError


@dataclass
class Options(evaluation.Options):
    """An evaluation with a robot's errors."""
    ring: bool = option(False, "ultrasonic sensors stop the robot")
    simulator: str = option("ours", "simulator to drive in", choices=("ours", "mujoco"))

    def environment(self, scenes):
        suffix = "-ring" if self.ring else ""
        if self.simulator == "ours":
            return environment_of(scenes, self.ring), suffix
        from robot import mujoco_robot  # loads MuJoCo
        mujoco_robot.check_installed()
        if self.planner:
            raise RunError(f"--planner {self.planner} does not work with --simulator mujoco: "
                           "planners expect exact motion")
        kinds = mujoco_robot.MujocoVecEnv, mujoco_robot.MujocoRingVecEnv
        return kinds[self.ring], f"{suffix}-mujoco"


def main(argv=None):
    """Runs the command line."""
    evaluation.main(argv, Options)


if __name__ == "__main__":
    main()
