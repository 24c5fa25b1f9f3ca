"""How rooms look to the camera: textures and light of the simulation, and those of the lab."""

import numpy as np

from render import Camera, H, W
from scenes import MATERIALS
from support.textures import ABOVE, PERIOD

DRAWN_LOOKS = 16  # our choice


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


class DrawnCamera(Camera):
    """A camera in a room that looks like nobody knows what: the simulation's patterns in other
    colours, and another light, by a seed."""

    def __init__(self, scenes, seed):
        rng = np.random.default_rng(seed)
        direction = rng.normal(0, 1, 3)
        direction[2] = abs(direction[2])
        self.sun = direction / np.linalg.norm(direction)
        self.ambient = rng.uniform(0.4, 0.8)
        self.floor, self.sky = rng.uniform(60, 240, (2, 3))
        self.colours = {material: rng.uniform(40, 230, 3) for material in MATERIALS}
        self.contrast = rng.uniform(0.5, 2.0)
        super().__init__(scenes)

    def light(self, normal):
        return self.ambient + (1 - self.ambient) * np.clip(np.asarray(normal) @ self.sun, 0, 1)

    def texture(self, material):
        pattern = super().texture(material)
        pattern = (pattern - pattern.mean((0, 1))) * self.contrast
        return np.clip(pattern + self.colours[material], 0, 255)


CAMERAS = {"simulation": Camera, "lab": LabCamera}


class Cameras:
    """A camera for each look. Like render.Camera, its `render` takes indices into scenes."""

    def __init__(self, look_of, cameras):
        """look_of: of each scene, the key of its camera in `cameras`."""
        self.look_of = np.array(look_of)
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
    return Cameras(look_of, {look: CAMERAS[look](scenes) for look in sorted(set(look_of))})


def drawn_cameras(scenes):
    """The Cameras of Scenes that take turns to look in DRAWN_LOOKS ways."""
    look_of = np.arange(len(scenes)) % DRAWN_LOOKS
    return Cameras(look_of, {seed: DrawnCamera(scenes, seed) for seed in range(DRAWN_LOOKS)})
