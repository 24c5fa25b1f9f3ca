"""The robot behind the page: its room, its driver, and what a page may request.

One thread runs the session: it drives, and does what the pages request between two steps.
"""

import base64
import re
import time
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

import scenes
from evaluation.drivers import Planned
from evaluation.protocols import HIDDEN, hide, make_environment
from playground.choices import YOU, drivers, make_driver
from playground.server import Feed
from robot.environment import environment_of
from sim import CONTROL_PERIOD, ROBOT_RADIUS, SceneError
from support.checks import is_reachable
from support.palette import PALETTE
from support.rooms import change_room
from support.runs import RunError

ROBOT = np.array([0])  # the index of the only robot
KEYS = {"ArrowUp": (1, 0), "ArrowLeft": (0, 1), "ArrowRight": (0, -1)}  # key -> action
HOLD = 1.5  # [s] for which an episode's end is shown, at most
SPEEDS = (0.25, 16)  # slowest and fastest, times real time
STILL = 0.05  # [s] a delay longer than this is not made up


class Session(Feed):
    """One robot in a room. Attributes that begin with an underscore belong to its thread."""

    def __init__(self, room, driver):
        """room, driver: names. Raises SceneError, RunError."""
        super().__init__()
        self._message = ""
        self._runs = True
        self._speed = 1.0
        self._held = set()  # keys
        self._pressed = set()  # keys that were held since the last step
        self._hidden = ""
        self._forget_paths()
        self._choose(driver, begins=False)
        self._enter(scenes.load(room))

    def _forget_paths(self):
        self._waiting = []  # names of drivers that will drive the same task
        self._paths = []  # of the earlier episodes of this task

    # ------------------------------------------------------------------------------ the requests

    def answer(self, request):
        """Does what a page requests: name -> argument. Raises SceneError, RunError, ValueError,
        TypeError, KeyError."""
        actions = {"run": self._run_or_pause, "step": self._single_step, "speed": self._set_speed,
                   "keys": self._hold, "hide": self._hide, "driver": self._choose,
                   "again": lambda _: self._begin(self._task), "another": self._begin_another,
                   "start": self._begin_at_start, "compare": self._compare,
                   "target": self._move_target, "robot": self._move_robot,
                   "boxes": self._change_boxes, "room": self._load, "file": self._read}
        for name, argument in request.items():
            actions[name](argument)

    def _run_or_pause(self, runs):
        self._runs = bool(runs)

    def _single_step(self, _):
        self._runs = False
        self._step()

    def _set_speed(self, speed):
        self._speed = scenes.number(speed, "speed", *SPEEDS)

    def _hold(self, keys):
        self._held = held_keys(keys)
        self._pressed |= self._held

    def _hide(self, what):
        scenes.check(what in HIDDEN, f"hide is {scenes.shown(what)}; it must be one of {HIDDEN}")
        self._hidden = what
        hide(self._env, what)
        self._look()

    def _choose(self, name, begins=True):
        """Lets another driver take over, in the middle of the episode."""
        self._driver, self._run = make_driver(name)
        self._name = name
        if begins:
            self._driver.reset(self._env, ROBOT)

    def _begin_another(self, _=None):
        """Begins a random task."""
        self._forget_paths()
        self._begin()

    def _begin_at_start(self, _):
        """Begins at the room's start, with the next one of its targets."""
        self._forget_paths()
        self._target = (self._target + 1) % len(self._scene.targets)
        self._begin((self._scene.targets[self._target], np.array(self._scene.start)))

    def _compare(self, names):
        """Lets several drivers drive the same task, one after the other."""
        known = drivers()
        scenes.check(names, "choose at least one driver to compare")
        for name in names:
            scenes.check(name in known, f"there is no driver {scenes.shown(name)}")
        self._forget_paths()
        self._waiting = list(names)
        self._runs = True
        self._next_episode()

    def _move_target(self, place):
        check_target(self._scene, scenes.numbers(place, "the target", 2))
        self._leave_end()
        self._env.goals[0] = place
        self._moved()

    def _move_robot(self, pose):
        check_robot(self._scene, scenes.numbers(pose, "the robot", 3))
        self._leave_end()
        self._put(pose)
        self._moved()

    def _change_boxes(self, change):
        """Changes the boxes around the robot. Start and targets that are still free remain. change:
        `boxes`, and the name of the `room`, which another page may have changed."""
        scenes.check(change["room"] == self._scene.name, "another page has changed the room")
        boxes = scenes.each(change, "boxes", 1, scenes.MOST_BOXES, scenes.box_of, False)
        self._leave_end()
        old = self._scene
        pose = self._env.world.poses[0]
        goal = tuple(self._env.goals[0].tolist())
        new = replace(old, boxes=boxes, start=tuple(pose.tolist()))
        scenes.check_size(new)
        check_robot(new, pose)
        check_target(new, goal)

        def free(places):
            return tuple(place for place in places if is_reachable(new, place[:2]))

        starts = [start for start in free((old.start, *old.other_starts)) if new.fits(start)]
        first, *others = starts or [new.start]
        self._scene = replace(new, start=first, other_starts=tuple(others),
                              training_targets=free(old.training_targets) or (goal,),
                              new_targets=free(old.new_targets))
        change_room(self._env, 0, self._scene)
        self._put(pose)
        self._moved()
        self.publish(room=room_content(self._scene))

    def _load(self, name):
        """Enters a room by its name. A page cannot ask for a file of this machine."""
        known = name in scenes.names() or re.fullmatch(r"random:\d{1,9}", str(name))
        scenes.check(known, f"there is no room {scenes.shown(name)}")
        self._enter(scenes.load(name))

    def _read(self, file):
        """Enters the room of a file that was opened in the browser: its name and its text."""
        scene = scenes.read(str(file["text"]), Path(Path(str(file["name"])).name))
        self._enter(scenes.rebuild(asdict(scene)))  # checks the name

    # ----------------------------------------------------------------------------- the simulation

    def _enter(self, scene):
        """Puts the robot into another room."""
        self._scene = scene
        self._env = make_environment("anywhere", [scene], [0], self._hidden,
                                     environment_of([scene]))
        self._env.reset(seed=int(time.time()))
        self._target = -1  # index of the last target of a task from the room's start
        self._begin_another()
        self.publish(room=room_content(self._scene))

    def _begin(self, task=None):
        """Begins an episode: a task (goal, start), or a random one."""
        env = self._env
        observations, _ = env.reset(options={"goal": task[0], "start": task[1]} if task else None)
        self._task = env.goals[0].copy(), env.starts[0].copy()
        self._seen = observations
        self._command = np.zeros((1, 2))
        self._reward = 0.0
        self._return = 0.0
        self._steps = 0
        self._outcome = ""
        self._goal = env.goals[0].copy()
        self._pose = env.starts[0].copy()
        self._path = [self._pose[:2].round(3).tolist()]
        self._refresh()
        self._driver.reset(env, ROBOT)

    def _refresh(self):
        """Takes the newest weights of a run under way. If there are none, the last ones remain."""
        try:
            newer = self._run and self._run.newer_driver()
            self._driver = newer or self._driver
        except RunError as error:
            self._message = str(error)

    def _next_episode(self):
        """Begins the next episode: with the next driver that waits, or with another task."""
        if self._waiting:
            self._choose(self._waiting.pop(0), begins=False)
            self._begin(self._task)
        else:
            self._begin_another()

    def _leave_end(self):
        """If the episode has ended, begins one at this place, so that things can be moved."""
        if self._outcome:
            self._begin((self._goal, self._pose))

    def _put(self, pose):
        """Moves the robot."""
        self._env.world.place(ROBOT, [pose])
        for name in {"estimates", "_last_estimates"} & vars(self._env).keys():  # in the lab
            getattr(self._env, name)[0] = pose

    def _moved(self):
        """Begins a new task here: something was moved. A policy keeps its memory."""
        self._pose = self._env.world.poses[0]
        self._goal = self._env.goals[0].copy()
        self._task = self._goal.copy(), self._pose.copy()
        self._path = [self._pose[:2].round(3).tolist()]
        self._forget_paths()
        if isinstance(self._driver, Planned):
            self._driver.reset(self._env, ROBOT)  # it plans again
        self._look()

    def _look(self):
        """Observes again, without a step."""
        if not self._outcome:
            env = self._env
            self._seen = env.observe(ROBOT, env.world.poses, env.goals, self._command,
                                     np.array([self._reward]))

    def _step(self):
        """Drives for one control period. After an episode's end, begins the next one."""
        if self._outcome:
            return self._next_episode()
        action = self._driver.act(self._env, self._seen)
        if self._held | self._pressed:
            action = action_of(self._held | self._pressed)
        self._pressed = set()
        seen, rewards, terminated, truncated, infos = self._env.step(action)
        self._command = infos["command"]
        self._reward = float(rewards[0])
        self._return += self._reward
        self._steps += 1
        self._pose = infos["pose"][0]
        self._path.append(self._pose[:2].round(3).tolist())
        self._seen = seen
        if terminated[0] or truncated[0]:
            self._seen = infos["final_obs"]
            self._outcome = self._env.outcomes[infos["final_info"]["outcome"][0]]
            self._paths.append({"driver": self._name, "outcome": self._outcome,
                                "points": self._path})
            if self._paths[1:] and not self._waiting:
                self._runs = False  # a comparison is complete: its paths stay visible
        return None

    # ------------------------------------------------------------------------------ what is shown

    def _publish_state(self):
        distance, bearing = self._seen["target"][0].tolist()
        v, w = self._command[0].tolist()
        state = {"runs": self._runs, "speed": self._speed, "driver": self._name,
                 "hide": self._hidden, "message": self._message, "outcome": self._outcome,
                 "steps": self._steps, "pose": self._pose.tolist(), "goal": self._goal.tolist(),
                 "linear": v, "angular": w, "distance": distance, "bearing": bearing,
                 "reward": self._reward, "return": self._return,
                 "image": encoded(self._seen["image"][0])}
        if isinstance(self._driver, Planned):  # the points that it still wants to reach
            path = getattr(self._driver.planners[0], "path", [])
            state |= {"plan": [list(point) for point in path]}
        activations = getattr(self._driver, "activations", None)
        if activations and self._steps:
            memory = np.round(127 * activations["memory"][0]).astype(np.int8)  # (layers, HIDDEN)
            state |= {"value": float(activations["value"][0]),
                      "features": activations["features"][0].round(2).tolist(),
                      "memory": [encoded(layer) for layer in memory if memory.any()]}
        curves = self._run.curves if self._run else {}
        compared = self._paths if self._waiting or self._paths[1:] else []
        self.publish(state=state, paths=compared, curves=curves)

    # --------------------------------------------------------------------------------- the thread

    def run(self):
        """Runs the session for ever. Without an open page it sleeps."""
        due = time.monotonic()  # when the next step begins
        while True:
            drives = self._runs and self.pages
            item = self.next_request(max(due - time.monotonic(), 0) if drives else None)
            if item:
                request, answer = item
                self._message = ""  # of an earlier request
                answer.put(self._safely(self.answer, request))
            else:
                self._safely(self._step)
                period = CONTROL_PERIOD / self._speed
                due = max(due, time.monotonic() - STILL)
                due += min(HOLD, 4 * period) if self._outcome else period

    def _safely(self, action, *arguments):
        """Does something, and publishes the state. Returns what is wrong with it, or ''."""
        try:
            action(*arguments)
        except (SceneError, RunError) as error:
            self._message = str(error)
        except Exception as error:  # of a driver, or of a request that no page of ours sends
            self._runs = False
            self._message = f"paused: {type(error).__name__}: {str(error)[:200]}"
        try:
            self._publish_state()
        except Exception as error:  # of a driver: it is replaced
            self._runs = False
            self._message = f"paused: {type(error).__name__}: {str(error)[:200]}"
            self._choose(YOU)
            self._publish_state()
        return self._message


