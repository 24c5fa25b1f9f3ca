"""A network as the policy that `robot.robot.drive` asks; `robot.onnx_policy.OnnxPolicy` does the
same without torch."""

import numpy as np
import torch


class TorchPolicy:
    """Deterministic (mean) actions of a network for one robot: `reset()`, then `act(observation)`
    every step."""

    def __init__(self, network):
        """network: a `model.Network`."""
        self.network = network
        self.generator = torch.Generator()  # of samples, which are not used
        self.reset()

    def reset(self):
        """An episode begins."""
        self.memory = self.network.initial_state(1)

    def act(self, observation):
        """The action (2,) for what the robot sees, a dict of arrays."""
        of_one = {name: np.asarray(value)[None] for name, value in observation.items()}
        mean, _, _, _, self.memory = self.network.act(of_one, self.memory, self.generator)
        return mean[0].numpy()
