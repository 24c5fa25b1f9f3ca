"""Makes every published result: `python -m experiments.results` trains and evaluates each run of
`experiments.runs`, then makes tables and figures. If interrupted, run the command again."""

import itertools
import os
import shutil
import subprocess
import sys
import time
from dataclasses import replace

import pandas as pd

import scenes
from evaluation import Planned, Policy, evaluate, summarise
from evaluation.planners import PLANNERS
from experiments import figures, runs, tables
from experiments.mujoco import write_mujoco
from experiments.tables import RESULTS, ROOT
from robot.environment import RingVecEnv
from robot.mujoco_robot import check_installed
from scenes.reality import Reality
from support.cli import option, parse
from support.parallel import available_cores
from support.rooms import validation_scenes
from support.runs import RunError, write
from support.weights import FILE, load_model

OPTIONS = {
    "level": option("", "only this level of the paper, or this part (default: all)",
                    choices=("1", "2", "3", "lab", "stops", "planners", "mujoco")),
    "jobs": option(2, "number of runs at a time, each on one core", 1, 64)}


def words(options):
    """Returns options (field -> value) as the words of a command line."""
    pairs = [(f"--{name.replace('_', '-')}", str(value)) for name, value in options.items()
             if value is not False]
    return [word for pair in pairs for word in pair if word != "True"]  # flags have no value


def commands(run):
    """Returns the commands that make the missing files of a run, each a list of words."""
    in_robot = run.stage in ("lab", "drawn")
    training = "robot.train" if in_robot else "train"
    evaluation = "robot.evaluate" if in_robot else "evaluation"
    folder = os.path.relpath(run.folder, ROOT)  # config.json must not name a machine's folders
    missing = []
    if not run.weights and not (run.folder / "evaluation.json").exists():
        options = run.training | {"out": folder}
        if (run.folder / "config.json").exists():
            config = run.read("config.json")
            if not run.training.items() <= config.items():
                raise RunError(f"'{folder}' is a run with other options: delete it")
            options = {"resume": folder}
        missing.append([training, *words(options)])
    for name, options in run.evaluations.items():
        if not (run.folder / f"evaluation-{name}.json").exists():
            missing.append([evaluation, folder, *words(options | {"workers": 1})])
    return [[sys.executable, "-m", *command] for command in missing]


def make_run(run):
    """Makes the missing files of a run, unless its rows are in results/. Yields each process until
    it ends. Raises RunError."""
    if is_recorded(run):
        return
    log = run.folder.with_suffix(".log")
    log.parent.mkdir(parents=True, exist_ok=True)
    if run.weights:
        run.folder.mkdir(exist_ok=True)
        shutil.copy(ROOT / run.weights, run.folder / FILE)
    elif run.folder.exists() and not (run.folder / "config.json").exists():
        shutil.rmtree(run.folder)  # the run was interrupted in its first second
    for command in commands(run):
        with open(log, "w") as output:
            process = subprocess.Popen(command, cwd=ROOT, stdout=output, stderr=subprocess.STDOUT)
        yield process
        if process.returncode:
            raise RunError(f"'{' '.join(command)}' failed, see '{log}'")
    record(run)


def make_runs(wanted, jobs):
    """Makes these runs, at most `jobs` at a time. Raises RunError."""
    waiting = [make_run(run) for run in wanted]
    under_way = {}  # process -> generator of its run
    try:
        while waiting or under_way:
            for process in [process for process in under_way if process.poll() is not None]:
                waiting.insert(0, under_way.pop(process))
            while waiting and len(under_way) < jobs:
                run = waiting.pop(0)
                process = next(run, None)
                if process:
                    under_way[process] = run
            time.sleep(0.1)
    finally:
        for process in under_way:
            process.terminate()
            process.wait()


def is_recorded(run):
    """Returns whether all tables of a run have its rows, and pretrained/ its weights."""
    missing = [name for name, published in runs.PRETRAINED.items()
               if run.folder.name == published and not weights_file(name).exists()]
    tables = [RESULTS / name for name, (members, _) in runs.TABLES.items() if run in members]
    return bool(tables) and not missing and all(
        path.exists() and own_rows(read_text(path), run).any() for path in tables)


def read_text(path):
    """Returns a table as a DataFrame of text."""
    return pd.read_csv(path, dtype=str, keep_default_na=False)


def own_rows(rows, run):
    """Returns which rows (a DataFrame of text) of a table belong to a run, a Series of bool."""
    return (rows[list(run.names)] == pd.Series(run.names).astype(str)).all(axis=1)


