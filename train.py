"""Algorithm 1: train on the training targets, record the new ones, stop by the paper's rule.

`python train.py --env env1` trains from scratch, evaluates the frozen policy on fresh episodes and
leaves a run folder: config.json, episodes.csv, updates.csv, model.pt, curves.png, evaluation.json,
summary.json.
"""

from support.interruption import interruption

if __name__ == "__main__":
    interruption.handle()  # before torch is loaded: Ctrl-C is one line from the beginning

import math
import sys
import time
from dataclasses import asdict, dataclass

import numpy as np
from tqdm import tqdm

import scenes as scene_files
from model import BLANKS, MEMORIES, REWARD_SCALE
from navbot_min import OUTCOMES
from ppo import Collector, update
from robot.environment import REALITIES, environment_of
from sim import SceneError
from support.adam import Adam
from support.checkpoints import Keeper, NoKeeper
from support.command_line import CommandLine, option
from support.processes import join_processes
from support.record import Record
from support.rooms import make_rooms
from support.run_folder import NoFolder, RunFolder
from support.run_options import faults_as_one_line, open_run
from support.weights import first_network

SUCCESS_RATE = 0.60  # r of Algorithm 1, paper IV-B
FINAL_STD = 0.2  # of the initial standard deviations, when a run uses all its steps, our choice
ANNEALING = 0.15  # share of the steps, the last ones, in which they shrink to it, our choice
TASKS = ("memorize", "both", "anywhere")  # levels 1, 2 and 3 of the paper, II-B


@dataclass
class Config:
    """A training run. The command line is made from these fields."""
    env: str = option("env1", "a room's name or file, random:7 (one random room), or random (many)")
    targets: str = option("both", "one to memorize (level 1), both old and new ones (level 2), or "
                          "anywhere (level 3, and all there is in random rooms)", choices=TASKS)
    rooms: int = option(0, "random rooms to learn in; by default 0: ever new ones", 0, 4096)
    seed: int = option(0, "what all random numbers come from: another one, another run", 0)
    steps: int = option(500_000, "at most so many steps, all robots' together", 1, 10 ** 9)
    episodes: int = option(0, "so many are enough; by default 0: steps alone count", 0, 10 ** 9)
    fixed_budget: bool = option(False, "train for all the steps: the paper's rule stops nothing")
    init: str = option("", "a run's folder or weights to begin with; by default random weights")
    ring: bool = option(False, "sensors stop the robot: ultrasonic ones, as on the paper's robot")
    reality: str = option("", "random: how camera, odometry and wheels err is drawn anew each "
                          "episode; by default as the room's file says", choices=REALITIES)
    robots: int = option(64, "R, the robots that drive side by side", 1, 4096)
    random_starts: float = option(0.7, "share of training episodes that start anywhere", 0.0, 1.0)
    mirrored: float = option(0.5, "share of the robots that drive in the mirrored room", 0.0, 1.0)
    memory: str = option("stacked", "the network's memory: how many LSTMs", choices=MEMORIES)
    without: str = option("", "an input that is blanked; by default none", choices=BLANKS)
    episodes_per_update: int = option(64, "N of Algorithm 1: an update's episodes", 1, 4096)
    workers: int = option(0, "processes; by default 0: one for each core, 4 at most", 0, 64)
    epochs: int = option(2, "K of Algorithm 1: how often it learns from them", 1, 1000)
    minibatches: int = option(4, "parts of an epoch, each of whole episodes", 1, 4096)
    learning_rate: float = option(1e-3, "of Adam at the start; it shrinks to 0", 1e-9, 1.0)
    gamma: float = option(0.99, "discount of the rewards to come, a step", 0.0, 1.0)
    lam: float = option(0.95, "lambda of generalised advantage estimation", 0.0, 1.0)
    clip: float = option(0.2, "epsilon of Eq. (3): how far an update may go", 1e-9, 1e9)
    device: str = option("cpu", "where the network runs", choices=("cpu", "cuda"))
    evaluation_episodes: int = option(1000, "after training, to targets of each kind", 1, 10 ** 5)
    out: str = option("", "the run's folder, a new one; by default runs/<env>-seed<k>")
    resume: str = option("", "a run's folder: go on with that run; by default a new one begins")
    json: bool = option(False, "print the summary alone, as JSON, on standard output")


