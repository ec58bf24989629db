"""Plant faults in the package and count which of them the tests find: how much a change of the tests has lost.

    python benchmarks/mutations.py out=FILE.json [n=100] [seed=0] [trees=NAME:DIR:PYTHON,...] [full=false]
        [only=GROUP,...] [timeout=600]
    python benchmarks/mutations.py out=FILE.json again=NAME [trees=...] [timeout=600]

A mutant is one small change of the code: another comparison or operator, a number that is off by one, a condition
turned round, a call left out. As many are drawn of each group of modules below, the same for all trees: a tree is a
checkout, and the interpreter of an environment that has what its tests need. Trees may lay out the package differently,
since a place is known by its definition and its statement; what is not in all of them alike is not drawn.

Each mutant is put into a copy of the tree, and the tests that name its module (and those of its room) run until one
fails; with ``full=true``, all others after them. A test that also fails without the mutant does not count. What is
known already is in ``out`` and not run again, so that a run can be broken off.

With ``again=NAME`` the mutants of ``out`` are run against a tree that has changed since: first the file, its nightly
tests too, of the test that found the mutant in the tree of that name, then the others. A mutant whose statement is no
longer in the tree is ``gone``.
"""

from __future__ import annotations

import ast
import copy
import functools
import json
import math
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from common import options

from gctd3.files import write_text

ROOT = Path(__file__).parents[1]
# Modules of the first tree; of the others those that are most like them.
GROUPS = {
    "task": ["gctd3/tasks/*.py"],
    "replay": ["gctd3/data/replay.py", "gctd3/data/frame_buffer.py"],
    "mirror": [
        "gctd3/tasks/reflection.py",
        "gctd3/robots/mirror_*.py",
        "gctd3/robots/model_reflection.py",
        "gctd3/robots/foot_outlines.py",
        "gctd3/robots/random_states.py",
        "gctd3/data/mirror_augmentation.py",
    ],
    "losses": ["gctd3/objectives/*.py", *(f"gctd3/algorithms/{name}.py" for name in ("td3", "sac", "ddpg"))],
    "resume": ["gctd3/training/checkpoint.py", "gctd3/envs/checkpointing.py", "gctd3/files.py"],
    "contract": [f"gctd3/deploy/{name}.py" for name in ("contract", "robot_contract", "policy")],
}
COPIED = (
    "gctd3",
    "conf",
    "models",
    "tests",
    "benchmarks",
    "examples",
    "docs",
    ".ci",
    "*.md",
    "pyproject.toml",
    "LICENSE",
)
DETECTED = ("killed", "timeout")
# Python runs a module of this name first of all: whatever is installed, the package is the copy.
SITE = """
import importlib.util, sys
class Finder:
    @staticmethod
    def find_spec(name, path=None, target=None):
        folders = {{"gctd3": "gctd3", "gctd3.conf": "conf", "gctd3.models": "models"}}
        if name not in folders:
            return None
        folder = {root!r} + "/" + folders[name]
        return importlib.util.spec_from_file_location(
            name, folder + "/__init__.py", submodule_search_locations=[folder]
        )
sys.meta_path.insert(0, Finder)
"""

# What stands for what.
COMPARED: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
REVERSED: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.Gt,
    ast.Gt: ast.Lt,
    ast.LtE: ast.GtE,
    ast.GtE: ast.LtE,
}
COMPUTED: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}
CALLED = [("min", "max"), ("minimum", "maximum"), ("any", "all"), ("floor", "ceil"), ("argmin", "argmax")]
NAMES = {a: b for pair in CALLED for a, b in (pair, pair[::-1])}


@dataclass(frozen=True)
class Site:
    """Describe a place in a file and its replacement.

    Attributes:
        key: Place and change, in words that do not depend on the file and its lines.
        kind: Kind of the change.
        line: Line in the unchanged file.
        span: Start and end, bytes.
        text: Replacement for it.
    """

    key: str
    kind: str
    line: int
    span: tuple[int, int]
    text: str


# Mutants of a file.


