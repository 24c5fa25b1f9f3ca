"""The camera: a numpy raycaster that paints what the robots see, and the map from above.

The world is 2.5-D: upright boxes on a flat floor, all higher than the camera, and one low target
cube. So an image is made of columns: a column's ray meets the room in the plane, and what it meets
is painted as texture between the rows where its top and its foot appear.

Points of the plane are complex, x + iy [m]: a product turns. Axis letters: R robots, B boxes,
F faces in view, K in one image, W = 64 columns, H = 48 rows, C columns of several images.
"""

import numpy as np

from sim import CAMERA_HEIGHT

H, W = 48, 64  # [px] paper III-C
FOCAL = W / 2 / np.tan(np.radians(60) / 2)  # [px] 60 degrees across, square pixels, released model
CAMERA_OFFSET = -0.118  # [m] the camera's place ahead of the robot's centre, released model
NEAR, FAR = 0.05, 8.0  # [m] released model
CUBE_SIZE = 0.2  # [m] the target, released model

SUN = np.array((0.5, -0.1, 0.9)) / np.linalg.norm((0.5, -0.1, 0.9))  # towards it, released world
FLOOR, SKY, BLUE = (118, 118, 118), (178, 178, 178), (20, 20, 235)
TEXEL = 0.025  # [m] one texture element, our choice
PERIOD = 48  # texels after which a texture repeats along a wall, 1.2 m
BLOCK = 64  # images that are painted at once, few enough to stay in the cache
BELOW, ABOVE = 128, 160  # texels of a texture column below and above the floor line: all that
#   a camera column can show up to FAR, so that no lookup needs to be clipped

# Rays through the middle of each column: direction (1, RAY) in (forward, left), so that a ray's
# parameter is the distance along the optical axis and a wall seen head-on is flat.
RAY = ((W / 2 - 0.5 - np.arange(W)) / FOCAL).astype(np.float32)
DROP = ((np.arange(H) + 0.5 - H / 2) / FOCAL).astype(np.float32)  # fall of a row's ray, per metre
HORIZON = np.float32(BELOW + CAMERA_HEIGHT / TEXEL)  # the camera's height in a texture column


def light(normal):
    """Brightness of a face with that (..., 3) outward normal: ambient light and Lambert's law."""
    return 0.5 + 0.5 * np.clip(2 * (np.asarray(normal) @ SUN), 0, 1)


