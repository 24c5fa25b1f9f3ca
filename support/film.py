"""An episode as a film, a picture or a window: the map next to the camera image."""

from functools import partial

# Must be imported before matplotlib.
from support.palette import PALETTE
from support.pictures import draw_robot, draw_room, draw_target, kind_of

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from render import H, W
from sim import CONTROL_PERIOD

SIZE = 760, 312  # [px] width and height of a frame; video encoders need even numbers
SHAPE = dict(figsize=np.divide(SIZE, 100), dpi=100)
ZOOM = 5  # pixels of a frame per camera pixel, in both directions
CAMERA_CORNER = 428, 32  # [px] left and top of the camera image, from the upper left
MAP = 8, 40, 412, 240  # [px] left, bottom, width, height, from the lower left
ABOVE, BELOW = 292, 12  # [px] heights of the texts above and below map and camera
RENDER_FPS = 10  # frames per second of a film, as in navbot_min


class EpisodeView:
    """Draws the frames of one episode. The robot's trail grows with every frame."""

    def __init__(self, scene, goal, label="", pace=""):
        """goal: (2,) [m]. label, pace: texts below and above the camera image."""
        figure = Figure(**SHAPE)
        self._canvas = FigureCanvasAgg(figure)
        self._axes = figure.add_axes(np.divide(MAP, SIZE * 2), anchor="W")
        draw_room(self._axes, scene)
        draw_target(self._axes, scene, goal, ring=True, fc=PALETTE["cube"], ec=PALETTE["cube"])
        self._axes.axis("off")
        self._text = partial(figure.text, fontsize=10, transform=None)  # None: in pixels
        target = f"{kind_of(scene, goal)} target".removeprefix("goal ")
        self._text(MAP[0], BELOW, f"blue cube, circled: {target}")
        self._text(CAMERA_CORNER[0], ABOVE, f"camera image{pace}")
        self._text(CAMERA_CORNER[0], BELOW, label)
        self._canvas.draw()
        self._still = self._canvas.copy_from_bbox(figure.bbox)
        self._places = []

    def frame(self, pose, image, command, step):
        """Returns the frame (h, w, 3) uint8 after a step: the robot at its pose (3,), its image
        (H, W, 3), and the command (2,) [m/s, rad/s] of the step."""
        self._places.append(tuple(pose[:2]))
        trail = self._axes.plot(*zip(*self._places), color=PALETTE["robot"], lw=1.6, alpha=0.6)
        words = f"{step * CONTROL_PERIOD:4.1f} s  {command[0]:5.2f} m/s  {command[1]:+5.2f} rad/s"
        text = self._text(MAP[0], ABOVE, words, family="monospace")
        self._canvas.restore_region(self._still)
        for artist in (*trail, *draw_robot(self._axes, pose), text):
            artist.draw(self._canvas.get_renderer())
            artist.remove()
        frame = np.asarray(self._canvas.buffer_rgba())[:, :, :3].copy()
        x, y = CAMERA_CORNER
        frame[y:y + ZOOM * H, x:x + ZOOM * W] = image.repeat(ZOOM, 0).repeat(ZOOM, 1)
        return frame


def write_film(trace, file):
    """Writes a trace that has images as a GIF. file: a path or a binary file."""
    pace = f", {RENDER_FPS * CONTROL_PERIOD:g} times real time"
    view = EpisodeView(trace.scene, trace.goal, trace.label, pace)
    commands = [(0, 0), *trace.commands]  # no command led to the start
    frames = list(map(view.frame, trace.poses, trace.images, commands, range(len(commands))))
    several = np.concatenate(frames[::8] + frames[-1:])  # the same colours for all frames
    colours = Image.fromarray(several).quantize(64, Image.Quantize.MAXCOVERAGE, kmeans=1)
    first, *others = [Image.fromarray(frame).quantize(palette=colours, dither=0)
                      for frame in frames]
    first.save(file, format="GIF", save_all=True, append_images=others, loop=0,
               duration=[1000 // RENDER_FPS] * len(others) + [1500])  # [ms]


class Window:
    """A matplotlib window that shows frames. Once closed, it stays closed."""

    def __init__(self):
        """Opens the window. Raises RuntimeError without a display."""
        import matplotlib.pyplot as plt  # needed only for a window
        figure = plt.figure(**SHAPE)
        self._canvas = figure.canvas
        self._is_open = partial(plt.fignum_exists, figure.number)
        self.close = partial(plt.close, figure)  # has no effect on a closed window
        if self._canvas.required_interactive_framework is None:
            self.close()
            raise RuntimeError("no window can be opened here, so the render mode must be rgb_array")
        axes = figure.add_axes((0, 0, 1, 1))
        axes.axis("off")
        self._image = axes.imshow(np.zeros((SIZE[1], SIZE[0], 3), np.uint8))
        figure.show()

    def show(self, frame, fps):
        """Shows a frame (h, w, 3) uint8 for 1 / fps seconds."""
        if self._is_open():
            self._image.set_data(frame)
            self._canvas.draw_idle()
            self._canvas.start_event_loop(1 / fps)


class Screen:
    """Pictures for `NavEnv.render`: the map next to the camera image."""
    def __init__(self, mode, fps):
        """mode: "rgb_array" or "human", a window. Raises RuntimeError."""
        self.fps = fps
        self.window = Window() if mode == "human" else None
        self.view = None  # EpisodeView of the current episode

    def draw(self, scene, observation, info):
        """Returns the picture (h, w, 3) uint8 of a step of `NavEnv`; None if a window shows it."""
        if self.view is None or info["length"] == 0:
            self.view = EpisodeView(scene, (info["goal_x"], info["goal_y"]))
        picture = self.view.frame(info["pose"], observation["image"], info["command"],
                                  info["length"])
        return self.window.show(picture, self.fps) if self.window else picture

    def close(self):
        """Closes the window, if there is one."""
        if self.window:
            self.window.close()
