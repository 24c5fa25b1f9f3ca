"""What is said of a long run."""

import json

import pytest

from experiments import long_runs


def test_each_tenth_has_its_own_speed_and_memory():
    slow = [(100 * k, 2.0 * k, 50.0) for k in range(6)]
    fast = [(500 + 100 * k, 10 + k, 60.0 + k) for k in range(1, 6)]
    rows = long_runs.in_tenths(slow + fast)
    assert [row["steps"] for row in rows] == list(range(100, 1001, 100))
    assert [row["steps_per_second"] for row in rows] == [50.0] * 5 + [100.0] * 5
    assert [row["memory_mb"] for row in rows] == [50.0] * 5 + [61.0, 62.0, 63.0, 64.0, 65.0]
    halves = long_runs.in_tenths([(0, 0, 1.0), (15, 1, 2.0), (18, 2, 6.0), (100, 3, 9.0)])
    assert halves[1]["memory_mb"] == 4.0 and halves[1]["highest_mb"] == 6.0
    assert halves[4]["memory_mb"] is None


@pytest.mark.parametrize("content, whole", [
    ("steps,kind\r\n64,new\r\n64,new\r\n128,new\r\n", True),
    ("steps,kind\r\n64,new\r\n128,ne", False), ("steps,kind\r\n64,new\r\n128\r\n", False),
    ("steps,kind\r\n64,new\r\n128,\r\n", False), ("steps,kind\r\n128,new\r\n64,new\r\n", False)])
def test_a_table_is_whole_where_every_row_is_and_steps_never_go_back(content, whole, tmp_path):
    path = tmp_path / "table.csv"
    path.write_bytes(content.encode())
    figures = long_runs.table_figures(path)
    assert figures["whole"] is whole and figures["rows"] == len(content.splitlines()) - 1


def test_of_a_table_that_is_being_written_the_last_whole_line_counts(tmp_path):
    path = tmp_path / "table.csv"
    assert long_runs.steps_so_far(path) == 0
    for content, steps in (("steps,kind\r\n", 0), ("steps,kind\r\n64,new\r\n128", 64)):
        path.write_bytes(content.encode())
        assert long_runs.steps_so_far(path) == steps


def test_the_environments_run_is_written(tmp_path, monkeypatch):
    out = tmp_path / "runs.json"
    monkeypatch.setattr(long_runs, "INTERVAL", 0)
    monkeypatch.setattr(long_runs, "environment_run",
                        lambda steps: {"tenths": long_runs.in_tenths(long_runs.drive(steps))})
    monkeypatch.setattr(long_runs, "training_run", lambda steps: {
        "tenths": [dict(memory_mb=1, steps_per_second=1)] * 2, "tables": {}})
    long_runs.main(["--env-steps", "1000", "--out", str(out)])
    tenths = json.loads(out.read_text())["environment"]["tenths"]
    assert tenths[-1]["steps"] == 992 and all(row["memory_mb"] != 0 for row in tenths)


@pytest.mark.parametrize("arguments, words", [
    (["--env-steps", "10"], "--env-steps is 10, it must be a whole number from 1,000"),
    (["--out", "/no/such/folder/out.json"], "'/no/such/folder/out.json' cannot be written")])
def test_bad_input_is_one_line(arguments, words, capsys):
    with pytest.raises(SystemExit) as stop:
        long_runs.main(arguments)
    printed = capsys.readouterr()
    assert stop.value.code == 2 and printed.out == "" and printed.err.count("\n") == 1
    assert words in printed.err
