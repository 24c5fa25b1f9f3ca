"""What a frozen policy can do: fresh episodes, outcomes, intervals, path lengths.

`python evaluate.py runs/env1-seed0` examines a run, `python evaluate.py --planner bug` a planner.
"""

import json
import math
import pickle
import sys
import warnings
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

from command_line import CommandLine, option
from model import Network
from navbot_min import MAX_COMMAND, OUTCOMES, NavVecEnv
from pictures import draw_floor, draw_trajectories, write_episode
from planners import ANGLES, PLANNERS, RANGE, visibility_graph
from render import CUBE_SIZE
from runs import write
from scene_file import load_scene, parse_scene
from sim import CONTROL_PERIOD, ROBOT_RADIUS, SceneError

EPISODES_PER_ROBOT = 8  # at most; the robots of all targets drive side by side
PROTOCOLS = ("paper", "perturbed", "anywhere", "validation")
KINDS = {"training": "all training targets", "new": "all new targets",
         "validation": "validation targets", "anywhere": "any free target"}
PATCH = 0.25  # [m] of floor.png, and from one validation target to the next
HIDDEN = ("", "place", "cube", "both")  # what a policy may not be shown of its target
Z95 = 1.959963984540054  # standard normal quantile of a two-sided 95 % interval


def wilson(successes, n):
    """The 95 % interval (low, high) of a proportion (Wilson 1927). n = 0 gives (0, 1)."""
    if n == 0:
        return 0.0, 1.0
    p, z2 = successes / n, Z95 ** 2
    centre, spread = p + z2 / (2 * n), Z95 * math.sqrt(p * (1 - p) / n + z2 / (4 * n * n))
    return max(0.0, (centre - spread) / (1 + z2 / n)), min(1.0, (centre + spread) / (1 + z2 / n))


def validation_scene(scene):
    """The scene to tune on, so that its new targets stay an exam. In their place it has the points
    of a grid that can be driven to, 0.5 m or more from the start and from each new target. Raises
    SceneError where there is none."""
    columns, rows = (np.ptp(scene.bounds, axis=0) / PATCH).astype(int)
    grid = scene.bounds[0] + PATCH * np.argwhere(np.ones((columns, rows)))
    to_free, to_training, to_others = (np.hypot(*(grid[:, None] - points).T).min(0) for points in (
        scene.reachable, np.array(scene.training_targets), [scene.start[:2], *scene.new_targets]))
    spots = grid[(to_free < 0.02) & (to_training >= CUBE_SIZE) & (to_others >= 0.5)]
    if not len(spots):
        raise SceneError(f"{scene.name} has no room for validation targets: none of a grid of "
                         f"{PATCH} m is 0.5 m from the start and the new targets")
    return replace(scene, new_targets=tuple(map(tuple, spots.tolist())))


class Exam(NavVecEnv):
    """Episodes as a protocol asks for them: `paper`, the paper's start and heading; `perturbed`,
    the start moved by 5 cm and 10 degrees, one standard deviation each, drawn again until free;
    `anywhere`, any reachable start and goal at least 1 m apart (in a smaller room, as far as can
    be), at any heading; `validation`, as `paper`, in the `validation_scene`. hidden: `place`, the
    observed distance and bearing are 0; `cube`, the camera does not show the target; `both`."""

    def __init__(self, scene, targets, protocol, hidden=""):
        super().__init__(len(targets), scene, targets)
        self.protocol, self.hidden = protocol, hidden

    def _observe(self, robots, poses, targets, velocity, reward):
        seen = super()._observe(robots, poses, targets, velocity, reward)
        if self.hidden in ("place", "both"):
            seen["target"] = np.zeros_like(seen["target"])
        if self.hidden in ("cube", "both"):
            elsewhere = targets + 1000  # [m]
            seen["image"] = self.camera.render(self.room[robots], poses, elsewhere)
        return seen

    def draw(self, r):
        target, goal, start = super().draw(r)
        scene, rng = self.world.scenes[r], self.np_random
        while self.protocol == "perturbed":
            moved = start + rng.normal(0, (0.05, 0.05, np.radians(10)))
            if scene.clearance(moved[:2]) > ROBOT_RADIUS:
                return target, goal, moved
        if self.protocol == "anywhere":
            goal = scene.reachable[rng.integers(len(scene.reachable))]
            distances = np.hypot(*(scene.reachable - goal).T)
            away = scene.reachable[distances >= min(1, distances.max())]
            start = (*away[rng.integers(len(away))], rng.uniform(-np.pi, np.pi))
        return target, goal, start