def rule_is_met(record):
    """The stop of Algorithm 1: the last 100 test episodes succeed at a rate above r."""
    return record.is_full("new") and record.success("new") > SUCCESS_RATE


class Training:
    """All that changes while a policy learns, in one place: network, optimiser, collector, record,
    buffer and random generators. `train` only steps it."""

    def __init__(self, config, scenes, processes, states=None):
        """scenes: a list of Scenes. processes: support.processes, which share robots and episodes:
        all hold the same weights and record, each has robots and random numbers of its own.
        states: of all processes, by their rank, where a training goes on from a checkpoint."""
        self.config = config
        self.processes = processes
        self.model = first_network(config).to(config.device)
        self.optimizer = Adam(self.model)
        self.rng = np.random.default_rng(config.seed)  # shuffles, the same in all processes
        self.robots = range(processes.rank, config.robots, processes.count)  # those of this process
        self.rooms = make_rooms(config, scenes)
        self.enter_rooms()
        self.record = Record()
        self.buffer = []  # episodes to training targets since the last update
        if states is not None:
            self.load_state(states[processes.rank])

    def enter_rooms(self):
        """Puts every robot into its room, where its next episode begins."""
        own_rng = np.random.default_rng([self.config.seed, self.processes.rank, self.rooms.moves])
        env_seed, action_seed = own_rng.integers(2 ** 31, size=2).tolist()
        self.env = self.make_env([self.rooms.of_robot(r) for r in self.robots])
        self.collector = Collector(self.env, self.model, REWARD_SCALE, env_seed, action_seed)

    def make_env(self, rooms):
        """The environment with a robot in each of these rooms."""
        environment = environment_of(rooms, self.config.ring, self.config.reality)
        return environment(len(rooms), rooms, self.config.targets, self.config.random_starts)

    def is_over(self):
        """Whether the steps are used up, or the paper's rule stops the run."""
        return self.progress() >= 1 or self.stopped_by_rule()

    def progress(self):
        """How much of the steps, or of the episodes, is used up: 1 is all."""
        used = self.record.steps / self.config.steps
        if self.config.episodes:
            used = max(used, len(self.record.episodes) / self.config.episodes)
        return used

    def stopped_by_rule(self):
        """Whether the paper's rule stops the run."""
        return rule_is_met(self.record) and not self.config.fixed_budget

    def collect(self):
        """Drives all robots until the buffer holds N episodes to training targets, lines 3 to 5 of
        Algorithm 1, or the steps are used up. Returns the rows of episodes.csv of the episodes that
        ended, in all processes, in their order. Raises FloatingPointError."""
        if self.rooms.move(self.record.steps):
            self.enter_rooms()
        ended = []  # here: an episode, or None if it is not learnt from, and its row
        stored = 0  # in all processes
        while stored < self.config.episodes_per_update and self.record.steps < self.config.steps:
            left = math.ceil((self.config.steps - self.record.steps) / self.config.robots)
            try:
                for _ in range(min(self.processes.steps_alone, left)):
                    self.record.steps += self.config.robots
                    ended += [self._ended(*pair) for pair in self.collector.step()]
                mine = sum(row["kind"] == "training" for _, row in ended)
            except FloatingPointError:
                mine = math.nan  # so all processes get to know
            stored = self.processes.count_all(mine)
        if math.isnan(stored):
            raise FloatingPointError("an observation or an action")
        everyone = [pair for pairs in self.processes.gather(ended) for pair in pairs]
        everyone.sort(key=lambda pair: pair[1]["steps"])
        self.buffer = [episode for episode, _ in everyone if episode is not None]
        return [row for _, row in everyone]

    def _ended(self, episode, info):
        """An episode that ended now, and its row of episodes.csv. What happens on the way to a new
        target, or in a room for validation, is never learnt from."""
        new = info["new"] or self.rooms.is_watched(self.robots[info["scene"]])
        row = {"steps": self.record.steps, "scene": self.env.scenes[info["scene"]].name,
               "target_x": info["goal_x"], "target_y": info["goal_y"],
               "kind": "new" if new else "training", "outcome": OUTCOMES[info["outcome"]],
               "return": info["return"], "length": info["length"]}
        return (None if new else episode), row

    def learn(self):
        """One update by the episodes in the buffer, which it empties. Returns its statistics.

        The learning rate shrinks linearly to 0 with the steps that are left, and in the last part
        of them so does the standard deviation of the actions, to FINAL_STD.
        """
        left = max(1 - self.progress(), 0)
        statistics = update(self.model, self.optimizer, self.config.learning_rate * left,
                            self.buffer, self.config, self.rng, self.processes)
        self.model.limit_std(FINAL_STD + (1 - FINAL_STD) * min(left / ANNEALING, 1))
        self.buffer = []
        return statistics

    def state(self):
        """All that changes, for `load_state`, between two updates."""
        weights = {name: value.clone() for name, value in self.model.state_dict().items()}
        return {"model": weights, "optimizer": self.optimizer.state(),
                "rng": self.rng.bit_generator.state, "collector": self.collector.state(),
                "record": self.record.state(), "rooms": self.rooms.state()}

    def load_state(self, state):
        """Goes on from a state of a training with the same config and scenes, exactly."""
        self.model.load_state_dict(state["model"])
        self.optimizer.load_state(state["optimizer"])
        self.rng.bit_generator.state = state["rng"]
        if self.rooms.load_state(state["rooms"]):
            self.enter_rooms()
        self.collector.load_state(state["collector"])
        self.record.load_state(state["record"])


