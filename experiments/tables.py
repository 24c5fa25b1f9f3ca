"""The tables of the pages: `python -m experiments.tables` makes them from `results/`. It writes the
rows of TABLES[NAME] between `<!-- table: NAME -->` plus header and `<!-- end -->`."""

import json
import re
import tomllib
from functools import partial
from pathlib import Path

import pandas as pd

from evaluation.measures import wilson
from support.cli import parse
from support.runs import write

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "results"
MARKED = re.compile(r"(<!-- table: (.*) -->\n(?:\|.*\n){2})(?:\|.*\n)*(<!-- end -->)")

ROOMS_LEARNT = {f"rooms-{count}": str(count) for count in (1, 4, 16, 64, 256)}
ROOMS_LEARNT["rooms-0"] = "always new (600)"  # 60 robots get a new room 10 times in 500,000 steps
LAB = {"env2": "env2 policy, unchanged", "any-room": "any-room policy, unchanged",
       "random-env2": "trained in env2 with random errors",
       "random-rooms": "any-room policy, trained further with random errors",
       "from-scratch": "from random weights", "from-env2": "from env2 policy",
       "from-any-room": "from any-room policy"}

SPEEDS = {  # key of benchmark.json -> name in a table
    "train_sps": "steps of training", "train_sps_training_targets": "steps of training at level 1",
    "network_fps act": "network, actions of 32 robots", "network_fps forward": "network, forward",
    "network_fps both": "network, forward and backward", "env_sps 32": "environment, 32 robots",
    "camera_fps 32": "camera, 32 robots", "world_sps 32": "world, 32 robots"}

LOOK = " with the lab's look"  # end of the name of a simulator in mujoco.csv

# Tables with a row for each group of runs: (files, query, columns that group, columns to show).
RANDOM_TARGETS = "targets not in ['training', 'new']"  # level3.csv has no such column
PARTS = "way in ['rooms-0', 'single', 'none', 'blind', 'no-target', 'no-last']"
GROUPS = {  # a cell has the values of all seeds
    "level1-short": ("level1.csv", "", "env", "perturbed_success perturbed_spl"),
    "level2-short": ("seeds.csv", "way == 'varied'", "env",
                     "new_success new_spl anywhere_success anywhere_spl"),
    "level3": ("level3.csv rooms.csv", f"way == 'any-room' and {RANDOM_TARGETS}", "way",
               "success spl validation_success seconds"),
    "released-learner": ("released_learner.csv", "", "variant",
                         "peak_success peak_steps last_success frozen_new frozen_training")}
MEANS = {  # a cell has the mean of the seeds and the worst one
    "level1": ("level1.csv", "", "env", "start_success perturbed_success perturbed_spl"),
    "ablations": ("seeds.csv ablations.csv", "way != 'one-start' and seed < 3", "env way",
                  "new_success anywhere_success"),
    "level3-ablations": ("level3.csv rooms.csv", f"{PARTS} and {RANDOM_TARGETS}", "way",
                         "validation_success success")}


def read(name):
    """Returns the content of a file in results/: a dict, or a DataFrame with `rates`."""
    path = RESULTS / name
    is_json = path.suffix == ".json"
    return json.loads(path.read_text()) if is_json else rates(pd.read_csv(path, comment="#"))


def rates(rows):
    """Converts rates to percent. Adds their 95 % intervals: `new` for `new_success`, or `rate`."""
    columns = rows.filter(regex="(success|low|high|collision|frozen_new|frozen_training)$").columns
    rows[columns] *= 100
    for low in rows.filter(regex="low$"):
        values = rows[[low.replace("low", end) for end in ("success", "low", "high")]].values
        rows[low[:-4] or "rate"] = [interval(*row) for row in values]
    return rows


def interval(rate, low, high):
    """Returns a rate [%] and its interval as text."""
    return f"{rate:.1f} % [{low:.1f}, {high:.1f}]"


def text(value):
    """Returns a cell. A number has three digits, or all digits of its integer part; nan is '-'."""
    if isinstance(value, str):
        return value.replace("_", " ")  # for names of columns and keys
    if isinstance(value, list):
        return " / ".join(map(text, value))
    if pd.isna(value):
        return "-"
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def each(values):
    """Returns a cell with the values of the seeds in order, and their mean in bold."""
    if values.isna().all():
        return "-"
    mean = f": **{text(values.mean())}**" if len(values) > 1 else ""
    return ", ".join(map(text, values)) + mean


def mean_and_worst(values):
    """Returns a cell with the mean of the seeds and, if there are several, the worst one."""
    return text(values.mean()) + (f" ({text(values.min())})" if len(values) > 1 else "")


