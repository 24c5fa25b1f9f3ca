"""The network of Fig. 1 and Fig. 2: a CNN, a stacked LSTM, a Gaussian policy and a value.

It maps what the robot has seen so far to a distribution over actions, Eq. (1), in the action units
of the task: linear velocity in [0, 1], angular in [-1, 1].

Axis letters: M sequences, T steps, B real steps (those that are not padding), H = 48 and W = 64
image rows and columns. While robots drive, T = 1 and M is their number.
"""

import torch
from torch import nn
from torch.distributions import Normal

MEMORIES = ("stacked", "single", "none")  # ablations of the paper
BLANKS = ("", "image", "target", "last")  # inputs that can be blanked, ours
HIDDEN = 256  # units of each LSTM and of the dense layer, paper Fig. 2
FEATURES = 32  # values that the CNN makes of an image, paper Fig. 2
TARGET = 2  # distance and bearing
LAST = 3  # a_{t-1}: last velocity (2) and last reward (1), paper III-B
BATCH_MULTIPLE = 16  # batches of images are padded to a multiple: torch caches memory per size
IMAGE_MEAN, IMAGE_SCALE = 115.0, 64.0  # our choice: colours become about -1.5 .. 1.5
TARGET_SCALE = 0.3  # [1/m, 1/rad] our choice
REWARD_SCALE = 0.01  # our choice: brings rewards, and so values, to the order of 1
MAX_COMMAND = (0.3, 1.0)  # [m/s, rad/s] paper III-C
INITIAL_STD = (0.25, 0.5)  # a quarter of the linear and half of the angular maximum, our choice
RELU_GAIN = 2 ** 0.5  # of orthogonal weights before a ReLU


def orthogonal(layer, gain=1.0):
    """The layer with orthogonal weights and zero biases, our choice."""
    for name, parameter in layer.named_parameters():
        if "weight" in name:
            nn.init.orthogonal_(parameter, gain)
        else:
            nn.init.zeros_(parameter)
    return layer


def make_cnn():
    """The CNN of Fig. 2: (B, 3, H, W) colours -> (B, FEATURES).

    Kernels are (height, width). The second and the third convolution need one row of padding; torch
    pads both sides, and the stride never gets to the lower one.
    """
    cnn = nn.Sequential(
        orthogonal(nn.Conv2d(3, 32, (6, 8), stride=4, padding=(1, 2)), RELU_GAIN),  # (32, 12, 16)
        nn.ReLU(inplace=True),
        orthogonal(nn.Conv2d(32, 64, (3, 4), stride=2, padding=1), RELU_GAIN),  # (64, 6, 8)
        nn.ReLU(inplace=True),
        nn.MaxPool2d(2),  # (64, 3, 4)
        orthogonal(nn.Conv2d(64, 64, 2, stride=2, padding=(1, 0)), RELU_GAIN),  # (64, 2, 2)
        nn.ReLU(inplace=True),
        nn.Flatten(),  # (256,)
        orthogonal(nn.Linear(64 * 2 * 2, FEATURES), RELU_GAIN),  # (FEATURES,)
        nn.ReLU(inplace=True))
    return cnn.to(memory_format=torch.channels_last)


class Memory(nn.Module):
    """One LSTM, or for `--memory none` a dense layer in its place, which forgets everything."""

    def __init__(self, inputs, recurrent):
        super().__init__()
        self.recurrent = recurrent
        self.layer = orthogonal(nn.LSTM(inputs, HIDDEN) if recurrent else nn.Linear(inputs, HIDDEN))

    def forward(self, x, state):
        """x (M, T, inputs), state (M, 2, HIDDEN) -> (M, T, HIDDEN), state after the last step."""
        if not self.recurrent:
            return torch.relu(self.layer(x)), state
        h, c = state.transpose(0, 1).contiguous()  # (M, HIDDEN) each
        y, (h, c) = self.layer(x.transpose(0, 1), (h[None], c[None]))
        return y.transpose(0, 1), torch.cat([h, c]).transpose(0, 1)


