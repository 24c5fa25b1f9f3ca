"""Each test is the shortest proof of one claim about files that may come from strangers.

NAVBOT_FUZZ=100000 in the environment makes the fuzz tests try so many cases of each kind: scenes
and files of weights, and half as many Gazebo worlds.
"""

import copy
import os
import pickle
import random
import re
import warnings
import zipfile
from collections import OrderedDict
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import scenes
from evaluation.drivers import Policy
from evaluation.examine import evaluate
from model import make_network
from scenes.limits import LARGEST_FILE, MOST_BOXES, MOST_TARGETS, shown
from scenes.test_scenes import box, square_room
from scenes.test_world_file import GOOD as WORLD
from sim import Scene, SceneError
from support import weights
from support.pictures import draw_trajectories
from support.run_folder import RunError
from support.torch_files import read_torch_file
from support.weights import LARGEST_GATE_WEIGHT, LARGEST_WEIGHT, load_run, save_model

CASES = int(os.environ.get("NAVBOT_FUZZ", 1000))
ENV1 = scenes.load("env1")
# Small, so that many of its kind are checked in a second.
ROOM = square_room(half=0.5, training_targets=[[0.2, 0.0]], new_targets=[[0.0, 0.2]])
TEXT = (scenes.SCENE_FOLDER / "env1.toml").read_bytes()


def nested(levels):
    """A list that names one list twice, which names another one twice, and so on."""
    value = [1]
    for _ in range(levels):
        value = [value, value]
    return value


def is_sentence(error):
    """Whether a message is one printable sentence of our length, without what libraries say."""
    text = str(error)
    foreign = ("torch", "pickle", "weights_only", "Traceback", "object at 0x", "codec")
    return len(text) < 200 and text.isprintable() and not any(word in text for word in foreign)


def outcome(read, *arguments):
    """What a reader returns, or the word "refused" where it refuses in a sentence."""
    try:
        return read(*arguments)
    except (SceneError, RunError) as error:
        assert is_sentence(error), str(error)
        return "refused"


# ------------------------------------------------------------------------------------------ scenes


VALUES = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=30),
    st.sampled_from([10 ** 400, -10 ** 5000, 1e308, 5e-324, 1e6, "\udcff", "\x1b[31m", "$x^$", [],
                     {}, [[]], (1.0,), [0.0] * 3, {"x": 1.0}, b"wall", "wall" * 10 ** 5]),
    st.lists(st.floats(-2, 2), max_size=3), st.floats(-2, 2))


def places(content, path=()):
    """The path of every value in dicts and lists."""
    keys = content if isinstance(content, dict) else range(len(content))
    for key in keys:
        yield (*path, key)
        if isinstance(content[key], (dict, list, tuple)):
            yield from places(content[key], (*path, key))


def change(content, path, action, value):
    """Changes the value at that path of nested dicts and lists: another value, none, or twice."""
    for key in path[:-1]:
        content = content[key]
    if isinstance(content, tuple):
        return  # it stays as it was
    if action == "set":
        content[path[-1]] = copy.deepcopy(value)  # for the next change may go into it
    elif action == "delete":
        del content[path[-1]]
    elif isinstance(content, list):
        content.append(content[path[-1]])
    else:
        content[shown(value)] = content[path[-1]]


@settings(max_examples=CASES * 7 // 10, derandomize=True, deadline=None, database=None,
          suppress_health_check=list(HealthCheck))
@given(st.lists(st.tuples(st.integers(0, 10 ** 6), st.sampled_from(["set", "delete", "twice"]),
                          VALUES), min_size=1, max_size=3),
       st.one_of(st.just("room"), st.text(max_size=90)))
def test_a_changed_scene_is_a_scene_or_refused_in_a_sentence(changes, name):
    table = copy.deepcopy(ROOM)
    for place, action, value in changes:
        paths = list(places(table))
        if paths:
            change(table, paths[place % len(paths)], action, value)
    room = outcome(scenes.parse, table, name)
    assert room == "refused" or isinstance(room, Scene)


@settings(max_examples=CASES * 3 // 10, derandomize=True, deadline=None, database=None,
          suppress_health_check=list(HealthCheck))
