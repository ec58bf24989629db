"""Complete what Hydra composes: every key that no YAML holds gets the default of the dataclass that ``_target_`` names.

So a default has one place, and a YAML holds the keys that differ. It happens between the last YAML and the first
override of the command line: by then groups, robots and experiments have chosen each ``_target_``, a key that some YAML
gives is kept, and Hydra, which closes the configuration next, accepts ``algo.tau=0.01``, refuses ``algo.tua=0.01``, and
shows, sweeps and saves every key.

Fields that settings list in ``BY_NAME`` hold terms by name, and are completed name by name: a YAML names only the terms
that it adds, changes or, with ``null``, leaves out, and every other one keeps its default and its place. Any other
mapping is the YAML's as it stands.

Alternatives: entries of Hydra's ConfigStore, generated from the dataclasses, as the first default of each YAML. That
is Hydra's own way, but names each class twice, gives nothing to a class from outside that is only named by the
``_target_`` of somebody's YAML, and what is merged first cannot know which class is chosen last: nested settings of one
would be left over under another. Prefixing unlisted keys with ``++`` would accept misspelt ones, and reach neither
YAMLs nor sweeps.

Hydra has no plug-in for that moment, so a method of its loader is wrapped, in :mod:`gctd3.compat`. Importing
``gctd3.conf`` does it, and Hydra cannot read ``pkg://gctd3.conf`` without importing that: so every process composes
alike, including the processes of a launcher and of other projects.
"""

from __future__ import annotations

from typing import Any

from omegaconf import DictConfig, ListConfig, OmegaConf, flag_override

from gctd3.compat import complete_compositions, read_packaged_yamls_once
from gctd3.config.fields import TARGET, defaults_of, find, is_settings
from gctd3.config.help import conf
from gctd3.errors import ConfigError, PackageError

OWN = "gctd3."
_HYDRAS = "hydra"  # Hydra's own part of a configuration


def install() -> None:
    """Install the completion of every configuration that Hydra composes; further calls change nothing."""
    complete_compositions(complete)
    read_packaged_yamls_once()


def complete(config: DictConfig | ListConfig, ours: bool = False, path: str = "") -> None:
    """Add the keys that ``config`` lacks with their defaults, in place.

    Settings of gctd3 are completed, and all settings below them, whoever defines them; the rest of the configuration
    of a project that uses some of gctd3's YAMLs stays as it was.

    Args:
        config: The configuration that the YAMLs give.
        ours: Whether it stands below settings of gctd3.
        path: Its place in the configuration, for messages.

    Raises:
        ConfigError: If a ``_target_`` cannot be imported, or settings of a part have taken the place of the whole.
        PackageError: If the module of a ``_target_`` needs a package that is missing.
    """
    if isinstance(config, DictConfig):
        target = _inner(config, TARGET) if _says(config, TARGET) else None
        ours = ours or (isinstance(target, str) and target.startswith(OWN))
        if ours and isinstance(target, str) and OmegaConf.get_type(config) is dict:
            _add_defaults(config, target, path)
    keys: list[Any] = list(range(len(config))) if isinstance(config, ListConfig) else list(config.keys())
    for key in keys:
        inner = _inner(config, key)
        if OmegaConf.is_config(inner) and not (path == "" and key == _HYDRAS):
            complete(inner, ours, f"{path}.{key}".lstrip("."))


def _add_defaults(config: DictConfig, target: str, path: str) -> None:
    try:
        settings = find(target)
    except PackageError:
        raise
    except ImportError as error:
        raise ConfigError(f"{path or 'the configuration'}: _target_ {target!r} cannot be imported: {error}") from error
    if is_settings(settings):
        defaults = defaults_of(settings)
        if path == "" and _HYDRAS in config:
            _check_root(config, target, set(defaults))
        for key in getattr(settings, "BY_NAME", ()):
            if _says(config, key) and isinstance(_inner(config, key), DictConfig):
                _add_by_name(config, key, defaults[key])
        _add(config, defaults)


def _check_root(config: DictConfig, target: str, known: set[str]) -> None:
    """Refuse settings of a part, such as the robot's, that have taken the place of a command's."""
    parts = {str(key): _inner(config, key) for key in config if key not in {*known, TARGET, _HYDRAS}}
    nameless = [key for key, part in parts.items() if isinstance(part, DictConfig) and not _says(part, TARGET)]
    if nameless and not any(
        f"\n{TARGET}: {target}\n" in file.read_text(encoding="utf-8") for file in conf().glob("*.yaml")
    ):
        raise ConfigError(
            f"{target} has taken the place of all settings; {nameless[0]} has no class. A YAML with '# @package "
            "_global_' begins from another one by its place, as in '- /robot/biped@robot', not '- biped'."
        )


def _add(config: DictConfig, defaults: dict[str, Any]) -> None:
    with flag_override(config, ["struct", "readonly"], False):
        for key, default in defaults.items():
            if not _says(config, key):
                config[key] = default
                continue
            inner = _inner(config, key)
            # Nested settings: the YAML gives some of their keys, and not their class.
            nested = isinstance(default, dict) and TARGET in default
            if nested and isinstance(inner, DictConfig) and not _says(inner, TARGET):
                _add(inner, default)


def _add_by_name(config: DictConfig, key: str, defaults: dict[str, Any]) -> None:
    """Add the default terms that the mapping at ``key`` does not name; they stand first, in their order."""
    given: Any = OmegaConf.to_container(config[key], resolve=False)
    with flag_override(config, ["struct", "readonly"], False):
        config[key] = _merged(defaults, given)


def _merged(defaults: dict[str, Any], given: dict[str, Any]) -> dict[str, Any]:
    known = {key: _term(default, given[key]) if key in given else default for key, default in defaults.items()}
    return known | {key: value for key, value in given.items() if key not in defaults}


def _term(default: Any, given: Any) -> Any:  # noqa: ANN401 - anything
    """Complete what a YAML says of a term; a class that is not the default's keeps nothing of it."""
    settings = isinstance(default, dict) and TARGET in default and isinstance(given, dict)
    return _merged(default, given) if settings and given.get(TARGET, default[TARGET]) == default[TARGET] else given


def _says(config: DictConfig, key: str) -> bool:
    """Tell whether a YAML gives the key, with or without a value; ``in`` would resolve it, and need one."""
    return key in set(config.keys())


def _inner(config: DictConfig | ListConfig, key: Any) -> Any:  # noqa: ANN401 - anything
    """Get the value of a key; ``None`` if it is missing or would have to be resolved."""
    if OmegaConf.is_missing(config, key) or OmegaConf.is_interpolation(config, key):
        return None
    return config[key]