def texture(material):
    """(PERIOD, ABOVE, 3) colours [0, 255] of a wall, by texels along it and above its foot."""
    rng = np.random.default_rng(sum(material.encode()))
    u, v = np.meshgrid(np.arange(PERIOD), np.arange(ABOVE), indexing="ij")
    if material == "wall":  # grey-brown ceiling tiles, 0.6 m, grainy
        colour = np.array((186, 176, 168)) + rng.normal(0, 7, (PERIOD, ABOVE, 1))
        colour[(u % 24 == 0) | (v % 24 == 0)] -= 45
    elif material == "brick":  # courses of 10 cm, bricks of 30 cm, every other course shifted
        course = v // 4
        brick = (u + 6 * (course % 2)) // 12 % (PERIOD // 12)
        tone = rng.normal(0, 1, (PERIOD // 12, ABOVE // 4, 1))[brick, course]
        colour = np.array((178, 74, 62)) + tone * (22, 14, 14)
        colour += rng.normal(0, 6, (PERIOD, ABOVE, 1))
        colour[((u + 6 * (course % 2)) % 12 == 0) | (v % 4 == 0)] = (176, 158, 150)
    else:  # wood: upright orange-brown planks of 15 cm with grain along them
        tone = rng.normal(0, 14, (PERIOD // 6, 1))[u // 6]
        grain = rng.normal(0, 7, (PERIOD, ABOVE // 8, 1)).repeat(8, 1)
        colour = np.array((206, 126, 48)) + tone + grain
        colour[u % 6 == 0] *= 0.72
    return colour


class Camera:
    """Paints what robots see in the given rooms. Raises nothing: any pose gives an image."""

    def __init__(self, rooms):
        """rooms: Scenes; a robot's room is an index into them. Heights are rounded to a texel."""
        shape = (len(rooms), max(len(room.boxes) for room in rooms), 4)
        self._corners = np.zeros(shape, np.complex64)  # boxes that a room lacks have no size,
        self._tops = np.zeros(shape, np.float32)  # and a face without size is never seen
        self._lit = np.zeros(shape, np.int64)  # where the face's lit texture starts in the palette
        lit = {}
        for i, room in enumerate(rooms):
            for b, box in enumerate(room.boxes):
                self._corners[i, b] = box.corners @ (1, 1j)
                top = min(round(box.height / TEXEL), ABOVE)
                self._tops[i, b] = top * TEXEL
                for face, angle in enumerate(box.yaw + np.pi * np.array((0.5, 1, 1.5, 2))):
                    bright = light((np.cos(angle), np.sin(angle), 0)).round(1)  # few, to stay small
                    key = (box.material, top, float(bright))
                    self._lit[i, b, face] = lit.setdefault(key, len(lit)) * PERIOD * (BELOW + ABOVE)
        self._highest = self._tops.max()
        self._palette = self._pack(lit)

    def _pack(self, lit):
        """One flat array of 32-bit colours: a texture column is floor, wall, sky from below up."""
        blocks = np.empty((len(lit) + 1, PERIOD, BELOW + ABOVE, 3))
        blocks[:, :, :BELOW], blocks[:, :, BELOW:] = FLOOR, SKY
        for (material, top, bright), k in lit.items():
            blocks[k, :, BELOW:BELOW + top] = texture(material)[:, :top] * bright
        self._open = (len(blocks) - 1) * PERIOD * (BELOW + ABOVE)  # no wall: floor and sky alone
        faces = ((0, 0, 1), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0))
        cube = np.array([np.multiply(BLUE, light(normal)) for normal in faces])
        self._cube = blocks.size // 3 + np.arange(len(faces))  # top, then faces to +x, -x, +y, -y
        colours = np.concatenate([blocks.reshape(-1, 3), cube]).clip(0, 255)
        packed = np.zeros((len(colours), 4), np.uint8)
        packed[:, :3] = colours.round()
        return packed.view(np.uint32)[:, 0]

    def render(self, room, poses, targets):
        """Images (R, H, W, 3) uint8 RGB seen from (R, 3) poses in rooms (R,) with the target cubes
        at (R, 2) [m]."""
        images = np.empty((len(poses), H, W, 3), np.uint8)
        for k in range(0, len(poses), BLOCK):
            block = slice(k, k + BLOCK)
            self._paint(images[block], room[block], poses[block], targets[block])
        return images

    def _paint(self, images, room, poses, targets):
        heading = np.exp(1j * poses[:, 2]).astype(np.complex64)
        eye = (poses[:, 0] + 1j * poses[:, 1]).astype(np.complex64) + CAMERA_OFFSET * heading
        index, depth = self._paint_room(room, eye, heading)
        offset = (targets[:, 0] + 1j * targets[:, 1] - eye).astype(np.complex64)
        self._paint_cube(index, depth, offset, heading)
        packed = self._palette.take(index, mode="wrap").view(np.uint8).reshape(-1, H, W, 4)
        for channel in range(3):
            images[..., channel] = packed[..., channel]

    def _paint_room(self, room, eye, heading):
        """Palette index of each pixel (R, H, W), and depth [m] of each column's nearest wall."""
        (a, b, e, f, lit, top), inverse, slots = self._visible_faces(room, eye, heading)
        R, K = slots.shape
        index = depth = None
        column, skyline = np.arange(R * W), np.float32(0)
        while len(column):  # the nearest face of each column, then what is seen over its top
            slot = inverse.argmax(1)
            if index is not None:
                more = np.flatnonzero(slot)
                column, inverse, skyline, slot = (x[more] for x in (column, inverse, skyline, slot))
            robot, x = np.divmod(column, W)
            face = slots[robot, slot]
            z = 1 / (a[face] + b[face] * RAY[x])
            u = ((e[face] + f[face] * RAY[x]) * z).astype(np.int64) % PERIOD
            base = lit[face] + u * (BELOW + ABOVE)
            if index is None:
                v = HORIZON - DROP[:, None] * (z / TEXEL).reshape(R, 1, W)
                index, depth = v.astype(np.int64), z.reshape(R, W)
                index += base.reshape(R, 1, W)
            else:
                v = HORIZON - DROP[:H // 2] * (z / TEXEL)[:, None]
                index[robot, :H // 2, x] = np.where(
                    DROP[:H // 2] <= skyline[:, None], base[:, None] + v.astype(np.int64),
                    index[robot, :H // 2, x])
            skyline = np.minimum(skyline, (CAMERA_HEIGHT - top[face]) / z)
            more = np.flatnonzero(top[face] < self._highest)
            column, skyline = column[more], skyline[more]
            higher = top[slots[robot[more]]] > top[face[more], None]
            inverse = np.where(higher, inverse[more], np.float32(0))
        return index, depth

    def _visible_faces(self, room, eye, heading):
        """The faces that each camera may see.

        Along a face, inverse depth is affine in the column's ray, 1 / z = a + b ray, and so is
        u / z, where u is how far along the face the ray meets it [texel]. Returns a, b, e, f
        (u / z = e + f ray), the lit texture and the top [m] of each face (F,); the inverse
        depth of K slots for each column (C, K), 0 where a ray misses; and the faces (R, K) in those
        slots. Slot 0 is no wall but the end of sight, floor and sky at FAR.
        """
        p = (self._corners[room] - eye[:, None, None]) * heading.conj()[:, None, None]  # (R, B, 4)
        q = p[:, :, (1, 2, 3, 0)]
        cross = (p.conj() * q).imag  # negative when seen from outside: p is left then, q right
        ahead = p.real > NEAR / 2  # an end behind the camera is out of view on its side
        slope = p.imag / np.where(ahead, p.real, 1)
        left = np.where(ahead, slope, np.inf)
        right = np.where(ahead, slope, -np.inf)[:, :, (1, 2, 3, 0)]
        visible = (cross < -1e-6) & (ahead | ahead[:, :, (1, 2, 3, 0)])
        visible &= (left >= RAY[-1]) & (right <= RAY[0])
        robot, box, side = np.nonzero(visible)
        p, q, cross, left, right = (x[robot, box, side] for x in (p, q, cross, left, right))
        along = q - p
        a, b = along.imag / cross, -along.real / cross
        seen = (RAY <= left[:, None]) & (RAY >= right[:, None])  # both ends: corners leave no gap
        count = np.bincount(robot, minlength=len(room))
        slot = np.arange(len(robot)) - np.repeat(np.cumsum(count) - count, count) + 1
        inverse = np.zeros((len(room), W, count.max() + 1), np.float32)
        inverse[:, :, 0] = 1 / FAR
        inverse[robot, :, slot] = (a[:, None] + b[:, None] * RAY) * seen
        slots = np.zeros((len(room), inverse.shape[2]), np.int64)
        slots[robot, slot] = np.arange(len(robot)) + 1
        along /= TEXEL * np.abs(along)
        start = (along.conj() * p).real
        faces = (a, b, along.real - start * a, along.imag - start * b,
                 self._lit[room[robot], box, side], self._tops[room[robot], box, side])
        end = (1 / FAR, 0, 0, 0, self._open, np.inf)
        faces = [np.concatenate([[y], x], dtype=x.dtype) for x, y in zip(faces, end)]
        return faces, inverse.reshape(-1, inverse.shape[2]), slots

    def _paint_cube(self, index, depth, offset, heading):
        """Paints the target cubes, (R,) `offset` from the cameras, over `index` in place."""
        ahead = offset * heading.conj()
        robots = np.flatnonzero(np.abs(ahead.imag) < RAY[0] * ahead.real + CUBE_SIZE)
        # Slabs: each axis-aligned pair of faces bounds the ray's parameter, which is the depth.
        way = heading[robots, None] * (1 + 1j * RAY)  # (R, W)
        x, y = (np.where(np.abs(d) < 1e-6, np.float32(1e-6), d) for d in (way.real, way.imag))
        half = np.float32(CUBE_SIZE / 2)
        dx, dy = offset[robots, None].real, offset[robots, None].imag
        enter_x, enter_y = (dx - half * np.sign(x)) / x, (dy - half * np.sign(y)) / y
        enter = np.maximum(enter_x, enter_y)
        leave = np.minimum((dx + half * np.sign(x)) / x, (dy + half * np.sign(y)) / y)
        leave = np.minimum(leave, depth[robots])
        robot, column = np.nonzero((enter < leave) & (leave > NEAR))
        near = np.maximum(enter[robot, column], np.float32(NEAR))[:, None]
        far = leave[robot, column][:, None]
        side = np.where(enter_x > enter_y, np.where(x < 0, 1, 2), np.where(y < 0, 3, 4))
        lid = np.float32(CAMERA_HEIGHT - CUBE_SIZE)  # the top face is this far below the camera
        on_top = (DROP * far >= lid) & (DROP * near < lid)
        on_side = (DROP * near >= lid) & (DROP * near < np.float32(CAMERA_HEIGHT))
        colour = np.where(on_top, 0, side[robot, column][:, None])
        index[robots[robot], :, column] = np.where(
            on_top | on_side, self._cube[colour], index[robots[robot], :, column])


def draw_map(axes, scene):
    """Draws a scene from above on matplotlib axes, training targets blue, new green (Fig. 3)."""
    colours = {"wall": "#b9b0a8", "brick": "#b24a3e", "wood": "#ce7e30"}
    for box in scene.boxes:
        axes.fill(*box.corners.T, color=colours[box.material])
    half = CUBE_SIZE / 2
    square = np.array([(-half, -half), (half, -half), (half, half), (-half, half)])
    for targets, colour in ((scene.training_targets, "#1414eb"), (scene.new_targets, "#12b512")):
        for target in targets:
            axes.fill(*(square + target).T, color=colour)
    low, high = scene.bounds
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal",
             xlabel="x [m]", ylabel="y [m]")