def train(training, folder=NoFolder(), keeper=NoKeeper()):
    """Algorithm 1, in our words; `training` holds what changes, `folder` gets what happened.

     1  begin with random weights and an empty buffer
     2  repeat:
     3      draw a target from the set P, training and new targets together
     4      if it is a training target:
     5          drive to the episode's end, and store the episode in the buffer
     6          if the buffer holds N episodes:
     7              compute their advantages
     8              learn from them for K epochs by Eq. (3), and empty the buffer
     9      else:
    10          drive to the episode's end, and record only whether the robot arrived
    11          if more than r of the last 100 of these arrived: stop

    Here R robots do so side by side, a step at a time. keeper: saves the training between updates,
    from time to time and when it is interrupted, which ends it early.
    """
    record = training.record
    begin = time.perf_counter() - record.seconds
    tqdm.monitor_interval = 0  # no thread of the bar's own, for this process may be forked
    with tqdm(initial=record.steps, total=training.config.steps, unit=" steps", mininterval=0.5,
              disable=training.processes.rank > 0) as bar:
        while not training.is_over() and keeper.go_on(training):  # line 2
            for row in training.collect():  # lines 3, 4, 5
                record.add_episode(row)  # lines 9, 10
                folder.add_row("episodes.csv", row)
                if training.stopped_by_rule():  # line 11
                    record.steps = row["steps"]  # what was driven after the stop does not count
                    break
            record.seconds = time.perf_counter() - begin
            bar.set_postfix(record.rates(), refresh=False)
            bar.update(record.steps - bar.n)
            if not training.is_over():  # line 6
                folder.add_row("updates.csv", record.add_update(training.learn()))  # lines 7, 8
        keeper.save(training)


def train_along(config, scenes, states, processes):
    """What every process does but the first, which writes for all."""
    train(Training(config, scenes, processes, states), keeper=Keeper(NoFolder(), scenes))


def main(argv=None):
    """The command line: train or go on, evaluate the frozen policy, summarise."""
    interruption.handle()
    parser = CommandLine("Train a robot to navigate from its camera (Algorithm 1).")
    config = parser.read(Config, argv)
    config, scenes, states = open_run(config, parser, Training)
    processes = join_processes(train_along, config, scenes, states)
    training = Training(config, scenes, processes, states)
    with faults_as_one_line(config, training.record):
        folder = RunFolder(config, training.record)
        print(f"run folder: {folder.path}", file=sys.stderr if config.json else sys.stdout,
              flush=True)
        train(training, folder, Keeper(folder, scenes))
        processes.close()
        interruption.leave_if_asked()
        from evaluation.after_training import finish  # the lesson can do without, up to here
        finish(folder, training, scenes, SUCCESS_RATE)


if __name__ == "__main__":
    main()
