"""The camera: a numpy raycaster that paints the robots' images.

The world is 2.5-D: upright boxes on a flat floor, all higher than the camera, and one low target
cube. An image is painted column by column: the ray of a column hits a face in the plane, and the
face fills the rows between its foot and its top. docs/code.md shows the derivations.

The camera looks along its x axis; y points left. The ray of a column goes through the points
(z, s z), where z is the depth [m] and s is the slope of the column's ray (`SLOPE`).

Points of the plane are complex numbers, x + iy [m]: multiplying by exp(i angle) rotates them. Axis
letters: R robots, B boxes, F visible faces, K faces in one image, W = 64 columns, H = 48 rows,
C columns of several images.
"""

from dataclasses import dataclass

import numpy as np

from sim import CAMERA_HEIGHT
from support.textures import BLUE, FLOOR, PERIOD, SKY, TEXEL, light, texture

H, W = 48, 64  # [px] paper III-C
FOCAL = W / 2 / np.tan(np.radians(60) / 2)  # [px] 60 degrees wide, square pixels, released model
CAMERA_OFFSET = -0.118  # [m] ahead of the robot's centre (so behind it), released model
NEAR = 0.05  # [m] near limit of sight, released model
FAR = 8.0  # [m] far limit of sight, released model
CUBE_SIZE = 0.2  # [m] edge of the target cube, released model
BLOCK = 64  # images painted together, few enough to stay in the cache

# A texture column holds all that one column of the camera can show of a wall: floor below the foot,
# the wall, sky above the top. It covers the rise and fall of the steepest ray up to FAR, so lookups
# need no clipping: 127.3 texels below the foot and 149.8 above, rounded up to multiples of 32.
EYE = CAMERA_HEIGHT / TEXEL  # [texel] camera height
STEEPEST = FAR * H / 2 / FOCAL / TEXEL  # [texel] largest rise or fall of a ray up to FAR
BELOW = 32 * int(np.ceil((STEEPEST - EYE) / 32))
ABOVE = 32 * int(np.ceil((STEEPEST + EYE) / 32))
COLUMN = BELOW + ABOVE

SLOPE = ((W / 2 - 0.5 - np.arange(W)) / FOCAL).astype(np.float32)  # (W,) y / z of a column's ray
DROP = ((np.arange(H) + 0.5 - H / 2) / FOCAL).astype(np.float32)  # (H,) fall of a row's ray per m
EYE_TEXEL = np.float32(BELOW + EYE)  # the camera's height in a texture column


def slab(offset, direction):
    """Returns the depths [m] at which a ray enters and leaves the slab between two opposite faces
    of the cube. offset: from the eye to the cube's centre [m]. direction: per metre of depth."""
    half = np.float32(CUBE_SIZE / 2) * np.sign(direction)
    return (offset - half) / direction, (offset + half) / direction


@dataclass
class Faces:
    """The faces of boxes visible to several cameras, arrays (F,).

    A ray of slope s hits a face at inverse depth 1/z = a + b s, linear in s. Likewise,
    u/z = e + f s, with the position u of the hit along the face [texel].
    """
    a: np.ndarray  # [1/m]
    b: np.ndarray  # [1/m]
    e: np.ndarray  # [texel/m]
    f: np.ndarray  # [texel/m]
    texture: np.ndarray  # index in the palette of the face's texture
    top: np.ndarray  # [m] height of the box


