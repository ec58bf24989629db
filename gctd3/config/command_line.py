"""Run a function on the configuration of a command line: by Hydra, with errors that fit on a line."""

from __future__ import annotations

import contextlib
import functools
import os
import re
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from traceback import walk_tb
from typing import NoReturn

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from gctd3.compat import own_launcher
from gctd3.config.explanation import USER_ERRORS, explain
from gctd3.config.fields import TARGET
from gctd3.config.help import CONF, choices, command_of, fail, unread
from gctd3.config.options import chooses, options, unchosen
from gctd3.config.paths import literal_paths
from gctd3.config.requirements import why_no_mujoco
from gctd3.config.terminal import prepare_output
from gctd3.errors import ConfigError, PackageError, RobotError, RunError
from gctd3.files import remove_empty, title
from gctd3.signals import Interruption

_NULL = "null"
_WRONG_SETTINGS = (ConfigError, RobotError, HydraException, OmegaConfBaseException, YAMLError)


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
    except USER_ERRORS as error:
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
        except USER_ERRORS as error:
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
            # Hydra's grammar has no key with a `*`, but a mapping with one.
            each = [
                f"'{key}={{{name}:null}}'"
                if not re.fullmatch(r"\w+", name)
                else f"{key}.{name}=null"
                if terms
                else f"'~{key}.{name}'"
                for name in names
            ]
            raise ConfigError(
                f"{override} removes nothing, since it is merged with what is there. Leave out each: {' '.join(each)}"
            )
    # Options may have keys for other commands, too, as a robot's for its training.
    own = {choice.name for choice in choices(command_of(config))}
    for group in map(str, settings):
        value = OmegaConf.select(settings, group, throw_on_missing=False)
        if isinstance(value, DictConfig) and TARGET not in value and group in own and chooses(f"{group}="):
            raise ConfigError(unchosen(group))


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
