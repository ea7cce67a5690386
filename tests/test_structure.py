"""The shape of the project, read from its source alone: who imports whom, and how long a file is."""

import ast
import sys
from collections import defaultdict
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LIBRARY = "lerobot_gloves"
PACKAGES = {LIBRARY: ROOT / LIBRARY, **{path.parent.name: path.parent for path in ROOT.glob("policies/*/__init__.py")}}
METHOD = {
    "adapter",
    "conformal",
    "editors",
    "flow",
    "generators",
    "networks",
    "faults",
    "perturbations",
    "scores",
    "specification",
}
"""Rooms of the library that are the method: readable with only the paper beside them."""
FLOORS = (
    METHOD | {"system"},
    {"checkpoints", "tasks"},
    {"evaluation"},
    {"recording", "benchmark"},
    {"report"},
    {"demo", "drive"},
    {"commands"},
)
"""Rooms of the library from the ground up: each stands on those below it, and on none beside it but the method."""
LINES = 300


def imports(path: Path, package: Path) -> Iterator[str]:
    """The dotted names that a file of a package imports, wherever in it; of `from a import b` it is `a.b`."""
    inside = [package.name, *path.relative_to(package).parts[:-1]]
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        if isinstance(node, ast.ImportFrom):
            above = inside[: len(inside) - node.level + 1] if node.level else []
            yield from (".".join([*above, *filter(None, [node.module]), alias.name]) for alias in node.names)


def room(name: str) -> str | None:
    """The room that a dotted name is in: a folder or a file of a package's top level, or else what is loaded with it.

    None if it is of no package of ours.
    """
    package, _, rest = name.partition(".")
    if package not in PACKAGES:
        return None
    first = rest.partition(".")[0]
    inside = (PACKAGES[package] / first).is_dir() or (PACKAGES[package] / f"{first}.py").is_file()
    return f"{package}.{first}" if first and inside else package


def edges() -> Iterator[tuple[Path, str, str]]:
    """Every import of the packages: the file, the room that it is in and what it imports."""
    for package in PACKAGES.values():
        for path in sorted(package.rglob("*.py")):
            parts = path.relative_to(package).with_suffix("").parts
            own = package.name if parts == ("__init__",) else f"{package.name}.{parts[0]}"
            yield from ((path.relative_to(ROOT), own, name) for name in imports(path, package))


def cycle(arrows: dict[str, set[str]]) -> list[str]:
    """A way from a node along the arrows back to it; none if there is no such way."""
    try:
        TopologicalSorter(arrows).prepare()
    except CycleError as error:
        return error.args[1][::-1]
    return []


def test_a_circle_is_found():
    assert cycle({"a": {"b"}, "b": {"c"}, "c": {"d"}}) == []
    assert sorted(set(cycle({"a": {"b"}, "b": {"c"}, "c": {"b"}}))) == ["b", "c"]


def test_every_kind_of_import_is_seen(tmp_path):
    path = tmp_path / "room" / "deep" / "file.py"
    path.parent.mkdir(parents=True)
    path.write_text("import a.b\nfrom c import d\ndef f():\n    from ..other import e\n    from . import g\n")
    found = set(imports(path, tmp_path))
    assert found == {"a.b", "c.d", f"{tmp_path.name}.room.other.e", f"{tmp_path.name}.room.deep.g"}
    assert room("lerobot_gloves.editors.feeg.FEEG") == room("lerobot_gloves.editors") == "lerobot_gloves.editors"
    assert (room("lerobot_gloves.flow.endpoint"), room("torch.nn")) == ("lerobot_gloves.flow", None)
    assert room("lerobot_policy_csa_assist.CsaAssistConfig") == "lerobot_policy_csa_assist"


@pytest.mark.parametrize("level", ["packages", "rooms"])
def test_nothing_imports_back_what_imports_it(level):
    arrows, seen = defaultdict(set), 0
    for _, own, name in edges():
        there = room(name)
        if there is None:
            continue
        here, there = (own, there) if level == "rooms" else (own.partition(".")[0], there.partition(".")[0])
        if here != there:
            arrows[here].add(there)
            seen += 1
    assert seen > 30
    assert " -> ".join(cycle(arrows)) == ""


def test_the_method_imports_torch_and_nothing_of_lerobot():
    rooms = {f"{LIBRARY}.{name}" for name in METHOD}
    allowed = {*sys.stdlib_module_names, "torch", "torchvision", "numpy"}
    seen, foreign = set(), []
    for path, own, name in edges():
        if own in rooms:
            seen.add(own)
            if room(name) not in rooms and name.partition(".")[0] not in allowed:
                foreign.append((str(path), name))
    assert seen == rooms and foreign == []


def test_every_arrow_points_down():
    floor = {f"{LIBRARY}.{name}": height for height, names in enumerate(FLOORS) for name in names}
    inside = [(path, own, room(name)) for path, own, name in edges() if own.startswith(f"{LIBRARY}.")]
    arrows = [(str(path), own, there) for path, own, there in inside if there not in (None, own, LIBRARY)]
    assert {room for _, *ends in arrows for room in ends} <= floor.keys() and len(arrows) > 100
    assert [arrow for arrow in arrows if floor[arrow[1]] and floor[arrow[2]] >= floor[arrow[1]]] == []


def test_the_library_never_imports_a_policy():
    assert len(PACKAGES) >= 4
    policies = PACKAGES.keys() - {LIBRARY}
    ours = [(str(path), name) for path, own, name in edges() if own.partition(".")[0] == LIBRARY]
    assert [(path, name) for path, name in ours if name.partition(".")[0] in policies] == []


def test_a_file_that_is_too_long_is_two_files():
    folders = (LIBRARY, "policies", "examples", "scripts", "tests")
    paths = [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]
    lengths = {str(path.relative_to(ROOT)): len(path.read_text().splitlines()) for path in paths}
    assert len(lengths) > 200
    assert {path: length for path, length in lengths.items() if length > LINES} == {}
