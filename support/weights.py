"""Weights as a file: both ends of its format, `save_model` and `load_run`."""

from dataclasses import asdict
from pathlib import Path

import torch

import scenes as scene_files
from model import BLANKS, MEMORIES, SHUT, Network, make_network
from scenes.limits import sentence, shown, shown_path
from sim import SceneError
from support.run_folder import RunError, write
from support.torch_files import read_torch_file

FORMAT = "navbot_min model"
VERSION = 1
LARGEST = 2 ** 23  # bytes of the file, our choice: the weights are 4 MB
MOST_SCENES = 256  # our choice
# With weights up to this, no step of the network leaves the range of its floats, so that whatever
# it sees it drives: 8 layers without an LSTM between them are the most. Trained ones are far below.
LARGEST_WEIGHT = 300.0
LARGEST_GATE_WEIGHT = -SHUT  # of an LSTM's inputs; its own output is at most 1
LARGEST_LOG_STD = 10.0
COMMAND_SCALES = (1e-2, 1e2)  # [m/s, rad/s] lowest and highest `command_scale`


def save_model(path, model, scenes):
    """Writes the weights, what rebuilds the network, and the scenes it learnt in. Raises RunError
    for weights that `load_run` would refuse, and WriteError."""
    check_weights(model)
    content = {"format": FORMAT, "version": VERSION, "weights": dict(model.state_dict()),
               "memory": model.memory, "without": model.without,
               "scenes": [asdict(scene) for scene in scenes]}
    write(path, lambda file: torch.save(content, file))


def check_weights(model):
    """Raises RunError for weights that `load_run` would refuse, before they are written."""
    for name, weight in model.state_dict().items():
        reason = wrong_values(name, weight)
        if reason:
            raise RunError(f"weights '{name}' {reason}, and are not saved; try a new run with a "
                           "lower --learning-rate")


def load_run(path):
    """The network and the list of scenes of a run folder, or of its weights' file. Raises RunError;
    nothing in the file is executed."""
    what = f"run {shown_path(path)}"
    valid = "it must be a run folder or a .pt file"
    try:
        if not Path(path).exists():
            raise RunError(f"{what} does not exist: {valid}")
        file = Path(path) / "model.pt" if Path(path).is_dir() else Path(path)
        if not file.is_file():
            raise RunError(f"{what} has no {shown_path(file.name)}: {valid}")
    except OSError as error:
        raise RunError(f"{what} cannot be read: {error.strerror}") from None
    saved = read_torch_file(file, LARGEST)
    form, version = saved.get("format"), saved.get("version")
    if not isinstance(form, str) or form != FORMAT:
        raise RunError(f"{shown_path(file)} holds no weights of this program")
    if type(version) is not int or version != VERSION:
        raise RunError(f"{shown_path(file)} is of version {shown(version)} of its format, it must "
                       f"be {VERSION}")
    try:
        return network_of(saved), scenes_of(saved)
    except (RunError, SceneError) as error:
        raise RunError(sentence(f"{shown_path(file)} is no whole run: {error}")) from None


def first_network(config):
    """The network that a training begins with: that of `config.init`, else random weights, which a
    checkpoint soon replaces where the training goes on. Raises RunError.

    Of weights that have learnt only eyes and memory are kept. What it does and what it expects, the
    last layers and the deviations of its actions, begin anew: where it stands still, sure of itself
    in a world of another look, it would learn next to nothing."""
    if not config.init or config.resume:
        return make_network(config.seed, config.memory, config.without)
    model, _ = load_run(config.init)
    for name in ("memory", "without"):
        own = getattr(model, name)
        wanted = getattr(config, name)
        if own != wanted:
            raise RunError(f"--init {shown_path(config.init)} was trained with --{name} "
                           f"{own or 'nothing'}, but --{name} is {wanted or 'nothing'}")
    fresh = make_network(config.seed, config.memory, config.without)
    model.action = fresh.action
    model.value = fresh.value
    model.log_std = fresh.log_std
    return model


def network_of(saved):
    """The Network that a file's content describes. Raises RunError."""
    for name, valid in (("memory", MEMORIES), ("without", BLANKS)):
        value = saved.get(name)
        if not isinstance(value, str) or value not in valid:
            raise RunError(f"{name} is {shown(value)}, it must be one of {', '.join(valid)}")
    model = Network(saved["memory"], saved["without"])
    weights = saved.get("weights")
    expected = model.state_dict()
    if not isinstance(weights, dict) or weights.keys() != expected.keys():
        raise RunError("the names of its weights are not those of its network")
    for name, like in expected.items():
        weight = weights[name]
        if not isinstance(weight, torch.Tensor):
            raise RunError(f"weights '{name}' are {shown(weight)}, it must be a tensor")
        if weight.dtype != like.dtype or weight.shape != like.shape:
            raise RunError(f"weights '{name}' are {kind(weight)}, it must be {kind(like)}")
        reason = wrong_values(name, weight)
        if reason:
            raise RunError(f"weights '{name}' {reason}")
    model.load_state_dict(weights)
    return model


def scenes_of(saved):
    """The Scenes that a file's content describes. Raises RunError, SceneError."""
    scenes = saved.get("scenes")
    if not isinstance(scenes, list) or not 1 <= len(scenes) <= MOST_SCENES:
        raise RunError(f"scenes is {shown(scenes)}, it must be a list of 1 to {MOST_SCENES}")
    return [scene_files.rebuild(fields) for fields in scenes]


def kind(tensor):
    """A tensor's type and shape in a few words."""
    return f"{str(tensor.dtype).removeprefix('torch.')} {shown(tuple(tensor.shape))}"


def wrong_values(name, weight):
    """What is wrong with the values of those weights, in words, or "" where nothing is."""
    largest = LARGEST_WEIGHT
    if name == "log_std":
        largest = LARGEST_LOG_STD
    elif "weight_ih" in name:
        largest = LARGEST_GATE_WEIGHT
    if not weight.isfinite().all():
        return "are not all finite numbers"
    if weight.abs().max() > largest:
        return f"have a value beyond {largest:g}"
    low, high = COMMAND_SCALES
    if name == "command_scale" and not (low <= weight.min() and weight.max() <= high):
        return f"are not from {low:g} to {high:g}"
    return ""
