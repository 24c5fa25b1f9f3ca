"""The network of Fig. 1 and Fig. 2: a CNN, a stacked LSTM, a Gaussian policy and a value.

It maps what the robot has seen so far to a distribution over actions, Eq. (1), in the action units
of the task: linear velocity in [0, 1], angular in [-1, 1].

Axis letters: M sequences, T steps, B = real (not padded) steps, H = 48, W = 64. While robots drive,
T = 1 and M is their number.
"""

import torch
from torch import nn
from torch.distributions import Normal

MEMORIES = ("stacked", "single", "none")  # ablations of the paper
BLANKS = ("", "image", "target", "last")  # inputs that can be blanked, ours
HIDDEN = 256  # units of each LSTM and of the dense layer, paper Fig. 2
FEATURES = 32  # values that the CNN makes of an image, paper Fig. 2
IMAGE_MEAN, IMAGE_SCALE = 115.0, 64.0  # our choice: colours become about -1.5 .. 1.5
TARGET_SCALE = 0.3  # [1/m, 1/rad] our choice
REWARD_SCALE = 0.01  # our choice: brings rewards, and so values, to the order of 1
SHUT = -1e4  # a gate's input at which the gate is 0 whatever else comes in
INITIAL_STD = (0.25, 0.5)  # a quarter of the linear and half of the angular maximum, our choice


def orthogonal(layer, gain=1.0):
    """The layer with orthogonal weights and zero biases, our choice."""
    for name, parameter in layer.named_parameters():
        if "weight" in name:
            nn.init.orthogonal_(parameter, gain)
        else:
            nn.init.zeros_(parameter)
    return layer


class Memory(nn.Module):
    """One LSTM, or for `--memory none` a dense layer in its place, which forgets everything.

    The LSTM has one input more, 1 at steps that are no steps of an episode. It shuts all gates for
    good: the memory is zero after such a step, and no gradient passes. So episodes can lie end to
    end in one sequence, a step apart, and none knows of the one before it.
    """

    def __init__(self, inputs, recurrent):
        super().__init__()
        self.recurrent = recurrent
        self.layer = orthogonal(nn.LSTM(inputs + 1, HIDDEN, batch_first=True) if recurrent
                                else nn.Linear(inputs, HIDDEN))
        if recurrent:  # torch's order: input gate, forget gate, candidate, output gate
            column = self.layer.weight_ih_l0.detach()[:, -1]
            column.view(4, HIDDEN)[:] = torch.tensor([SHUT, SHUT, 0, SHUT])[:, None]

    def forward(self, x, state, real):
        """(M, T, inputs), state (M, 2, HIDDEN), real (M, T) bool -> (M, T, HIDDEN), state."""
        if not self.recurrent:
            return torch.relu(self.layer(x)), state
        x = torch.cat([x, ~real[..., None]], -1)
        h, c = state.transpose(0, 1).unsqueeze(1).contiguous()  # (1, M, HIDDEN) each
        y, (h, c) = self.layer(x, (h, c))
        return y, torch.cat([h, c]).transpose(0, 1)