class Policy:
    """Drives an Exam's robots with a network. actions: "sampled" or "mean"."""

    def __init__(self, model, actions, seed):
        self.model, self.sampled = model, actions == "sampled"
        self.generator = torch.Generator().manual_seed(seed)

    def begin(self, env):
        self.state = self.model.initial_state(env.num_envs)

    def act(self, env, observations):
        mean, sampled, _, _, self.state = self.model.act(observations, self.state, self.generator)
        return (sampled if self.sampled else mean).numpy()

    def end(self, env, r):
        self.state[r] = 0


class Planned:
    """Drives an Exam's robots with a planner, each robot with one of its own."""

    def __init__(self, name, scene, seed):
        self.planner, self.scene = PLANNERS[name], scene
        self.rng = np.random.default_rng(seed)

    def begin(self, env):
        self.planners = [self.planner(self.scene, self.rng) for _ in range(env.num_envs)]
        for r in range(env.num_envs):
            self.end(env, r)

    def act(self, env, observations):
        angles = ANGLES if self.planner.senses else []
        readings = env.world.range_readings(angles, RANGE)
        return np.array([planner.act(pose, reading) for planner, pose, reading
                         in zip(self.planners, env.world.poses, readings)]) / MAX_COMMAND

    def end(self, env, r):
        self.planners[r].begin(env.world.poses[r], env.goals[r])