def grouped(rows, groups, columns, cell=each):
    """Returns a DataFrame of cells with a row for each group: `cell` of the means of its seeds."""
    groups = groups.split()  # the last one keeps its order
    rows = rows.sort_values([*groups[:-1], "seed"], kind="stable")
    seeds = rows.groupby([*groups, "seed"], sort=False, dropna=False)[columns.split()].mean()
    return seeds.groupby(groups, sort=False, dropna=False).agg(cell)


def group_rows(files, query, groups, columns, cell=each):
    """Returns `grouped` of the rows that a query selects from files. Arguments: as in GROUPS."""
    rows = pd.concat(map(read, files.split()))
    return grouped(rows.query(query) if query else rows, groups, columns, cell)


def summary():
    """Returns level 2, and the any-target and any-room policies in the same test."""
    rooms = read("rooms.csv").query("way == 'any-room' and room in ['env1', 'env2']")
    rooms = rooms.rename(columns={"room": "env"}).pivot(
        index=["env", "way", "seed"], columns="targets", values="success").add_suffix("_success")
    rows = [read("seeds.csv").sort_values("way"), read("any-target.csv"), rooms.reset_index()]
    columns = "training_success new_success anywhere_success"
    return grouped(pd.concat(rows), "env way", columns, mean_and_worst)


def hidden():
    """Returns success on new targets, with a column for each hidden part of the observation."""
    rows = pd.concat([read("seeds.csv"), read("hidden.csv")]).fillna({"hidden": "nothing"})
    return grouped(rows, "env way hidden", "new_success", mean_and_worst).new_success.unstack()


def carry_over():
    """Returns success in unseen rooms, with a row for each training room."""
    random = read("rooms.csv").query("way == 'any-room'").assign(env="random rooms")
    rows = pd.concat([read("carry-over.csv"), random]).query(RANDOM_TARGETS)
    return grouped(rows, "env room", "success", mean_and_worst).success.unstack().sort_index(axis=1)


def level3_rooms():
    """Returns level 3 with each seed: the test rooms, and the random rooms for validation."""
    runs = read("level3.csv").rename(columns={"validation": "rate"})
    runs = runs.assign(room="random, validation", targets="anywhere")
    rows = pd.concat([read("rooms.csv"), runs]).query("way == 'any-room'")
    return rows.pivot(index=["room", "targets"], columns="seed", values="rate")


def peers():
    """Returns level 2 in env1 by our learner and those of other projects, seeds 0 to 2."""
    ours = read("seeds.csv").query("env == 'env1' and way == 'varied' and seed < 3")
    ours = ours.rename(columns={"anywhere_success": "anywhere_mean_success"})
    rows = pd.concat([ours.assign(learner="ours"), read("peers.csv").query("level == 2")])
    columns = "training_success new_success anywhere_success anywhere_mean_success seconds"
    return grouped(rows, "learner", columns)


def rooms_learnt():
    """Returns success at level 3 by the number of training rooms."""
    rows = pd.concat([read("level3.csv"), read("rooms.csv").query(RANDOM_TARGETS)])
    rows = rows.query("way in @ROOMS_LEARNT").replace({"way": ROOMS_LEARNT})
    columns = "training_success validation_success success"
    return grouped(rows, "way", columns, mean_and_worst)


def level3_planners():
    """Returns planners and any-room policies in the rooms of level 3: success [%]/SPL."""
    validation = {"validation_success": "success", "validation_spl": "spl"}
    rows = pd.concat([read("level3-planners.csv").rename(columns={"planner": "way"}),
                      read("rooms.csv").query(f"way == 'any-room' and {RANDOM_TARGETS}"),
                      read("level3.csv").query("way == 'any-room'").rename(columns=validation)])
    groups = rows.fillna({"room": "validation"}).groupby(["way", "room"], sort=False)
    cells = groups[["success", "spl"]].mean().map(text)
    return (cells.success + "/" + cells.spl).unstack().drop("random")


def lab():
    """Returns the policies in the lab."""
    rows = read("lab.csv").sort_values("allowed").replace({"way": LAB})
    return grouped(rows, "way allowed", "new_success anywhere_success", mean_and_worst)


def lab_errors():
    """Returns success with each single error of the lab, lowest first, and the error's value."""
    room = tomllib.loads((ROOT / "scenes" / "lab.toml").read_text(encoding="utf-8"))
    values = {key.removesuffix("_degrees"): value for key, value in room["reality"].items()}
    values["all"] = "each of these"
    rows = read("lab-errors.csv").query("error == 'none' or error in @values")
    success = rows.pivot(index="error", columns="weights", values="success")[["env2", "any-room"]]
    success = success.loc[success.mean(axis=1).sort_values(kind="stable").index]
    success.insert(0, "value", [values.get(error) for error in success.index])
    return success