def mutations(node: ast.AST) -> Iterator[tuple[str, ast.AST]]:
    """All that can be done to one node: kind, and the node that takes its place."""

    def changed(kind: str, **fields: Any) -> tuple[str, ast.AST]:  # noqa: ANN401
        other = copy.deepcopy(node)
        for name, value in fields.items():
            setattr(other, name, value)
        return kind, other

    if isinstance(node, ast.Compare) and len(node.ops) == 1:
        for table, kind in ((COMPARED, "comparison"), (REVERSED, "comparison turned round")):
            if type(node.ops[0]) in table:
                yield changed(kind, ops=[table[type(node.ops[0])]()])
    elif isinstance(node, (ast.BinOp, ast.AugAssign)) and type(node.op) in COMPUTED and not joins(node):
        yield changed("operator", op=COMPUTED[type(node.op)]())
    elif isinstance(node, ast.BoolOp):
        yield changed("and, or", op=ast.Or() if isinstance(node.op, ast.And) else ast.And())
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        yield "not left out", node.operand
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        yield "sign left out", node.operand
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield changed("truth", value=not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int):
        yield changed("off by one", value=node.value + 1)
    elif isinstance(node, ast.Constant) and isinstance(node.value, float) and math.isfinite(node.value):
        yield changed("number", value=1.25 * node.value if node.value else 1.0)
    elif isinstance(node, ast.Slice):
        for end in ("lower", "upper"):
            value = getattr(node, end)
            # Numbers themselves are changed above.
            if value is not None and not isinstance(value, ast.Constant):
                yield changed("slice off by one", **{end: ast.BinOp(copy.deepcopy(value), ast.Add(), ast.Constant(1))})
    elif isinstance(node, ast.Name) and node.id in NAMES:
        yield changed("least, most", id=NAMES[node.id])
    elif isinstance(node, ast.Attribute) and node.attr in NAMES:
        yield changed("least, most", attr=NAMES[node.attr])
    elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
        yield "call left out", ast.Pass()


def joins(node: ast.BinOp | ast.AugAssign) -> bool:
    """Whether texts are put together, which is seen of those that stand there."""
    parts = [node.left, node.right] if isinstance(node, ast.BinOp) else [node.value]
    return any(
        isinstance(part, ast.JoinedStr) or (isinstance(part, ast.Constant) and isinstance(part.value, str))
        for part in parts
    )


def sites(source: str) -> list[Site]:
    """All mutants of a file that are code: neither its annotations, messages nor the defaults of fields."""
    data = source.encode()
    starts = [0]
    for line in data.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    found: list[Site] = []
    seen: dict[str, int] = {}

    def span(node: Any) -> tuple[int, int]:  # noqa: ANN401 - any node with a place
        return starts[node.lineno - 1] + node.col_offset, starts[node.end_lineno - 1] + node.end_col_offset

    def visit(node: ast.AST, inside: str, statement: str) -> None:
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            inside = f"{inside}.{node.name}" if inside else node.name
        if isinstance(node, ast.stmt) and not isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            # Of a statement with others in it, its head.
            statement = ast.unparse(node).splitlines()[0]
        for kind, other in mutations(node):
            text = ast.unparse(ast.fix_missing_locations(other))
            text = f"({text})" if isinstance(other, ast.expr) and not isinstance(other, (ast.Slice, ast.Name)) else text
            name = f"{inside or 'module'}: {statement} | {kind} | {ast.unparse(node)} -> {text}"
            seen[name] = seen.get(name, 0) + 1
            found.append(Site(f"{name} | {seen[name]}", kind, node.lineno, span(node), text))  # type: ignore[attr-defined]
        for child in children(node):
            visit(child, inside, statement)

    visit(ast.parse(source), "", "")
    return found


def children(node: ast.AST) -> Iterable[ast.AST]:
    """Return the children of a node that are visited."""
    if isinstance(node, (ast.JoinedStr, ast.Raise, ast.Import, ast.ImportFrom, ast.Assert)):
        return []
    if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
        return []
    if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
        return node.body
    if isinstance(node, ast.ClassDef):
        # The defaults of a dataclass stand in YAML as well.
        return [child for child in node.body if not isinstance(child, (ast.AnnAssign, ast.Expr))]
    if isinstance(node, ast.AnnAssign):
        return [node.value] if node.value is not None else []
    if isinstance(node, ast.Call) and ast.unparse(node.func) in ("print", "cast", "TypeVar"):
        return []
    return ast.iter_child_nodes(node)


def mutated(source: str, site: Site) -> str:
    """The file with one mutant."""
    data = source.encode()
    return (data[: site.span[0]] + site.text.encode() + data[site.span[1] :]).decode()


