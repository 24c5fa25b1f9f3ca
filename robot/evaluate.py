"""The evaluation with a robot's errors: `python -m robot.evaluate pretrained/lab.safetensors
--ring` evaluates as `python -m evaluation` does, in an environment with the errors of its room."""

from dataclasses import dataclass

from evaluation import __main__ as evaluation
from robot.environment import environment_of
from support.cli import option


@dataclass
class Options(evaluation.Options):
    """An evaluation with a robot's errors."""
    ring: bool = option(False, "ultrasonic sensors stop the robot")


def choose_environment(scenes, options):
    """Returns the class of environment to drive in, and what a file's name says of it."""
    return environment_of(scenes, options.ring), "-ring" if options.ring else ""


def main(argv=None):
    """The command line."""
    evaluation.main(argv, Options, choose_environment)


if __name__ == "__main__":
    main()
