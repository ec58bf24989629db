"""Run a function on the configuration of a command line: by Hydra, with errors that fit on a line."""

from __future__ import annotations

import contextlib
import functools
import itertools
import os
import re
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from traceback import walk_tb
from typing import NoReturn

import hydra
from hydra import compose, initialize_config_module
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException, MissingConfigException, OverrideParseException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import MarkedYAMLError, YAMLError

from gctd3.compat import own_launcher
from gctd3.config.fields import TARGET, find, is_settings, meanings
from gctd3.config.help import CONF, choices, command_of, conf, fail, unread
from gctd3.config.paths import literal_paths
from gctd3.config.requirements import why_no_mujoco
from gctd3.config.suggestions import nearest
from gctd3.config.terminal import prepare_output
from gctd3.errors import ConfigError, GCTD3Error, PackageError, RobotError, RunError, suggest
from gctd3.files import remove_empty, title
from gctd3.signals import Interruption

_NULL = "null"
_JOBLIB = ("hydra/launcher", "joblib")  # an option only where the plugin is installed
_WRONG_SETTINGS = (ConfigError, RobotError, HydraException, OmegaConfBaseException, YAMLError)
_USER_ERRORS = (GCTD3Error, HydraException, OmegaConfBaseException, OSError, MemoryError, YAMLError)


def command(
    config: str,
    task: Callable[[DictConfig], object],
    rewrite: Callable[[list[str]], list[str]] = list,
    may_change: Sequence[str] = (),
    at_end: Callable[[BaseException | None], None] | None = None,
) -> None:
    """Run ``task`` on the configuration that the command line asks for; exit with 2 after a message if it is wrong.

    Args:
        config: Name of the root YAML in ``conf/``.
        task: Function of the resolved configuration; its return value goes to Hydra's sweeper.
        rewrite: Function of the arguments that returns those for Hydra.
        may_change: Keys that the command line may change, if it continues a run.
        at_end: Function to call in the end, however that comes, with the error if there is one.
    """
    heard = Interruption()
    prepare_output()
    try:
        with heard.listening(), _ending(at_end):
            _run(config, task, rewrite, may_change)
    except BaseException as error:
        # An import that a signal broke off raises what it likes.
        if heard.signal is None and not isinstance(error, KeyboardInterrupt):
            raise
        with contextlib.suppress(OSError):  # a terminal that is gone
            print("\nInterrupted.", file=sys.stderr)
        raise SystemExit(heard.exit_code) from None


@contextlib.contextmanager
def _ending(at_end: Callable[[BaseException | None], None] | None) -> Iterator[None]:
    try:
        yield
    except BaseException as error:
        if at_end is not None:
            at_end(error)
        raise
    if at_end is not None:
        at_end(None)


def _run(
    config: str,
    task: Callable[[DictConfig], object],
    rewrite: Callable[[list[str]], list[str]],
    may_change: Sequence[str],
) -> None:
    sys.argv[1:] = _together(_without_null(sys.argv[1:], config))
    # A launcher's plug-in has settings of the same name as ours in conf/, on purpose.
    warnings.filterwarnings("ignore", message=r"\s*'hydra/launcher/", category=UserWarning)
    # Makes Hydra raise its errors, which are reported below in the library's words, instead of printing and exiting.
    os.environ.setdefault("HYDRA_FULL_ERROR", "1")
    try:
        sys.argv[1:] = rewrite(literal_paths(sys.argv[1:]))
        hydra.main(version_base="1.3", config_path=f"pkg://{CONF}", config_name=config)(_guarded(task, config))()
    except BrokenPipeError:
        unread()
    except _USER_ERRORS as error:
        fail(explain(error, config, may_change))
    except (AssertionError, AttributeError, LookupError, RecursionError, TypeError, ValueError) as error:
        # Hydra raises these for a value that is not an option of its group; the task's own errors keep their traceback.
        if _raised_by_the_task(error):
            raise
        fail(f"The arguments cannot be combined: {error or type(error).__name__}")
    except ImportError as error:
        fail(_broken(error))
    except RuntimeError as error:
        plugin = re.search(r"Unknown plugin class : 'hydra_plugins\.hydra_(\w+)_launcher", str(error))
        if plugin is None:
            raise
        fail(f"hydra/launcher={plugin[1]} needs its package: pip install 'gctd3[{plugin[1]}]'.")


def _broken(error: ImportError) -> str:
    """Return what to do about a package that cannot be imported; raise the error again if that is not known."""
    reason = why_no_mujoco(error)
    if reason is None:
        raise error
    return reason


def _raised_by_the_task(error: Exception) -> bool:
    """Tell whether the task had begun: Hydra runs it in ``run_job``, and raises here what a launcher's job returned."""
    return any(frame.f_code.co_name in ("run_job", "return_value") for frame, _ in walk_tb(error.__traceback__))