def rollouts(driver, scene, quotas, protocol="paper", seed=0, hidden=""):
    """Drives `quotas[k]` episodes to target k, for every k; returns a dict each: what `final_info`
    of the environment holds, `start` (3,), `goal` (2,), `path` (T + 1, 3) poses, `metres` driven.

    Which episodes count is fixed before they start, by a quota per robot: counting the first n that
    finish would favour short collisions.
    """
    targets, quota = [], []
    for k, n in enumerate(quotas):
        robots = math.ceil(n / EPISODES_PER_ROBOT)
        targets += [k] * robots
        quota += [n // robots + (i < n % robots) for i in range(robots)]
    env, quota, episodes = Exam(scene, targets, protocol, hidden), np.array(quota), []
    observations, infos = env.reset(seed=seed)
    paths, metres = [[pose] for pose in infos["pose"]], np.zeros(len(targets))
    driver.begin(env)
    bar = tqdm(total=quota.sum(), unit=" episodes", leave=False, disable=None)
    while quota.any():
        actions = driver.act(env, observations)
        starts, goals = env.starts.copy(), env.goals.copy()
        observations, _, terminated, truncated, infos = env.step(actions)
        metres += np.clip(actions[:, 0], 0, 1) * MAX_COMMAND[0] * CONTROL_PERIOD
        for path, pose in zip(paths, infos["pose"]):
            path.append(pose)
        for r in np.flatnonzero(terminated | truncated):
            if quota[r]:
                quota[r] -= 1
                bar.update()
                info = {key: value[r].item() for key, value in infos["final_info"].items()}
                episodes.append(info | {"start": starts[r], "goal": goals[r], "metres": metres[r],
                                        "path": np.array(paths[r])})
            paths[r], metres[r] = [env.world.poses[r]], 0
            driver.end(env, r)
    bar.close()
    return episodes


def watch(driver, scene, target, seed=0, hidden=""):
    """One episode to that target, by its index: the pose, image and velocity of every step."""
    env = Exam(scene, [target], "paper", hidden)
    observations, infos = env.reset(seed=seed)
    driver.begin(env)
    frames, over = [(infos["pose"][0], observations["image"][0], np.zeros(2))], False
    while not over:
        observations, _, terminated, truncated, infos = env.step(driver.act(env, observations))
        over = terminated[0] or truncated[0]
        seen = infos["final_obs"][0] if over else {key: v[0] for key, v in observations.items()}
        frames.append((infos["pose"][0], seen["image"].copy(), seen["velocity"]))
    return frames


@lru_cache(maxsize=None)
def shortest_path(scene, start, goal):
    """Metres that the robot's disc has to drive at least from start (x, y) until it arrives at the
    goal (x, y); inf where it cannot."""
    return visibility_graph(scene).path(start, goal)[1]


def spl(success, shortest, metres):
    """Success weighted by path length of one episode (Anderson et al. 2018, Eq. 1): the shortest
    path over what was driven. 1 where nothing had to be driven."""
    if not success or shortest == math.inf:
        return 0.0
    return shortest / max(shortest, metres) if shortest > 0 else 1.0


def summarise(scene, episodes):
    """Outcomes of those episodes as fractions that sum to 1, success with its 95 % interval, mean
    SPL, and the mean time to arrive [s], None where none arrived."""
    n = len(episodes)
    counts = {name: sum(e["outcome"] == name for e in episodes) for name in OUTCOMES}
    low, high = wilson(counts["arrival"], n)
    times = [e["length"] * CONTROL_PERIOD for e in episodes if e["outcome"] == "arrival"]
    weighted = [spl(e["outcome"] == "arrival", shortest_path(
        scene, tuple(e["start"][:2].tolist()), tuple(e["goal"].tolist())), e["metres"])
        for e in episodes]
    return {"n": n, "success": counts["arrival"] / n, "low": low, "high": high,
            "collision": counts["collision"] / n, "timeout": counts["timeout"] / n,
            "spl": sum(weighted) / n,
            "seconds_to_arrive": sum(times) / len(times) if times else None}


def evaluate(driver, scene, episodes=1000, protocol="paper", seed=0, actions="sampled", hidden=""):
    """Frozen evaluation: no learning, fresh episodes. Returns what `evaluation.json` holds, and the
    episodes.

    driver: a Policy or Planned. episodes: so many of each kind, training and new, split evenly over
    its targets; by `anywhere`, so many in all. hidden: as in `Exam`.
    """
    counts = [len(scene.training_targets), len(scene.new_targets)]
    quotas = [max(1, episodes // count + (k < episodes % count))
              for count in counts for k in range(count)]
    anywhere = protocol == "anywhere"
    done = rollouts(driver, scene, [episodes] if anywhere else quotas, protocol, seed, hidden)
    result = {"protocol": protocol, "actions": actions, "hidden": hidden, "training": None,
              "new": None}
    if anywhere:
        return result | {"anywhere": summarise(scene, done), "targets": []}, done
    kinds = ("training", "validation" if protocol == "validation" else "new")
    for kind, new in zip(kinds, (False, True)):
        result[kind] = summarise(scene, [e for e in done if e["new"] is new])
    result["targets"] = [{"x": float(x), "y": float(y), "kind": kinds[k >= counts[0]],
                          **summarise(scene, [e for e in done if e["target"] == k])}
                         for k, (x, y) in enumerate(scene.targets)]
    return result, done


def table(result):
    """An evaluation as lines of text: all targets of a kind, then a target a line."""
    rows, lines = {name: result.get(kind) for kind, name in KINDS.items()}, []
    for t in result["targets"] if result["protocol"] != "validation" else ():
        rows[f"{t['kind']} ({t['x']}, {t['y']})"] = t
    for name, row in rows.items():
        if row is None:
            continue
        time = f"{row['seconds_to_arrive']:.1f} s" if row["seconds_to_arrive"] else "-"
        lines.append(f"{name:23}  success {row['success']:6.1%} [{row['low']:.1%}, "
                     f"{row['high']:.1%}]  collision {row['collision']:6.1%}  "
                     f"timeout {row['timeout']:6.1%}  SPL {row['spl']:.2f}  "
                     f"arrives in {time}  n {row['n']}")
        if "mean_action_arrives" in row:
            lines[-1] += "  mean action " + ("arrives" if row["mean_action_arrives"] else "fails")
    return "\n".join(lines)


def report(summary):
    """What a training run says at its end: the rolling number that it stopped on and the frozen one
    side by side, then the table of the frozen evaluation."""
    why = "by the paper's rule" if summary["stopped_by_rule"] else "before the paper's rule was met"
    rolling, new = summary["rolling_new_success"], summary["frozen"]["new"]
    rolling = "no episode" if rolling is None else f"{rolling:.0%} of the last 100 episodes"
    return (f"stopped {why}: {summary['steps']:,} steps, {summary['episodes']:,} episodes, "
            f"{summary['seconds']:.0f} s\n"
            f"success on new targets: while training {rolling} | frozen {new['success']:.1%} "
            f"[{new['low']:.1%}, {new['high']:.1%}] of {new['n']:,} fresh episodes\n"
            + table(summary["frozen"]))


class RunError(ValueError):
    """A run that cannot be used; the message names it and says why."""


def load_run(path):
    """The network and the scene of a run folder, or of its weights' file. Raises RunError; what
    is in the file is never executed."""
    file = Path(path) / "model.pt" if Path(path).is_dir() else Path(path)
    if not file.is_file():
        raise RunError(f"run '{path}' has no {file.name}: it must be a run folder or a .pt file")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about files that are none of ours: the error says it
            saved = torch.load(file, weights_only=True, map_location="cpu")
        scene = parse_scene(saved["scene"], saved["scene"]["name"])
        model = Network(saved["memory"], saved["without"])
        model.load_state_dict(saved["weights"])
    except (pickle.UnpicklingError, EOFError, RuntimeError, KeyError, TypeError, ValueError,
            AttributeError) as error:
        missing = "it has no " if isinstance(error, KeyError) else ""
        reason = missing + (str(error) or type(error).__name__).splitlines()[0]
        raise RunError(f"'{file}' is not a whole run of this network: {reason[:200]}") from None
    return model, scene


@dataclass
class Options:
    """An evaluation."""
    planner: str = option("", "a planner instead of a run", choices=["", *PLANNERS])
    env: str = option("", "carry the policy into another room: a scene's name or path")
    protocol: str = option("paper", "where episodes start and lead",
                           choices=PROTOCOLS)
    hide: str = option("", "what the policy is not shown of its target: its place, its cube, both",
                       choices=HIDDEN)
    episodes: int = option(1000, "episodes to targets of each kind; by `anywhere` in all", 1)
    seed: int = option(0, "of every random number", 0)
    json: bool = option(False, "print the evaluation alone, as JSON, on standard output")


def main(argv=None):
    """The command line: evaluate, print, write the evaluation and its pictures."""
    parser = CommandLine("Evaluate a frozen policy, or a planner, on fresh episodes.")
    argv = sys.argv[1:] if argv is None else list(argv)
    run = argv.pop(0) if argv and not argv[0].startswith("-") else ""
    parser.usage = "evaluate.py [RUN] [options]"
    options = parser.read(Options, argv)
    if bool(run) == bool(options.planner):
        parser.error("give either a run (a folder or a .pt file) or --planner")
    if options.hide and options.planner:
        parser.error(f"--hide is {options.hide}, it must be left out with --planner: planners are "
                     "told their target's position")
    actions = "sampled" if options.protocol in ("paper", "validation") else "mean"
    try:
        model, scene = load_run(run) if run else (None, load_scene(options.env or "env1"))
        carried = bool(run and options.env)
        scene = load_scene(options.env) if carried else scene
        tasks = validation_scene(scene) if options.protocol == "validation" else scene
        driver = (Policy(model, actions, options.seed) if run
                  else Planned(options.planner, scene, options.seed))
        name = options.planner or Path(run).stem
        folder = Path(run) if run and Path(run).is_dir() else Path("evaluations") / (
            f"{name}-{scene.name}" if options.planner or carried else name)
        suffix = (f"-{scene.name}" if carried and folder == Path(run) else "") + (
            "" if options.protocol == "paper" else f"-{options.protocol}") + (
            f"-hidden-{options.hide}" if options.hide else "")
        folder.mkdir(parents=True, exist_ok=True)
    except (RunError, SceneError, OSError) as error:
        parser.error(error)
    try:
        result, episodes = evaluate(driver, tasks, options.episodes, options.protocol, options.seed,
                                    actions if run else options.planner, options.hide)
        write(folder / f"evaluation{suffix}.json", json.dumps(result, indent=2))
        print(json.dumps(result, indent=2) if options.json else
              f"{name} in {scene.name}, protocol {options.protocol}, in {folder}\n" + table(result))
        pictures = {"trajectories": draw_trajectories(scene, episodes)}
        if options.protocol in ("anywhere", "validation"):
            pictures["floor"] = draw_floor(scene, episodes, PATCH)
        for picture, figure in pictures.items():
            write(folder / f"{picture}{suffix}.png", partial(figure.savefig, dpi=110))
        frames = watch(driver, tasks, len(tasks.targets) - 1, options.seed, options.hide)
        write(folder / f"episode{suffix}.gif",
              partial(write_episode, scene, tasks.targets[-1], frames))
    except KeyboardInterrupt:
        sys.exit("interrupted: the files that are written are whole")


if __name__ == "__main__":
    main()
