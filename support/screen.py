"""What an environment's `render` shows of a robot. matplotlib is loaded by those who look."""

from gymnasium.error import ResetNeeded


class Screen:
    """One robot's episodes as pictures: the map beside what its camera sees."""

    def __init__(self):
        self._episode = None  # scene and goal
        self._seen = None  # pose, image, command, seconds
        self._view = None  # the pictures of this episode
        self._window = None

    def begin(self, scene, goal):
        """An episode begins: forgets the trail of the one before."""
        self._episode = scene, goal.copy()
        self._view = None

    def see(self, pose, image, command, seconds):
        """What there is to see now: pose (3,), image (H, W, 3), command (2,), time so far [s]."""
        self._seen = pose, image, command, seconds

    def picture(self):
        """A (height, width, 3) uint8 picture of now. The trail goes by the poses that were drawn.
        Raises ResetNeeded before the first episode."""
        if self._seen is None:
            raise ResetNeeded("render() was called before reset()")
        from support.film import EpisodeView
        if self._view is None:
            self._view = EpisodeView(*self._episode)
        return self._view.frame(*self._seen)

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
