"""The tables of the documentation, made from the files in `results/` and written into the pages.

`python -m experiments.tables` fills README.md and docs/*.md: what stands between
`<!-- table: NAME -->` and `<!-- end -->` is replaced by that table, wherever the markers are.
"""

import json
import re
from pathlib import Path

import numpy as np

from experiments import lab_tables, level_tables
from experiments.markdown import (markdown, mean_and_worst, percentages, select, with_interval,
                                  worst_first)
from support.command_line import CommandLine
from support.pictures import read_table

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "results"
MARKED = re.compile(r"(<!-- table: (?P<name>[\w-]+) -->\n).*?(<!-- end -->)", re.DOTALL)
MARKER = re.compile(r"<!-- (?:table: [\w-]+|end) -->")

ROOMS = ("env1", "env2")
WAYS = {"one-start": "one start pose", "varied": "starts anywhere"}  # ways to train
NETWORKS = {  # column `way` of seeds.csv and ablations.csv
    "varied": "as it is",
    "single": "one LSTM (`single`)",
    "none": "no memory (`none`)",
    "blind": "no camera image (`blind`)",
    "no-target": "no target position (`no-target`)",
    "no-last": "no last velocity and reward (`no-last`)",
    "one-room": "no mirrored room (`one-room`)"}
ABLATION_SEEDS = ("0", "1", "2")
HIDDEN = {"": "nothing", "place": "place", "cube": "cube", "both": "both"}
LEARNERS = {  # column `variant` of released_learner.csv
    "baseline": "none: this learner, one start pose",
    "unwrapped-bearing": "bearing never wrapped",
    "no-annealing": "learning rate and standard deviation not annealed",
    "no-baseline": "no value baseline",
    "one-step-gradients": "gradients of one step through the LSTMs",
    "beta": "Beta distribution of actions",
    "all": "all of these",
    "released": "all of these, one robot, and the released settings of an update"}
PAPER = {  # success rates of the paper's one run in each room
    ("env1", "new"): '61 %, "ultimate" 81 %',  # at the stop (released records); paper IV-B
    ("env2", "new"): '61 %, "ultimate" 69 %',
    ("env1", "training"): "77 %",  # at the stop (released records); paper IV-B: > 75 %
    ("env2", "training"): "62 %"}


# -------------------------------------------------------------------------------------------- parts


def arrivals(row):
    """To how many targets the deterministic action drove: 11 of '11 of 12'."""
    return int(row["mean_action_arrives"].split()[0])


# ------------------------------------------------------------------------------------------- tables


def summary_short(seeds, tests):
    """The README's rows: both paper's rooms. seeds, tests: rows of seeds.csv and rooms.csv."""
    header = ["mean success, trained:", "there, one start pose", "there, any start",
              "in random rooms"]
    table = []
    for kind, name in (("new", "new targets"), ("anywhere", "from anywhere to anywhere")):
        for room in ROOMS:
            cells = [f"{room}, {name}"]
            for way in WAYS:
                success = percentages(select(seeds, env=room, way=way), f"{kind}_success")
                cells.append(f"{np.mean(success):.1f} %")
            success = percentages(select(tests, way="any-room", room=room, targets=kind), "success")
            table.append([*cells, f"{np.mean(success):.1f} %"])
    return markdown(header, table)


def summary(seeds, others, floor):
    """The paper's numbers, and the mean and the worst of our seeds, here and on another machine.

    seeds, others: rows of seeds.csv and other-machine.csv. floor: rows of floor.csv, the
    validation targets, which the other machine has not seen.
    """
    header = ["success, from the start pose unless said", "paper, one run"]
    for name in WAYS.values():
        header += [f"{name}: mean (worst)", f"{name}, other machine"]
    table = []
    for kind, name in (("new", "new targets"), ("training", "training targets"),
                       ("validation", "validation targets"),
                       ("anywhere", "from anywhere to anywhere")):
        for room in ROOMS:
            cells = [f"{room}, {name}", PAPER.get((room, kind), "-")]
            for way in WAYS:
                here, there = (select(rows, env=room, way=way) for rows in (seeds, others))
                if kind == "validation":
                    spots = select(floor, env=room, way=way)
                    cells += [mean_and_worst(validation_success(spots)), "-"]
                else:
                    cells += [mean_and_worst(percentages(rows, f"{kind}_success"))
                              for rows in (here, there)]
            table.append(cells)
    return markdown(header, table)


