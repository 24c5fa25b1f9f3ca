"""The finished runs for weak laptops are small, and show what the questions ask for."""

import json
from pathlib import Path

import pytest

from evaluation.__main__ import main

RUNS = Path(__file__).parent / "runs"


def test_they_are_under_five_megabytes_in_all():
    assert sum(file.stat().st_size for file in RUNS.rglob("*") if file.is_file()) < 5_000_000


@pytest.mark.parametrize("name, changed", [
    ("one", {"random_starts": 0.0, "mirrored": 0.0}), ("anywhere", {}),
    ("none", {"memory": "none"})])
def test_each_is_the_run_of_its_command_in_the_class_page(name, changed):
    config = json.loads((RUNS / name / "config.json").read_text())
    lesson = {"random_starts": 0.7, "mirrored": 0.5, "memory": "stacked", "steps": 250_000,
              "seed": 0, "workers": 1, "fixed_budget": True}
    assert {key: config[key] for key in lesson} == lesson | changed
    summary = json.loads((RUNS / name / "summary.json").read_text())
    assert summary["steps"] >= 250_000
    assert summary["frozen"] == json.loads((RUNS / name / "evaluation.json").read_text())
    assert (RUNS / name / "curves.png").exists()
    assert (RUNS / name / "floor-validation.png").exists() == (name != "none")


def test_the_one_with_weights_does_what_its_numbers_say(tmp_path, capsys):
    run = tmp_path / "one"
    run.mkdir()
    for file in ("config.json", "model.pt"):
        (run / file).write_bytes((RUNS / "one" / file).read_bytes())
    main([str(run), "--episodes", "20", "--workers", "1", "--json"])
    result = json.loads(capsys.readouterr().out)
    assert result["training"]["success"] == 1 and result["new"]["success"] == 0
