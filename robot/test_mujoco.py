"""Tests of the robot in MuJoCo. Without MuJoCo or EGL they are skipped, except in CI."""

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.lib.stride_tricks import sliding_window_view

import scenes
from render import CAMERA_OFFSET, CUBE_SIZE, FAR, FOCAL, NEAR, Camera
from robot import evaluate, mujoco_robot
from robot.appearance import LabCamera
from robot.environment import WHEELBASE
from robot.lab import LabRobot
from robot.mujoco_robot import (STEPS, WHEEL_RADIUS, MujocoCamera, MujocoRingVecEnv, MujocoVecEnv,
                                MujocoWorld, compiled)
from robot.robot import drive
from scenes import generate
from scenes.generate import walls
from sim import CAMERA_HEIGHT, CONTROL_PERIOD, ROBOT_RADIUS, Scene, World, wrap_angle
from support.runs import RunError

ROOT = Path(__file__).parent.parent
FLOOR = Scene("floor", tuple(walls(12.0, 12.0)), (0.0, 0.0, 0.0), ((3.0, 0.0),), ())
ROOMS = [scenes.load(name) for name in ("env1", "env2", "maze0", "maze4")]


pytestmark = pytest.mark.usefixtures("installed")


@pytest.fixture
def installed():
    try:
        mujoco_robot.check_installed()
    except RunError as error:
        if "CI" in os.environ:
            pytest.fail(str(error))
        pytest.skip(str(error))


def views(scene, n):
    """Returns reachable poses (n, 3) of a scene, and reachable targets (n, 2) ahead of them."""
    rng = np.random.default_rng(n)
    places = scene.reachable[rng.integers(len(scene.reachable), size=(2, n))]
    headings = np.arctan2(*(places[1] - places[0]).T[::-1]) + rng.normal(0, 0.3, n)
    return np.column_stack([places[0], wrap_angle(headings)]), places[1]


def test_the_robot_has_the_dimensions_of_ours():
    model = compiled(FLOOR)
    assert model.geom("body").size[0] == ROBOT_RADIUS
    assert model.geom("cube").size[0] * 2 == CUBE_SIZE
    assert model.camera("camera").pos == pytest.approx([CAMERA_OFFSET, 0, CAMERA_HEIGHT])
    assert (model.vis.map.znear, model.vis.map.zfar) == pytest.approx((NEAR, FAR))
    assert model.geom("left").size[0] == WHEEL_RADIUS
    assert np.ptp(model.body_pos[model.jnt_bodyid[mujoco_robot.WHEELS], 1]) == WHEELBASE
    assert model.opt.timestep * STEPS == pytest.approx(CONTROL_PERIOD)


def labels(images):
    """Returns what pixels of images (n, H, W, 3) show: floor 0, cube 1, wood 2, other walls 3."""
    r, g, b = np.moveaxis(images.astype(int), -1, 0)
    is_floor = (abs(r - b) < 2) & (abs(g - 118) < 2)
    return np.select([is_floor, b > 2 * r, g > 1.7 * b], [0, 1, 2], 3)


@pytest.mark.parametrize("scene", ROOMS, ids=lambda scene: scene.name)
def test_both_cameras_see_the_same_edges_within_two_pixels(scene):
    poses, targets = views(scene, 40)
    ours, theirs = [labels(camera.render(np.zeros(40, int), poses, targets))
                    for camera in (Camera([scene]), MujocoCamera([scene]))]
    for one, other in ((ours, theirs), (theirs, ours)):
        wide = np.pad(other, [(0, 0), (2, 2), (2, 2)], "edge")
        around = sliding_window_view(wide, (5, 5), (1, 2))
        assert (around != one[..., None, None]).all((-2, -1)).mean() < 1e-4
    assert all((ours == label).mean() > 0.005 for label in range(4))