class Camera:
    """Paints images of the given scenes. No pose raises an error.

    All colours are in one flat palette: for each combination of material, height and brightness,
    PERIOD texture columns of COLUMN texels (floor, wall and sky, from below); then a texture with
    only floor and sky; then the colours of the cube's faces. A pixel is a palette index.

    A subclass can change the appearance: `floor`, `sky`, `light` and `texture`.
    """

    floor = FLOOR
    sky = SKY
    light = staticmethod(light)

    def texture(self, material):
        """Returns the colours (PERIOD, ABOVE, 3) of a material, see `support.textures`."""
        return texture(material, ABOVE)

    def __init__(self, scenes):
        """scenes: a list of Scenes; `render` takes indices. Heights are rounded to texels."""
        shape = (len(scenes), 0, 4)  # scenes, boxes, faces of a box
        self._corners = np.zeros(shape, np.complex64)
        self._tops = np.zeros(shape, np.float32)
        self._texture = np.zeros(shape, np.int64)  # index in the palette of a face's texture
        self._textures = {}  # (material, height [texel], rounded brightness) -> number
        for i, scene in enumerate(scenes):
            self.set_scene(i, scene)

    def set_scene(self, i, scene):
        """Replaces scene number i by another Scene."""
        missing = max(len(scene.boxes) - self._tops.shape[1], 0)
        self._corners, self._tops, self._texture = [
            np.pad(array, ((0, 0), (0, missing), (0, 0)))
            for array in (self._corners, self._tops, self._texture)]
        self._corners[i] = 0  # boxes of size 0 fill up the array: their faces are never visible
        known = len(self._textures)
        for b, box in enumerate(scene.boxes):
            self._corners[i, b] = box.corners @ (1, 1j)
            # A box is higher than the camera. Rounding must keep it so.
            top = min(max(round(box.height / TEXEL), int(np.ceil(EYE))), ABOVE)
            self._tops[i, b] = top * TEXEL
            for face in range(4):
                normal = box.yaw + (face + 1) * np.pi / 2
                brightness = self.light((np.cos(normal), np.sin(normal), 0)).round(1)
                key = (box.material, top, float(brightness))
                number = self._textures.setdefault(key, len(self._textures))
                self._texture[i, b, face] = number * PERIOD * COLUMN
        self._highest = self._tops.max()
        if len(self._textures) > known:
            self._palette = None  # `render` makes it

    def _make_palette(self, textures):
        """Returns the palette, a flat array of 32-bit colours."""
        colours = np.empty((len(textures) + 1, PERIOD, COLUMN, 3))
        colours[:, :, :BELOW] = self.floor
        colours[:, :, BELOW:] = self.sky
        for (material, top, brightness), number in textures.items():
            colours[number, :, BELOW:BELOW + top] = self.texture(material)[:, :top] * brightness
        self._no_wall = len(textures) * PERIOD * COLUMN  # the texture of only floor and sky
        normals = ((0, 0, 1), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0))
        cube = np.array([np.multiply(BLUE, self.light(normal)) for normal in normals])
        self._cube = colours.size // 3 + np.arange(5)  # top, then faces to +x, -x, +y, -y
        flat = np.concatenate([colours.reshape(-1, 3), cube])
        packed = np.zeros((len(flat), 4), np.uint8)
        packed[:, :3] = flat.clip(0, 255).round()
        return packed.view(np.uint32)[:, 0]

    def render(self, scene_of, poses, targets):
        """Returns images (R, H, W, 3) uint8 RGB from poses (R, 3) in scenes (R,), given by index,
        with target cubes at (R, 2) [m]."""
        if self._palette is None:
            self._palette = self._make_palette(self._textures)
        images = np.empty((len(poses), H, W, 3), np.uint8)
        for k in range(0, len(poses), BLOCK):
            block = slice(k, k + BLOCK)
            self._paint(images[block], scene_of[block], poses[block], targets[block])
        return images

    def _paint(self, images, scene_of, poses, targets):
        heading = np.exp(1j * poses[:, 2]).astype(np.complex64)
        eye = (poses[:, 0] + 1j * poses[:, 1]).astype(np.complex64) + CAMERA_OFFSET * heading
        faces, robot, left, right = self._visible_faces(scene_of, eye, heading)
        inverse, face_in = self._sort_by_image(faces, robot, left, right, len(poses))
        index, depth, nearest = self._paint_nearest(faces, inverse, face_in)
        self._paint_above(index, faces, inverse, face_in, depth, nearest)
        offset = (targets[:, 0] + 1j * targets[:, 1] - eye).astype(np.complex64)
        self._paint_cube(index, depth, offset, heading)
        # All indices are valid. Mode 'wrap' of `take` is faster than the default, which checks.
        packed = self._palette.take(index, mode="wrap").view(np.uint8).reshape(-1, H, W, 4)
        for channel in range(3):
            images[..., channel] = packed[..., channel]

    def _visible_faces(self, scene_of, eye, heading):
        """Returns the Faces (F,) that the cameras may see; face 0 is the background (floor, sky) at
        FAR. For the others also returns the robot and the slopes of both ends."""
        # Corners in the camera's axes. A face extends from corner p to corner q.
        p = (self._corners[scene_of] - eye[:, None, None]) * heading.conj()[:, None, None]
        q = p[:, :, (1, 2, 3, 0)]  # (R, B, 4)
        cross = (p.conj() * q).imag  # negative if the outside is visible; then p is left, q right
        ahead = p.real > NEAR / 2
        slope = p.imag / np.where(ahead, p.real, 1)
        # A corner behind the camera is out of view on its side of the image.
        left = np.where(ahead, slope, np.inf)
        right = np.where(ahead, slope, -np.inf)[:, :, (1, 2, 3, 0)]
        visible = (cross < -1e-6) & (ahead | ahead[:, :, (1, 2, 3, 0)])
        visible &= (left >= SLOPE[-1]) & (right <= SLOPE[0])
        robot, box, side = np.nonzero(visible)
        p = p[robot, box, side]
        cross = cross[robot, box, side]
        along = q[robot, box, side] - p
        # (z, s z) lies on the line through p and q where z (along_y - s along_x) = cross.
        a = along.imag / cross
        b = -along.real / cross
        # `along` becomes the unit vector along the face, divided by the size of a texel. Then
        # u = along . (z, s z) - start.
        along /= TEXEL * np.abs(along)
        start = (along.conj() * p).real  # along . p
        scene = scene_of[robot]
        faces = Faces(a=np.append(np.float32(1 / FAR), a),
                      b=np.append(np.float32(0), b),
                      e=np.append(np.float32(0), along.real - start * a),
                      f=np.append(np.float32(0), along.imag - start * b),
                      texture=np.append(self._no_wall, self._texture[scene, box, side]),
                      top=np.append(np.float32(np.inf), self._tops[scene, box, side]))
        return faces, robot, left[robot, box, side], right[robot, box, side]

    def _sort_by_image(self, faces, robot, left, right, R):
        """Returns `inverse` (R * W, K), the inverse depth of each image's K faces in each column, 0
        if the ray misses the face; and `face_in` (R, K), the indices of these faces."""
        a = faces.a[1:, None]
        b = faces.b[1:, None]
        # A face includes both of its ends, so adjacent faces leave no gap.
        seen = (SLOPE <= left[:, None]) & (SLOPE >= right[:, None])
        count = np.bincount(robot, minlength=R)  # faces in each image
        first = np.cumsum(count) - count
        place = np.arange(len(robot)) - first[robot] + 1  # number of a face within its image
        inverse = np.zeros((R, W, count.max() + 1), np.float32)
        inverse[:, :, 0] = 1 / FAR
        inverse[robot, :, place] = (a + b * SLOPE) * seen
        face_in = np.zeros((R, inverse.shape[2]), np.int64)
        face_in[robot, place] = np.arange(len(robot)) + 1
        return inverse.reshape(R * W, -1), face_in

    def _meet(self, faces, face, column):
        """Returns the depths [m] at which the rays of columns (C,) hit the faces (C,), and the
        palette indices of the texture columns that they hit."""
        slope = SLOPE[column]
        z = 1 / (faces.a[face] + faces.b[face] * slope)
        u = ((faces.e[face] + faces.f[face] * slope) * z).astype(np.int64) % PERIOD
        return z, faces.texture[face] + u * COLUMN

    def _paint_nearest(self, faces, inverse, face_in):
        """Paints the nearest face in each column, the first phase. Returns the palette index of
        each pixel (R, H, W), and the depth [m] and the face of each column (R, W)."""
        R = len(face_in)
        robot, column = np.divmod(np.arange(R * W), W)
        face = face_in[robot, inverse.argmax(1)]
        z, base = self._meet(faces, face, column)
        # The ray of a row falls by DROP per metre: at depth z it is z DROP below the camera.
        texel = EYE_TEXEL - DROP[:, None] * (z / TEXEL).reshape(R, 1, W)
        index = texel.astype(np.int64)
        index += base.reshape(R, 1, W)
        return index, z.reshape(R, W), face.reshape(R, W)

    def _paint_above(self, index, faces, inverse, face_in, depth, face):
        """Paints faces above the nearest, the second phase: above a face's top the nearest
        higher face is visible, above that one the next higher, and so on. Changes the rows of
        `index` above the horizon. Each iteration handles the columns (C,) with a higher face."""
        rows = np.arange(H // 2)[:, None]  # rows above the horizon
        pixels = index.reshape(-1)
        column = np.arange(depth.size)  # columns of all images that are not finished
        z = depth.ravel()
        top = faces.top[face.ravel()]
        skyline = np.float32(0)  # drop of the ray over the painted faces; negative is upwards
        while True:
            skyline = np.minimum(skyline, (CAMERA_HEIGHT - top) / z)
            low = np.flatnonzero(top < self._highest)
            higher = faces.top[face_in[column[low] // W]] > top[low, None]
            inverse = np.where(higher, inverse[low], np.float32(0))
            place = inverse.argmax(1)
            shown = np.flatnonzero(place)  # place 0 is the background: sky, already painted
            if not len(shown):
                return
            inverse = inverse[shown]
            column = column[low[shown]]
            skyline = skyline[low[shown]]
            robot, x = np.divmod(column, W)
            face = face_in[robot, place[shown]]
            top = faces.top[face]
            z, base = self._meet(faces, face, x)
            texel = EYE_TEXEL - DROP[rows] * (z / TEXEL)  # (H // 2, C)
            colour = base + texel.astype(np.int64)
            over = DROP[rows] <= skyline
            pixels[(robot * H * W + rows * W + x)[over]] = colour[over]

    def _paint_cube(self, index, depth, offset, heading):
        """Paints the target cubes over `index` in place. offset: (R,) from the cameras.

        Slab method: a ray is inside the cube while it is between both pairs of opposite faces.
        """
        ahead = offset * heading.conj()
        robots = np.flatnonzero(np.abs(ahead.imag) < SLOPE[0] * ahead.real + CUBE_SIZE)
        along = heading[robots, None] * (1 + 1j * SLOPE)  # (R, W) rays, per metre of depth
        tiny = np.float32(1e-6)
        x = np.where(np.abs(along.real) < tiny, tiny, along.real)
        y = np.where(np.abs(along.imag) < tiny, tiny, along.imag)
        enter_x, leave_x = slab(offset[robots, None].real, x)
        enter_y, leave_y = slab(offset[robots, None].imag, y)
        enter = np.maximum(enter_x, enter_y)
        leave = np.minimum(np.minimum(leave_x, leave_y), depth[robots])  # a wall may be nearer
        robot, column = np.nonzero((enter < leave) & (leave > NEAR))
        near = np.maximum(enter[robot, column], np.float32(NEAR))[:, None]
        far = leave[robot, column][:, None]
        side = np.where(enter_x > enter_y, np.where(x < 0, 1, 2), np.where(y < 0, 3, 4))
        to_top = np.float32(CAMERA_HEIGHT - CUBE_SIZE)  # [m] drop from the eye to the top face
        on_top = (DROP * far >= to_top) & (DROP * near < to_top)
        on_side = (DROP * near >= to_top) & (DROP * near < np.float32(CAMERA_HEIGHT))
        colour = np.where(on_top, 0, side[robot, column][:, None])
        index[robots[robot], :, column] = np.where(  # (columns with a cube, H)
            on_top | on_side, self._cube[colour], index[robots[robot], :, column])
