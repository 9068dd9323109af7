"""The pages: the navigation, every link, command and program in them, and the site as a whole."""

from __future__ import annotations

import functools
import html
import importlib
import posixpath
import re
import shlex
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
import tyro

import dashpot
from dashpot.cli import main
from dashpot.cli.overview import COMMANDS

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
FENCE = re.compile(r"^(`{3,})(\w*)[^\n]*\n(.*?)^\1 *$", re.M | re.S)
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
DASHPOT = re.compile(r"^(?:\$ )?(?:cd \S+ && )?(?:\.venv/bin/)?dashpot (?=[a-z])(.*)")

pages = pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(ROOT).as_posix())


def prose(text: str) -> str:
    """A page without its code."""
    return re.sub(r"`[^`\n]+`", "", re.sub(r"^( {4}\S.*\n)+", "", FENCE.sub("", text), flags=re.M))


@functools.cache
def anchors(page: Path) -> set[str]:
    """What can be linked to in a page, as MkDocs and git hosts name it."""
    found = set()
    for title in re.findall(r"^#+ (.*)", FENCE.sub("", page.read_text(encoding="utf-8")), re.M):
        words = re.sub(r"[^\w\s-]", "", re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", title)).strip().lower()
        found.add(re.sub(r"\s", "-", words))
    return found


def commands(text: str) -> list[str]:
    """The command lines of dashpot in a page's code."""
    blocks = [body for _, language, body in FENCE.findall(text) if language in ("", "console", "sh", "bash")]
    blocks += [block[0] for block in re.finditer(r"(?<=\n\n)(?: {4}.*\n)+", FENCE.sub("", text))]
    found = []
    for block in blocks:
        lines = re.sub(r"\\\n\s*", " ", block).splitlines()
        found += [match[1] for line in lines if (match := DASHPOT.match(line.strip()))]
    return found


def test_every_page_is_in_the_navigation():
    named = re.findall(r"[\w/.-]+\.md\b", (ROOT / "mkdocs.yml").read_text().split("\nnav:")[1])
    made = ["commands.md"]  # by docs/hooks.py
    assert sorted(named) == sorted([path.relative_to(DOCS).as_posix() for path in PAGES[1:]] + made)


@pages
def test_links_lead_somewhere(page):
    for link in LINK.findall(prose(page.read_text(encoding="utf-8"))):
        if re.match(r"https?:|mailto:", link):
            continue
        target, _, anchor = link.partition("#")
        path = (page.parent / target).resolve() if target else page
        assert path.exists(), link
        assert path.is_relative_to(ROOT), link
        assert not anchor or anchor in anchors(path), link


class ParsedError(Exception):
    """Takes the place of what a command would do."""


@pytest.fixture
def only_parsed(monkeypatch):
    real = tyro.cli

    def cli(*arguments, **options):
        real(*arguments, **options)
        raise ParsedError

    monkeypatch.setattr(tyro, "cli", cli)


@pages
def test_commands_parse(page, only_parsed, capsys):
    for line in commands(page.read_text(encoding="utf-8")):
        words = shlex.split(line, comments=True)
        ends = [i for i, word in enumerate(words) if word in ("|", "&", "&&", ";", ">", "2>")]
        try:
            main(words[: ends[0]] if ends else words)
        except ParsedError:
            continue
        except SystemExit:
            pytest.fail(f"dashpot {line}\n{capsys.readouterr().err}")


def test_commands_and_flags_in_the_text_exist(capsys):
    said = {}
    for page in PAGES:
        for code in re.findall(r"`dashpot ([a-z][^`]*)`", FENCE.sub("", page.read_text(encoding="utf-8"))):
            said.setdefault(code.split()[0], set()).update(re.findall(r"(?<=\s)--[a-z][a-z-]*", code))
    assert len(said) > 10
    for command, flags in said.items():
        with pytest.raises(SystemExit) as ended:
            main([command, "--help"])
        assert ended.value.code == 0, command
        assert flags <= set(re.findall(r"--[a-z][a-z-]*", capsys.readouterr().out)), command


@pages
def test_programs_compile(page):
    for _, language, body in FENCE.findall(page.read_text(encoding="utf-8")):
        if language == "python":
            compile(body, page.name, "exec")


@pages
def test_modules_and_targets_exist(page):
    text = page.read_text(encoding="utf-8")
    for module in re.findall(r"python -m (dashpot[\w.]*\w)", text.replace("\n", " ")):
        assert find_spec(module), module
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.M)
    for target in re.findall(r"`make ([a-z][\w-]*)", text):
        assert target in targets, target


def test_reference_is_complete():
    said = re.findall(r"^::: ([\w.]+)", "\n".join(p.read_text() for p in (DOCS / "api").glob("*.md")), re.M)
    assert len(said) == len(set(said))
    for name in said:
        module, _, attribute = name.rpartition(".")
        assert hasattr(importlib.import_module(module), attribute), name
    places = [name.rpartition(".") for name in said]
    known = {id(getattr(importlib.import_module(module), name)) for module, _, name in places}
    assert [name for name in dashpot.__all__ if id(getattr(dashpot, name)) not in known] == []


@pytest.mark.skipif(not find_spec("mkdocs") or not find_spec("mkdocstrings_handlers"), reason="extra docs")
def test_site_builds_and_needs_no_network(tmp_path):
    site = tmp_path / "site"
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", site],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    built = {path.relative_to(site).as_posix() for path in site.rglob("*") if path.is_file()}
    for page in PAGES[1:]:
        assert page.relative_to(DOCS).with_suffix(".html").as_posix() in built
    assert "search/search_index.js" in built
    said = (site / "commands.html").read_text(encoding="utf-8")
    assert all(f'id="dashpot-{name}"' in said for name in COMMANDS)
    for name in sorted(built):
        if not name.endswith(".html") or name == "404.html":  # that one is for servers
            continue
        text = (site / name).read_text(encoding="utf-8")
        for tag in re.findall(r"<(?:script|link|img|iframe|source)\b[^>]*>", text):
            assert not re.search(r"""(?:src|href)=["']?(?:https?:)?//""", tag), f"{name}: {tag}"
        for link in re.findall(r'<a\b[^>]*\bhref="([^"#:]+\.html)', text):
            path = posixpath.normpath(posixpath.join(posixpath.dirname(name), html.unescape(link)))
            assert path in built, f"{name}: {link}"