# Trees.


class Tree:
    """A checkout and an environment for it; ``with`` makes its copy.

    Args:
        name: For the table.
        root: Directory of the checkout.
        python: An interpreter for its tests.
    """

    def __init__(self, name: str, root: Path, python: str) -> None:
        self.name, self.root, self.python = name, root.resolve(), python
        self.sites: dict[str, dict[str, Site]] = {}
        self.sound: dict[str, bool] = {}

    def __enter__(self) -> Tree:
        self.copy = Path(tempfile.mkdtemp(prefix=f"mutants-{self.name}-"))
        for pattern in COPIED:
            for path in self.root.glob(pattern):
                ignore = shutil.ignore_patterns("__pycache__", "results")
                if path.is_dir():
                    shutil.copytree(path, self.copy / path.name, ignore=ignore)
                else:
                    shutil.copy(path, self.copy)
        (self.copy / "site").mkdir()
        (self.copy / "site" / "sitecustomize.py").write_text(SITE.format(root=str(self.copy)))
        found = subprocess.run(
            [self.python, "-c", "import gctd3, gctd3.conf; print(gctd3.__file__)"],
            cwd=self.copy,
            env=self.environment(),
            capture_output=True,
            text=True,
        )
        if not found.stdout.startswith(str(self.copy)):
            raise SystemExit(f"{self.python} does not import the copy of {self.root}: {found.stdout}{found.stderr}")
        return self

    def __exit__(self, *_: object) -> None:
        shutil.rmtree(self.copy, ignore_errors=True)

    def environment(self) -> dict[str, str]:
        """Return the tests' environment: the copy comes before the installed package, and no bytecode is written."""
        return {**os.environ, "PYTHONPATH": str(self.copy / "site"), "PYTHONDONTWRITEBYTECODE": "1"}

    def read(self, pattern: str) -> dict[str, dict[str, Site]]:
        """Mutants of the files that a pattern names, by file and key."""
        found = {}
        for path in sorted(self.root.glob(pattern)):
            name = str(path.relative_to(self.root))
            if name not in self.sites:
                self.sites[name] = {site.key: site for site in sites(path.read_text(encoding="utf-8"))}
            found[name] = self.sites[name]
        return found

    @functools.cache  # noqa: B019 - lives as long as the program
    def like(self, keys: frozenset[str]) -> str | None:
        """The file with most of these mutants, if it has half of them."""
        every = self.read("gctd3/**/*.py")
        name = max(every, key=lambda name: len(keys & every[name].keys()), default=None)
        return name if name is not None and 2 * len(keys & every[name].keys()) >= len(keys) > 0 else None

    @functools.cache  # noqa: B019
    def tests(self) -> list[Path]:
        """All test files, small ones first: they are fast more often than not."""
        return sorted((self.copy / "tests").rglob("test_*.py"), key=lambda path: (path.stat().st_size, path))

    def tests_of(self, file: str) -> list[str]:
        """Tests that name a module, then those of its room or with its name, then the rest: two lists."""
        parts = Path(file).with_suffix("").parts
        module = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        words = re.compile(
            rf"\b{re.escape(module)}\b|from {re.escape(module.rpartition('.')[0])} import .*\b{parts[-1]}\b"
        )
        naming = [path for path in self.tests() if words.search(path.read_text(encoding="utf-8"))]
        room = parts[1] if len(parts) > 2 else parts[-1]
        near = [path for path in self.tests() if path.parent.name == room or parts[-1] in path.stem]
        return [str(path.relative_to(self.copy)) for path in dict.fromkeys([*naming, *near])]

    def run(self, tests: list[str], timeout: float, skip: Iterable[str] = (), nightly: bool = False) -> tuple[str, str]:
        """``killed`` and the first test that failed, ``timeout``, or ``survived``."""
        if not tests:
            return "survived", ""
        without = [word for name in skip for word in ("--deselect", name)]
        marked = ["-m", "nightly or not nightly"] if nightly else []
        quiet = ["-x", "-q", "-n", "0", "-p", "no:cacheprovider"]
        line = [self.python, "-m", "pytest", *quiet, *marked, *without, *tests]
        with subprocess.Popen(
            line,
            cwd=self.copy,
            env=self.environment(),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
        ) as running:
            try:
                out, _ = running.communicate(timeout=timeout)
            except subprocess.TimeoutExpired:
                # With all that the tests have started.
                os.killpg(running.pid, signal.SIGKILL)
                running.communicate()
                return "timeout", ""
        if running.returncode in (0, 5):
            return "survived", ""
        # What a test is called with may hold anything, and what it fails with follows behind a dash.
        named = re.findall(r"^(?:FAILED|ERROR) ([^\s\[]+(?:\[.*?\])?)(?: - .*)?$", out, flags=re.M)
        return "killed", named[0] if named else out.strip().splitlines()[-1][:200]

    def find(self, key: str) -> tuple[str, Site] | None:
        """The only file, and the place in it, of a mutant."""
        found = [(file, there[key]) for file, there in self.read("gctd3/**/*.py").items() if key in there]
        return found[0] if len(found) == 1 else None

    def evaluate(self, file: str, site: Site, full: bool, timeout: float, first: Sequence[str] = ()) -> dict[str, Any]:
        """Run the tests on one mutant, files of ``first`` and their nightly tests before all; return the outcome."""
        target = self.copy / file
        source = target.read_text(encoding="utf-8")
        near = self.tests_of(file)
        stages = [near, [str(path.relative_to(self.copy)) for path in self.tests()]] if full else [near]
        # Files that are no longer there found nothing.
        first = [test for test in first if (self.copy / test).is_file()]
        stages = [list(first), *stages] if first else stages
        began, outcome, by, skip = time.monotonic(), "survived", "", set[str]()
        try:
            for stage, tests in enumerate(stages):
                left = [test for test in tests if not any(test in earlier for earlier in stages[:stage])]
                while True:
                    target.write_text(mutated(source, site), encoding="utf-8")
                    outcome, by = self.run(left, timeout, skip, nightly=bool(first) and stage == 0)
                    target.write_text(source, encoding="utf-8")
                    # One that fails again was not left out, so that its name is not what pytest calls it.
                    if outcome != "killed" or by in skip or self.is_sound(by, timeout):
                        break
                    skip.add(by)
                if outcome in DETECTED:
                    break
        finally:
            target.write_text(source, encoding="utf-8")
        stage_name = "all" if full else "near"
        return {"outcome": outcome, "by": by, "tests": stage_name, "seconds": round(time.monotonic() - began, 1)}

    def is_sound(self, test: str, timeout: float) -> bool:
        """Whether a test passes without any mutant; what is no test's name is taken to be the mutant's doing."""
        if "::" not in test:
            return True
        if test not in self.sound:
            self.sound[test] = self.run([test], timeout)[0] == "survived"
        return self.sound[test]