def validation_success(spots):
    """Success [%] over all validation targets, of each seed. spots: rows of floor.csv."""
    seeds = sorted({row["seed"] for row in spots})
    return [float(np.mean(percentages(select(spots, seed=seed), "success"))) for seed in seeds]


def seed_by_seed(seeds):
    """Every run, in each room and way the worst first, and their means. seeds: seeds.csv."""
    header = ["room", "trained from", "seed", "success on training targets [95 %]",
              "success on new targets [95 %]", "SPL, new targets",
              "success from anywhere to anywhere", "deterministic (mean) action arrives at"]
    table = []
    for room in ROOMS:
        for way, name in WAYS.items():
            chosen = select(seeds, env=room, way=way)
            for row in sorted(chosen, key=lambda row: float(row["new_success"])):
                table.append([
                    room, name, row["seed"], with_interval(row, "training"),
                    with_interval(row, "new"), f"{float(row['new_spl']):.2f}",
                    f"{100 * float(row['anywhere_success']):.1f} %", row["mean_action_arrives"]])
            if chosen:
                training, new, anywhere = (
                    np.mean(percentages(chosen, f"{kind}_success"))
                    for kind in ("training", "new", "anywhere"))
                spl = np.mean([float(row["new_spl"]) for row in chosen])
                table.append([room, name, "**mean**", f"**{training:.1f} %**", f"**{new:.1f} %**",
                              f"{spl:.2f}", f"{anywhere:.1f} %", ""])
    return markdown(header, table)


def hidden_targets(hidden, seeds):
    """Success with the target's place or cube hidden. hidden, seeds: hidden.csv and seeds.csv."""
    header = ["room", "trained from", "targets", *(f"{name} hidden" for name in HIDDEN.values())]
    rows = hidden + [row | {"hidden": ""} for row in seeds]
    table = []
    for room in ROOMS:
        for way, name in WAYS.items():
            for kind in ("new", "training"):
                cells = [room, name, kind]
                for what in HIDDEN:
                    chosen = select(rows, env=room, way=way, hidden=what)
                    chosen = sorted(chosen, key=lambda row: row["seed"])
                    cells.append(", ".join(f"{value:.0f}" for value in percentages(
                        chosen, f"{kind}_success")))
                table.append(cells)
    return markdown(header, table)


def ablations(seeds, ablated, others):
    """What the parts of the network do: seeds 0 to 2, here and on the other machine.

    seeds, ablated, others: rows of seeds.csv, ablations.csv and other-machine.csv.
    """
    header = ["room", "network"]
    for name in ("new targets", "training targets", "from anywhere to anywhere"):
        header += [f"success [%]: {name}", "other machine"]
    table = []
    for room in ROOMS:
        for way, name in NETWORKS.items():
            cells = [room, name]
            for kind in ("new", "training", "anywhere"):
                for rows in (seeds + ablated, others):
                    chosen = [row for row in select(rows, env=room, way=way)
                              if row["seed"] in ABLATION_SEEDS]
                    cells.append(ablation_cell(percentages(chosen, f"{kind}_success"), kind))
            table.append(cells)
    return markdown(header, table)


def ablation_cell(values, kind):
    """Each seed and the mean; of the training targets, which nearly all reach, the mean alone."""
    if not values:
        return "-"
    if kind == "training":
        return f"**{np.mean(values):.1f}**"
    return worst_first(values)


