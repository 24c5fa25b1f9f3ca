"""The command line: `python -m evaluation runs/env1-seed0` evaluates the frozen policy of a run,
`--planner bug` a planner. Files go to the run's folder, or else to a folder in `evaluations`."""

import json
import sys
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import scenes
from evaluation.drivers import Planned, Policy
from evaluation.examine import conditions, evaluate, film_episode, table
from evaluation.planners import PLANNERS
from evaluation.protocols import HIDDEN, PATCH, PROTOCOLS
from navbot_min import NavVecEnv
from support.cli import option, parse
from support.runs import ProcessLost, write

MOST_DRAWN = 4  # maximum number of scenes with pictures


@dataclass
class Options:
    """The options of an evaluation."""
    run: str = option("", "policy to evaluate: a run folder such as runs/env1-seed0, or a "
                      "weights file such as pretrained/env1.safetensors", positional=True)
    planner: str = option("", "planner to evaluate instead of a policy", choices=PLANNERS)
    env: str = option("", "room name or file, or random:7; by default the run's rooms or env1")
    protocol: str = option("", "default: start; for level 3: anywhere", choices=PROTOCOLS)
    hide: str = option("", "hide this part of the target from the policy", choices=HIDDEN)
    episodes: int = option(1000, "per kind of target; for anywhere, in total", 1, 10 ** 5)
    seed: int = option(0, "random seed", 0, 10 ** 9)
    workers: int = option(0, "number of processes, for a policy; 0: one per core", 0, 64)
    replay: bool = option(False, "also write replay.html: episodes with the network's activity")
    json: bool = option(False, "print only the evaluation, as JSON")

    def environment(self, scenes):
        """Returns the class of environment to drive in, and a suffix for the names of files."""
        return NavVecEnv, ""


class Examination:
    """One evaluation: driver, rooms and files. Raises RunError, SceneError."""

    def __init__(self, options):
        self.options = options
        config = Path(options.run, "config.json")
        run = json.loads(config.read_text()) if options.run and config.exists() else {}
        own = "anywhere" if run.get("targets") == "anywhere" else "start"
        options.protocol = options.protocol or own
        if options.planner:
            self.name = options.planner
            self.actions = options.planner
            self.driver = Planned(options.planner, options.seed)
            self.scenes = [scenes.load("env1")]
        else:
            import torch  # here, because planners do not need it
            from support.weights import load_model
            torch.set_num_threads(1)  # torch's own threads spin while they wait for each other
            self.name = Path(options.run).stem
            model, self.scenes = load_model(options.run)
            # With one start pose, all episodes with deterministic actions would be the same.
            sampled = options.protocol in ("start", "validation")
            self.actions = "sampled" if sampled else "mean"
            self.driver = Policy(model, self.actions, options.seed)
        if options.env:
            self.scenes = [scenes.load(options.env)]
        self.environment, suffix = options.environment(self.scenes)
        self.extras = suffix.replace("-", ", ")  # of a robot's environment, for the heading
        self.environment.check_rooms(self.scenes)
        if options.hide:
            suffix = f"-hidden-{options.hide}{suffix}"
        # Training writes `evaluation.json` in the run folder; at level 3 no evaluation replaces it.
        if not options.protocol == own == "start":
            suffix = f"-{options.protocol}{suffix}"
        place = f"-{self.scenes[0].name}" if options.env or options.planner else ""
        in_run = options.run and Path(options.run).is_dir()
        self.folder = Path(options.run) if in_run else Path("evaluations", self.name + place)
        self.suffix = place + suffix if in_run else suffix

    def path(self, name, which=""):
        """Returns the path of a file; `floor.png` becomes `FOLDER/floor-anywhere.png`."""
        stem, _, kind = name.partition(".")
        return self.folder / f"{stem}{self.suffix}{which}.{kind}"

    def evaluate(self):
        """Evaluates the driver, prints the result and writes it. Returns the Traces."""
        options = self.options
        result, traces = evaluate(
            self.driver, self.scenes, options.episodes, options.protocol, options.seed,
            self.actions, options.hide, self.environment,
            workers=1 if options.planner else options.workers)  # planners keep state
        text = json.dumps(result, indent=2)
        who = self.driver.label if options.planner else f"{self.name}, {self.driver.label}"
        rooms = ", ".join(scene.name for scene in self.scenes[:MOST_DRAWN])
        if len(self.scenes) > MOST_DRAWN:
            rooms += f" and {len(self.scenes) - MOST_DRAWN} more"
        heading = f"{who}, in {rooms}, {conditions(options.protocol, options.hide)}{self.extras}"
        print(text if options.json else f"{heading}; files in {self.folder}\n{table(result)}")
        self.folder.mkdir(parents=True, exist_ok=True)
        write(self.path("evaluation.json"), text)
        return traces

    def draw(self, traces):
        """Writes pictures of the evaluation, for the first scenes if there are many."""
        from support.pictures import draw_floor, draw_trajectories, save  # loads matplotlib
        for scene in self.scenes[:MOST_DRAWN]:
            here = [trace for trace in traces if trace.scene.boxes == scene.boxes]
            which = f"-{scene.name}" if len(self.scenes) > 1 else ""
            save(draw_trajectories(scene, here), self.path("trajectories.png", which))
            if self.options.protocol in ("anywhere", "validation"):
                save(draw_floor(scene, here, PATCH), self.path("floor.png", which))

    def show(self):
        """Writes a film of one more episode in the first scene and, with --replay, the page."""
        from support.film import write_film  # loads matplotlib
        scene = self.scenes[0]
        settings = self.options.protocol, self.options.seed
        trace = film_episode(self.driver, scene, *settings, self.options.hide, self.environment)
        # The film shows the room itself, without the validation targets.
        write(self.path("episode.gif"), partial(write_film, replace(trace, scene=scene)))
        if self.options.replay:
            from evaluation.replay import make_page
            title = f"{self.name} in {scene.name}, protocol {settings[0]}"
            page = make_page(title, self.driver.model, self.actions, scene, *settings,
                             self.environment)
            write(self.path("replay.html"), page)
            print(f"watch it: {self.path('replay.html')}", file=sys.stderr)


def main(argv=None, options_class=Options):
    """Runs the command line."""
    options, parser = parse(options_class, "Evaluate a policy or a planner.", argv)
    if bool(options.run) == bool(options.planner):
        parser.error("give either a run folder, a .safetensors file or --planner")
    if options.planner and (options.hide or options.replay):
        parser.error("--hide and --replay need a policy: a planner has no network")
    if options.hide and options.replay:
        parser.error("--replay cannot be combined with --hide: its page already hides the cube")
    try:
        examined = Examination(options)
        examined.draw(examined.evaluate())
        examined.show()
    except (ValueError, OSError, ProcessLost) as error:
        parser.error(error)
    except KeyboardInterrupt:
        sys.exit("\ninterrupted")


if __name__ == "__main__":
    main()
