"""The command line: `python -m evaluation runs/env1-seed0` examines a run's frozen policy,
`python -m evaluation --planner bug` a planner.

It prints what it measures, and writes it as `evaluation.json`, with the driven paths as
`trajectories.png`, success by place as `floor.png`, and one episode as `episode.gif`: into the
run's folder, else into a folder of `evaluations`.
"""

from support.interruption import interruption

if __name__ == "__main__":
    interruption.handle()  # before torch is loaded: Ctrl-C is one line from the beginning

import json
import sys
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import scenes
from evaluation.drivers import Planned, Policy
from evaluation.examine import conditions, evaluate, film_episode, table
from evaluation.planners import PLANNERS
from evaluation.protocols import HIDDEN, PATCH, PROTOCOLS, protocol_scenes
from robot.environment import environment_of
from sim import SceneError
from support.command_line import CommandLine, option
from support.cores import ProcessLost, available_cores, one_thread
from support.run_folder import RunError, WriteError, write
from support.weights import load_run

MOST_DRAWN = 4  # scenes of a run whose paths are drawn


@dataclass
class Options:
    """An evaluation."""
    run: str = option("", "whose policy drives: a run's folder such as runs/env1-seed0, or a file "
                      "of weights such as pretrained/env1.pt; by default none, then --planner says "
                      "who drives", positional=True)
    planner: str = option("", "a planner drives, not a run's policy; by default none",
                          choices=["", *PLANNERS])
    env: str = option("", "another room to drive in: its name, a path (.toml, .world) or random:7; "
                      "by default the run's own, for a planner env1")
    protocol: str = option("", "where episodes start and lead; by default start, for a run of "
                           "level 3 anywhere", choices=["", *PROTOCOLS])
    hide: str = option("", "what the policy is not shown of its target: its place, its cube or "
                       "both; by default it is shown all", choices=HIDDEN)
    ring: bool = option(False, "the robot's ultrasonic sensors stop it")
    episodes: int = option(1000, "episodes to targets of each kind, with anywhere in all", 1,
                           10 ** 5)
    seed: int = option(0, "what all random numbers come from: another one, other episodes", 0)
    workers: int = option(0, "processes that share the episodes; by default 0: one for each core",
                          0, 64)
    replay: bool = option(False, "write replay.html, too: episodes to watch in a browser, with "
                          "what goes on in the network")
    json: bool = option(False, "print the evaluation alone, as JSON, on standard output")


@dataclass
class Examination:
    """Who is examined where, and where the results go."""
    name: str
    driver: object
    actions: str  # as evaluation.json names them
    scenes: list  # of Scenes, without what a protocol changes
    folder: Path
    suffix: str  # of the files' names
    environment: type  # NavVecEnv or a subclass of it


def own_protocol(run):
    """The protocol of the task that a run's folder was trained for; without one, `start`."""
    try:
        config = json.loads((run / "config.json").read_text(encoding="utf-8"))
        return "anywhere" if config["targets"] == "anywhere" else "start"
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return "start"  # a file of weights, say


def prepare(run, options):
    """The Examination of a run, a folder or a .pt file, or where that is None of a planner. Raises
    RunError, SceneError."""
    own = own_protocol(run)
    options.protocol = options.protocol or own
    if run is None:
        chosen = [scenes.load("env1")]
        actions = options.planner
        driver = Planned(options.planner, options.seed)
        name = options.planner
    else:
        one_thread()
        model, chosen = load_run(run)
        # From the one start pose all episodes of deterministic actions would be the same.
        actions = "sampled" if options.protocol in ("start", "validation") else "mean"
        driver = Policy(model, actions, options.seed)
        name = run.stem
    if options.env:
        chosen = [scenes.load(options.env)]
    protocol_scenes(options.protocol, chosen)  # whatever it raises, before anything is driven
    place = f"-{chosen[0].name}" if options.env or run is None else ""
    # `evaluation.json` in a run's folder is training's own; at level 3 no other takes its place.
    suffix = "" if options.protocol == own == "start" else f"-{options.protocol}"
    if options.hide:
        suffix += f"-hidden-{options.hide}"
    if options.ring:
        suffix += "-ring"
    folder = Path("evaluations") / (name + place)
    if run is not None and run.is_dir():
        folder = run
        suffix = place + suffix
    environment = environment_of(chosen, options.ring)
    return Examination(name, driver, actions, chosen, folder, suffix, environment)