def planner_comparison(planners, seeds):
    """The planners, and the learner beside them. planners, seeds: planners.csv and seeds.csv.

    The learner started anywhere and drives its deterministic actions: the worst of the seeds from
    the start pose, the mean and the range of the seeds from anywhere.
    """
    header = ["planner", *(f"{room}: targets reached from the start pose" for room in ROOMS),
              *(f"{room}, from anywhere to anywhere: success [95 %], SPL" for room in ROOMS)]
    table = []
    for planner in dict.fromkeys(row["planner"] for row in planners):
        from_start = []
        anywhere = []
        for room in ROOMS:
            row, = select(planners, env=room, planner=planner)
            n = int(row["start_n"])
            from_start.append(f"{round(n * float(row['start_success']))} of {n}")
            anywhere.append(f"{with_interval(row, 'anywhere')}, {float(row['anywhere_spl']):.2f}")
        table.append([planner, *from_start, *anywhere])
    from_start = []
    anywhere = []
    for room in ROOMS:
        chosen = select(seeds, env=room, way="varied")
        from_start.append(min(chosen, key=arrivals)["mean_action_arrives"])
        success = percentages(chosen, "anywhere_success")
        spl = np.mean([float(row["anywhere_spl"]) for row in chosen])
        anywhere.append(f"{np.mean(success):.1f} % (seeds {min(success):.1f} to "
                        f"{max(success):.1f}), {spl:.2f}")
    table.append(["**learner**", *from_start, *anywhere])
    return markdown(header, table)


def benchmark(figures):
    """How fast each stage is, and a second table of the peers. figures: benchmark.json."""
    machines = [figures]
    if "all_cores" in figures:
        machines.append(figures["all_cores"])
    header = ["a second", *(f"{one['cores']} core" + "s" * (one["cores"] > 1) for one in machines),
              "share of the roof"]
    table = []
    for key, what in (("camera_fps", "camera, images of env1"),
                      ("camera_fps_boxes", "camera, images for 32 robots"),
                      ("world_sps", "world alone, robot-steps"),
                      ("env_sps", "environment, steps with images")):
        unit = "boxes" if key == "camera_fps_boxes" else "robots"
        counts = [f"{int(count):,}" for count in figures[key]]
        values = [" / ".join(f"{value:,.0f}" for value in one[key].values()) for one in machines]
        table.append([f"{what}, {' / '.join(counts)} {unit}", *values, ""])
    for key, what in (("act", "network, 32 robots drive, frames"),
                      ("forward", "network, forward, frames"),
                      ("both", "network, forward and backward, frames")):
        table.append([what, *(f"{one['network_fps'][key]:,.0f}" for one in machines),
                      shares([one["network_fps"][key] / one["roof_fps"][key] for one in machines])])
    table.append(["training, all told, steps", *(f"{one['train_sps']:,.0f}" for one in machines),
                  shares([one["train_sps"] / one["roof_sps"] for one in machines])])
    table.append(["training where every step is learnt from, steps",
                  *(f"{one['train_sps_training_targets']:,.0f}" for one in machines), ""])
    peers = [[name, f"{peer['sps']:,.0f}", f"{peer['ratio']:.1f}"]
             for name, peer in figures["peers"].items()]
    if not peers:
        return markdown(header, table)
    return markdown(header, table) + "\n\n" + markdown(
        ["peer, 1 core", "its steps a second", "this project's, times as many"], peers)


def workers(figures):
    """Training by one worker and by several. figures: benchmark.json."""
    races = figures["workers"]
    _, many, _ = races["idle"]
    header = ["training steps a second", "1 worker", f"{many} workers", "ratio"]
    names = {"idle": "idle machine", "busy": "another process keeps one core busy",
             "torchrun": "processes of torchrun, idle machine"}
    table = []
    for when, race in races.items():
        rates = [f"{sps:,.0f}" for count, sps in race.items() if count != "ratio"]
        table.append([names[when], *rates, f"{race['ratio']:.2f}"])
    for cores in (4, 8):
        table.append([f"a model, not measured: {cores} workers on {cores} idle cores", "", "",
                      f"{amdahl(races['idle']['ratio'], int(many), cores):.2f}"])
    return markdown(header, table)


def pauses(figures):
    """How long the parts of a training take, the median and the slowest. figures: benchmark.json.
    """
    ways = list(figures["pauses"]["idle"])
    names = {"update": "an update", "acting": "acting, a step of all robots",
             "environment": "the environment, a step of all robots"}
    table = []
    for when, measured in figures["pauses"].items():
        for part, name in names.items():
            cells = [" / ".join(f"{1000 * seconds:,.0f}" if seconds >= 0.1 else
                                f"{1000 * seconds:.1f}" for seconds in measured[way][part])
                     for way in ways]
            table.append([f"{name}, {when}", *cells])
    return markdown(["milliseconds: median / slowest", *ways], table)


