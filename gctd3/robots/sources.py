"""Find the file of a robot: one that ships with the library, a path, a file of an installed package, a download.

No package is imported for it but the two that download.
"""

from __future__ import annotations

import hashlib
import importlib
import pkgutil
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import gctd3
from gctd3.errors import RobotError, suggest
from gctd3.robots.mjcf import find_mjcf, shipped_robots
from gctd3.robots.urdf import is_urdf
from gctd3.robots.urdf_meshes import collision_meshes

if TYPE_CHECKING:
    from gctd3.robots.settings import RobotSettings

MENAGERIE, DESCRIPTION = "menagerie", "description"
SUFFIXES = (".xml", ".urdf", ".mjcf")
_PACKAGES = {MENAGERIE: "mujoco-menagerie", DESCRIPTION: "robot_descriptions"}
_LICENCE_FILES = ("LICENSE", "LICENSE.txt", "LICENSE.md", "LICENCE", "COPYING")
# Licences by words that only they contain; of two that fit, the first.
_LICENCES = {
    "Apache License": "Apache-2.0",
    "Permission is hereby granted, free of charge": "MIT",
    "Neither the name": "BSD-3-Clause",
    "Redistribution and use in source and binary forms": "BSD-2-Clause",
    "Attribution-ShareAlike 4.0": "CC-BY-SA-4.0",
    "Mozilla Public License": "MPL-2.0",
    "GNU LESSER GENERAL PUBLIC": "LGPL",
    "GNU GENERAL PUBLIC": "GPL",
}
# Which folder of the compiler's holds the files of an asset.
_FOLDERS = {"mesh": "meshdir", "hfield": "meshdir", "skin": "meshdir", "texture": "texturedir"}


@dataclass(frozen=True)
class Source:
    """Represent the file of a robot and where it comes from.

    Attributes:
        file: The file.
        place: The place as it was named.
        package: Package that brings it; ``None`` for a file of one's own.
        version: The package's version.
        licence: Licence that the file's folder states, or else the package.
        recorded: SHA-256 that was computed once; ``None`` to compute it now.
    """

    file: Path
    place: str
    package: str | None = None
    version: str | None = None
    licence: str | None = None
    recorded: str | None = None

    @cached_property
    def sha256(self) -> str:
        """Return the SHA-256 of the file and of all that it includes or shows, wherever they lie.

        Line endings of the file and of its includes do not count.
        """
        if self.recorded is not None:
            return self.recorded
        digest = hashlib.sha256()
        for file in files_of(self.file):
            content = file.read_bytes()
            digest.update(content.replace(b"\r\n", b"\n") if file.suffix in SUFFIXES else content)
        return digest.hexdigest()

    @property
    def ships(self) -> bool:
        """Return whether the file ships with the library."""
        return self.package == gctd3.__name__

    def __str__(self) -> str:
        brought = f"{self.package} {self.version}" if self.package else "a file of your own"
        return f"{self.file} ({brought}, {self.licence or 'no licence stated'}, SHA-256 {self.sha256[:12]})"


def find_source(settings: RobotSettings) -> Source:
    """Find the file of the robot that settings ask for.

    Raises:
        RobotError: If there is no such file, or no package that brings it is installed.
    """
    places = tuple(settings.sources)
    if not settings.takes_a_source:
        if settings.source is not None:
            raise RobotError(
                f"robot.source={settings.source} chooses among robot.sources, and robot.name={settings.name} has none."
            )
        return find_place(settings.name)
    if settings.name in shipped_robots():
        raise RobotError(
            f"robot.name={settings.name} does not choose a robot where robot.sources name files: robot={settings.name} "
            "does."
        )
    if settings.source is not None:
        chosen = [place for place in places if settings.source == place or _same(settings.source, place)]
        if not chosen:
            packages = dict.fromkeys(package_of(place) or place for place in places)
            raise RobotError(
                f"robot.source must be one of {', '.join(packages)} for the robot {settings.name!r}, or one of its "
                f"places {', '.join(places)}; got {settings.source!r}.{suggest(settings.source, packages)}"
            )
        places = tuple(chosen)
    present = [place for place in places if (package := package_of(place)) is None or is_installed(package)]
    if present:
        try:
            return find_place(present[0])
        except RobotError as error:
            # Another file is another robot, so that it is not taken unasked.
            hint = f" robot.source={present[1]} takes another that is installed." if present[1:] else ""
            raise RobotError(f"{error}{hint}") from error
    first, *others = dict.fromkeys(pip_name(package_of(place) or place) for place in places)
    instead = f" (or {', '.join(others)})" if others else ""
    raise RobotError(
        f"No package that brings the robot {settings.name!r} is installed: pip install {first}{instead}; "
        "pip install 'gctd3[robots]' brings those of most robots."
    )


