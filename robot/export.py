"""A policy as a file for a robot that has no torch: `python -m robot.export pretrained/any-room.pt
policy.onnx`. It needs `robot/requirements.txt`.

The file is ONNX. Its inputs are those of one step of one robot: `image` (48, 64, 3) uint8, `target`
(2,) [m, rad], `velocity` (2,) [m/s, rad/s], `last_reward` (1,) and `memory` (layers, 2, 256), zeros
as an episode begins. Its outputs are `action` (2,), the deterministic (mean) one, as fractions of
the maximum velocities, and the `memory` for the next step. All but the image are 32-bit floats.
"""

import logging
import warnings
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import nn

from model import HIDDEN, IMAGE_MEAN, IMAGE_SCALE, REWARD_SCALE, TARGET_SCALE
from render import H, W
from robot.onnx_policy import INPUTS, seconds_a_step
from support.command_line import CommandLine, option
from support.run_folder import RunError, WriteError, write
from support.weights import load_run

OUTPUTS = ("action", "next_memory")


@dataclass
class Options:
    """An export."""
    run: str = option("", "a run's folder, or a file of weights such as pretrained/any-room.pt",
                      positional=True)
    file: str = option("policy.onnx", "where it goes", positional=True)


class Step(nn.Module):
    """One step of one robot by a Network's weights, without what is for training alone: no value,
    and no gate input that clears the memory."""

    def __init__(self, network):
        """network: a model.Network."""
        super().__init__()
        self.network = network
        self.cells = nn.ModuleList([self._cell(memory) for memory in network.memories])

    def _cell(self, memory):
        """What takes the place of a model.Memory."""
        if not memory.recurrent:
            return memory.layer
        weights_in, weights_back, bias_in, bias_back = memory.layer.all_weights[0]
        cell = nn.LSTMCell(weights_in.shape[1] - 1, HIDDEN)  # the last input clears the memory
        cell.load_state_dict({"weight_ih": weights_in[:, :-1], "weight_hh": weights_back,
                              "bias_ih": bias_in, "bias_hh": bias_back})
        return cell

    def forward(self, image, target, velocity, last_reward, memory):
        network = self.network
        colours = image.permute(2, 0, 1)[None].float()
        features = network.cnn((colours - IMAGE_MEAN) / IMAGE_SCALE)  # (1, FEATURES)
        place = target[None] * TARGET_SCALE
        last = torch.cat([velocity / network.command_scale, last_reward * REWARD_SCALE])[None]
        if network.without == "image":
            features = network.cnn((colours * 0 - IMAGE_MEAN) / IMAGE_SCALE)
        if network.without == "target":
            place = place * 0
        if network.without == "last":
            last = last * 0
        x = torch.cat([features, place], 1)
        if network.memory == "single":
            x = torch.cat([x, last], 1)
        after = []
        for k, cell in enumerate(self.cells):
            if k == 1:
                x = torch.cat([x, last], 1)
            if isinstance(cell, nn.LSTMCell):
                h, c = cell(x, (memory[k, :1], memory[k, 1:]))
                x = h
                after.append(torch.cat([h, c]))
            else:
                x = torch.relu(cell(x))
                after.append(memory[k])
        linear, angular = network.action(torch.relu(network.dense(x)))[0]
        action = torch.stack([torch.sigmoid(linear), torch.tanh(angular)])
        return action, torch.stack(after)


def first_inputs(network):
    """Inputs of the right shapes, all zeros."""
    return (torch.zeros(H, W, 3, dtype=torch.uint8), torch.zeros(2), torch.zeros(2),
            torch.zeros(1), network.initial_state(1)[0])


def as_onnx(network):
    """The content of an ONNX file of that model.Network, bytes."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the exporter's own
        logging.getLogger("torch.onnx").setLevel(logging.ERROR)
        program = torch.onnx.export(Step(network).eval(), first_inputs(network), dynamo=True,
                                    input_names=INPUTS, output_names=OUTPUTS, verbose=False)
    return program.model_proto.SerializeToString()


def main(argv=None):
    """The command line."""
    parser = CommandLine("Export a policy to ONNX.")
    options = parser.read(Options, argv)
    file = Path(options.file)
    try:
        if not options.run:
            parser.error("give a run: a folder, or a .pt file such as pretrained/any-room.pt")
        if file.suffix != ".onnx":
            parser.error(f"the file is '{file}', its name must end in .onnx")
        model, _ = load_run(options.run)
        parser.must_write_to(file.parent)
        content = as_onnx(model)
        seconds = seconds_a_step(content)
        write(file, content)
    except (RunError, WriteError) as error:
        parser.error(error)
    except ImportError as error:
        parser.error(f"there is no library '{error.name}': pip install -r robot/requirements.txt")
    print(f"wrote {file}: {len(content) / 1e6:.1f} MB, "
          f"{1000 * seconds:.1f} ms a step on one core")


if __name__ == "__main__":
    main()
