"""How a run begins: what its options must obey together, and where `--resume` goes on."""

import json
import sys
from contextlib import contextmanager
from dataclasses import asdict, fields, replace
from pathlib import Path

import torch

import scenes as scene_files
from sim import SceneError
from support import checkpoints
from support.command_line import CommandLine
from support.cores import ProcessLost, available_cores, one_thread
from support.paths import check_new_folder
from support.processes import torchrun_count, torchrun_rank
from support.rooms import RANDOM, validation_scenes
from support.run_folder import PASSING, RunError, WriteError, how_to_go_on, new_folder
from support.weights import first_network

MOST_WORKERS = 4  # unless more are asked for: more were not tried, and each takes memory
CHANGEABLE = ("steps", *PASSING)  # options that a run may go on with other values of
LARGEST_CONFIG = 2 ** 16  # bytes of config.json


def open_run(config, parser, make_training):
    """What a run begins with: its config, its scenes and, where it goes on, the states of all
    processes, else None. What is not valid ends the program.

    make_training(config, scenes, processes) makes a Training to compare a checkpoint with.
    """
    one_thread()  # before anything is computed
    try:
        if "resume" in parser.given:
            config = resumed(config, parser)
        check_run(config, parser)
        first_network(config)  # whether it can be begun with
        saved = checkpoints.load(config, make_training) if config.resume else None
        if saved is not None:
            return config, *saved
        scenes, name = scenes_of(config)
        check_reality(config, scenes, parser)
        if not config.resume:
            config.out = config.out or str(new_folder(f"runs/{name}-seed{config.seed}"))
            if torchrun_rank() == 0:  # the process that writes
                check_new_folder(config.out)
                parser.remark(scene_files.remark(config.env))
        return config, scenes, None
    except (SceneError, RunError) as error:
        parser.error(error)


def scenes_of(config):
    """The Scenes that a run begins with, and their name. Raises SceneError."""
    if config.env == RANDOM:
        return validation_scenes(), RANDOM
    scene = scene_files.load(config.env)
    if config.targets == "memorize":  # one target, and there are no others
        scene = replace(scene, training_targets=scene.training_targets[:1], new_targets=())
    return [scene], scene.name


def resumed(config, parser):
    """The config of the run that `config.resume` names, with what may be changed of it by this
    command line. Raises RunError."""
    path = Path(config.resume)
    file = path / "config.json"
    if not config.resume or not file.is_file():
        raise RunError(f"--resume '{config.resume}' is no run folder: it has no config.json")
    own = read_config(file, type(config))
    for name in parser.given:
        flag = f"--{name.replace('_', '-')}"
        begun = getattr(own, name)
        if name not in CHANGEABLE and getattr(config, name) != begun:
            raise RunError(f"{flag} is {getattr(config, name)}, but run '{path}' was begun "
                           f"{'without' if begun == '' else f'with {begun}'}: leave it out")
    if "steps" in parser.given:
        if config.steps < own.steps:
            raise RunError(f"--steps is {config.steps}, it must be at least {own.steps}, as run "
                           f"'{path}' was begun with")
        own.steps = config.steps
    return replace(own, resume=config.resume, json=config.json, out=str(path))


def read_config(file, config_class):
    """The config that a run folder's config.json holds, checked as a command line is."""
    try:
        if file.stat().st_size > LARGEST_CONFIG:
            raise ValueError
        table = json.loads(file.read_text(encoding="utf-8"))
        argv = []
        for item in fields(config_class):
            if item.name in PASSING:
                continue
            value = table.pop(item.name)
            flag = f"--{item.name.replace('_', '-')}"
            if item.type is bool and value:
                argv.append(flag)
            elif item.type is not bool:
                argv.append(f"{flag}={value}")
        parser = CommandLine("")
        parser.exit = _refuse
        return parser.read(config_class, argv)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise RunError(f"'{file}' holds no config of this program") from None


def _refuse(code, message):
    raise ValueError


@contextmanager
def faults_as_one_line(config, record):
    """What keeps a run from going on ends the program with one line. record: of its training."""
    go_on = how_to_go_on(config)
    try:
        yield
    except RunError as error:  # another program writes to the folder, or weights are too large
        sys.exit(f"\nerror: {error}")
    except (WriteError, ProcessLost) as error:
        sys.exit(f"\nerror: {error}; {go_on}")
    except FloatingPointError as error:
        sys.exit(f"\nerror: {error} of update {len(record.updates) + 1} is not finite; the last "
                 "checkpoint is kept; try a new run with a --learning-rate below "
                 f"{config.learning_rate}")


def default_workers(config):
    """As many workers as there are cores to use that can share the robots, MOST_WORKERS at most."""
    if torchrun_count():
        return torchrun_count()
    if config.device == "cuda":
        return 1
    most = min(len(available_cores()), MOST_WORKERS,
               config.episodes_per_update // config.minibatches)
    return max(count for count in range(1, max(most, 1) + 1) if config.robots % count == 0)


def check_task(config, parser):
    """Ends the program where options contradict the task. In random rooms there is one alone."""
    is_random = config.env == RANDOM
    if is_random and "targets" not in parser.given:
        config.targets = "anywhere"
    if is_random and config.targets != "anywhere":
        parser.error(f"--targets is {config.targets}, with --env {RANDOM} it must be anywhere")
    goes_with = {"rooms": (f"--env {RANDOM}", is_random),
                 "mirrored": ("--targets both", config.targets == "both"),
                 "random_starts": ("--targets both", config.targets == "both")}
    for name, (other, valid) in goes_with.items():
        if name in parser.given and not valid:
            parser.error(f"--{name.replace('_', '-')} is {getattr(config, name)}, it goes with "
                         f"{other} alone: leave it out")


def check_reality(config, scenes, parser):
    """Ends the program where a room's own errors are to be drawn at random."""
    for scene in scenes:
        if config.reality and scene.reality:
            parser.error(f"--reality is {config.reality}, with --env {config.env} it must be left "
                         "out: the room's file says what reality does there")


def check_run(config, parser):
    """Ends the program where a run cannot be begun: there is no such GPU, or the robots and the
    episodes of a minibatch cannot be shared. Sets `config.workers` if it is 0."""
    check_task(config, parser)
    if config.device == "cuda" and not torch.cuda.is_available():
        parser.error("--device is cuda, but torch finds no such GPU here; it must be cpu")
    if config.minibatches > config.episodes_per_update:
        parser.error(f"--minibatches is {config.minibatches}, it must be at most "
                     f"{config.episodes_per_update}, the episodes of an update")
    config.workers = config.workers or default_workers(config)
    if torchrun_count() not in (0, config.workers):
        parser.error(f"--workers is {config.workers}, under torchrun it must be left out")
    if config.device == "cuda" and config.workers > 1 and not torchrun_count():
        parser.error(f"--workers is {config.workers}, with --device cuda it must be 1; torchrun "
                     "shares the work of several GPUs")
    if config.robots % config.workers:
        parser.error(f"--robots is {config.robots}, it must be a multiple of the "
                     f"{config.workers} processes")
    most = config.episodes_per_update // config.minibatches
    if config.workers > most:
        parser.error(f"--workers is {config.workers}, it must be at most {most}, the episodes of a "
                     "minibatch")