def check_robot(scene, pose):
    """Raises SceneError if the robot cannot be at a pose (x, y, ...)."""
    here = f"the robot at ({pose[0]:.2f}, {pose[1]:.2f})"
    scenes.check(scene.fits(pose), f"{here} is outside the room, or closer to a box than its "
                 f"radius, {ROBOT_RADIUS} m")
    scenes.check(is_reachable(scene, pose[:2]), f"no path leads to {here}")


def check_target(scene, place):
    """Raises SceneError if a robot cannot arrive at a place (x, y)."""
    x, y = place
    scenes.check(is_reachable(scene, place), f"the target at ({x:.2f}, {y:.2f}) cannot be reached")


def held_keys(keys):
    """Returns the set of known keys in a list from a page. Raises TypeError."""
    return set(KEYS) & {key for key in keys if isinstance(key, str)}


def action_of(keys):
    """Returns the action (1, 2) of a set of arrow keys that are held."""
    return np.sum([(0, 0), *(KEYS[key] for key in keys)], 0, dtype=float)[None]


def room_content(scene):
    """Returns a Scene as the page shows it."""
    return {"name": scene.name, "bounds": scene.bounds.tolist(), "toml": scenes.to_toml(scene),
            "start": scene.start,
            "targets": {"training": scene.training_targets, "new": scene.new_targets},
            "boxes": [asdict(box) | {"colour": PALETTE[box.material]} for box in scene.boxes]}


def encoded(array):
    """Returns the bytes of an array as text."""
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()
