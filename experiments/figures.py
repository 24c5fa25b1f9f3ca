"""The figures of the results: `python -m experiments.figures` draws all of them into pictures/.

Curves, floors and the benchmark come from the tables in results/; paths and the film are fresh
episodes of the policies in pretrained/.
"""

import json
from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

import scenes
from evaluation import PATCH, Assignment, Policy, film_episode, rollouts
from experiments import gallery
from experiments.runs import RESULTS, ROOT
from support.film import write_film
from support.pictures import (PALETTE, SPACING, WIDTH, WINDOW, draw_curves, draw_path, draw_robot,
                              draw_room, draw_target, draw_trajectories, floor_handles,
                              outcome_handle, paint_floor, read_table, released_curve,
                              start_handle, target_handle)
from support.weights import load_run
from support.traces import OUTCOMES
from train import SUCCESS_RATE

DPI = 130

ENVS = ("env1", "env2")
WAYS = {  # to train: the name of each, and the mark of its frozen policies
    "one-start": ("one start pose", {"marker": "s", "ms": 6, "ls": "none", "mfc": "none"}),
    "varied": ("starts anywhere, and mirrored",
               {"marker": "o", "ms": 7, "ls": "none", "mfc": "none"})}
BESIDE = {"one-start": 1.03, "varied": 1.07}  # budgets: where its frozen policies are drawn
SEEDS = "01234"
HIDDEN = {"": "nothing hidden", "place": "place hidden", "cube": "cube hidden"}
HIDDEN_EPISODES = 8  # of each panel of `draw_hidden`
PATHS = 20  # to each target in Fig. 6
STAGES = {"env_sps": ("environment step", "o", "-"),  # of the benchmark: name, mark and line
          "camera_fps": ("camera image", "s", "--"),
          "world_sps": ("world step", "^", ":")}


def select(rows, **values):
    """Those rows of a table that have these values."""
    return [row for row in rows if all(row[key] == value for key, value in values.items())]


def way_handles():
    """A legend's entries for the ways to train."""
    return [Line2D([], [], color=PALETTE[way], lw=1.5, label=name)
            for way, (name, _) in WAYS.items()]


def draw_training(axes, curves, seeds, env):
    """Draws one panel of `draw_memorizing_reasoning`. The frozen policies stand beside the curves,
    each way's apart, so that none hides the other's."""
    for way, (_, mark) in WAYS.items():
        for seed in SEEDS:
            points = select(curves, env=env, way=way, seed=seed, kind="new")
            axes.plot([float(row["steps"]) / 1000 for row in points],
                      [100 * float(row["success"]) for row in points],
                      color=PALETTE[way], lw=1.2, alpha=0.8)
        ends = select(seeds, env=env, way=way)
        budget = max(float(row["steps"]) for row in ends) / 1000
        axes.plot([BESIDE[way] * budget] * len(ends),
                  [100 * float(row["new_success"]) for row in ends], color=PALETTE[way],
                  clip_on=False, zorder=3, **mark)
    axes.axvline(1.005 * budget, color=PALETTE["robot"], lw=0.8, ls=":")
    axes.text(1.05 * budget, 50, "frozen", rotation=90, ha="center", va="center", fontsize=9)
    axes.set(title=env, xlabel="steps [thousands]", xlim=(0, 1.1 * budget), ylim=(-3, 103))
    axes.grid(alpha=0.3)


def draw_memorizing_reasoning(curves, seeds):
    """Success on new targets against steps, both ways, every seed, and the frozen last policies.

    curves, seeds: rows of `results/curves.csv` and `results/seeds.csv`. Returns a Figure.
    """
    figure = Figure(figsize=(WIDTH, 4.1), layout="constrained")
    for axes, env in zip(figure.subplots(1, 2, sharey=True), ENVS):
        draw_training(axes, curves, seeds, env)
    figure.axes[0].set_ylabel(f"new targets reached,\nlast {WINDOW} episodes [%]")
    handles = []
    for way, (name, mark) in WAYS.items():
        handles.append(Line2D([], [], color=PALETTE[way], label=f"{name}: while training"))
        handles.append(Line2D([], [], color=PALETTE[way], label=f"{name}: last policies, frozen",
                              **mark))
    first, second = (int(row["episodes"]) for row in curves[:2])
    figure.legend(handles=handles, loc="outside lower center", ncols=2, frameon=False, fontsize=9,
                  title=f"a curve has a point every {second - first} episodes to new targets, "
                        "so some end before the budget (dotted)", title_fontsize=9)
    return figure


