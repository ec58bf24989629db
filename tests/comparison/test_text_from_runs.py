"""Names and values of runs are data: nothing computes, resolves or interprets them."""

import csv
import html
import io
import json
import re
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_up_runs import make
from omegaconf import OmegaConf

from gctd3.comparison.tables import DIRECTORY, Table
from gctd3.errors import RunError
from gctd3.runs.evaluate import trace
from gctd3.training.saved_configuration import (
    CONFIG,
    OVERRIDES,
    as_data,
    changed,
    command_line,
    flat,
    load_config,
    save_config,
)

HOSTILE = ["=1+1", "+1+1", "-1+1", "@SUM(1)", "\t=1", '=HYPERLINK("x")', "<b>bold</b>", "${oc.env:HOME}", r"$\bad{$"]


def read(table):
    return list(csv.reader(io.StringIO(table.csv(), newline="")))


@pytest.mark.parametrize("text", HOSTILE)
def test_a_text_is_no_formula_in_a_csv_file(text):
    table = Table("t", "", "", ("", "return", DIRECTORY, text), [[text, "1.0", text, text]])
    head, row = read(table)
    for cell in (head[3], row[0], row[2], row[3]):
        assert cell.removeprefix("'") == text and not cell.startswith(("=", "+", "-", "@", "\t", "\r"))


@pytest.mark.parametrize(
    "shown, stored",
    [
        ("2,992", "2992"),
        ("1,234,567.5", "1234567.5"),
        ("-0.0114", "-0.0114"),
        ("1e-05", "1e-05"),
        ("-1,000", "-1000"),
        ("-", ""),
        ("", ""),
        ("1,000.5 (900.0 to 1,100.0)", "1,000.5 (900.0 to 1,100.0)"),
        ("- 1", "'- 1"),
    ],
)
def test_a_number_is_a_number_in_a_csv_file(shown, stored):
    (row,) = read(Table("t", "", "", ("", "frames"), [["a", shown]]))[1:]
    assert row == ["a", stored]


def test_a_name_that_looks_like_a_number_keeps_its_letters():
    assert read(Table("t", "", "", ("", DIRECTORY), [["1,000", "2,992"]]))[1] == ["1,000", "2,992"]


def test_names_of_joints_with_commas_and_quotes_keep_the_columns_of_a_trace():
    joint, foot, steps = SimpleNamespace(name='hip, "left"'), "foot, left", 3
    still, column = np.zeros(steps), np.zeros((steps, 1))
    motion = SimpleNamespace(velocity=still, angles=column, velocities=column)
    episode = SimpleNamespace(motion=motion, position=still, height=still, feet_down=column)
    robot = SimpleNamespace(joints=[joint], feet=[foot])
    head, *rows = csv.reader(io.StringIO(trace(episode, robot, 0.02)))
    assert head[-3:] == ['angle_hip, "left"_rad', 'velocity_hip, "left"_rad_s', "down_foot, left"]
    assert [len(row) for row in rows] == [7] * steps and float(rows[1][0]) == 0.04


def test_names_in_figures_are_no_formulas(tmp_path):
    pytest.importorskip("rliable")
    from gctd3.comparison.figures import Gallery
    from gctd3.viz.plot_style import legend, new

    figure, axes = new()
    axes[0, 0].plot([0, 1], label=r"$\bad{$ $x^2$ <b>")
    axes[0, 0].set(xlabel="$y$")
    legend(axes[0, 0])
    picture = Gallery(tmp_path).add(figure, "f", "<b>", "")
    drawn = re.sub(r"<!-- .*? -->", "", picture.body)
    assert "<b>" not in drawn and (tmp_path / "f.png").is_file()
    # matplotlib notes each text as a comment; a formula would have lost its marks.
    assert r"$\bad{$ $x^2$" in picture.body and "$y$" in picture.body


