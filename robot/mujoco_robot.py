"""The task in MuJoCo, a simulator that is not ours: a Kobuki with two driven wheels in a Scene. Its
motion, contacts, images and range readings come from MuJoCo, its odometry from its wheels.

Axis letters: R robots, S rays, T physics steps in a control period, H = 48 and W = 64 image rows
and columns.
"""

import functools
import math
import os
import sys
from pathlib import Path

import numpy as np

from render import ABOVE, FOCAL, Camera, H, W
from robot import ring
from robot.appearance import LabCamera
from robot.environment import WHEELBASE, RealVecEnv
from sim import CONTROL_PERIOD, wrap_angle
from support.runs import RunError
from support.textures import BLUE, PERIOD, SUN, TEXEL

if sys.platform == "linux":  # read when MuJoCo is imported; EGL needs no display
    os.environ.setdefault("MUJOCO_GL", "egl")
try:
    import mujoco
except Exception as error:  # without a library to render with, not only ImportError
    mujoco = None  # see `check_installed`
    reason = error

KOBUKI = Path(__file__).with_name("kobuki.xml")  # the robot, with the sources of its dimensions
WHEEL_RADIUS = 0.035  # [m] as in kobuki.xml
STEPS = round(CONTROL_PERIOD / 0.005)  # T, with the time step [s] of kobuki.xml
RAY_HEIGHT = 0.1  # [m] of the range sensors above the floor, our choice
POSE = [0, 1, 3]  # indices of x, y [m] and heading [rad] among the joint positions
WHEELS = [6, 7]  # indices of the angles [rad] of the left and the right wheel
LOOKS = {  # appearance -> textures; the light's direction, brightness in the shade, and strength
    "simulation": (Camera, SUN, 0.5, 1.0),  # as in `support.textures.light`: MuJoCo limits it to 1
    "lab": (LabCamera, LabCamera.sun, LabCamera.ambient, 1 - LabCamera.ambient)}
WALLS = 3  # group of the boxes that robots and rays meet; images do not show it


@functools.cache
def check_installed():
    """Raises RunError if MuJoCo or the library with which it renders is missing."""
    if mujoco is None and isinstance(reason, ModuleNotFoundError):
        raise RunError("MuJoCo is missing: pip install -r robot/requirements.txt")
    try:
        mujoco.Renderer(mujoco.MjModel.from_xml_string("<mujoco/>"), H, W).close()
    except Exception as error:  # each library raises its own
        raise RunError("MuJoCo cannot render: unset MUJOCO_GL, and on Linux apt install libegl1 "
                       f"libgl1-mesa-dri ({type(error).__name__})") from None


@functools.lru_cache(maxsize=128)
def compiled(scene):
    """Returns the MjModel of a Scene with one robot. Raises RunError."""
    check_installed()
    spec = mujoco.MjSpec.from_file(str(KOBUKI))
    spec.camera("camera").fovy = 2 * math.degrees(math.atan(H / 2 / FOCAL))
    look, sun, ambient, diffuse = LOOKS[scene.reality.appearance if scene.reality else "simulation"]
    paints = look([])  # a camera without rooms, for its colours
    spec.worldbody.add_light(type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, dir=-sun,
                             castshadow=False, ambient=[ambient] * 3, diffuse=[diffuse] * 3,
                             specular=(0, 0, 0))
    spec.add_texture(name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, width=8, height=48,
                     builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT, rgb1=np.divide(paints.sky, 255))
    spec.geom("floor").pos[:2] = scene.bounds.mean(0)
    lit = min(ambient + diffuse * sun[2], 1)  # light on the floor; ours paints it without light
    for name, colour in (("floor", np.divide(paints.floor, lit)), ("cube", BLUE)):
        add_material(spec, name, np.full((1, 1, 3), colour))
        spec.geom(name).material = name
    for material in {box.material for box in scene.boxes}:
        add_material(spec, material, paints.texture(material))
    for b, box in enumerate(scene.boxes):
        half = box.length / 2, box.thickness / 2, box.height / 2
        turn = math.cos(box.yaw / 2), 0, 0, math.sin(box.yaw / 2)  # a quaternion
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, pos=(box.x, box.y, half[2]),
                                quat=turn, size=half, contype=1, group=WALLS)
        # On a box geom MuJoCo would squeeze the texture of the narrow sides: images show meshes.
        points, texels, triangles = sides(box)
        spec.add_mesh(name=f"sides{b}", uservert=points, usertexcoord=texels, userface=triangles,
                      inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL)
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"sides{b}",
                                material=box.material)
    return spec.compile()


