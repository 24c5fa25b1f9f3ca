"""Tests of the export to ONNX: the exported policy acts like the network."""

import numpy as np
import pytest
import torch

from model import make_network
from navbot_min import NavVecEnv
from robot.policy import OnnxPolicy, TorchPolicy

pytest.importorskip("onnxruntime", reason="pip install -r robot/requirements.txt")
from robot.export import as_onnx, main  # noqa: E402, after the skip


@pytest.mark.parametrize("memory, without", [
    ("stacked", ""), ("single", "last"), ("none", ""), ("stacked", "image"), ("stacked", "target")])
def test_an_exported_policy_acts_like_the_network_for_whole_episodes(memory, without):
    network = make_network(0, memory, without)
    env = NavVecEnv(1, ["env2"], "both", max_episode_steps=40)
    seen, _ = env.reset(seed=0)
    policies = TorchPolicy(network), OnnxPolicy(as_onnx(network))
    for _ in range(90):
        of_one = {key: value[0] for key, value in seen.items()}
        action, exported = [policy.act(of_one) for policy in policies]
        assert np.allclose(action, exported, rtol=0, atol=1e-6)  # untrained policies vary little
        seen, _, [terminated], [truncated], _ = env.step(action[None])
        if terminated or truncated:
            for policy in policies:
                policy.reset()


def test_export_writes_the_file_or_names_the_missing_package(tmp_path, monkeypatch, capsys):
    def fail(*_, **__):
        raise ModuleNotFoundError(name="onnxscript")

    file = str(tmp_path / "policy.onnx")
    main(["pretrained/any-room.safetensors", file])
    assert OnnxPolicy(file).memory.shape == (2, 2, 256)
    monkeypatch.setattr(torch.onnx, "export", fail)
    with pytest.raises(SystemExit, match="2"):
        main(["pretrained/any-room.safetensors", file])
    assert "package 'onnxscript' is missing: pip install -r robot/" in capsys.readouterr().err