@pytest.mark.nightly
def test_a_report_shows_names_as_they_are(tmp_path):
    pytest.importorskip("rliable")
    from gctd3.comparison.report import report
    from gctd3.comparison.settings import ReportSettings

    algorithms = ["=1+1", r"$\bad{$", "<b>x</b>", "${oc.env:HOME}"]
    for number, algorithm in enumerate(algorithms):
        for seed in range(2):
            name = f"={number}" + "${oc.env:HOME}" + f"<i>{seed}"
            make(tmp_path / "runs", name, overrides=[f"algo={algorithm}"], change={"algo.tau": 0.01 * number})
    out = tmp_path / "out"
    report(ReportSettings(str(tmp_path / "runs"), str(out), episodes=10))
    text = (out / "index.html").read_text(encoding="utf-8")
    assert "<b>x" not in text and "<i>" not in text
    for algorithm in algorithms:
        assert html.escape(algorithm) in text.replace("<wbr>", "")
    with (out / "tables" / "runs.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row[""].removeprefix("'") for row in rows} == set(algorithms)
    assert all(row[DIRECTORY].startswith("'=") and "${oc.env:HOME}" in row[DIRECTORY] for row in rows)
    assert {row["frames"] for row in rows} == {"2000"} and {float(row["return"]) for row in rows} == {500.0}
    for file in (out / "tables").glob("*.csv"):
        with file.open(encoding="utf-8", newline="") as opened:
            cells = [cell for row in csv.reader(opened) for cell in row]
        assert not [cell for cell in cells if cell.startswith(("=", "+", "@"))], file.name


# Nothing of a run's configuration is resolved.

SECRET = "GCTD3_TEST_SECRET"


@settings(max_examples=40)
@given(st.text(alphabet="\\${}a:'\" .", max_size=12), st.sampled_from(["", "${", "${oc.env:HOME}", "${a}"]))
def test_any_text_is_kept(text, more):
    for value in (text + more, more + text):
        config = OmegaConf.create({"key": as_data(value), "list": as_data([value])})
        assert config.key == value and OmegaConf.to_container(config, resolve=True)["list"] == [value]


@pytest.mark.parametrize("text", [f"${{oc.env:{SECRET}}}", "${seed}", "${no.such}", "a${b}c", r"\${seed}"])
def test_a_configuration_of_a_run_is_not_resolved(tmp_path, monkeypatch, text):
    monkeypatch.setenv(SECRET, "secret")
    (tmp_path / ".hydra").mkdir()
    (tmp_path / CONFIG).write_text(json.dumps({"seed": 3, "robot": {"name": text, "feet": [text]}}), encoding="utf-8")
    config = load_config(tmp_path)
    assert flat(config) == {"seed": 3, "robot.name": text, "robot.feet": [text]}
    # It is the same when it is written again, as by a run that is continued.
    save_config(tmp_path / "again", config, [f"robot={text}"])
    assert flat(load_config(tmp_path / "again")) == flat(config)
    assert command_line(tmp_path / "again") == [f"robot={text}"]
    assert "secret" not in (tmp_path / "again" / CONFIG).read_text(encoding="utf-8")


def test_a_first_command_line_reads_no_environment(finished, tmp_path, monkeypatch, capsys):
    from hydra import initialize_config_module

    monkeypatch.setenv(SECRET, "secret")
    run = finished.copy("gctd3", tmp_path / "run")
    items = [*command_line(run), f"robot.name=${{oc.env:{SECRET}}}"]
    (run / OVERRIDES).write_text(json.dumps(items), encoding="utf-8")
    with initialize_config_module("gctd3.conf", version_base="1.3"), pytest.raises(RunError) as error:
        changed(run, "config", ["seed=5", "robot.name=other"])
    assert "secret" not in str(error.value) and "${oc.env:" in str(error.value)
    monkeypatch.setenv("HOME", "here")
    assert OmegaConf.create({"a": "${oc.env:HOME}"}).a == "here"