@given(st.integers(0, len(TEXT)), st.integers(0, 30), st.one_of(
    st.binary(max_size=20), st.sampled_from([b"[" * 5000, b"{a=" * 3000, b"9" * 5000, b"a." * 3000,
                                             b'"""', b"\0", b"\x1b", b"0x" + b"f" * 4000, b"#"])))
def test_changed_bytes_are_a_scene_or_refused_in_a_sentence(start, removed, put):
    path = Path(FOLDER) / "room.toml"
    path.write_bytes(TEXT[:start] + put + TEXT[start + removed:])
    room = outcome(scenes.load, path)
    assert room == "refused" or isinstance(room, Scene)


WORDS = re.findall(r"[\w.-]+|\s|[^\w\s]", WORLD)  # tags, names, numbers, and what parts them


@settings(max_examples=CASES // 2, derandomize=True, deadline=None, database=None,
          suppress_health_check=list(HealthCheck))
@given(st.lists(st.tuples(st.integers(0, len(WORDS) - 1), st.integers(0, 12), st.one_of(
    st.text(max_size=10), st.floats(-2, 2).map(str), st.sampled_from(WORDS), st.sampled_from([
        "<a>" * 5000, "</link>", "<a/>" * 9000, "nan", "-inf", "1e999", "9" * 5000, "\0", "&lt;",
        "<![CDATA[", "<!--", "&a;", "<!DOCTYPE a [<!ENTITY a 'b'>]>", "<?xml version='1.0'?>",
        "<state><model name='room'><pose>0 0 0 0 0 1</pose></model></state>", "\x1b", "\u202e",
        "<box><size>1 1 1</size></box>", "x" * 10 ** 5, "<a " + 'b="" ' * 100]))),
    min_size=1, max_size=3), st.binary(max_size=3), st.integers(0, 10 ** 6))
def test_a_changed_world_is_a_scene_or_refused_in_a_sentence(changes, put, place):
    words = list(WORDS)
    for start, removed, word in changes:
        words[start:start + removed] = [word]
    content = "".join(words).encode(errors="surrogatepass")
    place %= 8 * len(content)  # so that most files stay text
    path = Path(FOLDER) / "room.world"
    path.write_bytes(content[:place] + put + content[place:])
    room = outcome(scenes.load, path)
    assert room == "refused" or (isinstance(room, Scene) and len(room.training_targets) > 0)


@pytest.fixture(autouse=True, scope="module")
def folder(tmp_path_factory):
    """A folder for the files of this module's tests."""
    global FOLDER
    FOLDER = tmp_path_factory.mktemp("strangers")
    return FOLDER


@pytest.mark.parametrize("content, words", [
    (b"#" * (LARGEST_FILE + 1), "has more than 1,000,000 bytes"),
    (b"a = " + b"[" * 10 ** 5, "nested too deeply"),
    (b"a." * 10 ** 5 + b"a = 1", "has 100000 dots that are in no number"),
    (b"x = 1\nx = \0", "is no valid TOML at line 2, column 5")])
def test_a_file_that_would_take_long_is_refused_at_once(content, words, folder):
    path = folder / "long.toml"
    path.write_bytes(content)
    with pytest.raises(SceneError, match=words) as error:
        scenes.load(path)
    assert is_sentence(error.value)


@pytest.mark.parametrize("path", ["/tmp", "a\0b.toml", "x" * 5000, "x" * 5000 + ".toml", "\udcff"])
def test_what_is_no_file_is_refused_in_a_sentence(path):
    assert outcome(scenes.load, path) == "refused"
    assert outcome(load_run, path) == "refused"


@pytest.mark.parametrize("changes, words", [
    (dict(boxes=[box()] * (MOST_BOXES + 1)), "boxes has 129 entries, it may have 128"),
    (dict(new_targets=[[0.0, 1.0]] * MOST_TARGETS), "new_targets has 1,024 entries"),
    (dict(boxes=[box(x=1e7)]), r"boxes\[0\].x is 10000000.0, it must be a number within 1,000,000"),
    (dict(boxes=[box(length=20.0, thickness=20.0)] * 50), "the rectangles around all boxes cover")])