def find_place(place: str) -> Source:
    """Find the file at a place: a shipped robot's name, a path, ``PACKAGE:PATH``, ``menagerie:`` or ``description:``.

    Raises:
        RobotError: If there is none.
    """
    if "://" in place:
        raise RobotError(f"robot={place} is an address: download the file and name its path.")
    package = package_of(place)
    if package is not None:
        rest = place.partition(":")[2]
        finders: dict[str, Callable[[str], Source]] = {MENAGERIE: _in_menagerie, DESCRIPTION: _in_descriptions}
        finder = finders.get(place.partition(":")[0])
        return finder(rest) if finder else _in_package(package, rest, place)
    if place in shipped_robots():
        return Source(find_mjcf(place), place, gctd3.__name__, gctd3.__version__, "MIT")
    file = Path(place).expanduser()
    if file.is_dir() and is_place(place):
        raise RobotError(f"{place} is a folder; a robot is an MJCF or a URDF file.{_inside(file)}")
    if not file.is_file() and is_place(place):
        raise RobotError(f"No {'URDF' if file.suffix == '.urdf' else 'MJCF'} file at {file}.")
    if not file.is_file():
        file = find_mjcf(place)
    _check_format(file)
    return Source(file, place, licence=_stated(file.absolute().parent, file.absolute().parent.parent))


def is_place(name: str) -> bool:
    """Tell whether a robot's name says where its file is: by a path, a package or a downloader."""
    return package_of(name) is not None or Path(name).suffix in SUFFIXES or "/" in name or is_path(name)


def is_path(name: str) -> bool:
    """Tell whether a robot's name can only be a path: it begins like one, or there is such a file."""
    return name.startswith((".", "/", "~")) or Path(name).expanduser().is_file()


def _inside(folder: Path, most: int = 5) -> str:
    """Return the robots' files of a folder, for a message."""
    files = sorted(file.name for file in folder.glob("*") if file.suffix in SUFFIXES)
    return f" It has {', '.join(files[:most])}{' and more' if files[most:] else ''}." if files else ""


def package_of(place: str) -> str | None:
    """Return the package that a place names, ``None`` for a name or a path."""
    package, colon, _ = place.partition(":")
    # A single letter is a drive of Windows.
    if not colon or len(package) < 2 or not re.fullmatch(r"[\w.-]+", package) or Path(place).is_file():
        return None
    return _PACKAGES.get(package, package)


def is_installed(package: str) -> bool:
    """Tell whether a package is installed, named as it is imported or as pip knows it."""
    return _folder(package) is not None or _distribution(package) is not None


def pip_name(package: str) -> str:
    """Return the name by which pip knows a package."""
    distribution = _distribution(package)
    name: str = distribution.metadata["Name"] if distribution else package
    return name.replace("_", "-")