def add_material(spec, name, colours):
    """Adds a material to an MjSpec. colours: (width, height, 3) in [0, 255], from below."""
    width, height, _ = colours.shape
    pixels = colours.swapaxes(0, 1).clip(0, 255).round().astype(int)
    spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, width=width, height=height,
                     data=pixels.ravel().tolist())
    material = spec.add_material(name=name, specular=0)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name


def sides(box):
    """Returns the mesh of the four sides of a Box: corners (48,) [m], their places in the texture
    (32,) and triangles (24,). From the left end of each side, as seen from outside, the texture
    repeats every PERIOD texels, as in `render`."""
    points = []
    texels = []
    for p, q in zip(box.corners, np.roll(box.corners, -1, axis=0)):
        right = np.hypot(*(q - p)) / TEXEL / PERIOD
        top = box.height / TEXEL / ABOVE
        points += [*p, 0, *q, 0, *q, box.height, *p, box.height]
        texels += [0, 0, right, 0, right, top, 0, top]
    triangles = np.add.outer(4 * np.arange(4), (0, 1, 2, 0, 2, 3))
    return points, texels, triangles.ravel()


def wheel_speeds(commands):
    """Returns the speeds (R, 2) [rad/s] of both wheels for commands (R, 2) [m/s, rad/s]."""
    v, w = np.array(commands, dtype=float).T
    return np.stack([v - w * WHEELBASE / 2, v + w * WHEELBASE / 2], -1) / WHEEL_RADIUS


class MujocoWorld:
    """R robots; robot r drives in `scenes[r]`. It has the interface of `sim.World`."""

    def __init__(self, scenes):
        """scenes: R Scenes, one per robot. Robots start at the start poses of their scenes."""
        self.scenes = list(scenes)
        self.models = [compiled(scene) for scene in self.scenes]
        self.data = [mujoco.MjData(model) for model in self.models]
        self.wheels = np.zeros((len(self.scenes), STEPS + 1, 2))  # [rad] angles in the last period
        self.place(slice(None), [scene.start for scene in self.scenes])

    def set_scene(self, r, scene):
        """Puts robot r at the start pose of another Scene."""
        self.scenes[r] = scene
        self.models[r] = compiled(scene)
        self.data[r] = mujoco.MjData(self.models[r])
        self.place(r, [scene.start])

    @property
    def poses(self):
        """The true poses (R, 3)."""
        poses = np.array([data.qpos[POSE] for data in self.data])
        poses[:, 2] = wrap_angle(poses[:, 2])
        return poses

    def place(self, robots, poses):
        """Puts robots (indices or a slice) at poses (n, 3), standing still."""
        chosen = np.arange(len(self.data))[robots]
        for r, pose in zip(np.atleast_1d(chosen), np.atleast_2d(poses)):
            mujoco.mj_resetData(self.models[r], self.data[r])
            self.data[r].qpos[POSE] = pose
            mujoco.mj_forward(self.models[r], self.data[r])

    def drive(self, commands):
        """Drives every robot for CONTROL_PERIOD. Returns (R,) bool: True for robots that collided
        with a wall. They stop there for the rest of the period. commands: (R, 2) [m/s, rad/s]."""
        speeds = wheel_speeds(commands)
        hit = np.zeros(len(speeds), dtype=bool)
        for r, (model, data) in enumerate(zip(self.models, self.data)):
            data.ctrl[:] = speeds[r]
            body = model.geom("body").id
            self.wheels[r] = data.qpos[WHEELS]
            for t in range(1, STEPS + 1):
                mujoco.mj_step(model, data)
                self.wheels[r, t:] = data.qpos[WHEELS]  # also for the rest, after a collision
                if (data.contact.geom == body).any():
                    hit[r] = True
                    break
        return hit

    def odometry(self, estimates, drift=np.zeros((1, 2))):
        """Returns the poses (R, 3) by odometry after the last period, from those before it: each
        physics step is an arc whose length and turn are those of the wheels. drift: (R, 2), further
        relative errors of both."""
        left, right = np.moveaxis(np.diff(self.wheels, axis=1), -1, 0) * WHEEL_RADIUS  # (R, T) [m]
        turn = (right - left) / WHEELBASE * (1 + drift[:, 1:])
        heading = estimates[:, 2:] + np.cumsum(turn, axis=1)
        ahead = (left + right) / 2 * (1 + drift[:, :1])
        x = estimates[:, 0] + (ahead * np.cos(heading - turn / 2)).sum(1)
        y = estimates[:, 1] + (ahead * np.sin(heading - turn / 2)).sum(1)
        return np.stack([x, y, wrap_angle(heading[:, -1])], -1)

    def range_readings(self, angles, max_range):
        """Returns the distances (R, S) [m] from the robots' centres to the first wall, at most
        max_range [m], along rays at angles (S,) [rad] from their headings."""
        readings = np.empty((len(self.data), len(angles)))
        hits = np.empty(len(angles), np.int32)
        groups = np.arange(mujoco.mjNGROUP) == WALLS
        for r, pose in enumerate(self.poses):
            headings = pose[2] + np.asarray(angles)
            rays = np.stack([np.cos(headings), np.sin(headings), 0 * headings], -1)
            # Of these groups, also static boxes, except body -1; to hits and readings, no normals.
            mujoco.mj_multiRay(self.models[r], self.data[r], (*pose[:2], RAY_HEIGHT), rays.ravel(),
                               groups, True, -1, hits, readings[r], None, len(angles), max_range)
        return np.where(readings < 0, max_range, np.minimum(readings, max_range))  # -1: no wall