def mujoco():
    """Returns the policies in our simulation and in MuJoCo: success with its interval."""
    cells = read("mujoco.csv").set_index(["policy", "room", "targets", "n", "simulator"]).rate
    shown = [f"{simulator}{look}" for look in ("", LOOK) for simulator in ("ours", "MuJoCo")]
    return cells.unstack(sort=False).reindex(columns=shown)


def mujoco_mixed():
    """Returns the any-room policy in mixtures of both simulations, in each room and in all."""
    rows = read("mujoco.csv").query("policy == 'any-room'")
    rows = rows[~rows.simulator.str.endswith(LOOK)]
    cells = rows.set_index(["simulator", "room"]).success.unstack(sort=False)
    for simulator, here in rows.groupby("simulator"):
        n = here.n.sum()
        arrived = round((here.success * here.n).sum() / 100)
        low, high = wilson(arrived, n)
        cells.loc[simulator, "all"] = interval(100 * arrived / n, 100 * low, 100 * high)
    return cells


def peaks():
    """Returns the peaks of the runs from one start pose in env1."""
    rows = read("curves.csv").query("env == 'env1' and way == 'one-start' and kind == 'new'")
    rows = rows.assign(last=rows.groupby("seed").success.transform("last"))
    return rows.loc[rows.groupby("seed").success.idxmax(),
                    ["seed", "success", "steps", "last"]].values


def stops():
    """Returns the runs in env1 with one process that stop by the paper's rule."""
    rows = read("stops.csv").query("env == 'env1' and processes == 1").sort_values("new_success")
    return rows["seed steps rolling_new_success new training".split()].values


def stop_ranges():
    """Returns the ranges of all runs that stop by the paper's rule."""
    groups = read("stops.csv").groupby(["env", "processes"])
    return groups["steps new_success training_success".split()].agg(
        lambda values: f"{text(values.min())} to {text(values.max())}").reset_index().values


def budgets():
    """Returns the success rate on the worst target in env1 after fixed budgets."""
    rows = read("budgets.csv").groupby(["budget", "seed"], as_index=False).success.min()
    rows["seeds"] = rows.seed.map(lambda seed: "0 to 4" if seed < 5 else "200 to 204")
    return grouped(rows, "budget seeds", "success")


def speeds():
    """Returns the speed of each stage on one core and on all cores."""
    figures = read("benchmark.json")
    rows = pd.json_normalize([figures, figures["all_cores"]], sep=" ").T
    return rows.reindex(SPEEDS).rename(SPEEDS)


def workers():
    """Returns the speed of training with one worker and with several."""
    return pd.DataFrame(read("benchmark.json")["workers"]).T


def programs():
    """Returns the seconds of each part of training, and of each program's start."""
    figures = read("benchmark.json")["programs"]
    return [*figures["seconds"].items(),
            *((f"start of {name}", seconds) for name, seconds in figures["start"].items())]


TABLES = {function.__name__.replace("_", "-"): function for function in (summary, hidden,
    carry_over, level3_rooms, peers, rooms_learnt, level3_planners, lab, lab_errors, mujoco,
    mujoco_mixed, peaks, stops, stop_ranges, budgets, speeds, workers, programs)}
TABLES["headline"] = lambda: summary().drop(
    columns="training_success").drop("any-target", level="way")
TABLES |= {name: partial(group_rows, *row) for name, row in GROUPS.items()}
TABLES |= {name: partial(group_rows, *row, mean_and_worst) for name, row in MEANS.items()}


def markdown(table):
    """Returns the Markdown of a table: a list of lists of cells, or a DataFrame with its index."""
    if isinstance(table, pd.DataFrame):
        table = table.set_axis(range(table.shape[1]), axis=1).reset_index().values
    return "".join(f"| {' | '.join(map(text, row))} |\n" for row in table)


def fill(page):
    """Returns a page's text with new tables. Raises KeyError for an unknown table."""
    return MARKED.sub(lambda match: match[1] + markdown(TABLES[match[2]]()) + match[3], page)


def pages():
    """Returns README.md and the pages of docs/."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def main(argv=None):
    """Runs the command line: fills every page."""
    _, parser = parse({}, "Make the tables of the pages.", argv)
    try:
        for page in pages():
            write(page, fill(page.read_text(encoding="utf-8")))
    except (OSError, KeyError) as error:
        parser.error(f"a table of {page.name} cannot be made: {error}")


if __name__ == "__main__":
    main()
