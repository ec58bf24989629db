"""The configuration that a run keeps, and how a later command line may change it."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra import compose
from hydra.errors import MissingConfigException
from omegaconf import DictConfig, ListConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from omegaconf.resolvers import oc
from yaml import YAMLError

import gctd3
from gctd3.compat import stored_mapping
from gctd3.config.build import MODULES, build
from gctd3.config.options import chooses, ships
from gctd3.config.paths import escaped
from gctd3.errors import ConfigError, RunError
from gctd3.files import check_regular, write_text

if TYPE_CHECKING:
    from gctd3.training.settings import TrainSettings

CONFIG, OVERRIDES = Path(".hydra") / "config.yaml", Path(".hydra") / "overrides.yaml"
# Keys that may differ when a run is continued: they do not change what the run has learnt so far.
HARMLESS = (
    "logger",
    "video",
    "total_frames",
    "total_episodes",
    "time_limit",
    "threads",
    "env.threads",
    "env.check",
    "device",
    "keep_checkpoints",
    "checkpoint_every",
    "stop_when",
    "give_up",
    "collector.workers",
    "collector.cpus",
    "collector.timeout",
    "collector.start_within",
    "collector.max_restarts",
    "collector.address",
    "resume",
)
# Those of them on which the order of sums or the draws depend, so that numbers differ from there on.
_ARITHMETIC = ("threads", "device", "collector.workers", "collector.cpus")
_ELSEWHERE = ("--config-dir", "-cd", "hydra.searchpath")  # where other options may be


def find_run(run: str | Path | None) -> Path:
    """Return the directory of a run; of the walking biped that ships with the library if ``run`` is ``None``."""
    return Path(run) if run is not None else Path(str(resources.files("gctd3.models"))) / "biped" / "policy"


def load_config(run: str | Path) -> DictConfig:
    """Load the resolved configuration of a run; every ``${...}`` in it is text, and is not resolved.

    Raises:
        RunError: If ``run`` is not the directory of a run.
    """
    directory = Path(run)
    file = directory / CONFIG
    if not directory.is_dir():
        raise RunError(f"No run directory at {directory}.")
    if not file.is_file():
        raise RunError(f"{directory} is not a run: it has no {CONFIG}. gctd3.train makes runs.")
    try:
        config = OmegaConf.create(as_data(OmegaConf.to_container(OmegaConf.load(file))))
    except (OmegaConfBaseException, YAMLError, UnicodeDecodeError, OSError, ValueError) as error:
        raise _unusable(file, error) from error
    if not isinstance(config, DictConfig):
        raise RunError(f"{file} does not hold a mapping.")
    return config


def as_data(value: Any) -> Any:  # noqa: ANN401 - any nesting
    """Mark every ``${`` in the texts of a nesting as text for OmegaConf.

    A run may be somebody else's, and ``${oc.env:NAME}`` would read the environment here.
    """
    if isinstance(value, dict):
        return {key: as_data(item) for key, item in value.items()}
    if isinstance(value, list):
        return [as_data(item) for item in value]
    return escaped(value) if isinstance(value, str) else value


def load_settings(run: str | Path) -> TrainSettings:
    """Load the settings that a run was started with.

    Raises:
        RunError: If ``run`` is not the directory of a run, or one of another version.
    """
    from gctd3.training.settings import TrainSettings

    config = load_config(run)
    try:
        settings = build(config, trusted=False)
    except (OmegaConfBaseException, ConfigError) as error:
        raise _unusable(Path(run) / CONFIG, error) from error
    if not isinstance(settings, TrainSettings):
        raise RunError(f"{Path(run) / CONFIG} is not the configuration of a training.")
    return settings


def save_config(run: Path, config: DictConfig, overrides: Sequence[str]) -> None:
    """Write the resolved configuration and the command line that it came from."""
    (run / CONFIG).parent.mkdir(parents=True, exist_ok=True)
    write_text(run / CONFIG, OmegaConf.to_yaml(config, resolve=True))
    write_text(run / OVERRIDES, OmegaConf.to_yaml(OmegaConf.create(as_data(list(overrides))), resolve=True))


def changed(run: Path, root: str, overrides: Sequence[str]) -> tuple[DictConfig, list[str]]:
    """Return the configuration with which a run is to be continued, and the command line that describes it.

    Args:
        run: Directory of the run.
        root: Name of the root YAML.
        overrides: Overrides of the new command line.

    Raises:
        RunError: If they would change a setting that determines the run; the message lists the differences.
    """
    config, first = load_config(run), command_line(run)
    own = ("resume", "hydra.run.dir", "hydra.output_subdir")
    line = list(first)
    for item in overrides:
        # The run's own choices are repeated so that Hydra knows their keys, and a sweep repeats the whole line.
        if item.split("=", 1)[0] not in own and not _in_force(item, line):
            # Hydra adds a key by a single + only where it is missing.
            line.append(f"++{item.lstrip('+')}" if item in line and item.startswith("+") else item)
    new = line[len(first) :]
    if not new:
        return config, first
    with _without_environment():
        was, known = _composed(root, first)
        before, after = flat(was), flat(compose(root, [*known, *new]))
    difference = {key: after.get(key) for key in {*before, *after} if before.get(key) != after.get(key)}
    # A run beside others has its share of the cores in its configuration, and nothing of it on its command line.
    kept, named = flat(config), [_place(item) for item in new]
    for key in {*kept, *after}:
        if _harmless(key) and kept.get(key) != after.get(key) and any(f"{key}.".startswith(f"{n}.") for n in named):
            difference[key] = after.get(key)
    forbidden = sorted(key for key in difference if not _harmless(key))
    if forbidden:
        lines = "".join(f"\n  {key}: {before.get(key)!r} -> {difference[key]!r}" for key in forbidden)
        raise RunError(
            f"{run} cannot be continued with other settings:{lines}\nMay change: {', '.join(HARMLESS[:-1])}. "
            "Start a new run for the rest."
        )
    for key, value in difference.items():
        parent, _, name = key.rpartition(".")
        mapping = OmegaConf.select(config, parent) if parent else config
        if key in after:
            OmegaConf.update(config, key, as_data(value), force_add=True)
        elif isinstance(mapping, DictConfig):
            mapping.pop(name, None)
    return config, line if difference else first


def changes_of_arithmetic(before: DictConfig, after: DictConfig) -> str | None:
    """Return a line on the settings by which a run that goes on computes other numbers; ``None`` if there are none."""
    was, now = flat(before), flat(after)
    changes = [f"{key} {was.get(key)} -> {now.get(key)}" for key in _ARITHMETIC if was.get(key) != now.get(key)]
    if not changes:
        return None
    return f"{', '.join(changes)}: from here on its numbers are not those of a run that was left alone."


@contextlib.contextmanager
def _without_environment() -> Iterator[None]:
    """Leave ``${oc.env:NAME}`` as it stands: the first command line of a run may be somebody else's."""
    OmegaConf.clear_resolver("oc.env")
    OmegaConf.register_new_resolver("oc.env", lambda name, *default: f"${{oc.env:{name}}}")
    try:
        yield
    finally:
        OmegaConf.register_new_resolver("oc.env", oc.env, replace=True)


def _in_force(item: str, line: Sequence[str]) -> bool:
    """Tell whether a command line has an override, and none after it of the same key, of its parts or of its whole."""
    if item not in line:
        return False
    place = _place(item)
    after = map(_place, line[len(line) - line[::-1].index(item) :])
    return not any(f"{other}.".startswith(f"{place}.") or f"{place}.".startswith(f"{other}.") for other in after)


def _place(override: str) -> str:
    """Return the key or the group that an override is of."""
    return override.lstrip("+~").split("=", 1)[0]


def choices(run: Path, arguments: Sequence[str]) -> list[str]:
    """Return the options that a run's command line chose of groups that ``arguments`` leave alone.

    Hydra knows the keys of an option only with it: ``collector.workers`` exists with ``collector=process``. Custom
    options are found only if ``arguments`` name their directory; the run has kept their content.

    Raises:
        RunError: If the run does not say.
    """
    chosen = {chooses(argument) for argument in arguments}
    elsewhere = any(argument.startswith(_ELSEWHERE) for argument in arguments)
    own = [item for item in command_line(run) if chooses(item) not in {*chosen, None}]
    return [item for item in own if elsewhere or ships(item)]


def _composed(root: str, overrides: list[str]) -> tuple[DictConfig, list[str]]:
    """Compose a run's overrides, without custom options that are not found here: the run has kept their content."""
    # Only the user's own command line may say where Hydra looks for YAMLs: the classes that they name are imported.
    overrides = [item for item in overrides if not item.lstrip("+~").startswith("hydra")]
    try:
        return compose(root, overrides), overrides
    except MissingConfigException:
        kept = [item for item in overrides if chooses(item) is None or ships(item)]
        return compose(root, kept), kept


def command_line(run: Path) -> list[str]:
    """Return the command line that a run came from.

    Raises:
        RunError: If the run does not say.
    """
    try:
        check_regular(run / OVERRIDES)
        items = OmegaConf.load(run / OVERRIDES)
        if not isinstance(items, ListConfig):
            raise TypeError("it does not hold a list")
        plain: Any = OmegaConf.to_container(items)
        return [str(item) for item in plain]
    except (OSError, YAMLError, OmegaConfBaseException, UnicodeDecodeError, TypeError) as error:
        raise _unusable(run / OVERRIDES, error) from error


def _harmless(key: str) -> bool:
    return any(key == name or key.startswith(f"{name}.") for name in HARMLESS)


def flat(config: DictConfig, prefix: str = "") -> dict[str, object]:
    """Return the values of a configuration by their dotted path; lists count as values."""
    values: dict[str, object] = {}
    for key in map(str, config):
        mapping = stored_mapping(config, key)
        if mapping is not None:
            values |= flat(mapping, f"{prefix}{key}.")
        else:
            value = config[key]
            values[f"{prefix}{key}"] = (
                OmegaConf.to_container(value, resolve=True) if OmegaConf.is_config(value) else value
            )
    return values


def _unusable(file: Path, error: Exception) -> RunError:
    if MODULES in str(error):
        return RunError(f"{file}: {error}")
    return RunError(f"{file} cannot be used by gctd3 {gctd3.__version__}; it is damaged or of another version: {error}")
