"""Draws a room from above and through the robot's camera, or reports what is wrong with it:
`python -m scenes env1` writes env1-room.png in the current folder."""

import numpy as np
from matplotlib.figure import Figure

from render import Camera
from scenes import load
from scenes.generate import share_blocked
from scenes.places import are_clear
from sim import CELL, SceneError
from support.cli import option, parse
from support.pictures import draw_map, draw_robot, draw_target


def facts(scene):
    """Returns one line about a Scene. `reachable` is a fraction of the floor without boxes."""
    centres = [np.arange(low + CELL / 2, high, CELL) for low, high in zip(*scene.bounds)]
    grid = np.stack(np.meshgrid(*centres, indexing="ij"), -1).reshape(-1, 2)
    floor = are_clear(scene, grid, 0)
    length, width = np.ptp(scene.bounds, axis=0)
    return (f"{length:.2f} m x {width:.2f} m, boxes: {len(scene.boxes)}, "
            f"training targets: {len(scene.training_targets)}, "
            f"new targets: {len(scene.new_targets)}, "
            f"reachable: {len(scene.reachable) / floor.sum():.0%} of the floor, "
            f"blocked: {share_blocked(scene):.0%} of the straight lines")


def draw(scene):
    """Returns a Figure of the room and of the camera image at the start, with a circled target."""
    figure = Figure(figsize=(11, 5), layout="constrained")
    above, camera = figure.subplots(1, 2, width_ratios=(3, 2))
    target = scene.training_targets[0]
    draw_map(above, scene)
    draw_target(above, scene, target, ring=True)
    for start in (scene.start, *scene.other_starts):
        draw_robot(above, start)
    above.set_title(f"{scene.name}: training targets blue, new targets green", parse_math=False)
    images = Camera([scene]).render(np.array([0]), np.array([scene.start]), np.array([target]))
    camera.imshow(images[0])
    camera.set_title("camera image at the start")
    camera.axis("off")
    return figure


def main(argv=None):
    """Runs the command line: draws the room and prints facts about it."""
    room = option("env1", "room name or file, or random:7", positional=True)
    options, parser = parse({"scene": room}, "Draw a room or report what is wrong with it.", argv)
    try:
        scene = load(options.scene)
        file = f"{scene.name}-room.png"  # a map may be map.yaml with map.png
        draw(scene).savefig(file, dpi=110, bbox_inches="tight")
    except (SceneError, OSError) as error:
        parser.error(error)
    print(file, facts(scene), sep="\n")


if __name__ == "__main__":
    main()