def draw_learning(curves, env):
    """Fig. 4 (env1) or 5 (env2) over the five seeds, the paper's curves behind.

    curves: rows of `results/curves.csv`. Returns a Figure.
    """
    figure = Figure(figsize=(WIDTH, 5.8), layout="constrained")
    panels = figure.subplots(2, 2, sharey="row", sharex="col")
    for column, kind in enumerate(("training", "new")):
        theirs = released_curve(env, kind)
        ours = {way: [select(curves, env=env, way=way, seed=seed, kind=kind) for seed in SEEDS]
                for way in WAYS}
        for i, (key, scale) in enumerate((("success", 100), ("return", 1))):
            axes = panels[i, column]
            axes.plot(theirs[0], theirs[i + 1], color=PALETTE["paper"], lw=2)
            for way, runs in ours.items():
                for points in runs:
                    axes.plot([int(row["episodes"]) for row in points],
                              [scale * float(row[key]) for row in points],
                              color=PALETTE[way], lw=1, alpha=0.75)
            axes.set_xscale("log")
            axes.grid(alpha=0.3)
        panels[0, column].set_ylim(-3, 103)
        panels[0, column].set_title(f"{kind} targets", color=PALETTE[kind], weight="bold")
        window = str(WINDOW)
        if SPACING[env][kind] != WINDOW:
            window += f" (paper: {SPACING[env][kind]})"
        panels[1, column].set(xlabel=f"episodes to {kind} targets",
                              ylabel=f"average reward of an episode,\nlast {window} episodes")
    panels[0, 0].set_ylabel(f"success rate,\nlast {WINDOW} episodes [%]")
    paper = Line2D([], [], color=PALETTE["paper"], lw=2, label="the paper's run, released records")
    figure.legend(handles=[paper, *way_handles()], loc="outside lower center", ncols=3,
                  frameon=False, fontsize=9)
    figure.suptitle(f"{env}: five seeds of each way to train, and the paper's run")
    return figure


def draw_floors(rows, rooms, patch):
    """Where robots arrive that were trained in two ways, on validation targets, from the start.

    rows: of `results/floor.csv`, all seeds. rooms: Scenes. Returns a Figure.
    """
    figure = Figure(figsize=(WIDTH, 6), layout="constrained")
    panels = figure.subplots(len(WAYS), len(rooms), squeeze=False)
    any_grey = False
    for row, (way, (name, _)) in zip(panels, WAYS.items()):
        for axes, scene in zip(row, rooms):
            chosen = select(rows, env=scene.name, way=way)
            n = [int(spot["n"]) for spot in chosen]
            goals = [(float(spot["x"]), float(spot["y"])) for spot in chosen]
            success = [float(spot["success"]) for spot in chosen]
            mesh, grey = paint_floor(axes, scene, np.repeat(goals, n, axis=0),
                                     np.repeat(success, n), patch)
            any_grey |= grey
            draw_robot(axes, scene.start)
            axes.set_title(f"{scene.name}: {name}", fontsize=10)
    figure.colorbar(mesh, ax=panels, label="episodes that arrive,\nmean over five seeds [%]",
                    shrink=0.7)
    figure.legend(handles=[start_handle(), *floor_handles(rooms[0], any_grey)],
                  loc="outside lower center", ncols=5, frameon=False, fontsize=9)
    return figure


def draw_hidden(scene_traces):
    """What a policy does whose target is hidden: its paths from the start to one target, a row for
    each scene, a column for what is hidden.

    scene_traces: (scene, what is hidden -> Traces) for each row. Returns a Figure.
    """
    figure = Figure(figsize=(WIDTH, 2.3 * len(scene_traces) + 0.8), layout="constrained")
    panels = figure.subplots(len(scene_traces), len(HIDDEN), squeeze=False, sharey="row")
    met = set()
    for row, (scene, traces_of) in zip(panels, scene_traces):
        for axes, (hidden, name) in zip(row, HIDDEN.items()):
            traces = traces_of[hidden]
            draw_room(axes, scene)
            for trace in traces:
                draw_path(axes, trace, lw=1, alpha=0.7)
            draw_robot(axes, traces[0].start)
            draw_target(axes, scene, traces[0].goal, ring=True)
            arrived = sum(trace.arrived for trace in traces)
            axes.set_title(f"{name}: {arrived} of {len(traces)} arrive", fontsize=9)
            axes.set_ylabel("")
            met |= {trace.outcome for trace in traces}
        row[0].set_ylabel(f"{scene.name}\ny [m]")
    figure.suptitle(f"paths of seed 0 ({WAYS['varied'][0]}), parts of its target hidden",
                    fontsize=10)
    outcomes = [outcome_handle(outcome) for outcome in OUTCOMES if outcome in met]
    figure.legend(handles=[start_handle(), target_handle("new"), *outcomes],
                  loc="outside lower center", ncols=5, frameon=False, fontsize=9)
    return figure


