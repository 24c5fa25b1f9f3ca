"""Training in the lab, and for it: `python -m robot.train --ring --init pretrained/env2.safetensors
--episodes 3000` trains as `train.py` does, in an environment with a robot's errors."""

from dataclasses import dataclass, replace
from pathlib import Path

import train
from robot.environment import RealVecEnv, environment_of
from sim import SceneError
from support.cli import option, parse
from support.rooms import load_rooms
from support.run_folder import CHECKPOINT
from support.runs import RunError
from support.weights import load_model


@dataclass
class Config(train.Config):
    """A training run with a robot's errors."""
    env: str = option("lab", "a room's name or file, random:7 (one random room), or random (many)")
    init: str = option("", "weights to begin with: a run's folder or a file")
    ring: bool = option(False, "ultrasonic sensors stop the robot, as on the paper's robot")
    reality: str = option("", "random: the robot's errors are drawn anew in each episode; by "
                          "default they are as the room's file says", choices=("", "random"))
    episodes: int = option(0, "of all robots, at most; 0: only the steps count", 0, 10 ** 9)


class Training(train.Training):
    """A Training in the environment that its rooms and options ask for."""

    environment = RealVecEnv  # which accepts all rooms

    def __init__(self, config, scenes):
        self.environment = environment_of(scenes, config.ring, config.reality)
        if any(scene.reality for scene in scenes):
            config = replace(config, mirrored=0.0)  # a real room has no mirror image
        super().__init__(config, scenes)

    def first_network(self):
        network = super().first_network()
        network.load_state_dict(kept_weights(self.config), strict=False)
        return network

    def progress(self):
        used = self.episodes / self.config.episodes if self.config.episodes else 0
        return max(super().progress(), used)


def kept_weights(config):
    """Returns what a training keeps of the weights that `config.init` names, by name; {} if it
    names none, or if the run resumes at a checkpoint. The last layers and the standard deviations
    begin anew: a robot that stands still, sure of itself in a room of another look, would learn
    next to nothing. Raises RunError."""
    if not config.init or (config.resume and Path(config.resume, CHECKPOINT).exists()):
        return {}
    given, _ = load_model(config.init)
    if (given.memory, given.without) != (config.memory, config.without):
        raise RunError(f"--init '{config.init}' was trained with --memory {given.memory} and "
                       f"--without '{given.without}': give the same ones")
    return {name: value for name, value in given.state_dict().items()
            if name.split(".")[0] in ("cnn", "memories", "dense")}


def main(argv=None):
    """The command line: checks the given weights, then trains as `train.py` does."""
    config, parser = parse(Config, "Train a robot to navigate in spite of its errors.", argv)
    try:
        if not config.resume:
            kept_weights(config)
            if config.reality and any(scene.reality for scene in load_rooms(config)):
                raise RunError(f"--reality is {config.reality}, with --env {config.env} it must be "
                               "left out: the room's file says what the robot's errors are")
    except (RunError, SceneError) as error:
        parser.error(error)
    train.main(argv, Config, Training)


if __name__ == "__main__":
    main()
