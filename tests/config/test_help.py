"""The list of commands and each command's help name every key and choice, and nothing that does not exist."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from configs import composed, items
from hydra import compose, initialize_config_module
from omegaconf import OmegaConf
from thinned import parametrize

from gctd3.__main__ import main, script
from gctd3.config.command_line import CONF
from gctd3.config.help import COMMANDS, choices, help_of, keys, overview, summary
from gctd3.config.reference import reference

ROOTS = {"train": "config"}
FILES = Path(__file__).parents[2] / "conf"
PROJECT = (Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8")


def file(command):
    return FILES / f"{ROOTS.get(command, command)}.yaml"


def test_every_command_is_listed():
    """Every command has a YAML at the root of conf/, a module, a script and a line of the overview."""
    assert {file(command).name for command in COMMANDS} == {path.name for path in FILES.glob("*.yaml")}
    scripts = dict(re.findall(r'^([\w-]+) = "gctd3\.__main__:(\w+)"$', PROJECT, flags=re.M))
    assert scripts == {"gctd3": "main", **{f"gctd3-{command}": "script" for command in COMMANDS}}
    said = overview()
    for command in COMMANDS:
        assert re.search(rf"^  python -m gctd3\.{command} +\w.{{20,90}}$", said, flags=re.M), command
    assert max(map(len, said.splitlines())) <= 120


@pytest.mark.parametrize("command", COMMANDS)
def test_help_is_light(command):
    """Neither simulator, nor learner, nor Hydra is needed to say which keys there are."""
    code = (
        "import runpy, sys\n"
        f"sys.argv = ['gctd3', '--help']\nrunpy.run_module('gctd3.{command}', run_name='__main__')\n"
        "heavy = {'torch', 'torchrl', 'tensordict', 'mujoco', 'hydra', 'omegaconf', 'gymnasium', 'dm_control'}\n"
        "print(sorted(heavy & {name.split('.')[0] for name in sys.modules}), file=sys.stderr)"
    )
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert said.stderr.strip() == "[]" and "Keys (key=default):" in said.stdout


@pytest.mark.parametrize("command", COMMANDS)
def test_help_has_every_key_with_its_default_and_what_it_means(command):
    plain = yaml.safe_load(file(command).read_text(encoding="utf-8"))
    defaults = {k: v for item in plain.get("defaults", []) if isinstance(item, dict) for k, v in item.items()}
    groups = [name.rpartition("@")[2] for name in defaults if not name.startswith("override")]
    # Hydra's composition without the groups' keys.
    expected = {
        key: value
        for key, value in items(composed(root=ROOTS.get(command, command), missing=True))
        if not isinstance(value, dict) and not any(key == group or key.startswith(f"{group}.") for group in groups)
    }
    told = {key.name: key for key in keys(command)}
    assert set(told) == set(expected)
    said = help_of(command)
    for name, value in expected.items():
        assert told[name].value == "..." if value == "???" else yaml.safe_load(told[name].value) == value
        assert len(told[name].meaning) > 10 and f"  {name}={told[name].value}" in said
    offered = {choice.name: choice for choice in choices(command)}
    # What the task or another choice brings along is no choice, unless it can be left out.
    following = {name.split()[1] for name in defaults if name.startswith("optional")}
    left_out = {name for name in following if (FILES / name / "none.yaml").is_file()}
    assert set(offered) == {name for name in defaults if not name.startswith(("override", "optional"))} | left_out
    for name, choice in offered.items():
        assert choice.value == str(defaults.get(name, defaults.get(f"optional {name}")) or "null")
        options = sorted(path.stem for path in (FILES / name.split("@")[0]).glob("*.yaml"))
        assert choice.meaning.split(": ")[-1] == ", ".join(options)


def test_the_reference_is_up_to_date():
    page = (FILES.parent / "docs" / "configuration.md").read_text(encoding="utf-8")
    assert page == reference(), "python -m gctd3.config.reference > docs/configuration.md"
    for group, option in ((path.parent.name, path.stem) for path in FILES.glob("*/*.yaml")):
        assert f"\n### `{group}`\n" in page and f"\n| `{option}` | " in page


@parametrize(2, "command", COMMANDS)
def test_examples_of_help_are_command_lines(command):
    lines = help_of(command).splitlines()
    examples = [line.strip() for line in lines if line.startswith(f"  python -m gctd3.{command} ")]
    assert len(examples) >= 2
    for example in examples:
        arguments = [word.strip("'") for word in re.split(r"\s{2,}", example)[0].split()[3:] if "=" in word]
        said = [word for word in arguments if not word.startswith(("resume=", "robot=my_robot")) and "," not in word]
        with initialize_config_module(CONF, version_base="1.3"):
            assert OmegaConf.is_config(compose(ROOTS.get(command, command), [a for a in said if "range(" not in a]))


def fresh(*arguments):
    return subprocess.run([sys.executable, *arguments], capture_output=True, text=True)


def test_the_list_and_the_help_need_nothing_heavy():
    """One after the other: the first that imports it is named."""
    calls = [[], ["--help"], *([command, "--help"] for command in COMMANDS)]
    code = (
        "import sys, runpy\n"
        "for arguments in {}:\n"
        "    sys.argv[1:] = arguments; runpy.run_module('gctd3', run_name='__main__')\n"
        "    print([name for name in ('torch', 'torchrl', 'hydra') if name in sys.modules])\n"
    )
    done = fresh("-W", "error", "-c", code.format(calls))
    assert done.returncode == 0 and done.stderr == "", done.stderr
    *said, rest = done.stdout.split("[]\n")
    assert len(said) == len(calls) and rest == ""
    assert all(summary("render") in one or "Keys (key=default):" in one for one in said)


def test_the_reference_needs_nothing_heavy():
    code = "import sys; from gctd3.config.reference import reference; reference();"
    code += "print([name for name in ('torch', 'torchrl', 'hydra', 'omegaconf') if name in sys.modules])"
    assert fresh("-W", "error", "-c", code).stdout == "[]\n"


@pytest.mark.parametrize("command", ["train", "graph"])
def test_help_of_a_module_is_the_same(command, monkeypatch):
    monkeypatch.setenv("COLUMNS", "90")
    done = fresh("-m", f"gctd3.{command}", "--help")
    assert (done.returncode, done.stderr) == (0, "") and done.stdout == help_of(command) + "\n"


def test_a_script_knows_its_command_by_its_name(monkeypatch, capsys):
    for name in ("/usr/bin/gctd3-graph", "gctd3-graph.exe"):
        monkeypatch.setattr(sys, "argv", [name, "--help"])
        script()
        assert capsys.readouterr().out == help_of("graph") + "\n"


def test_an_unknown_command_is_answered(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["gctd3", "tarin", "algo=gctd3"])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 2
    error = capsys.readouterr().err
    assert error.startswith("error: There is no command 'tarin'. Did you mean 'train'? Commands: view, ")