def draw_benchmark(figures):
    """What an image, a world step and an environment step cost against the number of robots, and
    an image against the number of boxes. figures: what `benchmark.json` holds. Returns a Figure."""
    figure = Figure(figsize=(WIDTH, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    for key, (name, mark, line) in STAGES.items():
        robots = [int(R) for R in figures[key]]
        cost = [1e6 / rate for rate in figures[key].values()]  # [µs]
        left.plot(robots, cost, color=PALETTE["robot"], marker=mark, ls=line, label=name)
    left.set(xscale="log", yscale="log", xlabel="robots R, side by side (log scale)",
             ylabel="cost for one robot [µs] (log scale)", title="env1, one core", xticks=robots,
             xticklabels=robots)
    left.minorticks_off()
    left.legend(frameon=False)
    boxes = [int(B) for B in figures["camera_fps_boxes"]]
    cost = [1e6 / rate for rate in figures["camera_fps_boxes"].values()]
    _, mark, _ = STAGES["camera_fps"]
    right.plot(boxes, cost, color=PALETTE["robot"], marker=mark, ls="none")
    right.set(xlim=(0, None), ylim=(0, None), xlabel="boxes in the room, four of them walls",
              ylabel="cost of one camera image [µs]", title="R = 32, one core", xticks=boxes)
    for axes in (left, right):
        axes.grid(alpha=0.3)
    return figure


# ------------------------------------------------------------------------------- what is drawn


def pretrained(env):
    """A driver with the policy of that env in pretrained/, and its scene."""
    model, rooms = load_run(ROOT / "pretrained" / f"{env}.pt")
    return Policy(model, "sampled", seed=0), rooms[0]


def fig6(env):
    """Paths of the policy in pretrained/ from the start to each target. Returns a Figure."""
    driver, scene = pretrained(env)
    robots = [Assignment(scene, target, 1) for target in range(len(scene.targets))
              for _ in range(PATHS)]
    return draw_trajectories(scene, rollouts(driver, robots), PATHS)


def hidden_paths(env):
    """The scene, and what is hidden -> Traces to its last new target."""
    driver, scene = pretrained(env)
    robots = [Assignment(scene, len(scene.targets) - 1, 1)] * HIDDEN_EPISODES
    return scene, {hidden: rollouts(driver, robots, hidden=hidden) for hidden in HIDDEN}


def draw_all():
    """Yields the name of each figure and the Figure."""
    seeds = read_table(RESULTS / "seeds.csv")
    curves = read_table(RESULTS / "curves.csv")
    yield "memorizing-reasoning", draw_memorizing_reasoning(curves, seeds)
    yield "fig4", draw_learning(curves, "env1")
    yield "fig5", draw_learning(curves, "env2")
    rooms = [scenes.load(env) for env in ENVS]
    yield "floor", draw_floors(read_table(RESULTS / "floor.csv"), rooms, PATCH)
    for env in ENVS:
        yield f"fig6-{env}", fig6(env)
    yield "hidden", draw_hidden([hidden_paths(env) for env in ENVS])
    yield "benchmark", draw_benchmark(json.loads((RESULTS / "benchmark.json").read_text()))
    run = ROOT / "runs" / "env1-seed0" / "episodes.csv"
    if run.exists():  # of `python train.py --env env1`
        yield "curves", draw_curves(read_table(run), "env1", SUCCESS_RATE)


def main(argv=None):
    """The command line."""
    gallery.read_command_line("Draw every figure of the results into pictures/.", argv)
    gallery.save(draw_all(), DPI)
    driver, scene = pretrained("env1")
    trace = replace(film_episode(driver, scene), label="driven by pretrained/env1.pt")
    write_film(trace, gallery.PICTURES / "episode.gif")
    print("pictures/episode.gif")


if __name__ == "__main__":
    main()
