"""The tour runs from top to bottom and contains its outputs."""

from pathlib import Path

import pytest

nbformat = pytest.importorskip("nbformat", reason="pip install -r classroom/requirements.txt")
nbclient = pytest.importorskip("nbclient", reason="pip install -r classroom/requirements.txt")
TOUR = Path(__file__).parent / "tour.ipynb"


def test_the_tour_runs_from_top_to_bottom():
    tour = nbformat.read(TOUR, 4)
    where = {"metadata": {"path": str(TOUR.parent)}}  # as an editor starts it
    nbclient.NotebookClient(tour, timeout=1200, resources=where).execute()  # raises if a cell fails


def test_its_outputs_are_saved():
    cells = [cell for cell in nbformat.read(TOUR, 4).cells if cell.cell_type == "code"]
    assert all(cell.outputs for cell in cells[1:])  # the first one only imports