def files_of(file: Path) -> list[Path]:
    """List a robot's file and the files that it includes, attaches or shows and that exist, in the order it names them.

    Visual meshes of a URDF are not read and do not count.
    """
    if is_urdf(file):
        return [file, *dict.fromkeys(collision_meshes(file))]
    texts, folders, assets, attached = [file], dict[str, str](), list[tuple[str, str]](), list[Path]()
    for text in texts:  # grows as they include others
        for element in _elements(text):
            if element.tag == "compiler":
                folders |= {key: value for key, value in element.attrib.items() if key.endswith("dir")}
                folders |= {"strippath": element.get("strippath", "false")}
            for key, name in element.attrib.items():
                if element.tag == "include" and key == "file":
                    # Relative to the main file, as MuJoCo reads them.
                    texts += [path for path in [file.parent / name] if path not in texts and path.is_file()]
                elif element.tag == "model" and key == "file":
                    # A model of its own, with folders of its own.
                    attached += [path for path in [file.parent / name] if path != file and path.is_file()]
                elif element.tag in _FOLDERS and key.startswith("file") and key != "filename":
                    assets.append((element.tag, name))
    files = []
    for kind, name in assets:
        name = Path(name).name if folders.get("strippath") == "true" else name
        inside = folders.get(_FOLDERS[kind]) or folders.get("assetdir") or ""
        files += [path for path in [file.parent / inside / name] if path.is_file()]
    others = [part for path in dict.fromkeys(attached) for part in files_of(path)]
    return list(dict.fromkeys([*texts, *files, *others]))


def _elements(file: Path) -> Iterator[ElementTree.Element]:
    try:
        yield from ElementTree.parse(file).iter()
    except (OSError, ElementTree.ParseError):
        return  # MuJoCo's error is clearer


def _check_format(file: Path) -> None:
    """Raise a :class:`.RobotError` that names the remedy for files of formats that are not read."""
    if file.suffix == ".xacro":
        raise RobotError(f"{file} is a template: make the URDF of it with xacro {file.name} > {file.stem}.urdf.")
    if file.suffix in (".sdf", ".usd", ".usda", ".usdc", ".usdz", ".zip"):
        raise RobotError(f"{file}: a robot is an MJCF or a URDF file, got a {file.suffix}.")
    if file.suffix != ".xml" and not is_urdf(file):
        raise RobotError(f"{file}: MuJoCo reads an MJCF whose name ends in .xml; rename it to {file.stem}.xml.")


# Packages.


def _same(asked: str, place: str) -> bool:
    names = {place.partition(":")[0], package_of(place) or place}
    return any(_normal(asked) == _normal(name) for name in names)


def _normal(package: str) -> str:
    return re.sub(r"[-_.]+", "-", package).lower()


def _distribution(package: str) -> metadata.Distribution | None:
    """Return pip's record of a package, named as it is imported or as pip knows it."""
    try:
        return metadata.distribution(package)
    except (metadata.PackageNotFoundError, ValueError):
        pass
    # To read every package's list takes a while; most are imported under their own name.
    if _folder(package) is None:
        return None
    names = metadata.packages_distributions().get(package, [])
    return metadata.distribution(names[0]) if names else None


def _folder(package: str) -> Path | None:
    """Return the folder of a package that can be imported, without importing it."""
    if not package.isidentifier():
        return None
    try:
        spec = find_spec(package)
    except (ImportError, ValueError):
        return None
    places = list(spec.submodule_search_locations or []) if spec else []
    return Path(places[0]) if places else None


def _in_package(package: str, path: str, place: str) -> Source:
    folder, distribution = _folder(package), _distribution(package)
    if folder is None and distribution is None:
        raise RobotError(f"{place}: no package {package!r} is installed: pip install {pip_name(package)}.")
    file = folder / path if folder else None
    if file is None or not file.is_file():
        # Some packages put their robots elsewhere, in share/.
        files = (distribution.files if distribution else None) or []
        listed = [p for p in files if p.as_posix().endswith(f"/{path}")]
        file = Path(str(listed[0].locate())).resolve() if len(listed) == 1 else None
    version = f" {distribution.version}" if distribution else ""
    if file is None or not file.is_file():
        if not path.strip("/"):
            raise RobotError(f"robot={place} names no file of the package {package}{version}: {package}:PATH does.")
        raise RobotError(f"{place}: the package {package}{version} has no file {path!r}.{_nearest(folder, path)}")
    _check_format(file)
    # Up to the package's own folder; for files elsewhere up to the folder above theirs.
    inside = [p for p in file.parents if folder in (p, *p.parents)] or [file.parent, file.parent.parent]
    return Source(
        file,
        place,
        pip_name(package),
        distribution.version if distribution else None,
        _stated(*inside) or (_licence_of(distribution.metadata) if distribution else None),
    )


