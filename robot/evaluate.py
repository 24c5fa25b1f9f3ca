"""Evaluation with a robot's errors: `python -m robot.evaluate pretrained/lab.safetensors --ring`
does what `python -m evaluation` does, in an environment with the errors of the room."""

from dataclasses import dataclass

from evaluation import __main__ as evaluation
from robot.environment import environment_of
from support.cli import option


@dataclass
class Options(evaluation.Options):
    """An evaluation with a robot's errors."""
    ring: bool = option(False, "ultrasonic sensors stop the robot")

    def environment(self, scenes):
        return environment_of(scenes, self.ring), "-ring" if self.ring else ""


def main(argv=None):
    """Runs the command line."""
    evaluation.main(argv, Options)


if __name__ == "__main__":
    main()