# Drawing.


def draw(trees: list[Tree], groups: Iterable[str], count: int, seed: int) -> list[dict[str, Any]]:
    """Draw equally many mutants of each group, in turn, from the code that all trees share."""
    generator, decks = random.Random(seed), {}
    first, *others = trees
    for group in groups:
        deck: dict[str, dict[str, Any]] = {}
        for pattern in GROUPS[group]:
            for file, there in first.read(pattern).items():
                files = {first.name: file}
                common = set(there)
                for other in others:
                    name = other.like(frozenset(there))
                    common &= set(other.sites[name]) if name else set()
                    files[other.name] = name or ""
                for key in sorted(common):
                    deck[f"{file} {key}"] = {"group": group, "files": files, "key": key, "results": {}}
        names = sorted(deck)
        generator.shuffle(names)
        decks[group] = [deck[name] for name in names]
    drawn: list[dict[str, Any]] = []
    while len(drawn) < count and any(decks.values()):
        drawn += [deck.pop() for deck in decks.values() if deck]
    return drawn[:count]


# The table.


def table(content: dict[str, Any]) -> str:
    """Found of each group by each tree, then what was not found, and what one tree finds and another does not."""
    names, mutants = content["trees"], content["mutants"]
    width = max(map(len, names))
    lines = ["group       " + "  ".join(f"{name:>{max(width, 12)}}" for name in names)]
    for group in [*dict.fromkeys(mutant["group"] for mutant in mutants), "all"]:
        cells = []
        for name in names:
            evaluated = [
                m["results"][name]["outcome"] for m in mutants if group in (m["group"], "all") and name in m["results"]
            ]
            cells.append(f"{sum(outcome in DETECTED for outcome in evaluated)} of {len(evaluated)}")
        lines.append(f"{group:<12}" + "  ".join(f"{cell:>{max(width, 12)}}" for cell in cells))
    for mutant in mutants:
        found = {name: result["outcome"] in DETECTED for name, result in mutant["results"].items()}
        if not all(found.values()):
            said = ", ".join(f"{name}: {mutant['results'][name]['outcome']}" for name in found)
            lines.append(f"\n{said}\n  {mutant['files'][names[0]]}: {mutant['key']}")
    return "\n".join(lines)