def test_the_lab_has_its_own_look_and_the_drift_of_its_odometry():
    scene = scenes.load("lab")
    poses, targets = views(scene, 40)
    theirs, lab, ours = [camera([scene]).render(np.zeros(40, int), poses, targets).astype(int)
                         for camera in (MujocoCamera, LabCamera, Camera)]
    assert abs(theirs - lab).mean() < abs(theirs - ours).mean() / 3
    assert (theirs[:, -1] == lab[:, -1]).all(-1).mean() > 0.5  # the floor's colour
    for drift, (x, heading) in (((0, 0), (1, 1)), ((1, 0), (2, 1)), ((0, 1), (None, 2))):
        env = MujocoVecEnv(1, [FLOOR], "training")
        env.reset(seed=0, options={"start": FLOOR.start})
        env._drift[:] = drift
        env.step(np.array([[1.0, 0.5]]))
        true = env.world.poses[0]
        assert env.estimates[0, 2] == pytest.approx(heading * true[2], rel=0.05)
        assert x is None or env.estimates[0, 0] == pytest.approx(x * true[0], rel=0.05)


@pytest.mark.parametrize("scene", ROOMS[:2], ids=lambda scene: scene.name)
def test_both_cameras_see_the_same_textures(scene):
    """The mean difference is 4 to 5, because MuJoCo smooths them; 7 if shifted by one pixel."""
    poses, targets = views(scene, 40)
    ours, theirs = [camera.render(np.zeros(40, int), poses, targets).astype(int)
                    for camera in (Camera([scene]), MujocoCamera([scene]))]
    assert abs(ours - theirs).mean() < 6


def test_robots_in_different_rooms_and_later_episodes_do_not_affect_each_other():
    env = MujocoVecEnv(4, ROOMS, "training")
    alone = [MujocoVecEnv(1, [scene], "training") for scene in ROOMS]
    for turn in (0.0, 0.5):
        starts = [np.add(scene.start, (0, 0, turn)) for scene in ROOMS]
        options = {"target": 0, "start": np.array(starts)}
        env.reset(seed=0, options=options)
        for robot, start in zip(alone, starts):
            robot.reset(seed=0, options={"target": 0, "start": start})
        for _ in range(3):  # ends at full speed
            seen, *_ = env.step(np.array([[1.0, 0.2]] * 4))
            for r, robot in enumerate(alone):
                own, *_ = robot.step(np.array([[1.0, 0.2]]))
                assert (own["image"][0] == seen["image"][r]).all()
                assert (robot.world.poses[0] == env.world.poses[r]).all()
                assert (robot.ranges()[0] == env.ranges()[r]).all()
    env.world.set_scene(0, ROOMS[3])
    env.world.place([0, 3], env.world.poses[[3, 3]])
    one, *_, other = env.world.range_readings([0.0], 9.0)
    assert one == other
    view = env.world.poses[[0, 3]], np.zeros((2, 2))
    one, other = env.camera.render(np.array([0, 3]), *view)
    assert (one == other).all()


def test_a_robot_whose_nose_dips_sees_the_floor_higher():
    env = MujocoVecEnv(1, [ROOMS[1]], "training")
    view = np.zeros(1, int), env.world.poses, np.array([(9.0, 9.0)])
    level = env.camera.render(*view)
    env.world.data[0].joint("pitch").qpos = np.arctan(4 / FOCAL)
    dipped = env.camera.render(*view)
    rows = [(labels(images)[0, :, 32] == 0).argmax() for images in (level, dipped)]
    assert rows[0] - rows[1] in (3, 4, 5)
    assert (MujocoCamera([ROOMS[1]]).render(*view) == level).all()  # without a world


def test_straight_on_the_robot_drives_at_the_commanded_speed_after_a_lag():
    world = MujocoWorld([FLOOR])
    places = [0.0]
    for _ in range(6):
        assert not world.drive([(0.3, 0.0)]).any()
        places.append(world.poses[0, 0])
    steps = np.diff(places)
    assert 0.6 < steps[0] / 0.12 < 0.9  # with a time constant of 0.1 s, three quarters
    assert steps[2:] == pytest.approx(0.12, rel=0.01)