def heading(examined, options):
    """The line above the printed table: who, where, how, and where the files are."""
    who = examined.driver.label if options.planner else f"{examined.name}, {examined.driver.label}"
    rooms = ", ".join(scene.name for scene in examined.scenes[:MOST_DRAWN])
    if len(examined.scenes) > MOST_DRAWN:
        rooms += f" and {len(examined.scenes) - MOST_DRAWN} more"
    return (f"{who}, in {rooms}, {conditions(options.protocol, options.hide)}; files in "
            f"{examined.folder}")


def draw(examined, traces, options):
    """Writes the pictures of an evaluation, of its first scenes where there are many."""
    from support.pictures import draw_floor, draw_trajectories  # here and below: it takes a second

    for scene in examined.scenes[:MOST_DRAWN]:
        here = [trace for trace in traces if trace.scene.boxes == scene.boxes]
        figures = {"trajectories": draw_trajectories(scene, here)}
        if options.protocol in ("anywhere", "validation"):
            figures["floor"] = draw_floor(scene, here, PATCH)
        which = f"-{scene.name}" if len(examined.scenes) > 1 else ""
        for picture, figure in figures.items():
            path = examined.folder / f"{picture}{examined.suffix}{which}.png"
            write(path, partial(figure.savefig, dpi=110))


def film(examined, options):
    """Writes a film of one more episode by the same protocol, in the first scene."""
    from support.film import write_film

    scene = examined.scenes[0]
    trace = film_episode(examined.driver, scene, options.protocol, options.seed, options.hide,
                         examined.environment)
    trace = replace(trace, scene=scene)  # in which a validation target is no new target
    write(examined.folder / f"episode{examined.suffix}.gif", partial(write_film, trace))


def write_replay(examined, options):
    """Writes a page of some more episodes by the same protocol, in the first scene."""
    from evaluation.replay import make_page

    driver = examined.driver
    scene = examined.scenes[0]
    title = f"{examined.name} in {scene.name}, {conditions(options.protocol, '')}"
    page = make_page(title, driver.model, driver.actions, scene, options.protocol, options.seed,
                     examined.environment)
    path = examined.folder / f"replay{examined.suffix}.html"
    write(path, page)
    print(f"watch it: {path}", file=sys.stderr)


def read_command_line(argv):
    """The run, a path or None, the Options, and the parser, for later errors."""
    parser = CommandLine("Evaluate a frozen policy, or a planner, on fresh episodes.")
    options = parser.read(Options, argv)
    run = Path(options.run) if options.run else None
    if (run is None) == (options.planner == ""):
        parser.error("give either a run (a folder or a .pt file) or --planner")
    if options.replay and options.planner:
        parser.error("--replay needs a run: a planner has no network to look into")
    if options.replay and options.hide:
        parser.error(f"--hide is {options.hide}, with --replay it must be left out: the "
                     "page has an episode with the cube hidden")
    if options.hide and options.planner:
        parser.error(f"--hide is {options.hide}, it must be left out with --planner: planners are "
                     "told their target's position")
    return run, options, parser


def main(argv=None):
    """The command line: evaluate, print, write the evaluation, its pictures and its film."""
    interruption.handle("interrupted: the files that are written are whole")
    run, options, parser = read_command_line(argv)
    try:
        examined = prepare(run, options)
        parser.must_write_to(examined.folder)
        examined.folder.mkdir(parents=True, exist_ok=True)
        parser.remark(scenes.remark(options.env))
    except (RunError, SceneError, OSError) as error:
        parser.error(error)
    # Planners keep what they know to themselves.
    workers = 1 if options.planner else options.workers or len(available_cores())
    try:
        result, traces = evaluate(examined.driver, examined.scenes, options.episodes,
                                  options.protocol, options.seed, examined.actions, options.hide,
                                  examined.environment, workers)
        text = json.dumps(result, indent=2)
        write(examined.folder / f"evaluation{examined.suffix}.json", text)
        print(text if options.json else f"{heading(examined, options)}\n{table(result)}")
        draw(examined, traces, options)
        film(examined, options)
        if options.replay:
            write_replay(examined, options)
    except (WriteError, ProcessLost) as error:
        sys.exit(f"error: {error}")


if __name__ == "__main__":
    main()
