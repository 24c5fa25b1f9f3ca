"""The finished runs for slow laptops are those on the class page."""

import json
from pathlib import Path

import pytest

from evaluation.__main__ import main

RUNS = Path(__file__).parent / "runs"


@pytest.mark.parametrize("name, changed", [
    ("one", {"random_starts": 0.0, "mirrored": 0.0}), ("anywhere", {}),
    ("none", {"memory": "none"})])
def test_each_was_made_by_its_command_on_the_class_page(name, changed):
    config, summary, evaluation = [json.loads((RUNS / name / f"{stem}.json").read_text())
                                   for stem in ("config", "summary", "evaluation")]
    lesson = {"random_starts": 0.7, "mirrored": 0.5, "memory": "stacked", "steps": 250_000,
              "seed": 0, "workers": 1, "fixed_budget": True}
    assert {key: config[key] for key in lesson} == lesson | changed
    assert summary["steps"] >= 250_000 and summary["frozen"] == evaluation
    assert (RUNS / name / "curves.png").exists()
    assert (RUNS / name / "floor-validation.png").exists() == (name != "none")


def test_the_run_with_weights_reproduces_its_evaluation(tmp_path, capsys):
    run = tmp_path / "one"
    run.mkdir()
    for file in ("config.json", "model.safetensors"):
        (run / file).write_bytes((RUNS / "one" / file).read_bytes())
    main([str(run), "--episodes", "20", "--workers", "1", "--json"])
    result = json.loads(capsys.readouterr().out)
    assert result["training"]["success"] == 1 and result["new"]["success"] == 0
