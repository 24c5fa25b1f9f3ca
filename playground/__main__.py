"""Opens a page to play with: `python -m playground`. docs/class.md has a lesson of ten minutes."""

import threading
import webbrowser

import torch

import scenes
from playground.choices import drivers
from playground.server import Server
from playground.session import Session
from sim import SceneError
from support.cli import option, parse
from support.runs import RunError

OPTIONS = {
    "room": option("env1", "a room: its name, a file (.toml, .world, .yaml) or random:7"),
    "driver": option("pretrained/env1", "a policy, a planner, or `you`"),
    "port": option(8765, "port on this machine; 0: any free one", 0, 65535),
    "no_browser": option(False, "only print the address")}


def main(argv=None):
    """Runs the command line."""
    options, parser = parse(OPTIONS, "Open a page with a robot to play with.", argv)
    torch.set_num_threads(1)
    try:
        session = Session(options.room, options.driver)
        server = Server(session, options.port,
                        lambda: {"rooms": scenes.names(), "drivers": drivers()})
    except (SceneError, RunError) as error:
        parser.error(error)
    try:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        print(f"{server.address}\nCtrl-C ends it", flush=True)
        if not options.no_browser:
            webbrowser.open(server.address)
        session.run()
    except KeyboardInterrupt:
        print("\nended")


if __name__ == "__main__":
    main()
