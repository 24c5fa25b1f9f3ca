"""The film of an episode: the map from above beside what the camera sees.

`EpisodeView` makes one frame after the other, for films, for `render_mode="rgb_array"` and for
windows. All that does not move is drawn once.
"""

import time

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from PIL import Image

from render import CUBE_SIZE, H, W
from sim import CONTROL_PERIOD
from support.pictures import PALETTE, draw_ring, draw_robot, draw_room, kind_of, move_robot

SIZE = 760, 312  # [px] width and height of a frame, even, as video encoders need it
ZOOM = 5  # pixels of a frame, across and down, to a pixel of the camera
CAMERA_CORNER = 428, 32  # [px] where the camera's picture begins, from the left and from above
MAP = 8, 32, 412, 240  # [px] the map's left, top, width, height
ABOVE = 1 - 20 / SIZE[1]  # heights of the words above and below map and camera
BELOW = 12 / SIZE[1]
DPI = 100
RENDER_FPS = 10  # frames a second of a film, one a control period, as in the environments
HOLD = 1500  # [ms] that a film shows its last frame
COLOURS = 64  # of a film's GIF


def caption(kind, cube):
    """What a film says of its target. kind: as of `kind_of`. cube: whether the camera shows it."""
    name = {"training": "training target", "new": "new target", "goal": "target"}[kind]
    shown = "blue cube in the camera" if cube else "the camera never shows its cube"
    return f"{name} (ring): {shown}"


class EpisodeView:
    """An episode as pictures. One view is one episode: the trail of the robot grows by every frame.

    The target is a blue cube in the camera, whichever it is, and so it is on this map, in a ring.
    No other target is in the world during the episode, so none is shown.
    """

    def __init__(self, scene, goal, label="", pace="", cube=True):
        """goal: (2,) [m], where the target stands. label, pace: a few words below and above what
        the camera sees, on how the episode is driven and how fast it is shown. cube: whether the
        camera may show the cube."""
        figure = Figure(figsize=(SIZE[0] / DPI, SIZE[1] / DPI), dpi=DPI)
        self._canvas = FigureCanvasAgg(figure)
        left, top, width, height = MAP
        self._axes = figure.add_axes((left / SIZE[0], 1 - (top + height) / SIZE[1],
                                      width / SIZE[0], height / SIZE[1]))
        draw_room(self._axes, scene)
        self._axes.axis("off")
        self._axes.set_anchor("W")
        self._draw_target(scene, goal, cube)
        left = CAMERA_CORNER[0] / SIZE[0]
        right = (CAMERA_CORNER[0] + ZOOM * W) / SIZE[0]
        figure.text(left, ABOVE, "what the robot sees", fontsize=10)
        figure.text(right, ABOVE, pace, fontsize=10, ha="right")
        figure.text(left, BELOW, label, fontsize=10)
        self._trail, = self._axes.plot([], [], color=PALETTE["robot"], lw=1.6, alpha=0.6)
        self._disc, self._nose = draw_robot(self._axes, (0, 0, 0))
        self._title = figure.text(MAP[0] / SIZE[0], ABOVE, "", family="monospace", fontsize=10)
        self._moving = [self._trail, self._disc, self._nose, self._title]
        for artist in self._moving:
            artist.set_animated(True)  # left out when the still part is drawn
        self._canvas.draw()
        self._still = self._canvas.copy_from_bbox(figure.bbox)
        self._places = []

    def _draw_target(self, scene, goal, cube):
        """Draws the cube, hollow where the camera never shows it, in its ring, and says below the
        map what they are."""
        half = CUBE_SIZE / 2
        self._axes.add_patch(Rectangle((goal[0] - half, goal[1] - half), CUBE_SIZE, CUBE_SIZE,
                                       color=PALETTE["cube"], fill=cube))
        draw_ring(self._axes, goal)
        self._axes.figure.text(MAP[0] / SIZE[0], BELOW, caption(kind_of(scene, goal), cube),
                               fontsize=10)

    def frame(self, pose, image, command, seconds):
        """The next frame (h, w, 3) uint8: the robot at that pose (3,), what it sees (H, W, 3), the
        command (2,) [m/s, rad/s] that led here, and the time since the episode's start [s]."""
        self._places.append(tuple(pose[:2]))
        self._trail.set_data(*np.transpose(self._places))
        move_robot(self._disc, self._nose, pose)
        self._title.set_text(f"{seconds:4.1f} s  {command[0]:5.2f} m/s  {command[1]:+5.2f} rad/s")
        self._canvas.restore_region(self._still)
        for artist in self._moving:
            self._axes.figure.draw_artist(artist)
        frame = np.asarray(self._canvas.buffer_rgba())[:, :, :3].copy()
        x, y = CAMERA_CORNER
        frame[y:y + ZOOM * H, x:x + ZOOM * W] = image.repeat(ZOOM, 0).repeat(ZOOM, 1)
        return frame


