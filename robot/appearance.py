"""The appearance of rooms to the camera: textures and light. Three kinds: the simulation's, the
lab's (the simulated real room), and random ones."""

from functools import partial

import numpy as np

from render import ABOVE, Camera, H, W
from scenes import MATERIALS
from support.textures import PERIOD, texture

DRAWN_APPEARANCES = 64  # number of random appearances, the same in every run, our choice
SUN = np.array((-0.3, 0.6, 0.5))  # direction towards the light, from windows on a different side
U, V = np.meshgrid(np.arange(PERIOD), np.arange(ABOVE), indexing="ij")  # [texel] along, up


class LabCamera(Camera):
    """The camera in the lab: different textures for the same materials, light from a different
    side, a wooden floor and a white ceiling."""

    sun = SUN / np.linalg.norm(SUN)
    ambient = 0.62
    floor = (134, 112, 84)
    sky = (226, 226, 220)

    def light(self, normal):
        return self.ambient + (1 - self.ambient) * np.clip(np.asarray(normal) @ self.sun, 0, 1)

    def texture(self, material):
        rng = np.random.default_rng(sum(material.encode()))
        if material == "wall":  # pale plaster with a dark skirting board and door frames
            colour = np.array((206, 204, 190)) + rng.normal(0, 3, (PERIOD, ABOVE, 1))
            colour[V < 4] = (92, 90, 88)  # a skirting board 10 cm high
            colour[U < 2] -= 40  # the edge of a door frame every 1.2 m
        elif material == "brick":  # shelves 30 cm high, books with spines of many colours
            spines = rng.uniform(40, 170, (PERIOD // 2, ABOVE // 12 + 1, 3))
            colour = spines[U // 2, V // 12] + rng.normal(0, 5, (PERIOD, ABOVE, 1))
            colour[V % 12 == 0] = (120, 98, 74)  # the shelf boards
        else:  # wood: cartons of 30 cm, each with a strip of tape
            colour = np.array((168, 138, 98)) + rng.normal(0, 5, (PERIOD, ABOVE, 1))
            colour[(V % 12 == 5) | (V % 12 == 6)] = (196, 180, 140)
            colour[(U % 12 == 0) | (V % 12 == 0)] -= 50
        return colour


class DrawnCamera(LabCamera):
    """The camera in a room with a random appearance, drawn from a seed: each material has a pattern
    of the simulation or random blocks, in random colours; the light is random too."""

    def __init__(self, scenes, seed):
        rng = np.random.default_rng(seed)
        self.seed = seed
        direction = rng.normal(0, 1, 3)
        direction[2] = abs(direction[2])
        self.sun = direction / np.linalg.norm(direction)
        self.ambient = rng.uniform(0.4, 0.8)
        self.floor, self.sky = rng.uniform(60, 240, (2, 3))
        super().__init__(scenes)

    def texture(self, material):
        rng = np.random.default_rng([self.seed, MATERIALS.index(material)])
        if rng.random() < 0.5:  # blocks of a random size, each in a random colour
            long, high = rng.integers(1, 16, 2, endpoint=True)  # [texel] up to 40 cm
            colours = rng.uniform(40, 230, (PERIOD // long + 1, ABOVE // high + 1, 3))
            pattern = colours[U // long, V // high]
        else:
            pattern = texture(rng.choice(MATERIALS), ABOVE)
        pattern = (pattern - pattern.mean((0, 1))) * rng.uniform(0.3, 1.5)
        return np.clip(pattern + rng.uniform(40, 230, 3), 0, 255)


class Cameras:
    """One camera per appearance. `render` takes indices into scenes, like that of render.Camera."""

    def __init__(self, scenes, appearance_of):
        """appearance_of: an array with one entry per scene, which the caller may change:
        "simulation", "lab" or the seed of a DrawnCamera."""
        self.scenes = scenes
        self.appearance_of = appearance_of
        self.cameras = {}  # appearance -> camera, made on first use

    def set_scene(self, i, scene):
        """Replaces scene number i by another Scene, which the caller has put into the list."""
        for camera in self.cameras.values():
            camera.set_scene(i, scene)

    def render(self, scene_of, poses, targets):
        images = np.empty((len(poses), H, W, 3), np.uint8)
        for appearance in set(self.appearance_of[scene_of]):
            if appearance not in self.cameras:
                known = {"simulation": Camera, "lab": LabCamera}
                make = known.get(appearance) or partial(DrawnCamera, seed=appearance)
                self.cameras[appearance] = make(self.scenes)
            chosen = np.flatnonzero(self.appearance_of[scene_of] == appearance)
            images[chosen] = self.cameras[appearance].render(scene_of[chosen], poses[chosen],
                                                             targets[chosen])
        return images
