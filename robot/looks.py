"""How rooms look to the camera: textures and light of the simulation, and those of the lab."""

import numpy as np

from render import Camera, H, W
from scenes import MATERIALS
from support.textures import ABOVE, PERIOD, texture

DRAWN_LOOKS = 64  # our choice, the same in every run
LARGEST_BLOCK = 16  # [texel] 40 cm


def plaster(rng):
    """A pale wall with a dark band at its foot and door frames, (PERIOD, ABOVE, 3)."""
    u, v = np.meshgrid(np.arange(PERIOD), np.arange(ABOVE), indexing="ij")
    colour = np.array((206, 204, 190)) + rng.normal(0, 3, (PERIOD, ABOVE, 1))
    colour[v < 4] = (92, 90, 88)  # a skirting of 10 cm
    colour[(u % PERIOD) < 2] -= 40  # an edge each 1.2 m
    return colour


def shelves(rng):
    """Shelves with books, 30 cm high, their backs of many colours."""
    u, v = np.meshgrid(np.arange(PERIOD), np.arange(ABOVE), indexing="ij")
    backs = rng.uniform(40, 170, (PERIOD // 2, ABOVE // 12 + 1, 3))
    colour = backs[u // 2, v // 12] + rng.normal(0, 5, (PERIOD, ABOVE, 1))
    colour[v % 12 == 0] = (120, 98, 74)  # boards
    return colour


def cardboard(rng):
    """Cartons of 30 cm with a strip of tape across."""
    u, v = np.meshgrid(np.arange(PERIOD), np.arange(ABOVE), indexing="ij")
    colour = np.array((168, 138, 98)) + rng.normal(0, 5, (PERIOD, ABOVE, 1))
    colour[(v % 12 == 5) | (v % 12 == 6)] = (196, 180, 140)
    colour[(u % 12 == 0) | (v % 12 == 0)] -= 50
    return colour


class LabCamera(Camera):
    """The camera in the lab: other textures for the same materials, light from windows on the other
    side, a wooden floor and a white ceiling."""

    sun = np.array((-0.3, 0.6, 0.5)) / np.linalg.norm((-0.3, 0.6, 0.5))
    floor = (134, 112, 84)
    sky = (226, 226, 220)
    textures = {"wall": plaster, "brick": shelves, "wood": cardboard}

    def light(self, normal):
        return 0.62 + 0.38 * np.clip(np.asarray(normal) @ self.sun, 0, 1)

    def texture(self, material):
        return self.textures[material](np.random.default_rng(sum(material.encode())))


def blocks(rng):
    """A wall of blocks, each of a colour of its own: how large they are is drawn, too."""
    u, v = np.meshgrid(np.arange(PERIOD), np.arange(ABOVE), indexing="ij")
    long, high = rng.integers(1, LARGEST_BLOCK, 2, endpoint=True)
    colours = rng.uniform(40, 230, (PERIOD // long + 1, ABOVE // high + 1, 3))
    return colours[u // long, v // high]


class DrawnCamera(Camera):
    """A camera in a room that looks like nobody knows what: each material has a pattern of the
    simulation or blocks, in other colours, and the light is another one, by a seed."""

    def __init__(self, scenes, seed):
        rng = np.random.default_rng(seed)
        self.seed = seed
        direction = rng.normal(0, 1, 3)
        direction[2] = abs(direction[2])
        self.sun = direction / np.linalg.norm(direction)
        self.ambient = rng.uniform(0.4, 0.8)
        self.floor, self.sky = rng.uniform(60, 240, (2, 3))
        super().__init__(scenes)

    def light(self, normal):
        return self.ambient + (1 - self.ambient) * np.clip(np.asarray(normal) @ self.sun, 0, 1)

    def texture(self, material):
        rng = np.random.default_rng([self.seed, MATERIALS.index(material)])
        pattern = blocks(rng) if rng.random() < 0.5 else texture(rng.choice(MATERIALS))
        pattern = (pattern - pattern.mean((0, 1))) * rng.uniform(0.3, 1.5)
        return np.clip(pattern + rng.uniform(40, 230, 3), 0, 255)


CAMERAS = {"simulation": Camera, "lab": LabCamera}


class Cameras:
    """A camera for each look. Like render.Camera, its `render` takes indices into scenes."""

    def __init__(self, look_of, cameras):
        """look_of: of each scene, the key of its camera in `cameras`, an array."""
        self.look_of = look_of
        self.cameras = cameras

    def render(self, scene_of, poses, targets):
        """As render.Camera's."""
        images = np.empty((len(poses), H, W, 3), np.uint8)
        for look, camera in self.cameras.items():
            chosen = np.flatnonzero(self.look_of[scene_of] == look)
            if len(chosen):
                images[chosen] = camera.render(scene_of[chosen], poses[chosen], targets[chosen])
        return images


def own_cameras(scenes):
    """The Cameras of Scenes that look as their reality says."""
    look_of = [scene.reality.look if scene.reality else "simulation" for scene in scenes]
    cameras = {look: CAMERAS[look](scenes) for look in sorted(set(look_of))}
    return Cameras(np.array(look_of), cameras)


def drawn_cameras(scenes, look_of):
    """The Cameras of DRAWN_LOOKS looks. look_of: (R,) the look of each Scene now, an array that may
    change."""
    return Cameras(look_of, {seed: DrawnCamera(scenes, seed) for seed in range(DRAWN_LOOKS)})