def long_runs(figures):
    """Memory and speed of long runs by tenths. figures: long-runs.json."""
    names = {"environment": "environment, 32 robots at random", "training": "training, one process"}
    table = []
    for run, name in names.items():
        tenths = figures[run]["tenths"]
        rates = [tenth["steps_per_second"] for tenth in tenths]
        table.append([f"{name}, {tenths[-1]['steps']:,} steps",
                      *(f"{tenths[k]['memory_mb']:.0f}" for k in (0, 1, 4, 9)),
                      f"{max(tenth['highest_mb'] for tenth in tenths):.0f}",
                      f"{min(rates):,.0f} to {max(rates):,.0f}"])
    return markdown(["run", "memory [MB]: first tenth", "second", "fifth", "last", "highest",
                     "steps a second, slowest and fastest tenth"], table)


def amdahl(ratio, measured, cores):
    """How many times as fast so many cores are as one, by Amdahl's law, where as many as were
    measured are `ratio` times as fast."""
    # The share of one core's time that the cores divide.
    divided = (1 - 1 / ratio) * measured / (measured - 1)
    return 1 / (1 - divided + divided / cores)


def programs(figures):
    """What a user waits for, and the memory that it takes. figures: benchmark.json."""
    measured = figures["programs"]
    table = [[f"training in env1 to the stop, seed 0: {part}", f"{seconds:.1f} s"]
             for part, seconds in measured["seconds"].items()]
    whole = sum(seconds for part, seconds in measured["seconds"].items()
                if part not in ("evaluation", "curves"))
    table.append(["training in env1 to the stop, seed 0: training, all of it", f"{whole:.1f} s"])
    table += [[f"start-up of {name}", f"{seconds:.1f} s"]
              for name, seconds in measured["start_up_seconds"].items()]
    table.append(["peak of memory of `python train.py --env env1`, all processes",
                  f"{measured['memory_mb']} MB"])
    return markdown(["what", "measured"], table)


def shares(fractions):
    """Shares of the roof, one for each number of cores."""
    return " / ".join(f"{100 * fraction:.0f} %" for fraction in fractions)


def released_learner(rows):
    """One change at a time towards the released learner. rows: released_learner.csv."""
    header = ["change", "success on new targets [%]: peak", "its steps [thousands]",
              "at the end of training", "last policy, frozen: new targets", "training targets"]
    table = []
    for variant, name in LEARNERS.items():
        chosen = select(rows, variant=variant)
        if not chosen:
            continue
        chosen = sorted(chosen, key=lambda row: float(row["peak_success"]))
        peaks_at = ", ".join(f"{float(row['peak_steps']) / 1000:.0f}" for row in chosen)
        success = [worst_first(percentages(chosen, column)) for column in (
            "peak_success", "last_success", "frozen_new", "frozen_training")]
        table.append([name, success[0], peaks_at, *success[1:]])
    return markdown(header, table)


def stops(*runs):
    """Training in env1 that the paper's rule stopped, the worst first. runs: what the summaries
    env1-seed0.json to env1-seed4.json hold."""
    header = ["seed", "steps", "episodes", "seconds to the stop",
              "success on the new target: last 100 episodes", "frozen, new target [95 %]",
              "frozen, training targets [95 %]"]
    table = []
    for run in sorted(runs, key=lambda run: run["frozen"]["new"]["success"]):
        rates = {f"{kind}_{key}": value for kind in ("new", "training")
                 for key, value in run["frozen"][kind].items()}
        table.append([
            str(run["seed"]), f"{run['steps']:,}", f"{run['episodes']:,}", f"{run['seconds']:.0f}",
            f"{100 * run['rolling_new_success']:.0f} %", with_interval(rates, "new"),
            with_interval(rates, "training")])
    return markdown(header, table)


def peaks(curves):
    """The lucky moments of env1's runs from one start pose. curves: rows of curves.csv."""
    header = ["seed", "peak on the new target", "steps at the peak", "at the end of training"]
    rows = select(curves, env="env1", way="one-start", kind="new")
    table = []
    for seed in sorted({row["seed"] for row in rows}):
        points = select(rows, seed=seed)
        peak = max(points, key=lambda row: float(row["success"]))
        table.append([seed, f"{100 * float(peak['success']):.0f} %", f"{int(peak['steps']):,}",
                      f"{100 * float(points[-1]['success']):.0f} %"])
    return markdown(header, table)