class Network(nn.Module):
    """Policy and value. `memory` is the paper's stacked LSTM or one of its ablations: in `single`
    all inputs go into one LSTM, `none` is `stacked` with dense layers instead of LSTMs."""

    def __init__(self, memory="stacked", without="", command_scale=(0.3, 1.0)):
        """without: an input that is blanked, "image", "target" (where it is; the camera still shows
        it) or "last" (last velocity and reward).
        command_scale: maximum linear [m/s] and angular [rad/s] velocity, paper III-C."""
        super().__init__()
        if memory not in MEMORIES:
            raise ValueError(f"memory is {memory!r}, it must be one of {', '.join(MEMORIES)}")
        self.memory, self.without = memory, without
        # Kernels are (height, width), padding makes the sizes those of Fig. 2. Where that asks for
        # a single row it is the upper one: the lower one of the two that are given is never read.
        relu = 2 ** 0.5
        self.cnn = nn.Sequential(
            orthogonal(nn.Conv2d(3, 32, (6, 8), 4, padding=(1, 2)), relu), nn.ReLU(inplace=True),
            orthogonal(nn.Conv2d(32, 64, (3, 4), 2, padding=1), relu), nn.ReLU(inplace=True),
            nn.MaxPool2d(2),
            orthogonal(nn.Conv2d(64, 64, 2, 2, padding=(1, 0)), relu), nn.ReLU(inplace=True),
            nn.Flatten(), orthogonal(nn.Linear(256, FEATURES), relu), nn.ReLU(inplace=True))
        self.cnn.to(memory_format=torch.channels_last)
        first = FEATURES + 2 + (3 if memory == "single" else 0)
        self.memories = nn.ModuleList([Memory(first, memory != "none")])
        if memory != "single":
            self.memories.append(Memory(HIDDEN + 3, memory != "none"))
        self.dense = orthogonal(nn.Linear(HIDDEN, HIDDEN), relu)
        self.action = orthogonal(nn.Linear(HIDDEN, 2), 0.01)
        self.value = orthogonal(nn.Linear(HIDDEN, 1))
        self.log_std = nn.Parameter(torch.tensor(INITIAL_STD).log())
        self.register_buffer("command_scale", torch.tensor(command_scale))

    def initial_state(self, M):
        """The memory (M, layers, 2, HIDDEN) before an episode's first step: zeros."""
        return torch.zeros(M, len(self.memories), 2, HIDDEN, device=self.log_std.device)

    @torch.no_grad()
    def limit_std(self, share):
        """The deviation of the actions becomes at most that share of the initial one."""
        self.log_std.clamp_(max=(torch.tensor(INITIAL_STD) * share).log().to(self.log_std.device))

    def see(self, images):
        """Features (B, FEATURES) of images (B, H, W, 3) uint8."""
        x = images.permute(0, 3, 1, 2).float()  # channels stay last in memory
        return self.cnn(x.sub_(IMAGE_MEAN).div_(IMAGE_SCALE))

    @torch.no_grad()
    def act(self, observations, state, generator=None):
        """One step of M robots: what the environment shows (M, ...), as arrays, and the memory ->
        mean actions (M, 2), sampled actions (M, 2), the samples' log-probabilities (M,), values
        (M,), memory. A sample may lie outside the actions' bounds: the environment clips it, but
        its log-probability is that of the sample as drawn.
        """
        seen = {key: torch.as_tensor(value)[:, None].to(self.log_std.device)
                for key, value in observations.items()}
        distribution, values, state = self(seen, state)
        mean, std = distribution.mean[:, 0].cpu(), distribution.stddev[:, 0].cpu()
        actions = torch.normal(mean, std, generator=generator)
        log_probs = Normal(mean, std).log_prob(actions).sum(-1)
        return mean, actions, log_probs, values[:, 0].cpu(), state

    def forward(self, observations, state, mask=None):
        """Observations (M, T, ...) and the memory before them -> distribution of actions (M, T, 2),
        values (M, T), memory after them. Where the mask (M, T) is given and false, a step is no
        step of an episode and clears the memory; images are those of the others, (B, H, W, 3).
        """
        target, images = observations["target"], observations["image"].flatten(0, -4)
        real = torch.ones_like(target[..., 0], dtype=torch.bool) if mask is None else mask
        features = target.new_zeros(*target.shape[:2], FEATURES)  # (M, T, FEATURES)
        features[real] = self.see(images * 0 if self.without == "image" else images)
        last = torch.cat([observations["velocity"] / self.command_scale,
                          observations["reward"] * REWARD_SCALE], -1)  # a_{t-1}, paper III-B
        last = last * 0 if self.without == "last" else last
        target = target * (0 if self.without == "target" else TARGET_SCALE)
        x, states = torch.cat([features, target], -1), []
        if self.memory == "single":
            x = torch.cat([x, last], -1)
        for k, memory in enumerate(self.memories):
            x = torch.cat([x, last], -1) if k == 1 else x
            x, after = memory(x, state[:, k], real)
            states.append(after)
        x = torch.relu(self.dense(x))  # (M, T, HIDDEN)
        linear, angular = self.action(x).unbind(-1)
        mean = torch.stack([torch.sigmoid(linear), torch.tanh(angular)], -1)
        return Normal(mean, self.log_std.exp()), self.value(x)[..., 0], torch.stack(states, 1)
