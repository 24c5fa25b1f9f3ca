"""Weights as a file: both ends of its format, `save_model` and `load_run`."""

import pickle
import warnings
from dataclasses import asdict
from pathlib import Path

import torch

import scenes as scene_files
from model import Network
from support.run_folder import write


class RunError(ValueError):
    """A run that cannot be used; the message names it and says why."""


def save_model(path, model, scenes):
    """Writes the weights, what rebuilds the network, and the scenes it learnt in."""
    content = {"weights": model.state_dict(), "memory": model.memory, "without": model.without,
               "scenes": [asdict(scene) for scene in scenes]}
    write(Path(path), lambda partial: torch.save(content, partial))


def load_run(path):
    """The network and the list of scenes of a run folder, or of its weights' file. Raises RunError;
    what is in the file is never executed."""
    valid = "it must be a run folder or a .pt file"
    if not Path(path).exists():
        raise RunError(f"run '{path}' does not exist: {valid}")
    file = Path(path) / "model.pt" if Path(path).is_dir() else Path(path)
    if not file.is_file():
        raise RunError(f"run '{path}' has no {file.name}: {valid}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about files that are none of ours: the error says it
            saved = torch.load(file, weights_only=True, map_location="cpu")
        scenes = [scene_files.rebuild(fields) for fields in saved["scenes"]]
        model = Network(saved["memory"], saved["without"])
        model.load_state_dict(saved["weights"])
    except KeyError as error:
        raise RunError(f"'{file}' is not a whole run of this network: it has no {error}") from None
    except (pickle.UnpicklingError, EOFError, RuntimeError, TypeError, ValueError,
            AttributeError) as error:
        reason = (str(error) or type(error).__name__).splitlines()[0][:200]
        raise RunError(f"'{file}' is not a whole run of this network: {reason}") from None
    return model, scenes
