"""Tests of the replay page."""

import base64
import io
import json
import math
import re
import shutil

import numpy as np
import pytest
import torch
from PIL import Image

from evaluation import Assignment, rollouts
from evaluation.__main__ import main
from evaluation.replay import COLUMNS, RecordingPolicy, as_episode, make_page
from model import REWARD_SCALE
from navbot_min import MAX_COMMAND
from render import H, W
from sim import ARRIVAL_DISTANCE
from support.palette import PALETTE
from support.weights import load_model

WEIGHTS = "pretrained/env1.safetensors"
MODEL, [ENV1] = load_model(WEIGHTS)
TITLE = "<!--<script> of a title"


def content_of(page):
    """Returns the data of a page."""
    return json.loads(re.search(r'type="application/json">(.*?)</script>', page, re.DOTALL)[1])


@pytest.fixture(scope="module")
def made():
    """The text of a page and the Traces of its episodes."""
    traces = []

    def watched(name, trace, *others):
        traces.append(trace)
        return as_episode(name, trace, *others)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("evaluation.replay.as_episode", watched)
        return make_page(TITLE, MODEL, "mean", ENV1, "anywhere", seed=0), traces


def test_a_page_has_a_success_a_failure_and_a_hidden_cube_equal_to_their_traces(made):
    page, traces = made
    episodes = content_of(page)["episodes"]
    assert [episode["hidden"] for episode in episodes] == [False, False, True]
    assert episodes[0]["outcome"] == "arrival" != episodes[1]["outcome"]
    for episode, trace in zip(episodes, traces, strict=True):
        assert episode["outcome"] == trace.outcome
        for key in ("goal", "poses", "commands", "rewards"):
            assert np.allclose(episode[key], getattr(trace, key), rtol=0, atol=0.00051)
        assert np.allclose(episode["values"], trace.activations["value"], rtol=0, atol=0.00051)
        path = episode["shortest"]
        assert math.dist(path[0], trace.start[:2]) < 0.001
        assert math.dist(path[-1], trace.goal) < ARRIVAL_DISTANCE + 0.001
        sheet = Image.open(io.BytesIO(base64.b64decode(episode["images"].partition(",")[2])))
        cells = np.array(sheet.convert("RGB")).reshape(-1, H, COLUMNS, W, 3).swapaxes(1, 2)
        images = cells.reshape(-1, H, W, 3)[:len(trace.images)]
        off = np.abs(images.astype(float) - trace.images).mean((1, 2, 3))
        assert off.max() < 1  # out of 255: a sheet has 256 colours
        assert not (episode["hidden"] and (images == (20, 20, 235)).all(-1).any())  # the cube
        layers = trace.activations["memory"].swapaxes(0, 1)
        for strip, values in zip(episode["strips"], (trace.activations["features"], *layers),
                                 strict=True):
            shown = np.frombuffer(base64.b64decode(strip["values"]), np.uint8)
            fractions = (shown.reshape(-1, strip["units"]) - 128.0) / 127
            assert np.allclose(fractions * np.abs(values).max(), values, atol=0.01 * values.max())


def test_activations_and_commands_equal_those_of_one_pass_over_each_whole_episode():
    class Remembering(RecordingPolicy):
        def act(self, env, observations):
            actions = super().act(env, observations)
            self.activations |= observations
            return actions
    model, _ = load_model(WEIGHTS)
    robots = [Assignment(ENV1, target, quota=2) for target in range(3)]
    traces = rollouts(Remembering(model, "mean", 0), robots, "perturbed")
    outputs = []
    for memory in model.memories:
        memory.register_forward_hook(lambda module, seen, result: outputs.append(result[0]))
    assert len(traces) == 6
    for trace in traces:
        seen = {key: torch.as_tensor(value)[None] for key, value in trace.activations.items()}
        outputs.clear()
        with torch.no_grad():
            distribution, values, _ = model(seen, model.initial_state(1))
            features = model.see(seen["image"][0])
        assert torch.allclose(seen["value"] * REWARD_SCALE, values, atol=1e-4)
        assert torch.allclose(seen["features"][0], features, atol=1e-4)
        assert torch.allclose(seen["memory"], torch.stack(outputs, 2), atol=1e-4)
        actions = distribution.mean[0].numpy().clip((0, -1), (1, 1))
        assert np.allclose(actions * MAX_COMMAND, trace.commands, atol=1e-3)


def test_a_page_loads_nothing_and_has_all_data_that_its_script_uses(made):
    page, _ = made
    assert set(re.findall(r"https?://[^\"' ]+", page)) <= {"http://www.w3.org/2000/svg"}  # a name
    assert not re.search(r"<link|src=\"|@import", page) and len(page) < 2e6
    content = content_of(page)
    assert content["title"] == TITLE and TITLE not in page
    assert [box["colour"] for box in content["boxes"]] == [PALETTE[b.material] for b in ENV1.boxes]
    script = page.rpartition("<script>")[2]
    for name, table in (("data", content), ("episode", content["episodes"][0])):
        used = set(re.findall(rf"\b{name}\.(\w+)", script.replace("image.data", "")))
        assert len(used) > 5 and used <= set(table)


def test_the_command_line_writes_the_page(tmp_path, monkeypatch, capsys):
    shutil.copy(WEIGHTS, tmp_path)
    monkeypatch.chdir(tmp_path)
    main(["env1.safetensors", "--episodes", "3", "--workers", "1", "--replay"])
    assert "watch it: evaluations/env1/replay.html" in capsys.readouterr().err
    page = (tmp_path / "evaluations/env1/replay.html").read_text()
    assert content_of(page)["title"] == "env1 in env1, protocol start"
