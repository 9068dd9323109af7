"""What MkDocs does otherwise than git hosts: links to files outside docs/, and bars in the code of a table.

A page links to ``../examples/own_hardware.py`` as a git host wants it. In the site that file becomes a page
of its own, ``files/examples/own_hardware.html``, made here, and the link points there. So is the page of
commands: what the ``--help`` of each prints.
"""

import contextlib
import html
import io
import os
import posixpath
import re
from pathlib import Path

from mkdocs.structure.files import File

ROOT = Path(__file__).parent.parent
LINK = re.compile(r"(?<=\]\()((?:\.\./)+[^)#\s]+)(?=[)#])")
BARRED = re.compile(r"`([^`\n]*\\\|[^`\n]*)`")
LANGUAGE = {".py": "python", ".toml": "toml", ".xml": "xml", ".c": "c", ".h": "c", ".json": "json"}


def _outside(page: str, link: str) -> Path | None:
    """The repository's file that a page's link leads to, if it lies outside docs/."""
    path = Path(posixpath.normpath(posixpath.join("docs", posixpath.dirname(page), link)))
    return None if path.parts[0] in ("docs", "..") or not (ROOT / path).is_file() else path


def _commands() -> str:
    """Every command by stage, with its help as a terminal of 90 columns shows it."""
    from dashpot.cli import main
    from dashpot.cli.overview import STAGES

    before = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = "90"
    lines = ["# Commands", "", "What `--help` says; [the first page](index.md#the-chain) has the order.", ""]
    for stage, commands in STAGES.items():
        lines += [f"## {stage}", ""]
        for name in commands:
            said = io.StringIO()
            with contextlib.redirect_stdout(said), contextlib.suppress(SystemExit):
                main([name, "--help"])
            lines += [f"### dashpot {name}", "", "````text", said.getvalue().strip(), "````", ""]
    if before is None:
        del os.environ["COLUMNS"]
    else:
        os.environ["COLUMNS"] = before
    return "\n".join(lines)


def on_files(files, config):
    """Adds the page of commands, and a page for every file that a page links to outside docs/."""
    files.append(File.generated(config, "commands.md", content=_commands()))
    found = set()
    for page in files.documentation_pages():
        found |= {
            path for link in LINK.findall(page.content_string) if (path := _outside(page.src_uri, link))
        }
    for path in sorted(found):
        text = (ROOT / path).read_text(encoding="utf-8")
        language = LANGUAGE.get(path.suffix, "text")
        head = f"---\nsearch:\n  exclude: true\n---\n\n# {path.name}\n\n`{path.as_posix()}`\n\n"
        body = f"{head}````{language}\n{text}````\n"
        files.append(File.generated(config, f"files/{path.as_posix()}.md", content=body))
    return files


def on_page_markdown(markdown, page, config, files):
    """Turns such links round to those pages; a table's ``\\|`` within code is a bar without its backslash."""
    here = page.file.src_uri

    def turned(match):
        path = _outside(here, match[1])
        if path is None:
            return match[1]
        return posixpath.relpath(f"files/{path.as_posix()}.md", posixpath.dirname(here) or ".")

    def shown(match):
        return f"<code>{html.escape(match[1]).replace(chr(92) + '|', '&#124;')}</code>"

    return BARRED.sub(shown, LINK.sub(turned, markdown))
