"""Algorithm 1: train on the training targets, record the new ones, stop by the paper's rule.

`python train.py --env env1` trains from scratch, evaluates the frozen policy on fresh episodes and
leaves a run's folder (docs/code.md).
"""

import math
import time
from dataclasses import dataclass

import numpy as np
import torch
from tqdm import tqdm

from model import BLANKS, MEMORIES, REWARD_SCALE, make_network
from navbot_min import MAX_COMMAND, NavVecEnv
from ppo import Collector, update
from support import parallel
from support.cli import option, parse
from support.rooms import make_rooms
from support.run_folder import begin_run, open_folder, report_errors

SUCCESS_RATE = 0.60  # r of Algorithm 1, paper IV-B
WINDOW = 100  # episodes that a success rate is taken over, paper IV-B
FINAL_STD = 0.2  # of the initial standard deviations, when a run uses all its steps, our choice
ANNEALING = 0.15  # fraction of the steps, the last ones, in which they shrink to it, our choice
STAGE = 50_000  # steps of 64 robots from one checkpoint to the next, our choice
STEPS_ALONE = 4  # of each process between two counts of all their episodes, our choice
COUNTED = ("stage", "steps", "episodes", "seconds", "arrivals")  # attributes of a Training


@dataclass
class Config:
    """A training run. The command line is made from these fields."""
    env: str = option("env1", "a room's name or file, random:7 (one random room), or random (many)")
    targets: str = option("both", "levels 1, 2 and 3 of the paper, II-B",
                          choices=("memorize", "both", "anywhere"))
    rooms: int = option(0, "random rooms to learn in; 0: always new ones", 0, 4096)
    seed: int = option(0, "the source of all random numbers", 0)
    steps: int = option(500_000, "steps of all robots together, at most", 1, 10 ** 9)
    fixed_budget: bool = option(False, "use all the steps: the paper's rule does not stop the run")
    robots: int = option(64, "R, robots that drive side by side", 1, 4096)
    random_starts: float = option(0.7, "fraction of training episodes that start anywhere", 0., 1.)
    mirrored: float = option(0.5, "fraction of the robots in the mirrored room", 0.0, 1.0)
    memory: str = option("stacked", "the network's LSTMs", choices=MEMORIES)
    without: str = option("", "an input to blank", choices=BLANKS)
    episodes_per_update: int = option(64, "N of Algorithm 1: episodes of an update", 1, 4096)
    workers: int = option(0, "processes; 0: one for each core, 4 at most", 0, 64)
    epochs: int = option(2, "K of Algorithm 1: passes over these episodes", 1, 1000)
    minibatches: int = option(4, "parts of an epoch, each of whole episodes", 1, 4096)
    learning_rate: float = option(1e-3, "of Adam at the start; it shrinks to 0", 1e-9, 1.0)
    gamma: float = option(0.99, "discount of future rewards, per step", 0.0, 1.0)
    lam: float = option(0.95, "lambda of generalised advantage estimation", 0.0, 1.0)
    clip: float = option(0.2, "epsilon of Eq. (3), the clip range", 1e-9, 1e9)
    device: str = option("cpu", "where the network runs", choices=("cpu", "cuda"))
    evaluation_episodes: int = option(1000, "after training, to targets of each kind", 1, 10 ** 5)
    out: str = option("", "a new folder for the run; by default runs/<env>-seed<k>")
    resume: str = option("", "the folder of a run to resume")
    json: bool = option(False, "print only the summary, as JSON")


