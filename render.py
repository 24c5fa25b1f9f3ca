"""The camera: a numpy raycaster that paints what the robots see, and the map from above.

The world is 2.5-D: upright boxes on a flat floor, all higher than the camera, and one low target
cube. So an image is made of columns: a column's ray meets the room in the plane, and what it meets
is painted as texture between the rows where its top and its foot appear.

Axis letters: R robots, K faces that one robot may see, B boxes, W = 64 columns, H = 48 rows,
C columns of several images at once (C <= R W).
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
BELOW, ABOVE = 128, 160  # texels of a texture column below and above the floor line: all that
#   a camera column can show up to FAR, so that no lookup needs to be clipped

# Rays through the middle of each column: direction (1, RAY) in (forward, left), so that a ray's
# parameter is the distance along the optical axis and a wall seen head-on is flat.
RAY = ((W / 2 - 0.5 - np.arange(W)) / FOCAL).astype(np.float32)
DROP = ((np.arange(H) + 0.5 - H / 2) / FOCAL).astype(np.float32)  # fall of a row's ray, per metre


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
        self._corners = np.zeros((*shape, 2), np.float32)  # boxes that a room lacks have no size,
        self._tops = np.zeros(shape, np.int64)  # [texel]    and a face without size is never seen
        self._lit = np.zeros(shape, np.int64)  # where the face's lit texture starts in the palette
        lit = {}
        for i, room in enumerate(rooms):
            for b, box in enumerate(room.boxes):
                self._corners[i, b] = box.corners
                self._tops[i, b] = top = min(round(box.height / TEXEL), ABOVE)
                for face, angle in enumerate(box.yaw + np.pi * np.array((0.5, 1, 1.5, 2))):
                    bright = light((np.cos(angle), np.sin(angle), 0)).round(1)  # few, to stay small
                    key = (box.material, top, float(bright))
                    self._lit[i, b, face] = lit.setdefault(key, len(lit)) * PERIOD * (BELOW + ABOVE)
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
        for k in range(0, len(poses), 32):  # blocks that stay in the cache
            block = slice(k, k + 32)
            self._paint(images[block], room[block], poses[block], targets[block])
        return images

    def _paint(self, images, room, poses, targets):
        c, s = np.cos(poses[:, 2]).astype(np.float32), np.sin(poses[:, 2]).astype(np.float32)
        eye = poses[:, :2].astype(np.float32) + CAMERA_OFFSET * np.stack([c, s], -1)
        index, depth = self._paint_room(room, eye, c, s)
        self._paint_cube(index, depth, targets.astype(np.float32) - eye, c, s)
        packed = self._palette.take(index, mode="wrap").view(np.uint8).reshape(-1, W, H, 4)
        for channel in range(3):
            images[..., channel] = packed[..., channel].swapaxes(1, 2)

    def _paint_room(self, room, eye, c, s):
        """Palette index of each pixel (R W, H), and depth [m] of each column's nearest wall."""
        normal, p, span, tops, lit = self._visible_faces(room, eye, c, s)
        # Along a face, inverse depth is affine in the column: 1 / z = (n . (1, ray)) / (n . p).
        inverse = (normal[..., :1] + normal[..., 1:] * RAY) / (normal * p).sum(-1, keepdims=True)
        seen = (RAY <= span[..., :1]) & (RAY >= span[..., 1:])  # both ends: corners leave no gap
        inverse = np.where(seen & (inverse > 1 / FAR), inverse, np.float32(0))  # (R, K, W)
        inverse = inverse.swapaxes(1, 2).reshape(-1, inverse.shape[1])  # (C, K)
        robot, ray = np.repeat(np.arange(len(eye)), W), np.tile(RAY, len(eye))  # (C,)
        columns, index, depth, above = slice(None), None, None, None
        while len(inverse):  # the nearest face of each column, then what is seen over its top
            face = inverse.argmax(1)
            nearest = inverse[np.arange(len(face)), face]
            z = 1 / np.maximum(nearest, np.float32(1 / FAR))
            n, start = normal[robot, face], p[robot, face]
            # (n_y, -n_x) runs along the face; its length is the face's length.
            run = z * (ray * n[:, 0] - n[:, 1]) - (start[:, 1] * n[:, 0] - start[:, 0] * n[:, 1])
            u = (run / (np.hypot(n[:, 0], n[:, 1]) * TEXEL)).astype(np.int64) % PERIOD
            base = np.where(nearest > 0, lit[robot, face] + u * (BELOW + ABOVE), self._open)
            v = (CAMERA_HEIGHT / TEXEL + BELOW) - (z / TEXEL)[:, None] * DROP  # (C, H)
            v = v.astype(np.int64)
            if index is None:
                index, depth = base[:, None] + v, z
                above = np.ones(v.shape, bool)
            else:
                index[columns] = np.where(above, base[:, None] + v, index[columns])
            top = tops[robot, face]
            above &= v >= BELOW + top[:, None]
            inverse = np.where(tops[robot] > top[:, None], inverse, np.float32(0))
            more = np.flatnonzero(inverse.max(1) > 0)
            columns = more if isinstance(columns, slice) else columns[more]
            inverse, above, robot, ray = inverse[more], above[more], robot[more], ray[more]
        return index, depth

    def _visible_faces(self, room, eye, c, s):
        """The faces that each camera may see, in its own frame (forward, left).

        Returns outward normals (R, K, 2) as long as the face, first ends (R, K, 2), the rays
        through both ends (R, K, 2), tops [texel] (R, K) and lit textures (R, K).
        """
        offset = self._corners[room] - eye[:, None, None]  # (R, B, 4, 2)
        rotation = np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)  # (R, 2, 2)
        p = offset @ rotation[:, None]
        q = p[:, :, (1, 2, 3, 0)]
        normal = np.stack([q[..., 1] - p[..., 1], p[..., 0] - q[..., 0]], -1)
        # An end behind the camera is out of view on its side; from outside, p is left and q right.
        ahead = p[..., 0] > NEAR / 2
        slope = p[..., 1] / np.where(ahead, p[..., 0], 1)
        left = np.where(ahead, slope, np.inf)
        right = np.where(ahead, slope, -np.inf)[:, :, (1, 2, 3, 0)]
        visible = ((normal * p).sum(-1) < -1e-6) & (ahead | ahead[:, :, (1, 2, 3, 0)])
        visible &= (left >= RAY[-1]) & (right <= RAY[0])
        visible = visible.reshape(len(room), -1)
        order = np.argsort(~visible, axis=1, kind="stable")[:, :max(1, visible.sum(1).max())]

        def pick(faces):  # (R, B, 4, ...) -> (R, K, ...), each robot's visible faces first
            faces = faces.reshape(len(room), -1, *faces.shape[3:])
            return faces[np.arange(len(room))[:, None], order]
        normal, p, span = pick(normal), pick(p), pick(np.stack([left, right], -1))
        hidden = ~pick(visible.reshape(left.shape))
        span[hidden] = (-np.inf, np.inf)  # no ray is between these, and
        normal[hidden], p[hidden] = (1, 0), (-1, 0)  # no division by zero comes from those
        return normal, p, span, pick(self._tops[room]), pick(self._lit[room])

    def _paint_cube(self, index, depth, offset, c, s):
        """Paints the target cubes, (R, 2) `offset` from the cameras, over `index` in place."""
        # Slabs: each axis-aligned pair of faces bounds the ray's parameter, which is the depth.
        way = np.stack([c[:, None] - s[:, None] * RAY, s[:, None] + c[:, None] * RAY], -1)
        way = np.where(np.abs(way) < 1e-6, np.float32(1e-6), way)  # (R, W, 2)
        half = np.float32(CUBE_SIZE / 2) * np.sign(way)
        enter = (offset[:, None] - half) / way
        leave = ((offset[:, None] + half) / way).min(-1).ravel()
        side = enter.argmax(-1).ravel()
        enter = enter.max(-1).ravel()
        columns = np.flatnonzero((enter < np.minimum(leave, depth)) & (leave > NEAR))
        if not len(columns):
            return
        near = np.maximum(enter[columns], np.float32(NEAR))[:, None]
        far = np.minimum(leave, depth)[columns][:, None]
        away = way.reshape(-1, 2)[columns, side[columns]] < 0  # the ray runs down this axis
        face = self._cube[1 + 2 * side[columns] + np.where(away, 0, 1)][:, None]
        lid = np.float32(CAMERA_HEIGHT - CUBE_SIZE)  # the top face is this far below the camera
        on_top = (DROP * far >= lid) & (DROP * near < lid)
        on_side = (DROP * near >= lid) & (DROP * near < np.float32(CAMERA_HEIGHT))
        index[columns] = np.where(on_top, self._cube[0],
                                  np.where(on_side, face, index[columns]))


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
