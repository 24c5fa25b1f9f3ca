"""The drives of a class in one table and one figure: `python -m classroom.pool FOLDER`. The folder
contains each person's drives.csv, under any name. The same room and seed give the same tasks."""

import csv
from pathlib import Path

from matplotlib.figure import Figure

import scenes
from classroom.drive import policy_for, rows_of, same_tasks, summary, table
from sim import SceneError
from support.cli import option, parse
from support.palette import PALETTE
from support.pictures import WIDTH, save
from support.runs import RunError

COLUMNS = dict(name=str, env=str, seed=int, episode=int, outcome=str, seconds=float, spl=float)


def read_drives(folder):
    """Returns each person's first try at each task, name -> rows. Raises RunError, OSError."""
    drivers = {}  # (name, env, seed) -> episode -> row
    for file in sorted(Path(folder).rglob("*.csv")):
        with open(file, newline="", encoding="utf-8-sig") as text:  # with or without BOM
            reader = csv.DictReader(text)
            try:
                rows = [{key: kind(row[key]) for key, kind in COLUMNS.items()} for row in reader]
            except (csv.Error, KeyError, TypeError, ValueError):
                raise RunError(f"'{file}', line {reader.line_num}, is not a drive of "
                               "classroom.drive") from None
        for row in rows:
            tries = drivers.setdefault((row["name"], row["env"], row["seed"]), {})
            first = tries.setdefault(row["episode"], row | {"file": file})  # only the first
            if first["file"] != file:
                raise RunError(f"'{row['name']}' is in two files: choose another --name")
    tasks = {f"{len(tries)} tasks in {env} with seed {seed}"
             for (_, env, seed), tries in drivers.items()}
    if len(tasks) != 1:
        raise RunError(f"'{folder}' contains drives of {' and '.join(sorted(tasks)) or 'no task'}: "
                       "all must be of the same tasks")
    return {name: list(tries.values()) for (name, _, _), tries in drivers.items()}


def main(argv=None):
    """Prints the table of a class and draws drives.png: success rate and SPL of each person."""
    folder = option("drives", "folder with everyone's drives.csv, under any names", positional=True)
    options, parser = parse({"folder": folder}, "Compare the drives of a class.", argv)
    try:
        drivers = read_drives(options.folder)
        tries = next(iter(drivers.values()))  # all have the same tasks
        scene = scenes.load(tries[0]["env"])
    except (RunError, SceneError, OSError) as error:
        parser.error(error)
    name, policy = policy_for(scene)
    trained = summary(rows_of(same_tasks(policy, scene, len(tries), tries[0]["seed"])))
    results = [(driver, summary(rows)) for driver, rows in drivers.items()]
    results.sort(key=lambda pair: (pair[1]["success"], pair[1]["spl"]))
    figure = Figure(figsize=(WIDTH, 1.2 + 0.35 * len(results)), layout="constrained")
    names = [driver for driver, _ in results]
    panels = figure.subplots(1, 2, sharey=True)
    for axes, key, label in zip(panels, ("success", "spl"), ("success rate", "SPL")):
        axes.barh(names, [result[key] for _, result in results], color=PALETTE["run"])
        axes.axvline(trained[key], color=PALETTE["arrival"], lw=2)
        axes.set_yticks(names, names, parse_math=False)
        axes.set(xlabel=label, xlim=(0, 1.05))
    for driver, result in results:
        panels[0].hlines(driver, result["low"], result["high"], color=PALETTE["robot"], lw=1)
    figure.suptitle(f"{tries[0]['env']}, {len(drivers)} drivers, {len(tries)} tasks; tall line: "
                    "trained policy; thin: 95 % intervals", parse_math=False)
    save(figure, "drives.png")
    print(table([(name, trained), *reversed(results)]) + "\ndrives.png")


if __name__ == "__main__":
    main()
