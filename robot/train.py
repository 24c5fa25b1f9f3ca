"""Training in the lab or for it: `python -m robot.train --ring --init pretrained/env2.safetensors
--episodes 3000` does what `train.py` does, in an environment with a robot's errors."""

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
    env: str = option("lab", "name or file of the room, random:7 (one random room), random (many)")
    init: str = option("", "initial weights: folder of a run, or a weights file")
    ring: bool = option(False, "ultrasonic sensors stop the robot, as on the paper's robot")
    reality: str = option("", "random: draw the robot's errors in each episode; by default "
                          "they are those of the room's file", choices=("", "random"))
    episodes: int = option(0, "maximum number of episodes of all robots; 0: no limit", 0, 10 ** 9)


class Training(train.Training):
    """A Training in the environment for its rooms and options."""

    environment = RealVecEnv  # accepts all rooms

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
    """Returns the weights of `config.init` that training keeps, by name; {} if it is empty or the
    run resumes. The last layers and the standard deviations start from scratch: in a room that
    looks different the robot might stand still, with too little noise to learn. Raises RunError."""
    if not config.init or (config.resume and Path(config.resume, CHECKPOINT).exists()):
        return {}
    given, _ = load_model(config.init)
    if (given.memory, given.without) != (config.memory, config.without):
        raise RunError(f"--init '{config.init}' was trained with --memory {given.memory} and "
                       f"--without '{given.without}': use the same options")
    return {name: value for name, value in given.state_dict().items()
            if name.split(".")[0] in ("cnn", "memories", "dense")}


def main(argv=None):
    """Runs the command line: checks the initial weights, then trains as `train.py` does."""
    config, parser = parse(Config, "Train a robot to navigate despite its errors.", argv)
    try:
        if not config.resume:
            kept_weights(config)
            if config.reality and any(scene.reality for scene in load_rooms(config)):
                raise RunError(f"--reality {config.reality} does not work with --env {config.env}: "
                               "the room's file lists the robot's errors")
    except (RunError, SceneError) as error:
        parser.error(error)
    train.main(argv, Config, Training)


if __name__ == "__main__":
    main()
