"""Exports a policy to a file for a robot without torch: `python -m robot.export
pretrained/any-room.safetensors policy.onnx`. It needs `robot/requirements.txt`."""

import logging
import warnings

import torch
from torch import nn

from model import IMAGE_MEAN, IMAGE_SCALE, REWARD_SCALE, TARGET_SCALE
from render import H, W
from support.cli import option, parse
from support.runs import RunError, write
from support.weights import load_model

OPTIONS = {
    "run": option("", "folder of a run, or a weights file", positional=True),
    "file": option("policy.onnx", "output file", positional=True)}


class Step(nn.Module):
    """One step of a model.Network for one robot, without the parts that only training needs."""

    def __init__(self, network):
        super().__init__()
        self.network = network

    def forward(self, image, target, velocity, last_reward, memory):
        """Returns the action (2,) and the new memory. A blanked input is multiplied by 0."""
        network = self.network
        colours = image.permute(2, 0, 1)[None] * float(network.without != "image")
        features = network.cnn((colours - IMAGE_MEAN) / IMAGE_SCALE)  # (1, FEATURES)
        target = target * (TARGET_SCALE * (network.without != "target"))
        last = torch.cat([velocity / network.command_scale, last_reward * REWARD_SCALE])
        last = last * float(network.without != "last")
        x, memory = network.remember(features[None], target[None, None], last[None, None],
                                     memory[None])
        x = torch.relu(network.dense(x))
        return network.policy(x).mean[0, 0], memory[0]


def as_onnx(network):
    """Returns a model.Network as the bytes of an ONNX file. Inputs: `image` (48, 64, 3) uint8 and,
    as 32-bit floats, `target` (2,) [m, rad], `velocity` (2,) [m/s, rad/s], `last_reward` (1,) and
    `memory` (layers, 2, 256), zeros when an episode begins. Outputs: `action` (2,), the mean action
    as fractions of the maximum velocities, and `next_memory`."""
    zeros = (torch.zeros(H, W, 3, dtype=torch.uint8), torch.zeros(2), torch.zeros(2),
             torch.zeros(1), network.initial_state(1)[0])
    logging.getLogger("torch.onnx").setLevel("ERROR")  # hides 'torchvision is not installed'
    with warnings.catch_warnings(action="ignore"):  # PyTorch warns about its own code
        program = torch.onnx.export(Step(network).eval(), zeros, dynamo=True, verbose=False,
                                    output_names=("action", "next_memory"))
    return program.model_proto.SerializeToString()


def main(argv=None):
    """Runs the command line."""
    options, parser = parse(OPTIONS, "Export a policy to ONNX.", argv)
    try:
        network, _ = load_model(options.run)
        write(options.file, as_onnx(network))
    except (RunError, OSError) as error:
        parser.error(error)
    except ImportError as error:
        parser.error(f"package '{error.name}' is missing: pip install -r robot/requirements.txt")
    print(f"wrote {options.file}")


if __name__ == "__main__":
    main()
