"""Tests of the variants with parts of the released learner."""

from unittest.mock import MagicMock, Mock, patch

import numpy as np
import pytest
import torch

import ppo
from experiments import released_learner as study
from model import make_network


def collected(name):
    training = study.make_training(name, 0)
    training.begin_stage()
    return training, training.collect()[0]


def test_the_bearing_is_never_wrapped_and_jumps_after_the_first_step():
    env = study.UnwrappedBearing(1, ["env1"])
    seen, _ = env.reset(options={"start": (-1.0, -2.0, -2.4), "target": 0})
    goal_x, goal_y = env.scenes[0].targets[0]
    bearing = np.arctan2(goal_y + 2.0, goal_x + 1.0) + 2.4
    assert seen["target"][0, 1] == pytest.approx(bearing - 2 * np.pi)
    seen, *_ = env.step(np.zeros((1, 2)))
    assert seen["target"][0, 1] == pytest.approx(bearing)


def test_gradients_stop_at_the_stored_memory_of_the_step():
    training, episodes = collected("one-step-gradients")
    episode = max(episodes, key=len)
    batch = ppo.make_minibatch([episode], [episode.rewards])
    seen = batch["observations"]
    seen["target"].requires_grad_()
    for network, through_time in ((training.model, False), (make_network(0), True)):
        _, values, _ = network(seen, network.initial_state(1), batch["mask"])
        assert np.allclose(values[0].detach(), episode.values, atol=1e-5)
        [gradient] = torch.autograd.grad(values[0, -1], seen["target"])
        assert gradient[0, -1].any() and gradient[0, :-1].any() == through_time


def test_the_bounded_beta_is_a_density_within_the_bounds_of_the_actions_and_is_sampled():
    beta = study.BoundedBeta(torch.tensor([2.0, 1.5]), torch.tensor([3.0, 5.0]))
    unit = (torch.arange(4000) + 0.5) / 4000
    actions = torch.stack([unit, 2 * unit - 1], -1)
    mass = beta.log_prob(actions).exp() * torch.tensor([1.0, 2.0]) / 4000  # of each cell
    assert torch.allclose((mass * actions).sum(0), beta.mean, atol=1e-3)
    draws = torch.stack([beta.sample(torch.Generator().manual_seed(k)) for k in range(2000)])
    assert torch.allclose(draws.mean(0), beta.mean, atol=0.03)


@pytest.mark.parametrize("name, rate", [("no-baseline", 6e-5), ("no-annealing", 6e-4)])
def test_advantages_can_be_returns_and_the_learning_rate_can_stay(name, rate):
    training, episodes = collected(name)
    training.folder = MagicMock()
    training.seconds = training.config.epochs = training.config.minibatches = 1
    training.steps = 0.9 * training.config.steps
    value = training.model.value_head.weight.clone()
    training.learn(episodes)
    loss = training.folder.tables["updates.csv"].add.call_args.args[0]["policy_loss"]
    returns = [sum(0.99 ** k * r for k, r in enumerate(episode.rewards[t:]))
               for episode in episodes for t in range(len(episode))]
    assert (loss == pytest.approx(-np.mean(returns), rel=1e-3)) == (name == "no-baseline")
    assert torch.equal(training.model.value_head.weight, value) == (name == "no-baseline")
    assert training.optimizer.param_groups[0]["lr"] == pytest.approx(rate)


def test_the_released_loss_clips_each_ratio_to_the_largest_or_its_inverse():
    loss = study.released_loss(torch.tensor([[1.5, 0.5]] * 2), torch.tensor([[2.0], [-2.0]]))
    assert loss.item() == pytest.approx(-(2.4 + 1.0 - 3.0 - 2 / 1.2) / 4)


@pytest.mark.parametrize("name, steps, environment", [
    ("beta", 1500, "NavVecEnv"), ("released", 600, "UnwrappedBearing")])
def test_a_variant_is_trained_and_evaluated_only_once(name, steps, environment, tmp_path):
    evaluate = Mock(return_value=({kind: {"success": 0.5} for kind in ("new", "training")}, []))
    with patch.multiple(study, STEPS=steps, evaluate=evaluate, SEEDS=(0,), RESULT=tmp_path / "t",
                        VARIANTS={name: study.VARIANTS[name]}):
        study.main([])
        study.main([])
        [row] = study.read_table(study.RESULT)
    assert list(row) == list(study.read_table(study.RESULT)[0]) and evaluate.call_count == 1
    assert evaluate.call_args.kwargs["environment"].__name__ == environment
    weight = evaluate.call_args.args[0].model.action_head.weight
    assert not torch.equal(weight, study.make_training(name, 0).model.action_head.weight)