def _together(arguments: list[str]) -> list[str]:
    """Sort ``arguments``, those of the form key=value first: Hydra refuses them on both sides of an option."""

    def assigns(argument: str) -> bool:
        return not argument.startswith("-") and ("=" in argument or argument.startswith("~"))

    return sorted(arguments, key=lambda argument: not assigns(argument))


def _without_null(arguments: list[str], config: str) -> list[str]:
    """Drop choices of ``null`` where that is the default: Hydra takes none on a command line."""
    defaults = {choice.name: choice.value for choice in choices(command_of(config))}
    kept = []
    for argument in arguments:
        name, _, option = argument.partition("=")
        group = chooses(argument)
        if group is None or option != _NULL or argument.startswith("~"):
            kept.append(argument)
        elif defaults.get(name) != _NULL:
            fail(f"{argument}: {name} cannot be left out. Options of {group}: {', '.join(options(group))}.")
    return kept


def _subject(robot: object, task: str) -> str:
    """Return the name of the robot that walks, or with the task that it does instead, or the library's task."""
    own = {"walk": title(str(robot)), "velocity": f"{title(str(robot))}_velocity"}
    return own.get(task, task)


# The subject of a run, for its path; registered here, so that processes of a sweep know it too.
OmegaConf.register_new_resolver("subject", _subject, replace=True)


def _guarded(task: Callable[[DictConfig], object], config: str) -> Callable[[DictConfig], object]:
    """Wrap ``task`` to report its errors here: Hydra would announce them with a line of its own."""

    @functools.wraps(task)
    def guarded(settings: DictConfig) -> object:
        try:
            _check_overrides(settings, HydraConfig.get().overrides.task, config)
            return task(settings)
        except BrokenPipeError:
            unread()
        except _USER_ERRORS as error:
            _refuse(error, config)
        except ImportError as error:
            _refuse(PackageError(_broken(error)), config)
        except RuntimeError as error:
            # PyTorch reports a lack of memory as a RuntimeError.
            if "alloc" not in str(error) and "out of memory" not in str(error):
                raise
            _refuse(MemoryError(str(error).splitlines()[0]), config)

    return guarded


def _check_overrides(settings: DictConfig, overrides: Iterable[str], config: str) -> None:
    """Raise a :class:`.ConfigError` if an override does nothing, or fills a group of which no option was chosen."""
    for override in map(str, overrides):
        key, _, value = override.lstrip("+~").partition("=")
        mapping = OmegaConf.select(settings, key, throw_on_missing=False) if re.fullmatch(r"[\w.]+", key) else None
        if re.fullmatch(r"\{\s*\}", value) and isinstance(mapping, DictConfig) and len(mapping):
            terms = all(isinstance(item, DictConfig) for item in mapping.values())
            names = [str(name) for name in mapping if name != TARGET]
            each = [f"{key}.{name}=null" if terms else f"'~{key}.{name}'" for name in names]
            raise ConfigError(
                f"{override} removes nothing, since it is merged with what is there. Leave out each: {' '.join(each)}"
            )
    # Options may have keys for other commands, too, as a robot's for its training.
    own = {choice.name for choice in choices(command_of(config))}
    for group in map(str, settings):
        value = OmegaConf.select(settings, group, throw_on_missing=False)
        if isinstance(value, DictConfig) and TARGET not in value and group in own and chooses(f"{group}="):
            raise ConfigError(_unchosen(group))


def _unchosen(group: str) -> str:
    return f"{group} has no keys as it is: begin with {group}=..., which is one of {', '.join(options(group))}."


def _refuse(error: Exception, config: str) -> NoReturn:
    """Report an error and end the process; in a sweep end only the run, unless its settings are wrong."""
    hydra_config = HydraConfig.get()
    directory = Path(hydra_config.runtime.output_dir)
    # Hydra makes it for every run.
    remove_empty(directory)
    message, sweeping = explain(error, config), hydra_config.mode is RunMode.MULTIRUN
    if sweeping and not isinstance(error, _WRONG_SETTINGS):
        # The sweep continues with its other runs, and fails at its end.
        print(f"error: {directory}: {message}", file=sys.stderr, flush=True)
        raise RunError(f"{directory} failed, with the message printed above; the other runs went on.") from None
    if sweeping and not own_launcher(hydra_config.launcher):
        raise RunError(message) from None  # reported by the process that started the sweep
    fail(message)


