"""What an environment's `render` shows of a robot. matplotlib is loaded by those who look."""

import numpy as np
from gymnasium.error import ResetNeeded

SEEN = ("screen_poses", "screen_images", "screen_commands", "screen_seconds")


class Screen:
    """One robot's episodes as pictures: the map beside what its camera sees."""

    def __init__(self):
        self._scene = None  # of the episode
        self.goal = None
        self.seen = None  # pose, image, command, seconds
        self._view = None  # the pictures of this episode
        self._window = None

    def begin(self, scene, goal):
        """An episode begins: forgets the trail of the one before."""
        self._scene = scene
        self.goal = goal.copy()
        self._view = None

    def see(self, pose, image, command, seconds):
        """What there is to see now: pose (3,), image (H, W, 3), command (2,), time so far [s]."""
        self.seen = pose, image, command, seconds

    def picture(self):
        """A (height, width, 3) uint8 picture of now. The trail goes by the poses that were drawn.
        Raises ResetNeeded before the first episode."""
        if self.seen is None:
            raise ResetNeeded("render() was called before reset()")
        from support.film import EpisodeView
        if self._view is None:
            self._view = EpisodeView(self._scene, self.goal)
        return self._view.frame(*self.seen)

    def show(self, fps):
        """Shows the picture of now in a window, at most so many a second. Raises RuntimeError where
        there is no display."""
        from support.film import Window
        if self._window is None:
            self._window = Window()
        self._window.show(self.picture(), fps)

    def close(self):
        """Closes the window, if there is one."""
        if self._window is not None:
            self._window.close()
            self._window = None

    def __getstate__(self):
        """What is pickled or copied: all but the pictures, which are drawn anew."""
        return self.__dict__ | {"_view": None, "_window": None}


class Screens:
    """Those of the robots of a vector environment; none where nothing is ever drawn."""

    def __init__(self, count):
        self._screens = [Screen() for _ in range(count)]

    def begin(self, r, scene, goal):
        """Robot r's episode begins."""
        if self._screens:
            self._screens[r].begin(scene, goal)

    def see(self, poses, observations, seconds):
        """What there is to see now: poses (R, 3), observations, time so far (R,) [s]."""
        for r, screen in enumerate(self._screens):
            screen.see(poses[r], observations["image"][r], observations["velocity"][r], seconds[r])

    def pictures(self):
        """A picture of each, None where there are none. Raises ResetNeeded."""
        return tuple(screen.picture() for screen in self._screens) if self._screens else None

    def state(self):
        """What they show, (R, ...) arrays by their names, for `load_state`; {} where there are
        none. Of the trail only its last point is kept."""
        if not self._screens:
            return {}
        goals = np.array([screen.goal for screen in self._screens])
        seen = zip(*(screen.seen for screen in self._screens))
        return {"screen_goals": goals} | dict(zip(SEEN, map(np.array, seen)))

    def load_state(self, state, scenes):
        """Shows again what they showed. scenes: each robot's Scene."""
        for r, screen in enumerate(self._screens):
            screen.begin(scenes[r], state["screen_goals"][r])
            screen.see(*(state[name][r].copy() for name in SEEN))