def test_odometry_follows_the_true_pose_around_a_square():
    world = MujocoWorld([FLOOR])
    estimates = world.poses
    errors = []
    for _ in range(4):
        for command in [(0.3, 0.0)] * 6 + [(0.15, np.pi / 4)] * 5:
            world.drive([command])
            estimates = world.odometry(estimates)
            errors.append(np.abs(estimates - world.poses)[0])
    assert np.max(errors, axis=0) == pytest.approx([0, 0, 0], abs=0.04)  # [m, m, rad]


def test_a_full_speed_drive_into_a_wall_is_a_collision_and_ends_outside_it():
    world = MujocoWorld([ROOMS[1]])
    for _ in range(40):
        begun = world.data[0].time
        [collided] = world.drive([(0.3, 0.0)])
        if collided:
            break
    assert collided and world.data[0].time < begun + CONTROL_PERIOD - 0.001
    assert (world.wheels[0, -1] == world.data[0].qpos[mujoco_robot.WHEELS]).all()
    assert ROOMS[1].clearance(world.poses[0, :2]) == pytest.approx(ROBOT_RADIUS, abs=0.002)


def test_the_ring_stops_before_a_wall_and_nothing_of_our_simulation_drives(monkeypatch):
    for ours, name in ((World, "drive"), (Camera, "render"), (generate, "first_hit")):
        monkeypatch.setattr(ours, name, lambda *_: pytest.fail("this is not from MuJoCo"))
    env = MujocoRingVecEnv(1, [ROOMS[1]], "training")
    env.reset(seed=0, options={"start": ROOMS[1].start, "target": 0})
    ended = False
    while not ended:
        _, _, [ended], _, infos = env.step(np.array([[1.0, 0.0]]))
    assert env.outcomes[infos["final_info"]["outcome"][0]] == "standing"
    assert 0.01 < ROOMS[1].clearance(infos["pose"][0, :2]) - ROBOT_RADIUS < 0.3


def test_range_readings_are_those_of_the_boxes():
    angles = np.linspace(-np.pi, np.pi, 31)
    world = MujocoWorld(ROOMS * 5)
    poses = np.array([views(scene, 9)[0][k % 9] for k, scene in enumerate(world.scenes)])
    world.place(slice(None), poses)
    assert world.poses == pytest.approx(poses)
    measured = world.range_readings(angles, 2.0)
    assert measured == pytest.approx(generate.range_readings(world, angles, 2.0), abs=1e-6)


def test_a_scripted_policy_arrives_through_the_robot_interface():
    def act(seen):
        distance, bearing = seen["target"]
        return np.array([float(abs(bearing) < 0.3), np.clip(2 * bearing, -1, 1)])

    robot = LabRobot(FLOOR, target=0, environment=MujocoVecEnv)
    log = drive(robot, SimpleNamespace(reset=list, act=act), robot.goal)
    assert log.outcome == robot.outcome == "arrival" and log.stops == log.waits == 0
    assert np.abs(robot.true_poses[-1] - log.poses[-1]).max() < 0.05


@pytest.mark.parametrize("code, words", [
    ("sys.modules['mujoco'] = None", "pip install -r robot/requirements.txt"),
    ("os.environ['MUJOCO_GL'] = 'foo'", "unset MUJOCO_GL"),
    ("os.environ |= {'MUJOCO_GL': 'egl', 'MUJOCO_EGL_DEVICE_ID': '99'}", "apt install libegl1")])
def test_a_missing_package_is_one_sentence(code, words):
    code = f"import os, sys; {code}; from robot import evaluate; evaluate.main(sys.argv[1:])"
    arguments = "pretrained/env1.safetensors --simulator mujoco --episodes 1".split()
    run = subprocess.run([sys.executable, "-c", code, *arguments], cwd=ROOT, text=True,
                         capture_output=True)
    assert run.returncode == 2 and run.stderr.count("\n") == 1 and words in run.stderr


def test_planners_are_refused(capsys):
    with pytest.raises(SystemExit, match="2"):
        evaluate.main("--planner bug --simulator mujoco".split())
    assert "planners expect exact motion" in capsys.readouterr().err
