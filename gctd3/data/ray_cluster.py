"""Join or start a Ray cluster to collect on, and check that it is fit, before a training begins."""

from __future__ import annotations

import concurrent.futures
import contextlib
import os
import socket
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from typing import Any

from gctd3.data.background import in_thread
from gctd3.errors import ConfigError, WorkerError

ANSWER = 5.0  # s, that a head node may take to accept a connection
JOIN = 30.0  # s, that joining a cluster may take
PROBE = 60.0  # s, that the nodes may take to report their installed packages
# Packages that learner and workers must have alike: they exchange pickled settings, networks and steps.
ALIKE = ("gctd3", "torch", "torchrl", "tensordict", "mujoco")


def check_cluster(address: str | None, workers: int, cpus: int) -> None:
    """Join the cluster at ``address``, or start one, and check that ``workers`` of ``cpus`` CPUs each can work on it.

    Raises:
        ConfigError: If Ray is not installed, nothing answers at the address, or the CPUs do not suffice.
        WorkerError: If a node has another version of a required package than this machine.
    """
    if find_spec("ray") is None:
        raise ConfigError("collector=ray needs its package: pip install 'gctd3[ray]'.")
    _connect(address)
    nodes = _nodes()
    check_room(workers, cpus, {name: int(node["Resources"]["CPU"]) for name, node in nodes.items()})
    check_alike(installed(), _on_nodes(nodes))


def _connect(address: str | None) -> None:
    # Before the import, where Ray reads it; by default it reports that it is used.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    import ray

    if ray.is_initialized():
        return
    if address is not None and address != "auto":
        _check_answers(address)
    # In a thread: Ray tries for minutes to reach a missing cluster, and in the main thread would take over SIGTERM.
    # The thread stays, for a cluster that is started here ends with it.
    joined = in_thread(
        lambda: ray.init(
            address=address or "local",
            include_dashboard=False if address is None else None,
            logging_level="error",
            log_to_driver=False,
        ),
        stays=True,
    )
    try:
        joined.result(None if address is None else JOIN)
    except concurrent.futures.TimeoutError as error:
        raise ConfigError(f"collector.address={address}: no Ray cluster has answered there in {JOIN:g} s.") from error
    except Exception as error:  # Ray raises bare ones too
        reason = " ".join(line.strip() for line in str(error).splitlines()[:4]) or type(error).__name__
        if address is None:
            raise WorkerError(f"No Ray cluster could be started on this machine: {reason}") from error
        raise ConfigError(
            f"collector.address={address}: cannot join a Ray cluster there: {reason}. "
            "If it asks for a token, this machine needs the same one (RAY_AUTH_TOKEN)."
        ) from error


def _check_answers(address: str) -> None:
    """Raise a :class:`.ConfigError` unless something listens at ``host:port``; Ray itself would try for long."""
    host, _, port = address.rpartition(":")
    try:
        socket.create_connection((host, int(port)), timeout=ANSWER).close()
    except (OSError, OverflowError) as error:
        raise ConfigError(
            f"collector.address={address}: nothing answers there ({error}). The address is printed by `ray start "
            "--head`, port 6379 by default; null starts a cluster on this machine."
        ) from error


def check_room(workers: int, cpus: int, nodes: Mapping[str, int]) -> None:
    """Raise a :class:`.ConfigError` if ``nodes`` (their CPUs by name) do not hold so many workers."""
    room = sum(available // cpus for available in nodes.values())
    if room < workers:
        listed = ", ".join(f"{name}: {available}" for name, available in sorted(nodes.items()))
        raise ConfigError(
            f"collector.workers={workers} with collector.cpus={cpus} need {workers * cpus} CPUs, but the cluster has "
            f"room for {room} ({listed}): lower them, or add nodes with `ray start --address=...`."
        )


def installed() -> dict[str, str]:
    """Return the installed versions of the packages that learner and workers must have alike."""
    versions = {}
    for package in ALIKE:
        with contextlib.suppress(PackageNotFoundError):
            versions[package] = version(package)
    return versions


def _nodes() -> dict[str, dict[str, Any]]:
    """Return the cluster's live nodes that have CPUs, by host and node ID."""
    import ray

    return {
        f"{node['NodeManagerHostname']}/{node['NodeID'][:6]}": node
        for node in ray.nodes()
        if node["Alive"] and node["Resources"].get("CPU", 0)
    }


def _on_nodes(nodes: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, str]]:
    """Return the versions of the packages on every node, by its name."""
    import ray
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    def probe(packages: Sequence[str]) -> dict[str, str]:  # sent by value: gctd3 may be missing on the node
        import contextlib
        from importlib.metadata import PackageNotFoundError, version

        versions = {}
        for package in packages:
            with contextlib.suppress(PackageNotFoundError):
                versions[package] = version(package)
        return versions

    asked = {}
    for name, node in nodes.items():
        where = NodeAffinitySchedulingStrategy(node["NodeID"], soft=False)
        asked[name] = ray.remote(num_cpus=0, max_retries=0, scheduling_strategy=where)(probe).remote(ALIKE)
    try:
        return {name: ray.get(answer, timeout=PROBE) for name, answer in asked.items()}
    except ray.exceptions.RayError as error:
        raise WorkerError(f"The nodes of the Ray cluster do not answer: {str(error).splitlines()[0]}") from error


def check_alike(here: Mapping[str, str], nodes: Mapping[str, Mapping[str, str]]) -> None:
    """Raise a :class:`.WorkerError` if a node has other versions than ``here``."""
    wrong = [
        f"{package} {versions.get(package, 'none')} on {name}, {mine} here"
        for name, versions in sorted(nodes.items())
        for package, mine in here.items()
        if versions.get(package, "none") != mine
    ]
    if wrong:
        raise WorkerError(f"The nodes of the Ray cluster must have the versions of this machine: {'; '.join(wrong)}.")
