"""Algorithm 1: train on the training targets, record success on new ones, stop by the paper's rule.

`python train.py --env env1` trains, evaluates the frozen policy and writes a run folder.
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
from support.run_folder import begin_run, open_folder, report_errors, restore, state_of

SUCCESS_RATE = 0.60  # r of Algorithm 1, paper IV-B
WINDOW = 100  # episodes of a rolling success rate, paper IV-B
LEAST_STD = 0.5  # lower limit of the actions' std, as a fraction of the upper, our choice
FINAL_STD = 0.1  # final upper limit, as a fraction of the initial value, our choice
ANNEALING = 0.15  # last fraction of the steps, in which it falls to FINAL_STD, our choice
STAGE = 50_000  # steps of 64 robots between two checkpoints; in proportion to R, our choice
COUNT_EVERY = 4  # steps between two counts of the episodes of all processes, our choice
RULE = f"more than {WINDOW * SUCCESS_RATE:.0f} of the last {WINDOW} test episodes succeed"


@dataclass
class Config:
    """A training run. The command line is made from these fields."""
    env: str = option("env1", "name or file of the room, random:7 (one random room), random (many)")
    targets: str = option("both", "level 1, 2 or 3 of the paper, II-B",
                          choices=("memorize", "both", "anywhere"))
    rooms: int = option(0, "number of random rooms; 0: always new ones", 0, 4096)
    seed: int = option(0, "random seed", 0, 10 ** 9)
    steps: int = option(500_000, "most steps, summed over robots (rounded up)", 1, 10 ** 9)
    fixed_budget: bool = option(False, "use all the steps: ignore the paper's stopping rule")
    robots: int = option(64, "R, number of robots that drive in parallel", 1, 4096)
    random_starts: float = option(0.7, "fraction of training episodes with random start", 0.0, 1.0)
    mirrored: float = option(0.5, "fraction of robots in the mirrored room", 0.0, 1.0)
    memory: str = option("stacked", "the network's memory", choices=MEMORIES)
    without: str = option("", "input to blank", choices=BLANKS)
    episodes_per_update: int = option(64, "N of Algorithm 1: episodes per update", 1, 4096)
    workers: int = option(1, "number of processes", 1, 64)
    epochs: int = option(1, "K of Algorithm 1: passes over the episodes of an update", 1, 1000)
    minibatches: int = option(16, "minibatches of whole episodes per epoch", 1, 4096)
    learning_rate: float = option(1e-3, "initial learning rate of Adam; decays to 0", 1e-9, 1.0)
    gamma: float = option(0.99, "discount factor per step", 0.0, 1.0)
    lam: float = option(0.95, "lambda of generalised advantage estimation", 0.0, 1.0)
    clip: float = option(0.2, "epsilon of Eq. (3), the clip range", 1e-9, 1e9)
    device: str = option("cpu", "device of the network", choices=("cpu", "cuda"))
    evaluation_episodes: int = option(1000, "final test episodes per kind of target", 1, 10 ** 5)
    out: str = option("", "new folder for the run; by default runs/<env>-seed<k>")
    resume: str = option("", "folder of a run to resume")
    json: bool = option(False, "print only the summary, as JSON")


class Training:
    """Everything that changes during training. Each process has one Training with its own robots
    and random numbers; weights, steps and success rates are the same in all of them."""
    environment = NavVecEnv

    def __init__(self, config, scenes):
        """scenes: a list of Scenes."""
        self.folder = None  # a RunFolder in the first process, None in the others
        self.config = config
        self.scenes = scenes
        self.rooms = make_rooms(config, scenes)
        self.robots = range(parallel.rank(), config.robots, parallel.count())  # of this process
        self.model = self.first_network().to(config.device)
        self.optimizer = torch.optim.Adam(self.model.parameters(), eps=1e-5, fused=True)
        self.rng = np.random.default_rng([config.seed, parallel.rank()])  # shuffles episodes
        self.steps = 0  # summed over all robots
        self.episodes = 0
        self.seconds = 0.0
        self.arrivals = {"training": [], "new": []}  # of the last 100 episodes, bools
        self.stage = 0
        self.next_stage = 0  # steps at which the next stage begins

    def first_network(self):
        """Returns the initial network."""
        config = self.config
        return make_network(config.seed, config.memory, config.without, tuple(MAX_COMMAND.tolist()))

    def begin_stage(self):
        """Drops the current episodes and begins new ones; random rooms are changed."""
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
        """Returns the success rate of the last 100 episodes to a kind of target, None if none."""
        arrivals = self.arrivals[kind]
        return sum(arrivals) / len(arrivals) if arrivals else None

    def stops_by_rule(self):
        """Returns whether more than a fraction r of the last 100 test episodes succeeded, which
        stops the run unless its budget is fixed."""
        enough = len(self.arrivals["new"]) == WINDOW and self.success("new") > SUCCESS_RATE
        return enough and not self.config.fixed_budget

    def progress(self):
        """Returns the fraction of the budget used."""
        return self.steps / self.config.steps

    def is_over(self):
        """Returns whether the budget is used up or the paper's rule stops the run."""
        return self.progress() >= 1 or self.stops_by_rule()

    def collect(self):
        """Drives all robots until at least N episodes to training targets have ended (lines 3 to 6
        of Algorithm 1) or the steps are used up. Returns this process's Episodes, and the rows of
        episodes.csv for the episodes of all processes."""
        episodes = []
        rows = []
        stored = 0  # episodes to training targets in all processes
        short = 0  # number of processes with too few episodes for their minibatches
        while ((stored < self.config.episodes_per_update or short)
               and self.steps < self.config.steps):
            left = math.ceil((self.config.steps - self.steps) / self.config.robots)
            for _ in range(min(COUNT_EVERY, left)):
                self.steps += self.config.robots
                for episode, info in self.collector.step():
                    row = self.row_of(info)
                    rows.append(row)
                    if row["kind"] == "training":  # new targets are never trained on
                        episodes.append(episode)
            is_short = len(episodes) < self.config.minibatches
            stored, short = parallel.total(torch.tensor([len(episodes), is_short])).tolist()
        rows = [row for rows in parallel.gather(rows) for row in rows]
        return episodes, sorted(rows, key=lambda row: row["steps"])

    def row_of(self, info):
        """Returns an episode's row of episodes.csv. info: its statistics."""
        # At level 3, episodes of a few robots, in validation rooms, count as new.
        new = info["new"] or self.rooms.is_watched(self.robots[info["robot"]])
        return {"steps": self.steps, "scene": self.env.scenes[info["scene"]].name,
                "target_x": info["goal_x"], "target_y": info["goal_y"],
                "kind": "new" if new else "training",
                "outcome": self.env.outcomes[info["outcome"]],
                "return": info["return"], "length": info["length"]}

    def record(self, row):
        """Counts an episode, given its row of episodes.csv, and writes the row."""
        self.episodes += 1
        if self.folder:
            self.folder.tables["episodes.csv"].add(row)
        self.arrivals[row["kind"]].append(row["outcome"] == "arrival")
        del self.arrivals[row["kind"]][:-WINDOW]

    def learn(self, episodes):
        """Makes one update, writes its row of updates.csv and returns it. The learning rate decays
        linearly to 0 as the budget is used up."""
        self.optimizer.param_groups[0]["lr"] = self.config.learning_rate * (1 - self.progress())
        statistics = update(self.model, self.optimizer, episodes, self.config, self.rng,
                            parallel.total)
        row = {"steps": self.steps} | statistics
        row["steps_per_second"] = round(self.steps / max(self.seconds, 1e-9), 1)
        if self.folder:
            self.folder.tables["updates.csv"].add(row)
            self.folder.offer_weights(self.model, self.scenes)
        return row

    def limit_std(self):
        """Limits the standard deviation of the actions. The limits fall at the end of the budget:
        until then exploration helps; then little noise disturbs the frozen policy."""
        left = max(1 - self.progress(), 0)
        highest = FINAL_STD + (1 - FINAL_STD) * min(left / ANNEALING, 1)
        self.model.limit_std(LEAST_STD * highest, highest)

    def save(self):
        """Writes a checkpoint and the weights. Call it in all processes."""
        state = state_of(self)
        if self.folder and self.steps:
            self.folder.save_checkpoint(state)
            self.folder.offer_weights(self.model, self.scenes, now=True)