def test_limits_hold(changes, words):
    with pytest.raises(SceneError, match=words):
        scenes.parse(square_room() | changes, "room")


@pytest.mark.parametrize("name", ["../x", "a/b", "a\\b", "C:x", ".x", "", "x" * 81, "a\nb",
                                  "\udcff", "\x1b[31m", "\u202ex", None, ["x"]])
def test_a_name_leads_nowhere_and_can_be_printed(name):
    with pytest.raises(SceneError, match="^name is "):
        scenes.rebuild(asdict(ENV1) | dict(name=name))


@pytest.mark.parametrize("value", ["x" * 100, "\x1b" * 100, 10 ** 5000, nested(9),
                                   {"x": nested(9)}, torch.zeros(9), Path("x" * 100)],
                         ids=lambda value: type(value).__name__)
def test_a_value_is_shown_in_few_characters(value):
    assert len(shown(value)) <= 40 and shown(value).isprintable()


def test_a_name_is_drawn_as_it_is():
    room = scenes.rebuild(asdict(ENV1) | dict(name="$x^$ a_b"))
    figure = draw_trajectories(room, [])
    figure.draw_without_rendering()  # raises where it reads a formula
    assert figure.get_suptitle().startswith("$x^$ a_b")


# ---------------------------------------------------------------------------------- files of torch


@pytest.fixture(scope="module")
def saved(folder):
    """The file of a network, and what is in it."""
    path = folder / "model.pt"
    save_model(path, make_network(0, "none"), [scenes.parse(ROOM, "room")])
    return path, torch.load(path, weights_only=True)


def flip(content, rng):
    """Those bytes, cut, or with some of them changed; most of the changes lie where the file
    describes itself, at its two ends."""
    content = bytearray(content)
    if rng.random() < 0.2:
        return content[:rng.randrange(len(content))]
    for _ in range(rng.choice((1, 1, 2, 5))):
        place = rng.choice((rng.randrange(4000), rng.randrange(-3000, 0),
                            rng.randrange(len(content))))
        content[place] = rng.choice((content[place] ^ 1 << rng.randrange(8), rng.randrange(256)))
    return content


def rewrite(path, content, rng):
    """The bytes of a file whose pickle has changed bytes and the checksum of these."""
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(content, "w") as new:
        for name in old.namelist():
            member = bytearray(old.read(name))
            if name.endswith("data.pkl"):
                for _ in range(rng.choice((1, 2, 5))):
                    member[rng.randrange(len(member))] = rng.choice(
                        (rng.randrange(256), *b"RQ}])t\x85cXhq0b\x81"))
            new.writestr(name, member)


ODD = [None, True, 3, -1, 10 ** 30, float("nan"), "x", "\x1b[31m", "\udcff", [], {}, [[]], (1, 2),
       torch.zeros(2), torch.zeros(3, 3, dtype=torch.int64), torch.zeros(()), torch.zeros(0),
       torch.ones(2, dtype=torch.bool), torch.full((2,), torch.inf), torch.full((1,), 1e38),
       torch.zeros(1).expand(1000), torch.zeros(2, 3).to_sparse(), torch.zeros(2, device="meta"),
       torch.nn.Parameter(torch.zeros(2)), torch.zeros(2, dtype=torch.complex64), b"bytes",
       OrderedDict(a=1), torch.Size([2]), torch.float32]


def restructure(content, rng):
    """What a file holds, with some of its values changed."""
    content = copy.deepcopy(content)
    for _ in range(rng.choice((1, 1, 2))):
        change(content, rng.choice(list(places(content))),
               rng.choice(("set", "set", "delete", "twice")), rng.choice(ODD))
    return content


def test_a_changed_file_of_weights_is_a_network_or_refused_in_a_sentence(saved, folder):
    path, content = saved
    original = path.read_bytes()
    bad = folder / "bad.pt"
    rng = random.Random(0)
    counts = {"refused": 0, "read": 0}
    for case in range(CASES):
        way = case % 3
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of torch, about what it is asked to write
            if way == 0:
                bad.write_bytes(flip(original, rng))
            elif way == 1:
                rewrite(path, bad, rng)
            else:
                torch.save(restructure(content, rng), bad)
        run = outcome(load_run, bad)
        counts["refused" if run == "refused" else "read"] += 1
        if run != "refused":
            net, rooms = run
            assert all(weight.isfinite().all() for weight in net.state_dict().values())
            assert all(isinstance(room, Scene) for room in rooms)
    assert counts["refused"] > CASES / 2 and not Path("executed").exists()
    print(f"{CASES:,} changed files of weights: {counts}")


