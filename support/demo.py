"""The demo of `python navbot_min.py`: a robot drives by a simple rule, without torch."""

from sim import SceneError
from support.cli import option, parse
from support.pictures import draw_demo, save
from support.traces import TurnToTarget, drive


def main(environment, argv=None):
    """Runs six episodes and draws them in demo.png. environment: the class NavVecEnv."""
    options, parser = parse({"env": option("env1", "room name or file")},
                            "Drive a robot by a rule: turn to the target and go.", argv)
    try:
        traces = drive(TurnToTarget(), environment(1, [options.env]), quota=[6], images=True)
        for k, trace in enumerate(traces):
            print(f"episode {k + 1}: {trace}")
        save(draw_demo(traces[0].scene, traces), "demo.png")
        print("wrote demo.png: the map with the paths, and camera images")
    except (SceneError, OSError) as error:
        parser.error(error)
