"""The published numbers: a list of runs and its runner, tables, figures, diagrams, benchmark."""

import sys
from importlib.util import find_spec

if not find_spec("pandas"):
    print("error: pandas is missing: pip install -r experiments/requirements.txt", file=sys.stderr)
    sys.exit(2)