def clients(rows):
    """Libraries that drive the environments. rows: clients.csv."""
    columns = ("client", "version", "what", "result")
    return markdown(list(columns), [[row[column] for column in columns] for row in rows])


TABLES = {  # marker: what makes the table, and the files in results/ that it is made from
    "summary-short": (summary_short, ["seeds.csv", "rooms.csv"]),
    "summary": (summary, ["seeds.csv", "other-machine.csv", "floor.csv"]),
    "seeds": (seed_by_seed, ["seeds.csv"]),
    "hidden": (hidden_targets, ["hidden.csv", "seeds.csv"]),
    "ablations": (ablations, ["seeds.csv", "ablations.csv", "other-machine.csv"]),
    "planners": (planner_comparison, ["planners.csv", "seeds.csv"]),
    "benchmark": (benchmark, ["benchmark.json"]),
    "workers": (workers, ["benchmark.json"]),
    "pauses": (pauses, ["benchmark.json"]),
    "long-runs": (long_runs, ["long-runs.json"]),
    "programs": (programs, ["benchmark.json"]),
    "stops": (stops, [f"env1-seed{seed}.json" for seed in range(5)]),
    "peaks": (peaks, ["curves.csv"]),
    "released-learner": (released_learner, ["released_learner.csv"]),
    "clients": (clients, ["clients.csv"]),
    "level1": (level_tables.level1, ["level1.csv"]),
    "lower-levels": (level_tables.lower_levels, ["level1.csv", "seeds.csv"]),
    "level3": (level_tables.level3, ["level3.csv", "rooms.csv"]),
    "level3-targets": (level_tables.level3_targets, ["rooms.csv"]),
    "rooms-learnt": (level_tables.rooms_learnt, ["level3.csv", "rooms.csv"]),
    "level3-ablations": (level_tables.level3_ablations, ["level3.csv", "rooms.csv"]),
    "carry-over": (level_tables.carry_over, ["carry-over.csv"]),
    "level3-planners": (level_tables.level3_planners, ["level3-planners.csv"]),
    "lab": (lab_tables.lab, ["lab.csv"]),
    "knobs": (lab_tables.knobs, ["knobs.csv"])}


# -------------------------------------------------------------------------------------------- pages


def make(name):
    """The table of that name. Raises OSError where a file that it needs is missing."""
    maker, sources = TABLES[name]
    contents = []
    for source in sources:
        path = RESULTS / source
        if path.suffix == ".json":
            contents.append(json.loads(path.read_text()))
        else:
            contents.append(read_table(path))
    return maker(*contents)


def fill(text):
    """A page's text with its tables as they should be, and the names of these tables.

    Raises ValueError for a marker whose name is unknown, or that has no end.
    """
    names = [match["name"] for match in MARKED.finditer(text)]
    for name in names:
        if name not in TABLES:
            raise ValueError(f"an unknown table '{name}', known are {', '.join(TABLES)}")
    if len(MARKER.findall(text)) != 2 * len(names):
        raise ValueError("a marker <!-- table: NAME --> without its <!-- end -->, or the reverse")
    filled = MARKED.sub(lambda match: f"{match[1]}{make(match['name'])}\n{match[3]}", text)
    return filled, names


def pages():
    """README.md and the pages of docs/."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def main(argv=None):
    """The command line: fill every page."""
    parser = CommandLine("Write the tables of results/ into README.md and docs/.")
    parser.parse(argv)
    problems = []
    for page in pages():
        name = page.relative_to(ROOT).as_posix()
        try:
            text = page.read_text(encoding="utf-8")
            filled, names = fill(text)
            if filled != text:
                page.write_text(filled, encoding="utf-8")
        except OSError as error:
            problems.append(f"{name} needs '{error.filename}': {error.strerror}")
        except ValueError as error:
            problems.append(f"{name} has {error}")
        else:
            if names:
                print(f"{name}: {', '.join(names)}" + (" (changed)" if filled != text else ""))
    if problems:
        parser.error("; ".join(problems))


if __name__ == "__main__":
    main()
