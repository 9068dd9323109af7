"""The rooms of the package: imports go one way, and the page about them is complete."""

import ast
import re
from pathlib import Path

import pytest

import dashpot
from dashpot.studies.architecture import NATIVE, WORDS, draw, imports, reduced, storeys

ROOT = Path(dashpot.__file__).parent
PAGE = Path(__file__).parents[1] / "docs/architecture.md"


def test_rooms_import_only_what_lies_below_them():
    edges = imports(ROOT)
    level = storeys(edges)  # refuses a circle
    for room, to in edges.items():
        assert all(level[other] < level[room] for other in to)
    assert level["arm"] < level["control"] < level["simulation"] < level["certify"] < level["design"]
    assert max(level, key=level.get) == "studies"
    assert set(level) == set(WORDS)  # every room has words in the picture
    assert not any("studies" in to for to in edges.values())


def test_a_circle_is_found_and_named():
    with pytest.raises(ValueError, match="a -> b -> c -> a"):
        storeys({"a": {"b"}, "b": {"c"}, "c": {"a"}})


def test_what_follows_is_left_out_and_nothing_else():
    edges = imports(ROOT)

    def reach(of, room):
        return {room}.union(*(reach(of, other) for other in of[room]))

    small = reduced(edges)
    assert sum(map(len, small.values())) < sum(map(len, edges.values()))
    assert all(reach(small, room) == reach(edges, room) for room in edges)
    draw(edges)


def test_every_room_and_public_name_says_what_it_is():
    for room in (path for path in ROOT.iterdir() if (path / "__init__.py").exists()):
        assert ast.get_docstring(ast.parse((room / "__init__.py").read_text())), room.name
    for name in dashpot.__all__:
        assert getattr(getattr(dashpot, name), "__doc__", None), name


def test_the_page_names_files_that_exist():
    text = PAGE.read_text()
    native = PAGE.parents[1] / "native"
    for name in re.findall(r"`(dashpot_\w+)(?:\.[ch])?`", text):
        assert list(native.glob(f"{name}.*")), name
    for path in re.findall(r"`((?:\w+/)+\w*(?:\.py)?)`", text):
        assert (ROOT / path).exists() or (PAGE.parents[1] / path).exists() or (native / path).exists(), path
    sources = {path.stem for path in native.glob("dashpot_*.c")}
    assert sources <= set(re.findall(r"dashpot_\w+", text))
    assert NATIVE in WORDS
