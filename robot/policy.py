"""Policies for `robot.robot.drive`: a network, or its ONNX file for a robot without torch. `act`
takes the observation of one robot, a dict of arrays, and returns the mean action (2,)."""

import numpy as np


class TorchPolicy:
    """A policy from a `model.Network`."""

    def __init__(self, network):
        import torch  # here, because OnnxPolicy works without it
        self.network = network
        self.generator = torch.Generator()  # for samples, which are not used
        self.reset()

    def reset(self):
        self.memory = self.network.initial_state(1)

    def act(self, observation):
        of_one = {name: np.asarray(value)[None] for name, value in observation.items()}
        mean, _, _, _, self.memory = self.network.act(of_one, self.memory, self.generator)
        return mean[0].numpy()


class OnnxPolicy:
    """A policy from a file written by `robot.export`. It needs only numpy and onnxruntime."""

    def __init__(self, content):
        """content: the bytes of an ONNX file, or its path."""
        import onnxruntime  # here, because TorchPolicy works without it
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        self.session = onnxruntime.InferenceSession(content, options)
        shapes = {item.name: item.shape for item in self.session.get_inputs()}
        self.memory = np.zeros(shapes["memory"], np.float32)

    def reset(self):
        self.memory[:] = 0

    def act(self, observation):
        inputs = {**observation, "memory": self.memory}
        action, self.memory = self.session.run(None, inputs)
        return action