def weights_file(name):
    """Returns the path of published weights."""
    return ROOT / "pretrained" / f"{name}.safetensors"


def record(run):
    """Writes the rows of a run into its tables, and its weights into pretrained/ if published."""
    for name, (members, rows_of) in runs.TABLES.items():
        if run in members:
            rows = pd.DataFrame(rows_of(run)).astype(str)
            if (RESULTS / name).exists():
                old = read_text(RESULTS / name)
                rows = pd.concat([old[~own_rows(old, run)], rows])
            order = pd.DataFrame([member.names for member in members]).astype(str)
            write(RESULTS / name, order.merge(rows).to_csv(index=False))
    for name, published in runs.PRETRAINED.items():
        if run.folder.name == published:
            write(weights_file(name), (run.folder / FILE).read_bytes())
    for name, source in runs.CLASSROOM.items():
        if run.folder.name == source:
            kept = ROOT / "classroom" / "runs" / name
            for file in kept.iterdir():
                if (run.folder / file.name).exists():
                    write(file, (run.folder / file.name).read_bytes())


def write_planners():
    """Makes planners.csv and level3-planners.csv: one episode to each target, 50 random targets."""
    rooms = {name: [scenes.load(name)] for name in runs.TEST_ROOMS}
    rooms["validation"] = validation_scenes()
    rows = {"planners.csv": [], "level3-planners.csv": []}
    for planner, (room, here) in itertools.product(PLANNERS, rooms.items()):
        result, _ = evaluate(Planned(planner, seed=0), here, 50, "anywhere")
        rows["level3-planners.csv"].append({"planner": planner, "room": room}
                                           | runs.rates(result["anywhere"]))
        if room in runs.PAPER_ROOMS:
            _, traces = evaluate(Planned(planner, seed=0), here, 1, "start")
            rows["planners.csv"].append({"env": room, "planner": planner}
                                        | runs.rates(summarise(traces), prefix="start_")
                                        | runs.rates(result["anywhere"], prefix="anywhere_"))
    for name, lines in rows.items():
        write(RESULTS / name, pd.DataFrame(lines).to_csv(index=False))


def write_lab_errors():
    """Makes lab-errors.csv: success of the simulation's policies with each error of the lab."""
    lab = scenes.load("lab")
    realities = {"none": Reality()}
    realities |= {name: Reality(**{name: value}) for name, value in vars(lab.reality).items()
                  if value != getattr(Reality(), name)} | {"all": lab.reality}
    rows = []
    for weights, error in itertools.product(runs.WEIGHTS, realities):
        driver = Policy(load_model(ROOT / runs.WEIGHTS[weights])[0], "mean", seed=0)
        room = replace(lab, reality=realities[error])
        result, _ = evaluate(driver, [room], 200, "anywhere", environment=RingVecEnv,
                             workers=available_cores())
        rows.append({"weights": weights, "error": error}
                    | runs.rates(result["anywhere"], runs.LAB_RATES))
    write(RESULTS / "lab-errors.csv", pd.DataFrame(rows).to_csv(index=False))


def main(argv=None):
    """Runs the command line."""
    options, parser = parse(OPTIONS, "Make every table and figure of the results.", argv)
    level_2 = runs.LEVEL_2 + runs.ANY_TARGET + runs.BUDGET + runs.LEVEL_2_ABLATIONS + runs.DELTAS
    # In this order, because runs of `lab` and `mujoco` start from weights of levels 2 and 3.
    stages = {"1": runs.LEVEL_1, "2": level_2, "3": runs.LEVEL_3, "lab": runs.LAB,
              "mujoco": runs.DRAWN, "stops": runs.STOPS}
    chosen = [level for level in stages if options.level in ("", level)]
    try:
        if "mujoco" in chosen:
            check_installed()
        for level in chosen:
            # A run to the stop uses several cores, so each has the machine to itself.
            make_runs(stages[level], 1 if level == "stops" else options.jobs)
        if "lab" in chosen and not (RESULTS / "lab-errors.csv").exists():
            write_lab_errors()
        if "mujoco" in chosen:
            write_mujoco()
        if options.level in ("", "planners") and not (RESULTS / "planners.csv").exists():
            write_planners()
        figures.main([])
        tables.main([])
    except (RunError, OSError) as error:
        parser.error(error)
    except KeyboardInterrupt:
        sys.exit("\ninterrupted; the same command continues")


if __name__ == "__main__":
    main()