def show_cube(images):
    """Whether any of the images (T, H, W, 3) shows the cube: nothing else is blue."""
    red, green, blue = np.moveaxis(images, -1, 0)
    return bool((blue // 2 > np.maximum(red, green)).any())


def frames_of(trace):
    """The frames (h, w, 3) uint8 of a trace that has images, T + 1 of them."""
    pace = f"{RENDER_FPS * CONTROL_PERIOD:g} times faster than life"
    view = EpisodeView(trace.scene, trace.goal, trace.label, pace, show_cube(trace.images))
    commands = np.concatenate([np.zeros((1, 2)), trace.commands])  # none led to the start
    for t, (pose, image, command) in enumerate(zip(trace.poses, trace.images, commands)):
        yield view.frame(pose, image, command, t * CONTROL_PERIOD)


def write_film(trace, file):
    """Writes a trace that has images as a GIF, RENDER_FPS frames a second, that runs in a loop.
    file: a path or a binary file."""
    frames = list(frames_of(trace))
    several = np.concatenate(frames[::8] + frames[-1:])  # one choice of colours for all frames
    colours = Image.fromarray(several).quantize(COLOURS, Image.Quantize.MAXCOVERAGE, kmeans=1)
    frames = [Image.fromarray(frame).quantize(palette=colours, dither=Image.Dither.NONE)
              for frame in frames]
    durations = [1000 // RENDER_FPS] * (len(frames) - 1) + [HOLD]
    frames[0].save(file, format="GIF", save_all=True, append_images=frames[1:],
                   duration=durations, loop=0)


class Window:
    """A window that shows one frame after the other. Closed by hand, it stays closed."""

    def __init__(self):
        """Raises RuntimeError where there is no display, or python came without tkinter."""
        try:
            import tkinter  # here: not every python has it, and films do without
            self._root = tkinter.Tk()
        except Exception as error:  # tkinter's own class is not known where tkinter is missing
            raise RuntimeError(f"no window can be opened here ({error}), the render mode must be "
                               "rgb_array") from None
        self._root.title("navbot_min")
        self._root.protocol("WM_DELETE_WINDOW", self.close)
        self._label = tkinter.Label(self._root)
        self._label.pack()
        self._photo = tkinter.PhotoImage
        self._next = time.perf_counter()  # [s] when the next frame is due

    def show(self, frame, fps):
        """Shows a frame (h, w, 3) uint8, so that at most that many are shown a second."""
        time.sleep(max(self._next - time.perf_counter(), 0))
        self._next = time.perf_counter() + 1 / fps
        if self._root is None:
            return
        height, width, _ = frame.shape
        image = self._photo(data=b"P6 %d %d 255 " % (width, height) + frame.tobytes())
        self._label.configure(image=image)
        self._label.image = image  # tkinter itself does not keep it
        self._root.update()

    def close(self):
        """Closes it, if it is open."""
        if self._root is not None:
            self._root.destroy()
            self._root = None