@functools.lru_cache(maxsize=64)
def view(scene):
    """Returns the MjModel, an MjData and the Renderer of a Scene."""
    model = compiled(scene)
    return model, mujoco.MjData(model), mujoco.Renderer(model, H, W)


class MujocoCamera:
    """Renders the robots' images. It has the interface of `render.Camera`."""

    def __init__(self, scenes, world=None):
        """scenes: a list of Scenes, which the caller may change; `render` takes indices. world: if
        given, camera i is tilted like robot i of this MujocoWorld; otherwise it is level."""
        self.scenes = scenes
        self.world = world

    def set_scene(self, i, scene):
        """Does nothing: `render` takes scene number i from the caller's list."""

    def render(self, scene_of, poses, targets):
        """Returns images (R, H, W, 3) uint8 RGB from poses (R, 3) in scenes (R,), given by index,
        with target cubes at (R, 2) [m]."""
        images = np.empty((len(poses), H, W, 3), np.uint8)
        for image, i, pose, target in zip(images, scene_of, poses, targets):
            model, data, renderer = view(self.scenes[i])
            data.qpos[:] = model.qpos0 if self.world is None else self.world.data[i].qpos
            data.qpos[POSE] = pose
            data.mocap_pos[0, :2] = target
            mujoco.mj_kinematics(model, data)
            mujoco.mj_camlight(model, data)
            renderer.update_scene(data, "camera")
            renderer.render(out=image)
        return images


class MujocoVecEnv(RealVecEnv):
    """RealVecEnv in MuJoCo. The errors of a room's `reality` are added to those of MuJoCo."""

    def __init__(self, *args, **options):
        """Takes the arguments of NavVecEnv. Raises RunError."""
        super().__init__(*args, **options)
        self.world = MujocoWorld(self.scenes)
        self.scenes = self.world.scenes
        self.camera = MujocoCamera(self.scenes, self.world)

    def ranges(self):
        return ring.listen(self.world, MujocoWorld.range_readings)

    def _odometry(self, poses):
        return self.world.odometry(self.estimates, self._drift)


class MujocoRingVecEnv(MujocoVecEnv):
    """MujocoVecEnv with the ring of ultrasonic sensors, which stops the robot."""
    has_ring = True
