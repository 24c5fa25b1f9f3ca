"""A replay in a browser: one HTML file with a few episodes, what the robot saw and did in them, and
what went on in its network. It needs no network and no library from elsewhere.

Axis letters: R robots, T steps of an episode, H = 48 and W = 64 image rows and columns.
"""

import base64
import io
import json
import math
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from evaluation.drivers import Policy
from evaluation.examine import rollouts
from evaluation.planners import visibility_graph
from evaluation.protocols import Assignment, protocol_scenes
from model import REWARD_SCALE
from render import CUBE_SIZE, H, W
from sim import CONTROL_PERIOD, ROBOT_RADIUS
from support.pictures import PALETTE

PAGE = Path(__file__).with_suffix(".html")
TRIED = 48  # episodes among which a success and a failure are looked for
COLUMNS = 16  # images of an episode lie side by side in rows of so many
COLOURS = 256  # of these images
LARGEST = 500_000  # [byte] of a sheet; what is larger becomes a JPEG, as noise makes it
QUALITY = 60  # of that


class ThinkingPolicy(Policy):
    """A Policy that keeps what went on in its network in `thoughts`: `value` (R,) [rewards],
    `features` (R, FEATURES), and `memory` (R, layers, HIDDEN), what each LSTM puts out."""

    def act(self, env, observations):
        mean, sampled, _, values, self.memory = self.model.act(observations, self.memory,
                                                               self.generator)
        with torch.no_grad():
            features = self.model.see(torch.as_tensor(observations["image"]))
        self.thoughts = {"value": values.numpy() / REWARD_SCALE, "features": features.numpy(),
                         "memory": self.memory[:, :, 0].numpy()}
        chosen = sampled if self.actions == "sampled" else mean
        return chosen.numpy()


def as_sheet(images):
    """The images (T + 1, H, W, 3) in rows of COLUMNS, as a data URL of a PNG, exactly but for the
    number of colours; of a JPEG where they are noisy."""
    rows = -(-len(images) // COLUMNS)
    cells = np.zeros((rows * COLUMNS, H, W, 3), np.uint8)
    cells[:len(images)] = images
    sheet = cells.reshape(rows, COLUMNS, H, W, 3).swapaxes(1, 2).reshape(rows * H, COLUMNS * W, 3)
    picture = Image.fromarray(sheet)
    file = io.BytesIO()
    kind = "png"
    picture.quantize(COLOURS, dither=Image.Dither.NONE).save(file, "PNG", optimize=True)
    if file.tell() > LARGEST:
        file = io.BytesIO()
        kind = "jpeg"
        picture.save(file, "JPEG", quality=QUALITY)
    return f"data:image/{kind};base64," + base64.b64encode(file.getvalue()).decode()


def as_strip(name, values, height):
    """Values (T, units) for the page: a byte each, 128 is 0, the largest is 1 or 255."""
    largest = max(float(np.abs(values).max()), 1e-9)
    signed = np.round(values / largest * 127).astype(int) + 128
    return {"name": name, "units": values.shape[1], "height": height,
            "values": base64.b64encode(signed.astype(np.uint8).tobytes()).decode()}


def as_episode(name, trace, graph, hidden):
    """What the page shows of a Trace with images and thoughts. graph: of the shortest paths."""
    way, _ = graph.path(tuple(trace.start[:2]), tuple(trace.goal))
    memory = trace.thoughts["memory"]  # (T, layers, HIDDEN)
    strips = [as_strip("the 32 features that the CNN makes of the image",
                       trace.thoughts["features"], 64)]
    if memory.any():  # a network without memory has nothing to show there
        strips += [as_strip(f"memory: what LSTM {k + 1} of {memory.shape[1]} puts out, 256 units",
                            memory[:, k], 128) for k in range(memory.shape[1])]
    return {"name": name, "outcome": trace.outcome, "goal": rounded(trace.goal),
            "hidden": hidden in ("cube", "both"), "poses": rounded(trace.poses),
            "shortest": rounded([trace.start[:2], *(way or [])]),
            "commands": rounded(trace.commands), "rewards": rounded(trace.rewards),
            "values": rounded(trace.thoughts["value"]), "images": as_sheet(trace.images),
            "strips": strips}


def rounded(numbers):
    """Numbers as lists, to the third decimal."""
    return np.round(np.asarray(numbers, float), 3).tolist()


def choose(traces):
    """Of these Traces one that arrives and one that does not, where there are such, those with the
    farthest goals: pairs of what it is and the Trace."""
    chosen = []
    for wanted, name in ((True, "it arrives"), (False, "it fails")):
        found = [trace for trace in traces if trace.arrived == wanted]
        if found:
            farthest = max(found, key=lambda trace: math.dist(trace.start[:2], trace.goal))
            chosen.append((f"{name} ({farthest.outcome})", farthest))
    return chosen


def make_page(title, model, actions, scene, protocol, seed, environment=None):
    """The page, text: a success, a failure, and an episode with its cube hidden.

    model, actions, seed: as of a Policy. environment: as of `evaluate`.
    """
    [scene] = protocol_scenes(protocol, [scene])
    shown = []
    for hidden in ("", "cube"):
        count = max(len(scene.targets), 1)
        robots = [Assignment(scene, k % count, quota=1) for k in range(TRIED)]
        traces = rollouts(ThinkingPolicy(model, actions, seed), robots, protocol, seed, hidden,
                          images=True, environment=environment)
        found = choose(traces)
        if hidden:
            found = [(f"the cube is hidden: {name}", trace) for name, trace in found[:1]]
        shown += [(name, trace, hidden) for name, trace in found]
    graph = visibility_graph(scene)
    low, high = scene.bounds
    content = {
        "title": title, "bounds": rounded([low, high]), "period": CONTROL_PERIOD,
        "radius": ROBOT_RADIUS, "cube": CUBE_SIZE, "columns": COLUMNS,
        "boxes": [{"corners": rounded(box.corners), "colour": PALETTE[box.material]}
                  for box in scene.boxes],
        "episodes": [as_episode(name, trace, graph, hidden) for name, trace, hidden in shown]}
    text = json.dumps(content, separators=(",", ":")).replace("<", "\\u003c")
    return PAGE.read_text(encoding="utf-8").replace("DATA", text, 1)
