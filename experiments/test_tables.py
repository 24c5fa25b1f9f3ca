"""Tests of the tables of the pages."""

import numpy as np
import pandas as pd
import pytest

from experiments import tables


@pytest.fixture
def results(tmp_path, monkeypatch):
    """An empty folder that replaces results/."""
    monkeypatch.setattr(tables, "RESULTS", tmp_path)
    return tmp_path


@pytest.mark.parametrize("page", tables.pages(), ids=lambda page: page.name)
def test_the_tables_of_a_page_are_up_to_date(page):
    text = page.read_text(encoding="utf-8")
    blank = tables.MARKED.sub(r"\1\3", text)
    assert tables.fill(blank) == text, f"{page.name} is old: run python -m experiments.tables"
    marked = tables.MARKED.findall(text)
    assert text.count("<!-- table:") == text.count("<!-- end -->") == len(marked)
    for header, name, _ in marked:
        width = header.splitlines()[1].count("|")
        for line in tables.markdown(tables.TABLES[name]()).splitlines():
            assert line.count("|") == width, f"{name}: {line}"


def test_every_table_is_in_a_page():
    names = {name for page in tables.pages()
             for _, name, _ in tables.MARKED.findall(page.read_text(encoding="utf-8"))}
    assert names == set(tables.TABLES)


def test_cells_have_three_digits_and_mark_missing_values():
    assert tables.markdown([[1234.5, 99.96, 0.0012345, 0, np.nan, "white_balance", [0.5, 7]]]) == (
        "| 1,234 | 100 | 0.00123 | 0 | - | white balance | 0.5 / 7 |\n")


def test_a_group_lists_its_seeds_in_order_and_weights_them_equally(results):
    (results / "floor.csv").write_text(
        "# a comment\nenv,way,seed,success\n"
        "env2,varied,1,1\nenv2,varied,0,0\nenv2,varied,0,1\nenv1,varied,0,0.25\n"
        "env2,varied,1,1\nenv2,varied,1,1\nenv2,one-start,0,0\n")
    rows = tables.group_rows("floor.csv", "", "env way", "success")
    assert tables.markdown(rows).splitlines() == [
        "| env1 | varied | 25 |", "| env2 | varied | 50, 100: **75** |",
        "| env2 | one-start | 0 |"]


def test_a_cell_has_the_mean_and_the_worst_of_several_seeds():
    assert tables.mean_and_worst(pd.Series([90.0, 60.0, 100.0, 70.0])) == "80 (60)"
    assert tables.mean_and_worst(pd.Series([8.666])) == "8.67"


def test_the_training_room_of_a_policy_has_no_cell(results):
    header = "env,way,seed,room,targets,success\n"
    (results / "carry-over.csv").write_text(
        header + "env1,varied,0,env2,anywhere,0.5\nenv1,varied,1,env2,anywhere,0.7\n"
        "env1,varied,0,env2,new,0\nenv2,varied,0,env1,anywhere,0.25\n")
    (results / "rooms.csv").write_text(
        header.removeprefix("env,") + "any-room,0,env1,anywhere,0.9\nsingle,0,env1,anywhere,0\n"
        "any-room,0,env2,anywhere,1\n")
    assert tables.markdown(tables.carry_over()).splitlines() == [
        "| env1 | - | 60 (50) |", "| env2 | 25 | - |", "| random rooms | 90 | 100 |"]


def test_only_current_errors_of_the_lab_are_shown_lowest_success_first(results):
    (results / "lab-errors.csv").write_text("weights,error,success\n" + "".join(
        f"{weights},{error},{success}\n" for weights in ("env2", "any-room")
        for error, success in (("none", 1), ("veer", 0.5), ("camera_yaw", 0.9),
                               ("appearance", 0.2))))
    assert tables.markdown(tables.lab_errors()).splitlines() == [
        "| appearance | lab | 20 | 20 |", "| camera yaw | 2 | 90 | 90 |",
        "| none | - | 100 | 100 |"]
