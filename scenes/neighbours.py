"""Whether Python finds this project's modules: a file of one's own may have the name of one of them
and be found first, a `render.py` in the folder that one works in, say.

It stands in this folder because `scenes` is the first of ours that any program imports.
"""

import importlib.util
import sys
from pathlib import Path

PROJECT = Path(__file__).resolve().parent.parent
OURS = ("sim", "render", "model", "ppo", "navbot_min", "support", "evaluation")


def strangers():
    """The modules that Python would import, or has imported, under the names of ours from
    somewhere else: name -> where from."""
    found = {}
    for name in OURS:
        module = sys.modules.get(name)
        spec = importlib.util.find_spec(name) if module is None else module.__spec__
        origin = spec and spec.origin
        if origin and Path(origin).parent.resolve() not in (PROJECT, PROJECT / name):
            found[name] = origin
    return found


def check():
    """Raises ImportError, one sentence, where a module of ours is hidden by another one; ends the
    program where it was begun by `python -m`."""
    for name, origin in strangers().items():
        message = f"'{origin}' hides this project's {name}: rename it, or begin in another folder"
        if sys.argv[0] == "-m":  # as long as Python looks for the program
            print(f"error: {message}", file=sys.stderr)
            sys.exit(2)
        raise ImportError(message)


check()