def train(training):
    """Trains by Algorithm 1, in our words. R robots drive in parallel, one step at a time.

     1  begin with random weights and an empty buffer
     2  repeat:
     3      draw a target from the set P of training and new targets
     4      if it is a training target:
     5          drive until the episode ends and store the episode in the buffer
     6          if the buffer holds N episodes:
     7              compute their advantages
     8              update for K epochs by Eq. (3) and empty the buffer
     9      else:
    10          drive until the episode ends and record only whether the robot arrived
    11          if over a fraction r of the last 100 such episodes succeeded: stop
    """
    begin = time.perf_counter() - training.seconds
    config = training.config
    has_tests = config.targets == "both" or training.rooms.is_watched(config.robots - 1)
    shown = "{n_fmt} steps [{elapsed}, {rate_fmt}{postfix}], stops when " + RULE
    with tqdm(initial=training.steps, total=config.steps, unit=" steps", mininterval=0.5,
              disable=parallel.rank() > 0,
              bar_format=None if config.fixed_budget or not has_tests else shown) as bar:
        while not training.is_over():  # line 2
            if training.steps >= training.next_stage:
                training.save()
                training.begin_stage()
            episodes, rows = training.collect()  # lines 3 to 6, 10
            for row in rows:
                training.record(row)  # lines 9 to 11
                if training.stops_by_rule():  # line 11
                    training.steps = row["steps"]  # steps after the stop do not count
                    break
            training.seconds = time.perf_counter() - begin
            bar.set_postfix({kind: training.success(kind) for kind in training.arrivals}, False)
            bar.update(training.steps - bar.n)
            if not training.is_over():
                training.learn(episodes)  # lines 7, 8
            training.limit_std()
    training.save()


def run(config, scenes, training_class):
    """Trains, in each process. Returns the Training."""
    training = training_class(config, scenes)
    with open_folder(config) as folder:  # None in all processes except the first
        training.folder = folder
        state = parallel.gather(folder and folder.state)[0]  # from the first process
        if state:
            restore(training, state)
        train(training)
    return training


def main(argv=None, config_class=Config, training_class=Training):
    """Runs the command line: trains or resumes, evaluates the frozen policy, prints a summary."""
    config, parser = parse(config_class, "Train a robot to navigate from its camera.", argv)
    with report_errors(config, parser):
        config, scenes = begin_run(config, parser, training_class.environment)
        training = parallel.run_together(run, config, scenes, training_class)
        if parallel.rank() == 0:
            from evaluation.after_training import finish  # this is not part of the lesson
            finish(training, SUCCESS_RATE)


if __name__ == "__main__":
    main()
