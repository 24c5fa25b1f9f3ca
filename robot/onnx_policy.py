"""A policy of an ONNX file, for a robot that has no torch: numpy and onnxruntime are enough."""

import time

import numpy as np

from render import H, W

INPUTS = ("image", "target", "velocity", "last_reward", "memory")
STEPS = 200  # that are timed


class OnnxPolicy:
    """What an exported file does, for one robot: `reset()`, then `act(observation)` every step."""

    def __init__(self, content):
        """content: of an ONNX file, or its path."""
        import onnxruntime  # here: whoever lacks it is told so by the export, in a sentence
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        self.session = onnxruntime.InferenceSession(content, options)
        shapes = {item.name: item.shape for item in self.session.get_inputs()}
        self.memory = np.zeros(shapes["memory"], np.float32)

    def reset(self):
        """An episode begins."""
        self.memory[:] = 0

    def act(self, observation):
        """The action (2,) for what the robot sees, a dict of arrays."""
        inputs = {name: observation[name] for name in INPUTS if name != "memory"}
        action, self.memory = self.session.run(None, inputs | {"memory": self.memory})
        return action


def seconds_a_step(content):
    """How long a step takes by an ONNX file's content, the median of STEPS [s]."""
    policy = OnnxPolicy(content)
    seen = {"image": np.zeros((H, W, 3), np.uint8), "target": np.zeros(2, np.float32),
            "velocity": np.zeros(2, np.float32), "last_reward": np.zeros(1, np.float32)}
    took = []
    for _ in range(STEPS):
        begin = time.perf_counter()
        policy.act(seen)
        took.append(time.perf_counter() - begin)
    return np.median(took)