def trees_of(said: str) -> list[Tree]:
    """Read trees=."""
    return [Tree(name, Path(root), python) for name, root, python in (tree.split(":") for tree in said.split(","))]


def run_again(out: Path, before: str, trees: Sequence[Tree], timeout: float) -> None:
    """Run the mutants of an earlier table on trees that have changed since."""
    content = json.loads(out.read_text(encoding="utf-8"))
    if before not in content["trees"]:
        raise SystemExit(f"again= must name a tree of {out}: {', '.join(content['trees'])}")
    content["trees"] = list(dict.fromkeys([*content["trees"], *(tree.name for tree in trees)]))
    for tree in trees:
        with tree:
            for number, mutant in enumerate(content["mutants"], 1):
                if tree.name in mutant["results"]:
                    continue
                found, by = tree.find(mutant["key"]), mutant["results"].get(before, {}).get("by", "")
                result: dict[str, Any] = {"outcome": "gone", "by": "", "tests": "near", "seconds": 0.0}
                if found is not None:
                    mutant["files"][tree.name] = found[0]
                    first = [by.partition("::")[0]] if by else []
                    result = tree.evaluate(*found, full=False, timeout=timeout, first=first)
                mutant["results"][tree.name] = result
                write_text(out, json.dumps(content, indent=1) + "\n")
                print(
                    f"{tree.name} {number}/{len(content['mutants'])} {result['outcome']:<9}{result['by']}", flush=True
                )
    print(f"\n{table(content)}")


def main() -> None:
    """Draw, evaluate what is not evaluated yet, and print the table."""
    given = options(
        out="",
        n="100",
        seed="0",
        trees=f"here:{ROOT}:{sys.executable}",
        only=",".join(GROUPS),
        full="false",
        timeout="600",
        again="",
    )
    if not given["out"]:
        raise SystemExit("out=FILE.json is required: it holds what has been evaluated")
    unknown = [name for name in given["only"].split(",") if name not in GROUPS]
    if unknown:
        raise SystemExit(f"no group {', '.join(unknown)}; there are {', '.join(GROUPS)}")
    if given["again"]:
        run_again(Path(given["out"]), given["again"], trees_of(given["trees"]), float(given["timeout"]))
        return
    out, full = Path(given["out"]), given["full"] == "true"
    trees = trees_of(given["trees"])
    drawn = {"seed": int(given["seed"]), "n": int(given["n"]), "only": given["only"], "trees": [t.name for t in trees]}
    if out.exists():
        content = json.loads(out.read_text(encoding="utf-8"))
        other = [key for key, value in drawn.items() if content[key] != value]
        if other:
            raise SystemExit(f"{out} was drawn with other {', '.join(other)}: choose another out=")
    else:
        content = {**drawn, "mutants": draw(trees, given["only"].split(","), drawn["n"], drawn["seed"])}
    for tree in trees:
        with tree:
            for number, mutant in enumerate(content["mutants"], 1):
                known = mutant["results"].get(tree.name)
                # All tests may find what the nearest have not.
                if known and (known["outcome"] in DETECTED or not full or known["tests"] == "all"):
                    continue
                file = mutant["files"][tree.name]
                site = tree.read(file).get(file, {}).get(mutant["key"])
                if site is None:
                    raise SystemExit(
                        f"{tree.root / file} has changed since the mutants were drawn: choose another out="
                    )
                result = tree.evaluate(file, site, full, float(given["timeout"]))
                mutant["results"][tree.name] = result
                write_text(out, json.dumps(content, indent=1) + "\n")
                print(
                    f"{tree.name} {number}/{len(content['mutants'])} {result['outcome']:<9}{result['seconds']:6.0f} s  "
                    f"{file}:{site.line} {site.kind}  {result['by']}",
                    flush=True,
                )
    print(f"\n{table(content)}")


if __name__ == "__main__":
    main()
