"""Adam (Kingma and Ba 2015, their more efficient order of computation).

torch's own would do, but making it loads torch's compiler, which takes 1.3 s and 80 MB.
"""

import torch

MEAN_DECAY = 0.9  # of Adam's running mean of the gradients, as usual
SQUARE_DECAY = 0.999  # of Adam's running mean of their squares, as usual
SMALLEST_ROOT = 1e-5  # keeps Adam from dividing by 0, our choice


class Adam:
    """Adam (Kingma and Ba 2015), over all weights as one vector: each weight goes against the
    running mean of its gradient, over the root of the running mean of its square."""

    def __init__(self, model):
        self.parameters = list(model.parameters())
        weights = sum(parameter.numel() for parameter in self.parameters)
        self.mean = torch.zeros(weights, device=self.parameters[0].device)
        self.square = torch.zeros_like(self.mean)
        self.steps = 0

    @torch.no_grad()
    def step(self, gradient, learning_rate):
        """Changes all weights once, by their gradient, one vector (weights,)."""
        self.steps += 1
        self.mean.lerp_(gradient, 1 - MEAN_DECAY)
        self.square.mul_(SQUARE_DECAY).addcmul_(gradient, gradient, value=1 - SQUARE_DECAY)
        # Both begin at 0. That they are too small at first is made up for here, once for all.
        root = (1 - SQUARE_DECAY ** self.steps) ** 0.5
        change = self.mean / (self.square.sqrt().add_(SMALLEST_ROOT * root))
        length = learning_rate * root / (1 - MEAN_DECAY ** self.steps)
        start = 0
        for parameter in self.parameters:
            end = start + parameter.numel()
            parameter.sub_(change[start:end].view_as(parameter), alpha=length)
            start = end

    def state(self):
        """All that changes."""
        return {"mean": self.mean.clone(), "square": self.square.clone(), "steps": self.steps}

    def load_state(self, state):
        """Goes on from a state."""
        self.mean.copy_(state["mean"])
        self.square.copy_(state["square"])
        self.steps = state["steps"]
