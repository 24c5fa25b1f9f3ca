"""Draws a room from above and through the robot's camera, or says what is wrong with it.

    python -m scenes env1          draws a room of this folder to env1.png
    python -m scenes my-room.toml  draws a room of one's own to my-room.png
    python -m scenes env5.world    draws the room of a Gazebo world to env5.png

The picture goes to the working folder. A room that cannot be used is one sentence and exit code 2.
"""

from pathlib import Path

import numpy as np

from scenes import load, remark
from scenes.generate import share_blocked
from sim import CELL, SceneError


def share_reachable(scene):
    """The share of the floor, in [0, 1], that the robot's centre can reach from the start. Floor is
    what lies between the outermost faces of the boxes and in none of them."""
    low, high = scene.bounds
    x = np.arange(low[0] + CELL / 2, high[0], CELL)
    y = np.arange(low[1] + CELL / 2, high[1], CELL)
    cells = np.stack(np.meshgrid(x, y), -1)  # by their centres
    floor = scene.clearance(cells) > 0
    return len(scene.reachable) / floor.sum()


def facts(scene):
    """One line about a room: size, boxes, targets, shares that are reachable and blocked."""
    length, width = np.ptp(scene.bounds, axis=0)
    training = len(scene.training_targets)
    new = len(scene.new_targets)
    return (f"{length:.2f} m x {width:.2f} m, boxes: {len(scene.boxes)}, "
            f"training targets: {training}, new targets: {new}, "
            f"reachable: {share_reachable(scene):.0%} of the floor, "
            f"blocked: {share_blocked(scene):.0%} of the straight ways")


def draw(scene):
    """The room from above, and what the camera sees from the start of an episode to the first
    training target, which has a ring. Returns a Figure."""
    from matplotlib.figure import Figure

    from render import Camera
    from support.pictures import draw_map, draw_robot, draw_target

    figure = Figure(figsize=(11, 5), layout="constrained")
    above, camera = figure.subplots(1, 2, width_ratios=(3, 2))
    target = scene.training_targets[0]
    draw_map(above, scene)
    draw_target(above, scene, target, ring=True)
    for start in (scene.start, *scene.other_starts):
        draw_robot(above, start)
    above.set_title(f"{scene.name}: the robot at its start,\n"
                    "training targets blue, new ones green", fontsize=10, parse_math=False)
    images = Camera([scene]).render(np.array([0]), np.array([scene.start]), np.array([target]))
    camera.imshow(images[0])
    camera.set_title("what its camera sees there,\nin an episode to the target with a ring",
                     fontsize=10)
    camera.axis("off")
    return figure


def main(argv=None):
    """The command line: read, check, draw, print."""
    from support.command_line import CommandLine

    parser = CommandLine("Draw a room, or say what is wrong with it.")
    parser.add_argument("scene", metavar="SCENE", help="a scene's name, or a path to a scene file")
    options = parser.parse(argv)
    parser.must_write_to(".")
    try:
        scene = load(options.scene)
        path = Path(f"{scene.name}.png")
        draw(scene).savefig(path, dpi=110, bbox_inches="tight")
    except (SceneError, OSError) as error:
        parser.error(error)
    print(path)
    print(facts(scene))
    if remark(options.scene):
        print(remark(options.scene))


if __name__ == "__main__":
    main()
