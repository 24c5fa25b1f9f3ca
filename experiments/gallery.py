"""The folder pictures/, into which three programs draw."""

from experiments.runs import ROOT
from support.command_line import CommandLine

PICTURES = ROOT / "pictures"


def read_command_line(description, argv):
    """The command line of such a program, which has no options."""
    parser = CommandLine(description)
    parser.parse(argv)
    parser.must_write_to(PICTURES)


def save(figures, dpi):
    """Writes figures, pairs of a name and a Figure, and says so. dpi: dots per inch."""
    for name, figure in figures:
        path = PICTURES / f"{name}.png"
        figure.savefig(path, dpi=dpi)
        print(path.relative_to(ROOT), flush=True)
