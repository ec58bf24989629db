"""Table of the names that code outside imports."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

from markdown_table import table

import gctd3
from gctd3.config.fields import in_markdown

ROOT = Path(__file__).parents[2]
# Beside those of gctd3 itself, which gctd3/__init__.py lists.
OTHERS = {
    "gctd3.deploy": ("Policy",),
    "gctd3.envs.dmc": ("load",),
    "gctd3.envs.nodes": ("with_nodes",),
    "gctd3.objectives": ("SACLoss", "TD3Loss"),
}


def public_names() -> Iterator[str]:
    """List the names that stay importable, each with the module that defines it."""
    names = [("gctd3", name, home) for name, home in sorted(gctd3._HOME.items())]
    names += [(package, name, package) for package, members in OTHERS.items() for name in members]
    rows = []
    for package, name, home in names:
        file, text = defined(home, name)
        rows.append((f"[`{package}.{name}`](../{file.relative_to(ROOT).as_posix()})", in_markdown(text)))
    yield from table(("name", "what it does"), rows)


def target_names() -> Iterator[str]:
    """List the names for the ``_target_`` of a YAML."""
    rows = []
    for name, home in sorted(gctd3._TARGETS.items()):
        file, text = defined(home, name)
        rows.append((f"[`gctd3.{name}`](../{file.relative_to(ROOT).as_posix()})", in_markdown(text)))
    yield from table(("`_target_`", "what it is"), rows)


def defined(module: str, name: str) -> tuple[Path, str]:
    """Find the file that defines a name, and the first line of its docstring, without importing either."""
    file = ROOT / (module.replace(".", "/") + ".py")
    file = file if file.exists() else ROOT / module.replace(".", "/") / "__init__.py"
    tree = ast.parse(file.read_text(encoding="utf-8"))
    for node in tree.body:
        if isinstance(node, (ast.ClassDef, ast.FunctionDef)) and node.name == name:
            return file, (ast.get_docstring(node) or "").partition("\n")[0]
    # Light packages import names only where types are checked.
    for node in (node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)):
        for imported in node.names:
            if (imported.asname or imported.name) == name:
                return defined(node.module or "", imported.name)
    raise LookupError(f"{module} does not define {name}")


TABLES = {"public-names": public_names, "target-names": target_names}
