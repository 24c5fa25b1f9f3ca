"""The table of success in our simulation and in MuJoCo, results/mujoco.csv. Policies drive in both,
and in mixtures of both, which take one part from the other."""

import hashlib
from dataclasses import replace

import numpy as np
import pandas as pd

import scenes
from evaluation import Policy, evaluate
from experiments import runs
from experiments.tables import LOOK, RESULTS, ROOT
from robot.appearance import Cameras
from robot.environment import RealVecEnv
from robot.mujoco_robot import (POSE, WHEELS, MujocoCamera, MujocoVecEnv, MujocoWorld,
                                wheel_speeds)
from scenes.reality import Reality
from support.parallel import available_cores
from support.runs import write
from support.weights import load_model

EPISODES = 300  # of each cell
ROBOT = ("kobuki.xml", "mujoco_robot.py")
ROOMS = ("env1", "env2", "maze0", "maze4")  # for policies that drive in any room
LEVEL_2 = ("env1", "env2")  # policies, and the room of each
CELL = ("policy", "room", "protocol", "simulator", "weights")  # columns that name a cell


class OurImages(MujocoVecEnv):
    """MuJoCo with our images, from a level camera."""

    def __init__(self, *args, **options):
        super().__init__(*args, **options)
        self.camera = Cameras(self.scenes, self.appearance)


class LevelCamera(MujocoVecEnv):
    """MuJoCo with a camera that does not tilt with the robot."""

    def __init__(self, *args, **options):
        super().__init__(*args, **options)
        self.camera = MujocoCamera(self.scenes)


class TruePose(MujocoVecEnv):
    """MuJoCo with the true pose in place of odometry."""

    def _odometry(self, poses):
        return poses.copy()


class PromptWorld(MujocoWorld):
    """MujocoWorld whose robots have the commanded speed from the beginning of each period."""

    def drive(self, commands):
        for data, (v, w), speeds in zip(self.data, commands, wheel_speeds(commands)):
            heading = data.qpos[POSE[2]]
            data.qvel[POSE] = v * np.cos(heading), v * np.sin(heading), w
            data.qvel[WHEELS] = speeds
        return super().drive(commands)


class PromptWheels(MujocoVecEnv):
    """MuJoCo with wheels that follow their commands at once."""

    def __init__(self, *args, **options):
        super().__init__(*args, **options)
        self.world = PromptWorld(self.scenes)
        self.camera = MujocoCamera(self.scenes, self.world)


class MujocoImages(RealVecEnv):
    """Our simulation with the images of MuJoCo."""

    def __init__(self, *args, **options):
        super().__init__(*args, **options)
        self.camera = MujocoCamera(self.scenes)


WHOLE = {"ours": RealVecEnv, "MuJoCo": MujocoVecEnv}
MIXED = {"MuJoCo with our images": OurImages, "MuJoCo with a level camera": LevelCamera,
         "MuJoCo with the true pose": TruePose, "MuJoCo with prompt wheels": PromptWheels,
         "MuJoCo with late images": MujocoVecEnv, "ours with MuJoCo's images": MujocoImages}
# No policy of level 3 has seen the lab's appearance.
LOOKS = {f"{name}{LOOK}": environment for name, environment in WHOLE.items()}
SIMULATORS = WHOLE | MIXED | LOOKS
ERRORS = {name: Reality(appearance="lab") for name in LOOKS} | {
    "MuJoCo with late images": Reality(image_delay=1.0)}  # one period late


def cells():
    """Returns the cells of the table: policy, room, protocol, simulator, digest of the weights and
    of the robot's files."""
    robot = b"".join((ROOT / "robot" / name).read_bytes() for name in ROBOT)
    # From one start pose, mean actions would repeat one episode: start and target are perturbed.
    chosen = [(room, room, "perturbed", name) for room in LEVEL_2 for name in WHOLE]
    chosen += [("any-room", room, "anywhere", name) for name in SIMULATORS for room in ROOMS]
    chosen += [("drawn-errors", room, "anywhere", name) for name in WHOLE | LOOKS
               for room in ROOMS]
    return [(policy, *others,
             hashlib.sha256(weights(policy).read_bytes() + robot).hexdigest()[:8])
            for policy, *others in chosen if weights(policy).exists()]


def weights(policy):
    """Returns the path of a policy's weights."""
    return ROOT / "pretrained" / f"{policy}.safetensors"


def write_mujoco(episodes=EPISODES):
    """Makes mujoco.csv. Keeps the cells that have the same weights and number of episodes."""
    path = RESULTS / "mujoco.csv"
    rows = []
    if path.exists():
        rows = pd.read_csv(path, dtype={"weights": str}).to_dict("records")
    known = {}  # cell -> its rows
    for row in rows:
        if row["n"] == episodes:
            known.setdefault(tuple(row[key] for key in CELL), []).append(row)
    wanted = cells()
    for cell in wanted:
        if cell not in known:
            known[cell] = measure(*cell, n=episodes)
            rows = [row for key in wanted for row in known.get(key, [])]
            write(path, pd.DataFrame(rows).to_csv(index=False))


def measure(policy, room, protocol, simulator, digest, n):
    """Returns the rows of a cell with n episodes, one for each kind of targets."""
    driver = Policy(load_model(weights(policy))[0], "mean", seed=0)
    scene = replace(scenes.load(room), reality=ERRORS.get(simulator))
    result, _ = evaluate(driver, [scene], n, protocol, actions="mean",
                         environment=SIMULATORS[simulator], workers=available_cores())
    cell = dict(zip(CELL, (policy, room, protocol, simulator, digest)))
    return [cell | {"targets": kind} | runs.rates(result[kind])
            for kind in ("training", "new", "anywhere") if result.get(kind)]