class Network(nn.Module):
    """Policy and value. `memory` is the paper's stacked LSTM or one of its ablations: in `single`
    all inputs go into one LSTM, `none` is `stacked` with dense layers instead of LSTMs."""
    def __init__(self, memory="stacked", without="", command_scale=None):
        """without: an input that is blanked, "image", "target" (its position; the camera still
        shows it) or "last" (last velocity and reward).
        command_scale: maximum linear [m/s] and angular [rad/s] velocity, by default MAX_COMMAND.
        Weights are drawn from torch's global generator; `make_network` draws them from a seed.
        """
        super().__init__()
        assert memory in MEMORIES and without in BLANKS
        self.memory = memory
        self.without = without
        recurrent = memory != "none"
        self.cnn = make_cnn()
        if memory == "single":
            self.memories = nn.ModuleList([Memory(FEATURES + TARGET + LAST, recurrent)])
        else:
            self.memories = nn.ModuleList([Memory(FEATURES + TARGET, recurrent),
                                           Memory(HIDDEN + LAST, recurrent)])
        self.dense = orthogonal(nn.Linear(HIDDEN, HIDDEN), RELU_GAIN)
        self.action_head = orthogonal(nn.Linear(HIDDEN, 2), 0.01)  # small: it starts undecided
        self.value_head = orthogonal(nn.Linear(HIDDEN, 1))
        self.log_std = nn.Parameter(torch.tensor(INITIAL_STD).log())
        self.register_buffer("command_scale", torch.tensor(command_scale or MAX_COMMAND))

    def initial_state(self, M):
        """The memory (M, layers, 2, HIDDEN) before an episode's first step: zeros."""
        return torch.zeros(M, len(self.memories), 2, HIDDEN, device=self.log_std.device)

    @torch.no_grad()
    def limit_std(self, share):
        """The standard deviation of the actions becomes at most that share of the initial one."""
        limit = torch.tensor(INITIAL_STD) * share
        self.log_std.clamp_(max=limit.log().to(self.log_std.device))

    def see(self, images):
        """Features (B, FEATURES) of images (B, H, W, 3) uint8."""
        if self.without == "image":
            images = images * 0
        B = len(images)
        if B % BATCH_MULTIPLE:
            images = torch.cat([images, images[:-B % BATCH_MULTIPLE]])
        colours = images.permute(0, 3, 1, 2).float()  # (B, 3, H, W); channels stay last in memory
        return self.cnn(colours.sub_(IMAGE_MEAN).div_(IMAGE_SCALE))[:B]

    def remember(self, features, target, last, state):
        """Fig. 1: features (M, T, FEATURES), target (M, T, 2), last velocity and reward (M, T, 3)
        and memory -> (M, T, HIDDEN), memory."""
        x = torch.cat([features, target], -1)  # (M, T, FEATURES + TARGET)
        if self.memory == "single":
            x = torch.cat([x, last], -1)
            x, after = self.memories[0](x, state[:, 0])
            return x, after[:, None]
        x, after_first = self.memories[0](x, state[:, 0])  # (M, T, HIDDEN)
        x = torch.cat([x, last], -1)  # (M, T, HIDDEN + LAST)
        x, after_second = self.memories[1](x, state[:, 1])  # (M, T, HIDDEN)
        return x, torch.stack([after_first, after_second], 1)

    def policy(self, x):
        """The distribution of actions (M, T, 2) from the dense layer's output (M, T, HIDDEN)."""
        linear, angular = self.action_head(x).unbind(-1)
        mean = torch.stack([torch.sigmoid(linear), torch.tanh(angular)], -1)  # paper III-C
        return Normal(mean, self.log_std.exp(), validate_args=False)

    def forward(self, observations, state, mask=None):
        """Observations and the memory before them -> distribution of actions (M, T, 2), values
        (M, T), memory after them, Eq. (1).

        observations: `target` (M, T, 2), `velocity` (M, T, 2), `last_reward` (M, T, 1), and `image`
        (M, T, H, W, 3), or with a mask (B, H, W, 3): only the images of the real steps.
        state: (M, layers, 2, HIDDEN).
        mask: (M, T) bool, False at padding, which follows a sequence's last step.
        """
        target = observations["target"]
        images = observations["image"]
        if mask is None:
            mask = torch.ones_like(target[..., 0], dtype=torch.bool)
            images = images.flatten(0, 1)  # (B, H, W, 3)
        features = target.new_zeros(*mask.shape, FEATURES)  # (M, T, FEATURES)
        features[mask] = self.see(images)  # no convolutions of padding
        target = target * (0 if self.without == "target" else TARGET_SCALE)
        last = torch.cat([observations["velocity"] / self.command_scale,
                          observations["last_reward"] * REWARD_SCALE], -1)  # (M, T, LAST)
        if self.without == "last":
            last = last * 0
        x, state = self.remember(features, target, last, state)  # (M, T, HIDDEN)
        x = torch.relu(self.dense(x))  # (M, T, HIDDEN)
        return self.policy(x), self.value_head(x)[..., 0], state

    @torch.no_grad()
    def act(self, observations, state, generator):
        """One step of M robots: what the environment shows (M, ...), as arrays, and the memory ->
        mean actions (M, 2), sampled actions (M, 2), the samples' log-probabilities (M,), values
        (M,), memory. generator: torch Generator, draws the samples.

        A sample may lie outside the actions' bounds: the environment clips it, but its
        log-probability is that of the sample as drawn.
        """
        device = self.log_std.device
        seen = {key: torch.as_tensor(value)[:, None].to(device)  # (M, T = 1, ...)
                for key, value in observations.items()}
        distribution, values, state = self(seen, state)
        mean = distribution.mean[:, 0].cpu()
        std = distribution.stddev[:, 0].cpu()
        actions = torch.normal(mean, std, generator=generator)
        log_probs = Normal(mean, std, validate_args=False).log_prob(actions).sum(-1)
        return mean, actions, log_probs, values[:, 0].cpu(), state


def make_network(seed, memory="stacked", without="", command_scale=None):
    """Returns a Network with weights drawn from a seed. torch's global generator is not changed."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return Network(memory, without, command_scale)