def explain(error: Exception, config: str, may_change: Sequence[str] = ()) -> str:
    """Describe an error in a line or two; for an unknown key, name the nearest known one; see :func:`command`."""
    if isinstance(error, GCTD3Error):
        return f"{error}{_replacing(str(error))}"
    if isinstance(error, MarkedYAMLError):
        mark = error.problem_mark
        return f"{mark.name}, line {mark.line + 1}: {error.problem}." if mark else str(error)
    if isinstance(error, MemoryError):
        return f"Not enough memory ({error}): lower replay.buffer_size, env.num_envs or the number of episodes."
    # Hydra's counts as an OSError.
    if isinstance(error, MissingConfigException) and error.options:
        group, _, option = str(error.missing_cfg_file).rpartition("/")
        close, accepted = suggest(option, error.options), ", ".join(error.options)
        needed = " It needs its package: pip install 'gctd3[sweep]'." if (group, option) == _JOBLIB else ""
        return f"Could not find '{group}/{option}'.{needed or close} Options of {group}: {accepted}."
    if isinstance(error, OSError):
        return f"{error.strerror}: {error.filename}" if error.filename else str(error)
    if isinstance(error, OverrideParseException):
        return f"Cannot read {error.override!r}: {str(error).splitlines()[0]}. Expected key=value."
    causes = [str(error), *([str(error.__cause__)] if error.__cause__ else [])]
    text = "\n".join(line for line in "\n".join(causes).splitlines() if line.strip())
    unknown = re.search(r"full_key: (\S+)", text) if "is not in struct" in text else None
    if unknown is None:
        return text
    key = unknown.group(1)
    parent = key.rpartition(".")[0]
    if may_change:
        return (
            f"Unknown key {key!r}: a run that is continued keeps its robot, task and reward."
            f"{nearest(key, dict.fromkeys(may_change, ''))} May change: {', '.join(may_change)}."
        )
    keys = _known_keys(config, sys.argv[1:])
    group = key.partition(".")[0]
    if not any(known.startswith(f"{group}.") for known in keys) and group in keys and chooses(f"{group}="):
        return f"Unknown key {key!r}: {_unchosen(group)}"
    siblings = [k for k in keys if k.rpartition(".")[0] == parent]
    none = f" {parent} has no keys; +{key}=... adds one." if parent in keys else ""
    accepted = f" Accepted: {', '.join(siblings)}." if siblings else none
    if any(argument.startswith(f"{key}._target_=") for argument in sys.argv[1:]):
        return f"Unknown key {key!r}. To add it: +{key}._target_=...{accepted}"
    return f"Unknown key {key!r}.{nearest(key, keys)}{accepted}"


def _replacing(message: str) -> str:
    """Return how to replace settings by those of another class, if that is what ``message`` comes from."""
    for argument in sys.argv[1:]:
        place = argument.partition(f".{TARGET}=")[0]
        if f".{TARGET}=" in argument and not place.startswith("+") and f"Unknown key '{place}." in message:
            _, _, target = argument.partition("=")
            above = place.rpartition(".")[0]
            return (
                f" It was a key of the class before {target}: to replace {place}, leave it out and add yours by a new "
                f"name, {place}=null +{above}.NAME.{TARGET}={target}"
            )
    return ""


def chooses(argument: str) -> str | None:
    """Return the group of which an argument chooses an option; ``None`` for other arguments, which add no keys."""
    group = re.split("[=@]", argument.lstrip("+~"), maxsplit=1)[0]
    return group if group.isidentifier() and conf().joinpath(group).is_dir() else None


def options(group: str) -> list[str]:
    """List the options of a group that ship with gctd3."""
    return sorted(file.stem for file in conf().joinpath(group).glob("*.yaml"))


def ships(argument: str) -> bool:
    """Tell whether the option that an argument chooses of a group ships with gctd3."""
    group, option = chooses(argument), argument.partition("=")[2]
    return group is not None and conf().joinpath(group, f"{option}.yaml").is_file()


def _elsewhere(arguments: list[str]) -> list[str]:
    """Return the override with Hydra's further search paths, if a command line gives them."""
    overrides = [argument for argument in arguments if argument.startswith("hydra.searchpath=")]
    for argument, following in itertools.zip_longest(arguments, arguments[1:], fillvalue=""):
        option, _, folder = argument.partition("=")
        if option in ("--config-dir", "-cd"):
            path = str(Path(folder or following).absolute()).replace("'", "\\'")
            overrides.append(f"hydra.searchpath=['file://{path}']")
    return overrides[-1:]


def _known_keys(config: str, arguments: list[str]) -> dict[str, str]:
    """Return the meaning of every key, given those of the arguments that choose an option and are valid."""
    GlobalHydra.instance().clear()
    sound = _elsewhere(arguments)
    with initialize_config_module(CONF, version_base="1.3"):
        composed = compose(config, sound)
        for argument in filter(chooses, arguments):  # to compose takes long
            with contextlib.suppress(*_USER_ERRORS):
                composed = compose(config, [*sound, argument])
                sound.append(argument)

    def walk(node: DictConfig, prefix: str) -> dict[str, str]:
        known, described = {}, _meanings(node)
        for key in map(str, node):
            value = OmegaConf.select(node, key, throw_on_missing=False)
            if key != TARGET:
                known[f"{prefix}{key}"] = described.get(key, "")
            if isinstance(value, DictConfig):
                known |= walk(value, f"{prefix}{key}.")
        return known

    return walk(composed, "")


def _meanings(node: DictConfig) -> dict[str, str]:
    """Return the meanings of the keys of settings; of a mapping that is none, or of a class not found, nothing."""
    with contextlib.suppress(ImportError):
        cls = find(str(node.get(TARGET, "")))
        return meanings(cls) if is_settings(cls) else {}
    return {}
