"""Each test is the shortest proof of one claim about training in the lab and for it."""

import pickle
from pathlib import Path

import pytest
import torch

import scenes
import train
from model import make_network
from robot.environment import RandomVecEnv, RealVecEnv, RingVecEnv
from support.processes import OneProcess
from support.weights import load_run

ROOT = Path(__file__).parent.parent
ENV2_WEIGHTS = str(ROOT / "pretrained" / "env2.pt")
SMALL = {"env": "lab", "robots": 4, "episodes_per_update": 4, "minibatches": 1, "epochs": 1}


def training(**options):
    """A small training."""
    config = train.Config(**SMALL | options)
    return train.Training(config, [scenes.load(config.env)], OneProcess())


def test_a_training_begins_with_the_weights_that_it_is_given():
    given, _ = load_run(ENV2_WEIGHTS)
    begun = training(init=ENV2_WEIGHTS).model.state_dict()
    fresh = make_network(0).state_dict()
    last = ("log_std", "action.weight", "action.bias", "value.weight", "value.bias")
    assert all(torch.equal(value, (fresh if name in last else given.state_dict())[name])
               for name, value in begun.items())


def test_a_room_trains_in_its_own_environment_and_a_real_one_has_no_mirror():
    lab = training()
    assert isinstance(lab.env, RealVecEnv) and not lab.env.has_ring
    assert {scene.name for scene in lab.env.scenes} == {"lab"}
    assert isinstance(training(ring=True).env, RingVecEnv)
    drawn = training(env="env2", reality="random").env
    assert isinstance(drawn, RandomVecEnv)
    assert [scene.name for scene in drawn.scenes] == ["env2"] * 2 + ["env2-mirrored"] * 2


def test_a_training_ends_after_so_many_episodes_and_its_learning_rate_shrinks_by_them():
    run = training(episodes=12, steps=10 ** 6, fixed_budget=True)
    train.train(run)
    assert 12 <= len(run.record.episodes) < 12 + 4 + 4 and run.record.steps < 10 ** 5
    run.record.episodes = run.record.episodes[:6]
    assert run.progress() == 0.5


def test_a_training_in_the_lab_goes_on_from_its_state_as_if_it_had_never_stopped():
    whole = training(ring=True)
    whole.collect()
    whole.learn()
    state = pickle.loads(pickle.dumps(whole.state()))
    resumed = training(ring=True, seed=1)
    resumed.load_state(state)
    assert [str(row) for row in whole.collect()] == [str(row) for row in resumed.collect()]
    whole.learn()
    resumed.learn()
    for one, other in zip(whole.model.parameters(), resumed.model.parameters()):
        assert torch.equal(one, other)


@pytest.mark.parametrize("arguments, words", [
    (["--init", "nowhere"], "run 'nowhere' does not exist"),
    (["--init", ENV2_WEIGHTS, "--memory", "single"],
     "was trained with --memory stacked, but --memory is single"),
    (["--init", ENV2_WEIGHTS, "--without", "image"], "--without nothing, but --without is image"),
    (["--env", "lab", "--reality", "random"], "with --env lab it must be left out"),
    (["--reality", "none"], "--reality"), (["--episodes", "-1"], "--episodes is -1")])
def test_what_cannot_be_begun_is_one_line(arguments, words, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as stop:
        train.main(arguments)
    printed = capsys.readouterr()
    assert stop.value.code == 2 and printed.err.count("\n") == 1 and words in printed.err
    assert not (tmp_path / "runs").exists()
