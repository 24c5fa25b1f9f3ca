"""The network of Fig. 1 and Fig. 2: a CNN, a stacked LSTM, a Gaussian policy and a value.

It maps the history of observations to a distribution over actions, Eq. (1), in the action units of
the task: linear velocity in [0, 1], angular velocity in [-1, 1].

Axis letters: M sequences, T steps, B real steps (those that are not padding), H = 48 and W = 64
image rows and columns. While robots drive, T = 1 and M is the number of robots.
"""

import torch
from torch import nn
from torch.distributions import Normal

MEMORIES = ("stacked", "single", "none")  # ablations of the paper
BLANKS = ("", "image", "target", "last")  # inputs that can be blanked, ours
HIDDEN = 256  # units of each LSTM and of the dense layer, paper Fig. 2
FEATURES = 32  # outputs of the CNN, paper Fig. 2
TARGET = 2  # distance and bearing
LAST = 3  # last velocity (2) and last reward (1), a_{t-1} of paper III-B
BATCH_MULTIPLE = 16  # of most batch sizes: torch caches memory for each size
IMAGE_MEAN, IMAGE_SCALE = 115.0, 64.0  # our choice: scales colours to -1.8 .. 2.2
TARGET_SCALE = 0.3  # [1/m, 1/rad] our choice
REWARD_SCALE = 0.01  # our choice: scales rewards, and thus values, to about 1
MAX_COMMAND = (0.3, 1.0)  # [m/s, rad/s] paper III-C
INITIAL_STD = (0.25, 0.5)  # a quarter of the linear and half of the angular maximum, our choice
RELU_GAIN = 2 ** 0.5  # gain of orthogonal weights before a ReLU


def orthogonal(layer, gain=1.0):
    """Returns the layer with orthogonal weights and zero biases, our choice."""
    for name, parameter in layer.named_parameters():
        if "weight" in name:
            nn.init.orthogonal_(parameter, gain)
        else:
            nn.init.zeros_(parameter)
    return layer


def make_cnn():
    """Returns the CNN of Fig. 2: colours (B, 3, H, W) -> (B, FEATURES).

    Kernels are (height, width). The second and third convolutions need a row of padding; torch
    pads both sides, and the stride never reaches the lower one.
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
    """One LSTM, or for `--memory none` a dense layer instead, which has no memory."""

    def __init__(self, inputs, recurrent):
        super().__init__()
        self.recurrent = recurrent
        self.layer = orthogonal(nn.LSTM(inputs, HIDDEN) if recurrent else nn.Linear(inputs, HIDDEN))

    def forward(self, x, state):
        """Maps x (M, T, inputs) and a state (M, 2, HIDDEN) to (M, T, HIDDEN), final state."""
        if not self.recurrent:
            return torch.relu(self.layer(x)), state
        h, c = state.transpose(0, 1).contiguous()  # (M, HIDDEN) each
        y, (h, c) = self.layer(x.transpose(0, 1), (h[None], c[None]))
        return y.transpose(0, 1), torch.cat([h, c]).transpose(0, 1)


class Network(nn.Module):
    """Policy and value. `memory` is `stacked` (the paper's two LSTMs) or one of its ablations:
    `single` (one LSTM that gets all inputs) or `none` (dense layers instead of LSTMs)."""
    def __init__(self, memory="stacked", without="", command_scale=None):
        """without: the input to blank, "image", "target" (its position; the camera still shows
        the cube) or "last" (last velocity and reward).
        command_scale: maximum linear [m/s] and angular [rad/s] velocity, by default MAX_COMMAND.
        Weights come from torch's global generator; `make_network` takes a seed instead.
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
        self.action_head = orthogonal(nn.Linear(HIDDEN, 2), 0.01)  # small: little effect at first
        self.value_head = orthogonal(nn.Linear(HIDDEN, 1))
        self.log_std = nn.Parameter(torch.tensor(INITIAL_STD).log())
        self.register_buffer("command_scale", torch.tensor(command_scale or MAX_COMMAND))

    def initial_state(self, M):
        """Returns the memory (M, layers, 2, HIDDEN) at the start of an episode: zeros."""
        return torch.zeros(M, len(self.memories), 2, HIDDEN, device=self.log_std.device)

    @torch.no_grad()
    def limit_std(self, lowest, highest):
        """Limits the standard deviation of the actions. Limits: fractions of its initial value."""
        initial = torch.tensor(INITIAL_STD, device=self.log_std.device)
        self.log_std.clamp_((lowest * initial).log(), (highest * initial).log())

    def see(self, images):
        """Returns features (B, FEATURES) of images (B, H, W, 3) uint8."""
        if self.without == "image":
            images = images * 0
        B = len(images)
        if B % BATCH_MULTIPLE:
            missing = -B % BATCH_MULTIPLE
            images = torch.cat([images, images[:missing]])  # copies, whose features are dropped
        colours = images.permute(0, 3, 1, 2).float()  # (B, 3, H, W); channels stay last in memory
        return self.cnn(colours.sub_(IMAGE_MEAN).div_(IMAGE_SCALE))[:B]

    def remember(self, features, target, last, state):
        """Maps features (M, T, FEATURES), target (M, T, 2), last velocity and reward (M, T, 3) and
        the memory to (M, T, HIDDEN) and the memory after them (Fig. 1)."""
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
        """Returns the distribution of actions (M, T, 2) for the dense output (M, T, HIDDEN)."""
        linear, angular = self.action_head(x).unbind(-1)
        mean = torch.stack([torch.sigmoid(linear), torch.tanh(angular)], -1)  # paper III-C
        return Normal(mean, self.log_std.exp(), validate_args=False)

    def forward(self, observations, state, mask=None):
        """Maps observations and the memory before them to a distribution of actions (M, T, 2),
        values (M, T) and the memory after them, Eq. (1).

        observations: `target` (M, T, 2), `velocity` (M, T, 2), `last_reward` (M, T, 1), and `image`
        (M, T, H, W, 3), or with a mask (B, H, W, 3): only the images of the real steps.
        state: the memory (M, layers, 2, HIDDEN).
        mask: (M, T) bool, False for padding, which follows the last step of a sequence.
        """
        target = observations["target"]
        images = observations["image"]
        if mask is None:
            mask = torch.ones_like(target[..., 0], dtype=torch.bool)
            images = images.flatten(0, 1)  # (B, H, W, 3)
        features = target.new_zeros(*mask.shape, FEATURES)  # (M, T, FEATURES)
        features[mask] = self.see(images)  # padding has no images
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
        """Chooses actions for M robots. Takes observations, a dict of arrays (M, ...), and the
        memory; returns mean actions (M, 2), sampled actions (M, 2), their log-probabilities (M,),
        values (M,) and the new memory. generator: a torch Generator for the samples.

        A sample may be outside the action bounds. The environment clips it; its log-probability is
        that of the unclipped sample.
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
    """Returns a Network with weights drawn from a seed, without torch's global generator."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return Network(memory, without, command_scale)
