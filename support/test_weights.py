"""Tests of weights files and of other files of a run."""

import json
import os
import pickle
import shutil
from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file

import scenes
from model import make_network
from support.run_folder import RunFolder
from support.runs import RunError, read_table, write
from support.weights import FILE, load_model, save_model

ROOMS = [scenes.load("env1"), scenes.load("env2")]


def test_a_failed_write_leaves_the_old_file(tmp_path):
    write(tmp_path / "a.txt", "old\n")

    def fail(file):
        file.write(b"half")
        raise KeyboardInterrupt
    with pytest.raises(KeyboardInterrupt):
        write(tmp_path / "a.txt", fail)
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == {"a.txt": b"old\n"}
    with pytest.raises(OSError, match="directory: 'none/a.txt'$"):
        write("none/a.txt", "new\n")


def test_a_table_is_read_without_its_comments(tmp_path):
    write(tmp_path / "a.csv", "# a comment\na,b\n1,\"x,y\"\n# another\n2,\n")
    assert read_table(tmp_path / "a.csv") == [{"a": "1", "b": "x,y"}, {"a": "2", "b": ""}]


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A network and the file that holds its weights."""
    file = tmp_path_factory.mktemp("saved") / FILE
    model = make_network(3, "single", "target", (0.5, 2.0))
    save_model(file, model, ROOMS)
    return model, file


def are_same(model, other):
    """Returns whether two networks are equal to the last bit."""
    return (model.memory, model.without) == (other.memory, other.without) and all(
        torch.equal(value, other.state_dict()[name]) for name, value in model.state_dict().items())


def test_saved_weights_are_loaded_with_their_network_and_rooms(saved):
    model, file = saved
    for path in (file, file.parent, str(file)):
        loaded, rooms = load_model(path)
        assert rooms == ROOMS and are_same(loaded, model)


def test_a_run_under_way_has_its_newest_weights_on_disk(saved, tmp_path):
    for path, words in ((tmp_path, "has no model.safetensors yet"), ("a\0b", "does not exist")):
        with pytest.raises(RunError, match=f"{words}: it must be a run folder or a .safetensors"):
            load_model(path)
    folder = RunFolder(tmp_path)
    model = make_network(1)
    folder.offer_weights(model, ROOMS, now=True)
    folder.offer_weights(saved[0], ROOMS)  # ignored: the last write was less than ten seconds ago
    assert are_same(load_model(tmp_path)[0], model)


@pytest.mark.parametrize("name, value, about, words", [
    ("value_head.bias", torch.zeros(2), {}, "size mismatch for value_head.bias"),
    ("value_head.bias", torch.tensor([torch.nan]), {}, "its weights are not all finite"),
    ("other", torch.zeros(1), {}, "Unexpected key(s) in state_dict: \"other\""),
    (None, None, {"memory": "big"}, "it is not a network of this version"),
    (None, None, {"format": "navbot_min 2"}, "it is not a network of this version"),
    (None, None, {"scenes": 3}, "")])
def test_a_bad_weights_file_gives_one_sentence_with_the_reason(name, value, about, words, saved,
                                                               tmp_path):
    file = shutil.copy(saved[1], tmp_path)
    with safe_open(file, "pt") as content:
        weights = {key: content.get_tensor(key) for key in content.keys()}
        metadata = json.loads(content.metadata()["navbot_min"])
    if name is not None:
        weights[name] = value
    save_file(weights, file, {"navbot_min": json.dumps(metadata | about)})
    with pytest.raises(RunError) as error:
        load_model(file)
    assert str(error.value).startswith(f"'{file}' has no weights of this program: ")
    assert words in str(error.value) and "\n" not in str(error.value)


class Code:
    """An object whose pickle calls a function."""

    def __reduce__(self):
        return os.mkdir, ("executed",)


@pytest.mark.parametrize("content", [
    b"", pickle.dumps(Code()), (2 ** 60).to_bytes(8, "little") + b"{}"])
def test_an_untrusted_file_is_refused_and_nothing_in_it_is_executed(content, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("bad.safetensors").write_bytes(content)
    with pytest.raises(RunError, match="^'bad.safetensors' has no weights of this program: "):
        load_model("bad.safetensors")
    assert not Path("executed").exists()