def _nearest(folder: Path | None, path: str) -> str:
    if folder is None:
        return ""
    known = [p.relative_to(folder).as_posix() for suffix in SUFFIXES for p in folder.rglob(f"*{suffix}")]
    return suggest(path, known)


def _licence_of(about: metadata.PackageMetadata) -> str | None:
    classifiers = [line.rpartition(" :: ")[2] for line in about.get_all("Classifier") or [] if "License ::" in line]
    licences = [about[key] for key in ("License-Expression", "License") if key in about]
    return next((text.splitlines()[0] for text in (*licences, *classifiers) if text.strip()), None)


def _stated(*folders: Path) -> str | None:
    """Return the licence that a file in one of the folders states; of a text that is not known its first line."""
    for folder in folders:
        for name in _LICENCE_FILES:
            file = folder / name
            if file.is_file():
                text = file.read_text(errors="replace")
                known = [licence for words, licence in _LICENCES.items() if words.lower() in text.lower()]
                return known[0] if known else next((line.strip() for line in text.splitlines() if line.strip()), None)
    return None


# Downloads.


def _downloader(place: str, module: str) -> Any:  # noqa: ANN401 - a module
    package = _PACKAGES[place.partition(":")[0]]
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise RobotError(f"{place} needs its package: pip install {pip_name(package)} ({error}).") from error


def _in_menagerie(name: str) -> Source:
    place = f"{MENAGERIE}:{name}"
    menagerie = _downloader(place, "mujoco_menagerie")
    robot_name, _, entry = name.partition("/")
    known = menagerie.names()
    if robot_name not in known:
        raise RobotError(f"{place}: mujoco-menagerie has no robot {robot_name!r}.{suggest(robot_name, known)}")
    robot = menagerie.get(robot_name)
    if entry and entry not in robot.entry_names:
        raise RobotError(f"{place}: {robot_name} has {', '.join(robot.entry_names)}, not {entry!r}.")
    try:
        # The robot alone: a floor is added where there is none.
        file = Path(robot.xml(entry or robot.default_model))
    except (menagerie.MenagerieError, OSError) as error:
        remedy = f"mujoco-menagerie prefetch {robot_name}, or set MENAGERIE_ROOT to a checkout"
        raise _absent(place, error, remedy) from error
    return Source(file, place, "mujoco-menagerie", menagerie.__version__, robot.license)


def _in_descriptions(name: str) -> Source:
    place = f"{DESCRIPTION}:{name}"
    known = [entry.name for entry in pkgutil.iter_modules(_downloader(place, "robot_descriptions").__path__)]
    if name not in known or not name.endswith("_description"):
        raise RobotError(f"{place}: robot_descriptions has no module {name!r}.{suggest(name, known)}")
    try:
        # To import it is to download it.
        module = importlib.import_module(f"robot_descriptions.{name}")
    except ImportError as error:
        raise RobotError(
            f"{place} needs its package: pip install {pip_name('robot_descriptions')} ({error})."
        ) from error
    except Exception as error:  # of git, of the network, of the system
        remedy = f"robot_descriptions pull {name}, or set ROBOT_DESCRIPTIONS_CACHE to a folder that has it"
        raise _absent(place, error, remedy) from error
    file = getattr(module, "MJCF_PATH", None) or getattr(module, "URDF_PATH", None)
    if file is None:
        raise RobotError(f"{place} has neither an MJCF nor a URDF.")
    if not Path(file).is_file():
        raise RobotError(f"{place}: no file at {file}.")
    # The licence of the robot's folder, or else of the repository that it is from.
    whole = Path(getattr(module, "REPOSITORY_PATH", Path(file).parent))
    licence = _stated(*(folder for folder in Path(file).parents if whole in (folder, *folder.parents)))
    return Source(Path(file), place, "robot_descriptions", metadata.version("robot_descriptions"), licence)


def _absent(place: str, error: Exception, remedy: str) -> RobotError:
    return RobotError(
        f"{place} is not in the cache and cannot be downloaded: {_line(error)}. Where there is a network, get it with "
        f"{remedy}."
    )


def _line(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0].rstrip(".")