class Call:
    """What a pickle makes a call of."""

    def __init__(self, function, *arguments):
        self.call = function, arguments

    def __reduce__(self):
        return self.call


class Stored:
    """What a pickle makes a storage of."""

    def __init__(self, kind, count):
        self.pid = "storage", kind, "0", "cpu", count


class Pickler(pickle.Pickler):
    def persistent_id(self, value):
        return value.pid if isinstance(value, Stored) else None


def craft(path, value, data=bytes(64), compression=zipfile.ZIP_STORED, twice=False):
    """Writes a file like torch's that holds this value and one storage with these bytes."""
    with zipfile.ZipFile(path, "w", compression) as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about a name that is there twice
        with archive.open("m/data.pkl", "w") as file:
            if isinstance(value, bytes):
                file.write(value)
            else:
                Pickler(file, 2).dump({"a": value})
        for _ in range(1 + twice):
            archive.writestr("m/data/0", data)


def tensor(count, offset, size, stride, kind=torch.FloatStorage):
    """What a pickle makes a tensor of."""
    size = tuple(list(size))  # a tuple of its own, as torch has it
    stride = tuple(list(stride))
    return Call(torch._utils._rebuild_tensor_v2, Stored(kind, count), offset, size, stride, False,
                OrderedDict())


def doubled_key(levels):
    """The pickle of a dict with a key of such tuples, which Python would never be done with."""
    steps = [b"h%ch%c\x86q%c" % (k, k, k + 1) for k in range(levels)]
    return b"\x80\x02](()tq\0" + b"".join(steps) + b"e}h%cK\1s." % levels


@pytest.mark.parametrize("value, options", [
    (Call(Path.touch, Path("executed")), {}),
    (Call(torch.FloatStorage, 10 ** 10), {}),
    (Call(bytearray, 10 ** 10), {}),
    (tensor(5 * 10 ** 9, 0, (5 * 10 ** 9,), (1,)), {}),  # more than is stored
    (tensor(-1, 0, (4,), (1,)), {}),
    (tensor(16, 10, (10,), (1,)), {}),  # beyond the end
    (tensor(16, 0, (2,), (1000,)), {}),
    (tensor(16, 20, (2,), (-1,)), {}),
    (tensor(16, 0, (10 ** 10,), (0,)), {}),  # one value, many times
    (tensor(16, 0, (1,) * 1000, (1,) * 1000), {}),
    ([tensor(16, 0, (1000,), (0,)) for _ in range(1000)], {}),
    (tensor(16, 0, (16,), (1,), torch.HalfStorage), {}),
    (tensor(2 ** 20, 0, (2 ** 20,), (1,)), dict(data=bytes(2 ** 22),
                                                compression=zipfile.ZIP_DEFLATED)),
    (tensor(16, 0, (16,), (1,)), dict(compression=zipfile.ZIP_DEFLATED)),
    (tensor(16, 0, (16,), (1,)), dict(twice=True)),
    (nested(60), {}),
    (doubled_key(60), {}),
    (b"\x80\x02}r" + (10 ** 6).to_bytes(4, "little") + b".", {}),  # memory for so many values
    (b"\x80\x02}K\0](" + b"]" * 2 ** 18 + b"es.", {})])  # a list of empty lists
def test_a_crafted_file_is_refused_and_nothing_executed(value, options, folder, monkeypatch):
    monkeypatch.chdir(folder)
    craft("crafted.pt", value, **options)
    with pytest.raises(RunError, match="^'crafted.pt' is no whole file of this version"):
        read_torch_file("crafted.pt", 2 ** 20)
    assert not Path("executed").exists()


