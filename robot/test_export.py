"""The exported policy acts like torch's, over whole episodes."""

import subprocess
import sys

import numpy as np
import pytest
import torch

from model import make_network
from navbot_min import NavVecEnv
from support.weights import load_run

pytest.importorskip("onnxruntime", reason="pip install -r robot/requirements.txt")
from robot.export import as_onnx, main  # noqa: E402, after the skip
from robot.onnx_policy import OnnxPolicy  # noqa: E402


def compare(network, steps):
    """The largest difference of actions over that many steps, and how many episodes ended."""
    env = NavVecEnv(1, ["env2"], "both")
    seen, _ = env.reset(seed=0)
    policy = OnnxPolicy(as_onnx(network))
    memory = network.initial_state(1)
    generator = torch.Generator()
    worst = 0
    episodes = 0
    for _ in range(steps):
        action = policy.act({key: value[0] for key, value in seen.items()})
        mean, _, _, _, memory = network.act(seen, memory, generator)
        worst = max(worst, np.abs(mean.numpy()[0] - action).max())
        seen, _, terminated, truncated, _ = env.step(mean.numpy())
        if terminated[0] or truncated[0]:
            episodes += 1
            policy.reset()
            memory = network.initial_state(1)
    return worst, episodes


def test_an_exported_policy_acts_as_torchs_does_over_whole_episodes():
    network, _ = load_run("pretrained/any-room.pt")
    worst, episodes = compare(network, 150)
    assert worst < 1e-4 and episodes >= 2


@pytest.mark.parametrize("memory, without", [("single", ""), ("none", ""), ("stacked", "image"),
                                             ("stacked", "target"), ("single", "last")])
def test_every_kind_of_network_can_be_exported(memory, without):
    network = make_network(0, memory, without)
    worst, _ = compare(network, 5)
    assert worst < 1e-4


def test_the_command_line_writes_the_file(tmp_path, capsys):
    main(["pretrained/any-room.pt", str(tmp_path / "policy.onnx")])
    assert OnnxPolicy(str(tmp_path / "policy.onnx")).memory.shape == (2, 2, 256)
    with pytest.raises(SystemExit):
        main(["pretrained/any-room.pt", str(tmp_path / "policy.pt")])
    assert "its name must end in .onnx" in capsys.readouterr().err


def test_without_onnxruntime_nothing_is_written_and_one_sentence_says_so(tmp_path):
    code = ("import sys; sys.modules['onnxruntime'] = None; from robot.export import main; "
            f"main(['pretrained/env1.pt', {str(tmp_path / 'policy.onnx')!r}])")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 2 and not list(tmp_path.iterdir())
    assert done.stderr.startswith("error: there is no library 'onnxruntime': pip install ")
    assert done.stderr.count("\n") == 1


def test_a_robot_without_torch_can_drive_by_the_file(tmp_path):
    code = ("import sys; sys.modules['torch'] = None; import robot.robot; "
            "from robot.onnx_policy import OnnxPolicy")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
