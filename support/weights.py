"""Saves and loads weights, `model.safetensors`. Nothing in such a file can be executed."""

import json
from dataclasses import asdict
from pathlib import Path

from safetensors import SafetensorError, safe_open
from safetensors.torch import save

import scenes as scene_files
from model import BLANKS, MEMORIES, Network
from support.runs import RunError, write

FILE = "model.safetensors"
FORMAT = "navbot_min 3"


def save_model(path, model, scenes):
    """Writes the weights, with a description of the network and of its training rooms as metadata.
    Raises OSError."""
    about = {"format": FORMAT, "memory": model.memory, "without": model.without,
             "scenes": [asdict(scene) for scene in scenes]}
    weights = {name: value.contiguous() for name, value in model.state_dict().items()}
    write(path, save(weights, {"navbot_min": json.dumps(about)}))


def load_model(path):
    """Returns the Network and the list of Scenes of a run folder or a weights file. While a run is
    under way, these are its newest weights. Raises RunError."""
    path = Path(path)
    file = path / FILE if path.is_dir() else path
    if not file.exists():
        missing = f"has no {FILE} yet" if path.is_dir() else "does not exist"
        raise RunError(f"run '{path}' {missing}: it must be a run folder or a .safetensors file")
    try:
        with safe_open(file, "pt") as content:
            about = json.loads((content.metadata() or {})["navbot_min"])
            weights = {name: content.get_tensor(name) for name in content.keys()}
        known = about["memory"] in MEMORIES and about["without"] in BLANKS
        if about["format"] != FORMAT or not known:
            raise ValueError("it is not a network of this version")
        model = Network(about["memory"], about["without"])
        model.load_state_dict(weights)
        if not all(value.isfinite().all() for value in weights.values()):
            raise ValueError("its weights are not all finite")
        return model, [scene_files.rebuild(fields) for fields in about["scenes"]]
    except (OSError, SafetensorError, ValueError, KeyError, TypeError, RuntimeError) as error:
        reason = " ".join(str(error).split())[:150]
        raise RunError(f"'{file}' has no weights of this program: {reason}") from None