def test_what_is_read_is_what_torch_reads_and_stays_when_the_file_is_gone(folder):
    path = folder / "any.pt"
    kinds = (torch.float64, torch.float32, torch.int64, torch.uint8, torch.bool)
    content = {"a": [torch.arange(12).to(kind).reshape(3, 4).T for kind in kinds],
               "b": {"c": (1, 2.5, "x", None, 2 ** 100), "d": torch.zeros(0, 3)}}
    shared = torch.zeros(4)
    content["shared"] = [shared[:2], shared[1:]]
    torch.save(content, path)
    read = read_torch_file(path, 2 ** 20)
    path.write_bytes(bytes(path.stat().st_size))
    path.unlink()
    read["shared"][0].fill_(1)
    assert read["shared"][1].sum() == 0  # each is a copy
    assert read["b"]["c"] == content["b"]["c"] and read["b"]["d"].shape == (0, 3)
    for given_, found in zip(content["a"], read["a"]):
        assert found.dtype == given_.dtype and torch.equal(found, given_)


def test_the_bytes_that_a_file_may_have_are_a_limit(saved):
    size = saved[0].stat().st_size
    assert set(read_torch_file(saved[0], size)) == set(saved[1])
    with pytest.raises(RunError, match=f"has more than {size - 1:,} bytes"):
        read_torch_file(saved[0], size - 1)


@pytest.mark.parametrize("changes, words", [
    (dict(format="other"), "holds no weights of this program"),
    (dict(version=2), "is of version 2 of its format, it must be 1"),
    (dict(version=torch.zeros(2)), "is of version a Tensor of its format"),
    (dict(memory="big"), "memory is 'big', it must be one of stacked, single, none"),
    (dict(without=["image"]), "without is ['image'], it must be one of"),
    (dict(weights=torch.zeros(2)), "the names of its weights are not those of its network"),
    (dict(scenes=[]), "scenes is [], it must be a list of 1 to 256"),
    ({"value.bias": torch.zeros(1, dtype=torch.int64)}, "are int64 (1,), it must be float32 (1,)"),
    ({"value.bias": torch.zeros(1, dtype=torch.bool)}, "are bool (1,), it must be float32 (1,)"),
    ({"value.bias": torch.zeros(2)}, "are float32 (2,), it must be float32 (1,)"),
    ({"value.bias": torch.full((1,), torch.nan)}, "'value.bias' are not all finite numbers"),
    ({"value.bias": torch.full((1,), 1e38)}, "'value.bias' have a value beyond 300"),
    ({"value.bias": 0.0}, "weights 'value.bias' are 0.0, it must be a tensor"),
    ({"command_scale": torch.zeros(2)}, "'command_scale' are not from 0.01 to 100")])
def test_what_is_wrong_with_a_file_of_weights_is_said(changes, words, saved, folder):
    content = copy.deepcopy(saved[1])
    for name, value in changes.items():
        (content if name in content else content["weights"])[name] = value
    torch.save(content, folder / "wrong.pt")
    with pytest.raises(RunError) as error:
        load_run(folder / "wrong.pt")
    assert words in str(error.value) and is_sentence(error.value)


def test_weights_that_are_not_finite_are_never_written(folder):
    net = make_network(0, "none")
    net.value.bias.data[:] = torch.nan
    with pytest.raises(RunError, match="weights 'value.bias' are not all finite"):
        save_model(folder / "nan.pt", net, [ENV1])
    assert not (folder / "nan.pt").exists()


@pytest.mark.parametrize("memory", ["stacked", "none"])
def test_the_largest_weights_drive(memory):
    net = make_network(0, memory)
    for name, weight in net.state_dict().items():
        generator = torch.Generator().manual_seed(0)
        signs = torch.randint(0, 2, weight.shape, generator=generator) * 2 - 1
        most = LARGEST_GATE_WEIGHT if "weight_ih" in name else LARGEST_WEIGHT
        weight.copy_(most * signs)
    net.log_std.data[:] = weights.LARGEST_LOG_STD
    net.command_scale[:] = weights.COMMAND_SCALES[0]
    assert not any(weights.wrong_values(*item) for item in net.state_dict().items())
    result, _ = evaluate(Policy(net, "sampled", 0), [ENV1], 2)  # actions that are no numbers raise
    assert result["training"]["n"] == 2 and np.isfinite(result["training"]["spl"])
