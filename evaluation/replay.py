"""Makes a replay for a browser: one HTML file with images, actions and activations of a network.
Axis letters: R robots, T steps of an episode, H = 48 and W = 64 image rows and columns."""

import base64
import io
import json
import math
from pathlib import Path

import numpy as np
from PIL import Image

from evaluation.drivers import Policy
from evaluation.examine import rollouts
from evaluation.planners import visibility_graph
from evaluation.protocols import Assignment, protocol_scenes
from model import REWARD_SCALE
from navbot_min import NavVecEnv
from render import CUBE_SIZE, H, W
from sim import CONTROL_PERIOD, ROBOT_RADIUS
from support.palette import PALETTE

PAGE = Path(__file__).with_suffix(".html")
DRAWING = Path(__file__).with_name("drawing.js")  # shared with the playground
TRIED = 48  # number of episodes from which a success and a failure are chosen
COLUMNS = 16  # number of images per row in the sheet of an episode


class RecordingPolicy(Policy):
    """A Policy that keeps activations of its network in `activations`, (R, ...) arrays."""

    def __init__(self, model, actions, seed):
        super().__init__(model, actions, seed)
        model.cnn.register_forward_hook(self._keep_features)

    def _keep_features(self, cnn, images, features):
        self._features = features.numpy()

    def act(self, env, observations):
        actions = super().act(env, observations)
        self.activations = {"value": self.values.numpy() / REWARD_SCALE,
                            "features": self._features[:len(actions)],  # the rest is padding
                            "memory": self.memory[:, :, 0].numpy()}
        return actions


def as_sheet(images):
    """Returns a data URL of a PNG of 256 colours, with images (T + 1, H, W, 3) in rows."""
    cells = np.pad(images, ((0, -len(images) % COLUMNS), (0, 0), (0, 0), (0, 0)))
    sheet = cells.reshape(-1, COLUMNS, H, W, 3).swapaxes(1, 2).reshape(-1, COLUMNS * W, 3)
    file = io.BytesIO()
    picture = Image.fromarray(sheet).quantize(256, dither=Image.Dither.NONE)
    picture.save(file, "PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(file.getvalue()).decode()


def as_strip(name, values, height):
    """Returns values (T, units) as a strip of the page, `height` pixels high. Byte 128 means 0."""
    largest = max(float(np.abs(values).max()), 1e-9)
    signed = np.round(values / largest * 127) + 128
    return {"name": name, "units": values.shape[1], "height": height,
            "values": base64.b64encode(signed.astype(np.uint8).tobytes()).decode()}


def as_episode(name, trace, graph, hidden):
    """Returns the data of a Trace for the page. graph: the Roadmap of its scene."""
    path, _ = graph.path(trace.start[:2], trace.goal)
    memory = trace.activations["memory"]  # (T, layers, HIDDEN)
    strips = [as_strip("CNN: 32 features of the image",
                       trace.activations["features"], 64)]
    if memory.any():  # not for a network without memory
        strips += [as_strip(f"LSTM {k + 1} of {memory.shape[1]}: 256 outputs",
                            memory[:, k], 128) for k in range(memory.shape[1])]
    numbers = {"goal": trace.goal, "poses": trace.poses, "commands": trace.commands,
               "shortest": [trace.start[:2], *(path or [])], "rewards": trace.rewards,
               "values": trace.activations["value"]}
    return {"name": name, "outcome": trace.outcome, "hidden": hidden, "strips": strips,
            "images": as_sheet(trace.images),
            **{key: rounded(value) for key, value in numbers.items()}}


def rounded(numbers):
    """Returns numbers as lists, rounded to three decimals."""
    return np.round(np.asarray(numbers, float), 3).tolist()


def make_page(title, model, actions, scene, protocol, seed, environment=NavVecEnv):
    """Returns the text of the page: a success, a failure and an episode with a hidden cube, each
    the one with the farthest goal. For the arguments see Policy and `evaluate`."""
    [scene] = protocol_scenes(protocol, [scene])
    targets = max(len(scene.targets), 1)  # random targets need no index
    robots = [Assignment(scene, k % targets, quota=1) for k in range(TRIED)]
    graph = visibility_graph(scene)
    episodes = []
    for hidden, prefix, most in (("", "", 2), ("cube", "hidden cube: ", 1)):
        traces = rollouts(RecordingPolicy(model, actions, seed), robots, protocol, seed, hidden,
                          images=True, environment=environment)
        traces.sort(key=lambda trace: math.dist(trace.start[:2], trace.goal), reverse=True)
        farthest = [next((trace for trace in traces if trace.arrived == arrived), None)
                    for arrived in (True, False)]
        for trace in [trace for trace in farthest if trace is not None][:most]:
            name = f"{prefix}{'success' if trace.arrived else 'failure'} ({trace.outcome})"
            episodes.append(as_episode(name, trace, graph, hidden == "cube"))
    content = {
        "title": title, "bounds": rounded(scene.bounds), "period": CONTROL_PERIOD,
        "radius": ROBOT_RADIUS, "cube": CUBE_SIZE, "columns": COLUMNS,
        "boxes": [{"corners": rounded(box.corners), "colour": PALETTE[box.material]}
                  for box in scene.boxes],
        "episodes": episodes}
    text = json.dumps(content, separators=(",", ":")).replace("<", "\\u003c")
    page = PAGE.read_text(encoding="utf-8").replace("DRAWING", DRAWING.read_text("utf-8"), 1)
    return page.replace("DATA", text, 1)