class Training:
    """Everything that changes while a policy learns. Each process has one, with its own robots and
    random numbers; weights, steps and success rates are the same in all of them."""
    environment = NavVecEnv

    def __init__(self, config, scenes):
        """scenes: a list of Scenes."""
        self.folder = None  # a RunFolder, only in the first process
        self.config = config
        self.scenes = scenes
        self.rooms = make_rooms(config, scenes)
        self.robots = range(parallel.rank(), config.robots, parallel.count())  # of this process
        self.model = self.first_network().to(config.device)
        self.optimizer = torch.optim.Adam(self.model.parameters(), eps=1e-5, fused=True)
        self.rng = np.random.default_rng([config.seed, parallel.rank()])  # shuffles
        self.steps = 0  # of all robots
        self.episodes = 0
        self.seconds = 0.0
        self.arrivals = {"training": [], "new": []}  # of the last 100 episodes, whether it arrived
        self.stage = 0
        self.next_stage = 0  # steps at which it begins

    def first_network(self):
        """Returns the network that training begins with."""
        config = self.config
        return make_network(config.seed, config.memory, config.without, tuple(MAX_COMMAND.tolist()))

    def begin_stage(self):
        """Begins an episode of every robot, in random rooms in new rooms; drops those under way."""
        every = STAGE * self.config.robots / 64
        self.stage = int(self.steps / every)
        self.next_stage = (self.stage + 1) * every
        rng = np.random.default_rng([self.config.seed, parallel.rank(), self.steps])
        env_seed, action_seed = rng.integers(2 ** 31, size=2).tolist()
        rooms = [self.rooms.of_robot(r, self.stage) for r in self.robots]
        self.env = self.environment(len(rooms), rooms, self.config.targets,
                                    self.config.random_starts)
        self.collector = Collector(self.env, self.model, REWARD_SCALE, env_seed, action_seed)

    def success(self, kind):
        """Returns the success rate of the last 100 episodes to targets of a kind, None if none."""
        arrivals = self.arrivals[kind]
        return sum(arrivals) / len(arrivals) if arrivals else None

    def meets_rule(self):
        """The stop of Algorithm 1: the last 100 test episodes succeed at a rate above r."""
        return len(self.arrivals["new"]) == WINDOW and self.success("new") > SUCCESS_RATE

    def stops_by_rule(self):
        """Returns whether the paper's rule ends the run."""
        return self.meets_rule() and not self.config.fixed_budget

    def progress(self):
        """Returns the used fraction of the budget."""
        return self.steps / self.config.steps

    def is_over(self):
        """Returns whether the budget is used up, or the paper's rule ends the run."""
        return self.progress() >= 1 or self.stops_by_rule()

    def collect(self):
        """Drives all robots until there are N episodes to training targets, lines 3 to 5 of
        Algorithm 1, or the steps are used up. Returns the Episodes of this process, and the rows of
        episodes.csv of all that ended in any process."""
        episodes = []
        rows = []
        stored = 0  # episodes to training targets, of all processes
        short = 0  # processes that have too few for their minibatches
        while ((stored < self.config.episodes_per_update or short)
               and self.steps < self.config.steps):
            left = math.ceil((self.config.steps - self.steps) / self.config.robots)
            for _ in range(min(STEPS_ALONE, left)):
                self.steps += self.config.robots
                for episode, info in self.collector.step():
                    row = self.row_of(info)
                    rows.append(row)
                    if row["kind"] == "training":  # nothing is ever learned from new targets
                        episodes.append(episode)
            is_short = len(episodes) < self.config.minibatches
            stored, short = parallel.total(torch.tensor([len(episodes), is_short])).tolist()
        rows = [row for rows in parallel.gather(rows) for row in rows]
        return episodes, sorted(rows, key=lambda row: row["steps"])

    def row_of(self, info):
        """Returns the row of episodes.csv of an episode that has ended. info: its statistics."""
        new = info["new"] or self.rooms.is_watched(self.robots[info["robot"]])
        return {"steps": self.steps, "scene": self.env.scenes[info["scene"]].name,
                "target_x": info["goal_x"], "target_y": info["goal_y"],
                "kind": "new" if new else "training",
                "outcome": self.env.outcomes[info["outcome"]],
                "return": info["return"], "length": info["length"]}

    def record(self, row):
        """Counts an episode by its row of episodes.csv, and writes the row."""
        self.episodes += 1
        if self.folder:
            self.folder.tables["episodes.csv"].add(row)
        self.arrivals[row["kind"]].append(row["outcome"] == "arrival")
        del self.arrivals[row["kind"]][:-WINDOW]

    def learn(self, episodes):
        """Makes one update, writes its row of updates.csv and returns it. The learning rate shrinks
        linearly to 0 with the budget that is left. The standard deviation of the actions is limited
        to its initial value, in the last part of the budget to less, down to FINAL_STD of it."""
        left = max(1 - self.progress(), 0)
        self.optimizer.param_groups[0]["lr"] = self.config.learning_rate * left
        statistics = update(self.model, self.optimizer, episodes, self.config, self.rng,
                            parallel.total)
        self.model.limit_std(FINAL_STD + (1 - FINAL_STD) * min(left / ANNEALING, 1))
        row = {"steps": self.steps} | statistics
        row["steps_per_second"] = round(self.steps / max(self.seconds, 1e-9), 1)
        if self.folder:
            self.folder.tables["updates.csv"].add(row)
            self.folder.offer_weights(self.model, self.scenes)
        return row

    def state(self):
        """Returns what a stage begins with, for `load_state`. All processes call it together."""
        counted = {name: getattr(self, name) for name in COUNTED}
        return counted | {"model": self.model.state_dict(),
                          "optimizer": self.optimizer.state_dict(),
                          "rngs": parallel.gather(self.rng.bit_generator.state)}

    def save(self):
        """Writes a checkpoint and the weights. All processes call it together."""
        state = self.state()
        if self.folder and self.steps:
            self.folder.save_checkpoint(state)
            self.folder.offer_weights(self.model, self.scenes, now=True)

    def load_state(self, state):
        """Goes on from a state of a training with the same config."""
        self.model.load_state_dict(state["model"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.rng.bit_generator.state = state["rngs"][parallel.rank()]
        for name in COUNTED:
            setattr(self, name, state[name])


def train(training):
    """Algorithm 1, in our words:

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

    Here R robots do so side by side, one step at a time.
    """
    begin = time.perf_counter() - training.seconds
    with tqdm(initial=training.steps, total=training.config.steps, unit=" steps", mininterval=0.5,
              disable=parallel.rank() > 0) as bar:
        while not training.is_over():  # line 2
            if training.steps >= training.next_stage:
                training.save()
                training.begin_stage()
            episodes, rows = training.collect()  # lines 3, 4, 5, 6
            for row in rows:
                training.record(row)  # lines 9, 10
                if training.stops_by_rule():  # line 11
                    training.steps = row["steps"]  # what was driven after the stop does not count
                    break
            training.seconds = time.perf_counter() - begin
            bar.set_postfix({kind: training.success(kind) for kind in training.arrivals}, False)
            bar.update(training.steps - bar.n)
            if not training.is_over():
                training.learn(episodes)  # lines 7, 8
    training.save()


def run(config, scenes, training_class):
    """Trains in each process; returns the Training."""
    training = training_class(config, scenes)
    with open_folder(config) as folder:  # None in all processes except the first
        training.folder = folder
        state = parallel.gather(folder and folder.state)[0]  # that of the first process
        if state:
            training.load_state(state)
        train(training)
    return training


def main(argv=None, config_class=Config, training_class=Training):
    """The command line: train or resume, evaluate the frozen policy, summarise."""
    config, parser = parse(config_class, "Train a robot to navigate from its camera.", argv)
    with report_errors(config, parser):
        config, scenes = begin_run(config, parser, training_class.environment)
        training = parallel.run_together(run, config, scenes, training_class)
        if parallel.rank() == 0:
            from evaluation.after_training import finish  # the lesson ends here
            finish(training, SUCCESS_RATE)


if __name__ == "__main__":
    main()
