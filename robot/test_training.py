"""Tests of training and evaluation in the lab."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from model import make_network
from robot import evaluate
from robot.environment import RandomRingVecEnv, RandomVecEnv, RealVecEnv, RingVecEnv
from robot.train import Config, Training, main
from support.rooms import load_rooms
from support.runs import read_table
from support.test_cli import refusal
from support.weights import load_model
from train import train

ROOT = Path(__file__).parent.parent
ENV2_WEIGHTS = str(ROOT / "pretrained" / "env2.safetensors")
SMALL = {"robots": 4, "episodes_per_update": 4, "minibatches": 1, "epochs": 1}


def training(**options):
    """Returns a small Training at the start of its first stage."""
    config = Config(**SMALL | options)
    made = Training(config, load_rooms(config))
    made.begin_stage()
    return made


def test_init_keeps_all_layers_except_the_last_ones():
    given, _ = load_model(ENV2_WEIGHTS)
    begun = training(init=ENV2_WEIGHTS).model.state_dict()
    fresh = make_network(0).state_dict()
    last = ("log_std", "action_head.weight", "action_head.bias", "value_head.weight",
            "value_head.bias")
    expected = given.state_dict() | {name: fresh[name] for name in last}
    assert all(torch.equal(value, expected[name]) for name, value in begun.items())


@pytest.mark.parametrize("options, environment, rooms", [
    ({}, RealVecEnv, {"lab"}), ({"ring": True}, RingVecEnv, {"lab"}),
    ({"env": "env2", "reality": "random"}, RandomVecEnv, {"env2", "env2-mirrored"}),
    ({"env": "random", "targets": "anywhere", "robots": 2, "ring": True, "reality": "random"},
     RandomRingVecEnv, {"random-1000000", "random-1"})])
def test_options_choose_the_environment_and_the_lab_is_not_mirrored(options, environment, rooms):
    env = training(**options).env
    assert type(env) is environment and {scene.name for scene in env.scenes} == rooms


def test_training_ends_after_its_episodes_and_the_learning_rate_follows_them():
    run = training(episodes=12, steps=10 ** 6, fixed_budget=True, learning_rate=1.0)
    train(run)
    assert 12 <= run.episodes < 12 + 4 + 4 and run.steps < 10 ** 5
    run.episodes = 9
    run.learn(run.collect()[0])
    assert run.optimizer.param_groups[0]["lr"] == pytest.approx(0.25)


def test_a_run_resumes_with_its_options_and_is_evaluated_with_the_ring(tmp_path):
    given = tmp_path / "given.safetensors"
    shutil.copy(ENV2_WEIGHTS, given)
    folder = tmp_path / "run"
    options = "--ring --robots 4 --minibatches 1 --workers 1 --evaluation-episodes 1 --steps 240"
    subprocess.run([sys.executable, "-m", "robot.train", *options.split(), "--out", folder,
                    "--init", given], check=True, cwd=ROOT)
    begun = read_table(folder / "episodes.csv")
    given.unlink()
    main(["--resume", str(folder), "--steps", "400", "--json"])
    assert json.loads((folder / "summary.json").read_text())["steps"] == 400
    episodes = read_table(folder / "episodes.csv")
    assert episodes[:len(begun)] == begun
    evaluate.main([str(folder), "--ring", "--episodes", "2", "--workers", "1", "--protocol",
                   "anywhere", "--json"])
    result = json.loads((folder / "evaluation-anywhere-ring.json").read_text())
    assert result["anywhere"]["n"] == 2 and result["anywhere"]["collision"] == 0


@pytest.mark.parametrize("arguments, words", [
    (["--reality", "random"], "does not work with --env lab"),
    (["--init", "nowhere"], "run 'nowhere' does not exist"),
    (["--init", ENV2_WEIGHTS, "--memory", "single"], "was trained with --memory stacked"),
    (["--env", "nowhere"], "unknown scene 'nowhere'"), (["--episodes", "-1"], "--episodes")])
def test_invalid_options_give_an_error_of_one_line(arguments, words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert words in refusal(main, arguments, capsys)
    assert not (tmp_path / "runs").exists()
