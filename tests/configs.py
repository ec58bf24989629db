"""Compose configurations for tests, as the commands do, and change one key of them."""

import copy

from hydra import compose, initialize_config_module
from omegaconf import OmegaConf


def composed(*overrides, root="config", missing=False):
    """Compose a command's configuration; with ``missing``, required keys may be left out."""
    with initialize_config_module("gctd3.conf", version_base="1.3"):
        return OmegaConf.to_container(compose(root, list(overrides)), resolve=True, throw_on_missing=not missing)


def items(node, prefix=""):
    """Yield full names and values of all keys except ``_target_``, mappings included."""
    for key, value in node.items():
        if key != "_target_":
            yield f"{prefix}{key}", value
            if isinstance(value, dict):
                yield from items(value, f"{prefix}{key}.")


def edited(config, key, value=None, rename=None, drop=False):
    """Copy ``config`` with another value or name for ``key``, or without it."""
    config = copy.deepcopy(config)
    *path, last = key.split(".")
    node = config
    for part in path:
        node = node[part]
    old = node.pop(last) if rename or drop else None
    if not drop:
        node[rename or last] = old if rename else value
    return config
